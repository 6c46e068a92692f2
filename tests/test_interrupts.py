"""Ctrl-C, SIGTERM, errors and ends at random moments: an exit code in time, and results that go on.

Some moments are tried always, others by `make test-nightly`; ``--interrupts 200`` tries more.
"""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from spoofgym.cli import app
from spoofgym.cli.app import progress
from spoofgym.core import threads as _threads
from tests.nightly import heavy

SEED = 10
USUAL = 1  # moments that are tried always
IN_TIME_S = 10.0 if os.getloadavg()[0] <= (os.cpu_count() or 1) else 300.0
"""On a machine that does nothing else; what is looked for under load is one that never ends."""
TIMES = ["--warmup-s", "20", "--live-s", "10", "--attack-s", "60", "--time-to-alert-s", "5"]
CHOSEN = ["--detector", "ewma", "--spoofer", "none", "--spoofer", "ramp"]
SIZE = ["--training-runs", "48", "--alarm-budget", "0.25", "--runs", "96", "--threads", "2"]
SIZE += ["--nominal", "--selection-runs", "0", "--set", "domain={}"]
BENCH = ["bench", *TIMES, *CHOSEN, *SIZE]
ENVIRONMENT = """
import itertools, random, sys, time
from spoofgym.envs import SpoofVectorEnv

times = {"warmup_s": 100.0, "live_s": 50.0, "attack_s": 5.0, "time_to_alert_s": 1.0}
detector = {"name": "ewma", "thresholds": "nominal"}
envs = SpoofVectorEnv(64, threads=2, timeline=times, detector=detector)
envs.reset(seed=1)
print("begun", flush=True)
end, lasting_s = sys.argv[1], float(sys.argv[2])
began = time.monotonic()
for _ in itertools.count():
    envs.step(envs.action_space.sample())
    if end != "interrupt" and time.monotonic() - began > lasting_s:
        break
if end == "error":
    raise ArithmeticError("on purpose")
"""
AFTER_THE_INTERPRETER = """
import atexit, ctypes, os, signal, sys
from spoofgym.cli import app, main

# a call that is none any more without an interpreter, as of a thread that comes back too late
late = ctypes.cast(ctypes.pythonapi.PyThreadState_Get, ctypes.c_void_p)
assert ctypes.pythonapi.Py_AtExit(late) == 0
atexit.register(print, "hook", end="")


@app.command()
def interrupted() -> None:
    print("kept", end=" ")
    os.kill(os.getpid(), number)


number = signal.Signals[sys.argv[1]]
sys.argv[1:] = ["interrupted"]
main()
"""
WITHIN_A_DEL = """
import os, signal, sys, time
from spoofgym.cli.app import app, main

class Closed:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)

@app.command()
def closes():
    Closed()
    time.sleep(60.0)
    print("it was dropped")

sys.argv[1:] = ["closes"]
main()
"""
# as the processes that they start
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("default_rate")]


def pytest_generate_tests(metafunc):
    if "moment" in metafunc.fixturenames:
        moments = range(metafunc.config.getoption("--interrupts"))
        metafunc.parametrize("moment", heavy(moments, *moments[USUAL:]))


def started(*arguments, folder):
    """A child that hears Ctrl-C, also where these tests themselves don't."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    command = [sys.executable, "-X", "faulthandler", *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    try:
        return subprocess.Popen(command, cwd=folder, **pipes)
    finally:
        signal.signal(signal.SIGINT, before)


def code_of(process, within_s):
    """Exit code as a shell has it, and what was said."""
    try:
        _, said = process.communicate(timeout=within_s)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGABRT)  # faulthandler prints where all threads are
        _, said = process.communicate()
        pytest.fail(f"it has not ended within {within_s:g} s: {said.decode()}")
    code = process.returncode
    return (code if code >= 0 else 128 - code), said.decode()


def wait_for(path, process):
    while not path.exists() and process.poll() is None:
        time.sleep(2e-3)


def cells_of(out):
    return {path.name: path.read_bytes() for path in sorted((out / "cells").glob("*.npz"))}


def play_here(out):
    done = CliRunner().invoke(app, [*BENCH, "--out", str(out)])
    assert done.exit_code == 0, done.output
    return cells_of(out)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, default_rate_of_module):
    """Results of a campaign that nothing interrupts, and how long it takes."""
    folder = tmp_path_factory.mktemp("whole")
    began = time.monotonic()
    cells = play_here(folder)  # which may compile
    assert len(cells) == 5  # a search, runs of two, a bound and the floor
    return cells, time.monotonic() - began


def test_a_campaign_ends_at_any_moment_and_goes_on(moment, whole, tmp_path):
    expected, running_s = whole
    rng = np.random.default_rng([SEED, moment])
    number = signal.SIGTERM if rng.random() < 0.3 else signal.SIGINT
    out = tmp_path / "out"
    process = started("-m", "spoofgym", *BENCH, "--out", str(out), folder=tmp_path)
    if rng.random() < 0.15:
        time.sleep(rng.random() * 3.0)  # while it starts
    else:
        wait_for(out / "config.json", process)
        finished = int(rng.integers(len(expected)))
        while process.poll() is None and len(cells_of(out)) < finished:
            time.sleep(2e-3)
        time.sleep(rng.random() * running_s / len(expected))
    process.send_signal(number)
    code, said = code_of(process, IN_TIME_S)
    assert code == 128 + number or (code == 0 and (out / "report.html").exists()), said
    assert cells_of(out).items() <= expected.items()
    assert play_here(out) == expected


@pytest.mark.parametrize(
    ("end", "expected", "fraction"), [("interrupt", 130, 0.3), ("error", 1, 0.1), ("end", 0, 0.5)]
)
def test_an_environment_with_warm_ups_in_the_background_ends(end, expected, fraction, tmp_path):
    process = started("-c", ENVIRONMENT, end, str(fraction), folder=tmp_path)
    assert process.stdout is not None
    assert process.stdout.readline() == b"begun\n"
    time.sleep(fraction)
    if end == "interrupt":
        process.send_signal(signal.SIGINT)
    code, said = code_of(process, IN_TIME_S)
    assert code == expected, said


@pytest.mark.parametrize(
    ("program", "number", "printed"),
    [
        (AFTER_THE_INTERPRETER, signal.SIGINT, b"kept hook"),
        (AFTER_THE_INTERPRETER, signal.SIGTERM, b"kept hook"),
        (WITHIN_A_DEL, signal.SIGINT, b""),
    ],
)
def test_an_interrupt_ends_the_program_before_the_interpreter_and_is_not_dropped(
    program, number, printed, tmp_path
):
    process = started("-c", program, number.name, folder=tmp_path)
    found, said = process.communicate(timeout=120.0)
    assert process.returncode == 128 + number, said.decode()
    assert (found, said) == (printed, b"spoofgym: interrupted\n")


def test_progress_leaves_no_thread_that_nobody_waits_for(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    before = set(threading.enumerate())
    with progress(1.0) as bar:
        bar.advance(0.5, "half")
        assert set(threading.enumerate()) - before
        _threads.end_all()
        assert not set(threading.enumerate()) - before


@pytest.mark.parametrize("start", [["-m", "spoofgym"], ["spoofgym"]], ids=["module", "script"])
def test_an_interrupt_while_packages_are_imported_is_one_line(start, tmp_path):
    (tmp_path / "gymnasium").mkdir()  # in place of a slow one
    (tmp_path / "gymnasium/__init__.py").write_text(
        "print('importing', flush=True)\nimport time\ntime.sleep(60)"
    )
    script = tmp_path / "spoofgym"
    script.write_text("from spoofgym.cli import main\nmain()\n")
    words = start if start[0] == "-m" else [str(script)]
    path = os.pathsep.join(
        [str(tmp_path / ".."), str(tmp_path), os.environ.get("PYTHONPATH", ""), os.getcwd()]
    )
    process = subprocess.Popen(
        [sys.executable, *words, "list"],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # as from a terminal
    )
    assert process.stdout.readline() == "importing\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=IN_TIME_S)
    assert (process.returncode, errors) == (130, "spoofgym: interrupted\n")
