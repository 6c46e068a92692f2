"""What all tests share: the folder of real data, and a count of the tests that read it."""

from __future__ import annotations

import gc
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import hypothesis
import pytest

# Threads of BLAS wait for each other by turning: beside other processes that takes many times the
# products of these small matrices.  Before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
from numba.core import event

from spoofgym.core import progress

# The first example may compile a kernel, which no deadline allows for; the same code draws the
# same examples everywhere.
hypothesis.settings.register_profile("spoofgym", deadline=None, derandomize=True)
hypothesis.settings.load_profile("spoofgym")
# its assertions show their values, as those of a test
pytest.register_assert_rewrite("tests.command_line")

DATA_VARIABLE = "SPOOFGYM_DATA"
TESTS = Path(__file__).parent
FIRST = (
    "golden/test_trajectories.py",  # compiles nearly all that others load from the cache
    "agents/",  # and for other processes meanwhile, what needs little of it
    "core/test_compile.py",
    "data/",
    "conformance/test_compiled.py",
    "conformance/test_docstrings.py",
    "conformance/test_detectors.py",
    "train/",  # the longest, so that no process ends with one by itself
    "test_cli.py",
    "test_cli_shipped.py",
    "test_cli_warmup.py",
    "test_interrupts.py",
    "baselines/",
    "papers/",
    "conformance/test_envs.py",
)
"""Files in the order in which processes take them; then all others."""
# Before anything imports matplotlib: Gymnasium's checks open windows, and there may be no display.
WINDOW = "module://tests.window"
os.environ["MPLBACKEND"] = WINDOW


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--interrupts", type=int, default=20, help="moments of an interrupt")
    parser.addoption("--nightly", action="store_true", help="also the long lists, marked nightly")


@pytest.fixture(autouse=True)
def _window_of_the_tests() -> Iterator[None]:
    """Take back matplotlib's backend where a program under test has chosen one for its process."""
    yield
    matplotlib = sys.modules.get("matplotlib")
    if matplotlib is not None and matplotlib.get_backend() != WINDOW:
        matplotlib.use(WINDOW)


@pytest.fixture(autouse=True, scope="module")
def _torch_threads() -> Iterator[None]:
    """Put back the number of torch's threads, which trainings set for their process."""
    torch = sys.modules.get("torch")
    before = torch.get_num_threads() if torch is not None else 0
    yield
    if torch is not None:
        torch.set_num_threads(before)


@pytest.fixture
def bars(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, list[float]]]:
    """Bars that a terminal would have shown: the work that each expects, and reports of it."""
    found: list[tuple[float, list[float]]] = []

    @contextmanager
    def show(total: float, **_: str) -> Iterator[SimpleNamespace]:
        found.append((total, []))
        yield SimpleNamespace(advance=lambda amount, now: found[-1][1].append(amount))

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(progress, "show_progress", show)
    return found


def pytest_configure(config: pytest.Config) -> None:
    """Let detectors without a word on their thresholds have the nominal ones.

    Most tests play worlds that are too short and too many to be calibrated; those of the pages, and
    those that ask for `default_rate`, play as users do.  What tests calibrate all the same goes to
    a folder that all their processes share, and that ends with them.  So does bytecode where no
    process may write it beside the sources: every child would make it again.
    """
    from spoofgym.detectors import calibrated
    from spoofgym.detectors.calibration_file import FOLDER_VARIABLE

    calibrated.DEFAULT_RATE = None
    if not hasattr(config, "workerinput"):
        os.environ[FOLDER_VARIABLE] = folder = tempfile.mkdtemp(prefix="calibrations-")
        if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
            os.environ["PYTHONPYCACHEPREFIX"] = f"{folder}/bytecode"
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))


def _default_rate() -> Iterator[float]:
    """The rate of false alarms that users have by default."""
    from spoofgym.detectors import calibrated

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibrated, "DEFAULT_RATE", calibrated.STANDARD_RATE)
        yield calibrated.STANDARD_RATE


default_rate = pytest.fixture(_default_rate, name="default_rate")
default_rate_of_module = pytest.fixture(
    _default_rate, scope="module", name="default_rate_of_module"
)
"""The same, for fixtures that live as long as a module."""


@pytest.fixture
def in_tmp_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run in a folder of the test's own, where commands may write."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True, scope="session")
def _no_word_of_compiling() -> None:
    """In which test the notice would appear on stderr depends on the machine and the order."""
    from spoofgym.core import compile as compiling

    compiling.NOTICE_S = math.inf


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of real data; a test that asks for it is skipped where there is none."""
    checkout = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get(DATA_VARIABLE) or checkout.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"no data in {folder} (set {DATA_VARIABLE})")
    return folder


class _Compiled(event.Listener):
    def on_start(self, happened: event.Event) -> None:
        name = happened.data["dispatcher"].py_func.__qualname__
        pytest.fail(f"{name} is compiled while tests are collected, in every process at once")

    def on_end(self, happened: event.Event) -> None:
        pass


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Refuse a file that plays where it is imported; a test does it in one process, and later.

    What is imported stays: Python's collector looks for garbage among all else (8 of 34 CPU s).
    """
    gc.disable()
    try:
        with event.install_listener("numba:compile", _Compiled()):
            return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()


def place_of(item: pytest.Item) -> int:
    path = item.path.relative_to(TESTS).as_posix()
    return next((k for k, start in enumerate(FIRST) if path.startswith(start)), len(FIRST))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Order the files, mark the users of `data_folder` before -m selects, leave nightly tests out.

    They are in where ``--nightly`` is given, or -m names them; another -m does not bring them in.
    """
    if not (config.getoption("nightly") or "nightly" in config.getoption("markexpr")):
        nightly = [item for item in items if item.get_closest_marker("nightly")]
        config.hook.pytest_deselected(items=nightly)
        items[:] = [item for item in items if item not in nightly]
    items.sort(key=place_of)  # and else as they were found
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
