"""The program: its errors, interrupts and ends, and what it prints."""

from __future__ import annotations

import atexit
import errno
import functools
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, redirect_stdout
from pathlib import Path
from typing import Any, NoReturn, ParamSpec, TextIO, TypeVar

import typer
from typer import Option

from ..core.progress import START, ProgressCallback, show_progress

signals: list[int] = []
"""Signals that requested the end of the program."""
reported: list[str] = []
"""What a command has said of its interrupt."""
outputs: list[TextIO] = []
"""Standard output of a command that prints JSON, and nothing else."""
HANDLED_SIGNALS = (signal.SIGINT, signal.SIGTERM)
REPEAT_S = 0.05
"""Until a dropped interrupt is sent again."""
ERRORS = (ValueError, TypeError, ImportError, OSError, RuntimeError, ArithmeticError)
"""Errors whose message is meant for users."""
P = ParamSpec("P")
R = TypeVar("R")
TRACEBACK_VARIABLE = "SPOOFGYM_TRACEBACK"
INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""

app = typer.Typer(
    name="spoofgym",
    help="GNSS spoofing and its detection as a game: a benchmark, for defence research.",
    epilog=f"With {TRACEBACK_VARIABLE}=1 in the environment an error shows where it came from.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def clear_errors(function: Callable[P, R]) -> Callable[P, R]:
    """Print what users did wrong in one line, and leave with exit code 2."""

    @functools.wraps(function)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            with _only_json() if kwargs.get("as_json") else nullcontext():
                return function(*args, **kwargs)
        except (typer.Exit, typer.Abort):  # RuntimeErrors, too
            raise
        except (*ERRORS, SystemExit) as error:
            if os.environ.get(TRACEBACK_VARIABLE) or isinstance(error, BrokenPipeError):
                raise
            text = " ".join(str(error).split())
            if isinstance(error, OSError) and error.filename and error.strerror:
                text = f"{error.filename}: {error.strerror}"
            elif isinstance(error, OSError) and error.errno == errno.ENOSPC:
                text = f"standard output: {error.strerror}"  # files have names (`core.files`)
            elif isinstance(error, SystemExit):
                text = f"a detector, a spoofer or their module raises SystemExit({error.code!r})"
            typer.echo(f"spoofgym: error: {text}", err=True)
            raise typer.Exit(2) from error
        except KeyboardInterrupt as error:
            if not str(error):
                raise
            reported.append(str(error))  # what is finished
            typer.echo(f"spoofgym: {error}", err=True)
            raise typer.Exit(INTERRUPTED) from error

    return wrapper


@app.callback(invoke_without_command=True)
def _main(version: bool = Option(False, "--version", help="Print the version.")) -> None:
    """GNSS spoofing and its detection as a game: a benchmark, for defence research."""
    if version:
        from .. import __version__

        typer.echo(__version__)
        raise typer.Exit


def _interrupt(number: int, _: Any) -> None:
    signals.append(number)
    raise KeyboardInterrupt


def _repeat_interrupt(lost: sys.UnraisableHookArgs) -> None:
    """Interrupt again, once this returns, where Python drops an interrupt: within a `__del__`."""
    if signals and issubclass(lost.exc_type, KeyboardInterrupt):
        repeat = threading.Timer(REPEAT_S, os.kill, (os.getpid(), signals[0]))
        repeat.daemon = True
        repeat.start()
    else:
        sys.__unraisablehook__(lost)


def _leave(code: int) -> NoReturn:
    """End the process without taking the interpreter down, which an interrupt's thread in compiled
    code could abort, and the exit code with it; another interrupt ends it at once. Files are whole
    or absent (`core.files`), and exit hooks, such as of threads and temporary folders, are run."""
    try:
        for number in HANDLED_SIGNALS:
            if signal.getsignal(number) is _interrupt:
                signal.signal(number, signal.SIG_DFL)
        if not reported:
            typer.echo("spoofgym: interrupted", err=True)
        atexit._run_exitfuncs()
        for stream in (sys.stderr, sys.stdout):
            stream.flush()
    finally:
        os._exit(code)


def main() -> None:
    """Run the command line; Ctrl-C and SIGTERM end it in order, with 130 and 143."""
    for number in HANDLED_SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:  # as in the background of a shell
            signal.signal(number, _interrupt)
    sys.unraisablehook = _repeat_interrupt
    try:
        app()
    finally:
        if signals:
            _leave(128 + signals[0])


@contextmanager
def _only_json() -> Iterator[None]:
    """Leave standard output to `print_json`: what a detector prints goes to standard error."""
    outputs.append(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        outputs.pop()


def print_json(value: Any) -> None:
    """Print JSON; neither NaN nor infinity is."""
    typer.echo(json.dumps(value, indent=2, allow_nan=False), file=outputs[-1] if outputs else None)


def print_lines(lines: Iterable[str]) -> None:
    """Print some lines, or nothing."""
    for line in lines:
        typer.echo(line)


def can_draw(out: Path, others: Iterable[str] = ()) -> bool:
    """Whether there is matplotlib; a line says so where not. An ending must be valid."""
    from ..core.plots import check_picture

    try:
        check_picture(out, others)
    except ImportError as error:
        typer.echo(f"no picture: {error}", err=True)
        return False
    return True


def print_written(files: Sequence[Path]) -> None:
    """Say which files were written, if any."""
    if files:
        typer.echo(f"written: {', '.join(map(str, files))}")


def progress(total: float) -> AbstractContextManager[ProgressCallback]:
    """Show how far a command is, until it ends."""
    return show_progress(total, start=START, interrupted=lambda: signals)
