"""Files of which a function runs during a whole command, in the order of their first calls.

    python -m tools.walk -- bench --detector ewma --runs 4 --jobs 1 --out TMP
    python -m tools.walk --call "spoofgym.evaluate('ramp', task='T2', runs=10)"

A module that is imported only then does not count: all of them are imported beforehand.  Other
processes are not seen, hence `--jobs 1`.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import pkgutil
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import CodeType, FrameType
from typing import Annotated, Any

import typer

import spoofgym

ROOT = Path(spoofgym.__file__).parent


def import_all() -> None:
    for module in pkgutil.walk_packages([str(ROOT)], "spoofgym."):
        if not module.name.endswith("__main__"):
            with contextlib.suppress(ImportError):
                importlib.import_module(module.name)


@contextlib.contextmanager
def called_files() -> Iterator[dict[str, None]]:
    """Paths within the package of all functions that Python calls meanwhile, in any thread."""
    found: dict[str, None] = {}
    known: set[CodeType] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event != "call" or code in known:
            return
        known.add(code)
        file = Path(code.co_filename)
        if code.co_name != "<module>" and file.is_relative_to(ROOT):
            found.setdefault(file.relative_to(ROOT).as_posix())

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield found
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]


def walk(work: Callable[[], object], packages: list[str]) -> dict[str, list[str]]:
    with called_files() as found:
        work()
    return {name: [file for file in found if file.startswith(f"{name}/")] for name in packages}


def run_command(words: list[str]) -> None:
    code = importlib.import_module("spoofgym.cli").app(words, standalone_mode=False)
    if code:
        raise typer.Exit(code)


def main(
    words: Annotated[list[str] | None, typer.Argument(help="A command of spoofgym.")] = None,
    call: Annotated[str, typer.Option(help="A Python expression in its place.")] = "",
    package: Annotated[list[str], typer.Option(help="Parts of spoofgym.")] = ["bench", "cli"],  # noqa: B006
    as_json: Annotated[bool, typer.Option("--json", help="JSON in place of a list.")] = False,
) -> None:
    """Run a command or an expression, and list the files that it goes through."""
    if bool(words) == bool(call):
        raise typer.BadParameter("name either a command, after `--`, or an expression, by --call")
    import_all()
    work = partial(eval, call, {"spoofgym": spoofgym}) if call else partial(run_command, words)
    with contextlib.redirect_stdout(sys.stderr):
        found = walk(work, package)
    files = [file for part in found.values() for file in part]
    total, templates = len(files), sum(not file.endswith(".py") for file in files)
    if as_json:
        typer.echo(json.dumps({"files": found, "total": total, "templates": templates}, indent=1))
        return
    for name, part in found.items():
        typer.echo("\n".join([f"{name}: {len(part)} files", *(f"  {file}" for file in part)]))
    typer.echo(f"{total} files in all ({templates} of them templates)")


if __name__ == "__main__":
    typer.run(main)
