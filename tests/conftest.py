"""What all tests share: the folder of real data, and a count of the tests that read it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

# The first example may compile a kernel, which no deadline allows for; the same code draws the
# same examples everywhere.
hypothesis.settings.register_profile("spoofgym", deadline=None, derandomize=True)
hypothesis.settings.load_profile("spoofgym")

DATA_VARIABLE = "SPOOFGYM_DATA"
# Before anything imports matplotlib: Gymnasium's checks open windows, and there may be no display.
WINDOW = "module://tests.window"
os.environ["MPLBACKEND"] = WINDOW


@pytest.fixture(autouse=True)
def _window_of_the_tests() -> Iterator[None]:
    """Take back matplotlib's backend where a program under test has chosen one for its process."""
    yield
    matplotlib = sys.modules.get("matplotlib")
    if matplotlib is not None and matplotlib.get_backend() != WINDOW:
        matplotlib.use(WINDOW)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of real data; a test that asks for it is skipped where there is none."""
    checkout = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get(DATA_VARIABLE) or checkout.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"no data in {folder} (set {DATA_VARIABLE})")
    return folder


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the users of `data_folder`, before -m selects by marker."""
    for item in items:
        if "data_folder" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.data)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many data tests ran: a skipped one shows nothing, and should not look green."""
    ran: set[str] = set()
    skipped: set[str] = set()
    for outcome, reports in terminalreporter.stats.items():
        ids = {report.nodeid for report in reports if "data" in getattr(report, "keywords", ())}
        if outcome == "skipped":
            skipped |= ids
        elif outcome in {"passed", "failed", "error", "xfailed", "xpassed"}:
            ran |= ids
    terminalreporter.write_line(f"data tests: {len(ran)} ran, {len(skipped)} skipped")
