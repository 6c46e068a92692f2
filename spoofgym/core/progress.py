"""How far something is: what reports it, and the one bar that shows it."""

from __future__ import annotations

import functools
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol

from . import threads as _threads

REFRESH_S = 0.1  # how often the time in a bar is drawn
NAME = 64  # letters of what is going on that a line shows
START = "compiling, a minute the first time"
FORETOLD = 0.02  # part that is done before the time left is worth a line
PART_S, LINE_S = 10.0, 60.0
"""Least times between lines where there is no terminal, before another part and within one."""


class ProgressCallback(Protocol):
    """Is called with work that is done."""

    def advance(self, amount: float, now: str) -> None:
        """Add an amount of work; `now` says what is going on."""


ProgressBar = Callable[[float], AbstractContextManager[ProgressCallback]]  # of a total of work


class NullProgress:
    """Shows nothing."""

    def advance(self, amount: float, now: str) -> None:
        """Ignore it."""


def no_progress(_: float) -> AbstractContextManager[ProgressCallback]:
    """Open a bar that shows nothing."""
    return nullcontext(NullProgress())


class RemainingWork:
    """Reports one piece of work, never more than was expected, and the rest at its end."""

    def __init__(self, progress: ProgressCallback, expected: float, now: str) -> None:
        self._progress, self._left, self._now = progress, expected, now

    def tick(self, amount: float) -> None:
        amount = min(amount, self._left)
        self._left -= amount
        self._progress.advance(amount, self._now)

    def end(self) -> None:
        self.tick(self._left)


class _Bar:
    def __init__(self, update: Callable[..., None], interrupted: Callable[[], object]) -> None:
        self._update, self._interrupted = update, interrupted

    def advance(self, amount: float, now: str) -> None:
        """Show it; end here where an interrupt was lost, as in a destructor."""
        if self._interrupted():
            raise KeyboardInterrupt
        if amount > 0.0:
            self._update(advance=amount, description=now)


class _Lines:
    """Prints how far it is, now and then, and how long it has to go."""

    def __init__(self, total: float, now: str) -> None:
        self._total, self._done, self._now = total, 0.0, now
        self._start = self._last = time.monotonic()

    def update(self, advance: float, description: str) -> None:
        self._done += advance
        now = time.monotonic()
        if now - self._last >= (LINE_S if description == self._now else PART_S):
            self._now, self._last, passed = description, now, now - self._start
            part = min(self._done / self._total, 1.0)
            times = f"{passed:.0f} s"
            if part >= FORETOLD:
                times += f", some {passed * (1.0 - part) / part:.0f} s left"
            label = description if len(description) <= NAME else f"{description[: NAME - 4]} ..."
            print(f"{label}: {100.0 * part:.0f} %, {times}", file=sys.stderr, flush=True)


def show_on_terminal(total: float) -> AbstractContextManager[ProgressCallback]:
    """Open the bar where stderr is a terminal: what long functions do that are given none."""
    shown = sys.stderr is not None and sys.stderr.isatty()
    return show_progress(total, start=START) if shown else no_progress(total)


@contextmanager
def show_progress(
    total: float, *, start: str = "", interrupted: Callable[[], object] = lambda: False
) -> Iterator[ProgressCallback]:
    """Show a bar on stderr until the block ends, or, where that is no terminal, a line now and
    then; `interrupted` reports a lost Ctrl-C."""
    import rich.progress as bars
    from rich.console import Console

    if not Console(stderr=True).is_terminal:
        yield _Bar(_Lines(max(total, 1e-9), start).update, interrupted)
        return
    shown = bars.Progress(
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.TextColumn("{task.percentage:3.0f} %"),
        bars.TimeElapsedColumn(),
        bars.TextColumn("left"),
        bars.TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        redirect_stdout=sys.stdout.isatty(),  # what is printed meanwhile stays on stdout
        auto_refresh=False,  # its thread is one that nothing waits for
    )
    task = shown.add_task(start, total=max(total, 1e-9))
    over = threading.Event()

    def refresh() -> None:
        while not over.wait(REFRESH_S):
            shown.refresh()

    with shown:
        thread = _threads.start(refresh, over.set, "spoofgym-progress")
        try:
            yield _Bar(functools.partial(shown.update, task), interrupted)
        finally:
            over.set()
            thread.join()
