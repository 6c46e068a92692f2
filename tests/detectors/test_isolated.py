"""A detector in a process of its own: the same verdicts, nothing to find, and named failures."""

import copy
import ctypes
import gc
import os
import pickle
import secrets
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import joblib
import numpy as np
import pytest

from spoofgym.bench.runs.panel import generators
from spoofgym.bench.runs.play import WarmStart, play_side_by_side
from spoofgym.core.children import confine_process, list_children
from spoofgym.detectors import Calibrated, Never, PooledDetector, isolated, make_detector
from spoofgym.detectors.base import has_protection_level
from spoofgym.detectors.calibrated import describe_identity
from spoofgym.detectors.isolated import ISOLATED, Isolated, IsolationError, is_foreign, isolate

from ..nightly import heavy
from ..simulation.support import setup_of
from . import cheats
from .support import context, drawn, epoch, judge_all

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="detectors are isolated by forks")
RAMP = {"name": "ramp", "rate_mps": 1.0}
FAILS = "tests.detectors.cheats:Fails"


def same(one, other):
    return all(
        (a is None and b is None) or (a.dtype == b.dtype and a.tobytes() == b.tobytes())
        for a, b in zip(one, other, strict=True)
    )


def epochs(count=12, receivers=5, channels=6):
    rng = np.random.default_rng(3)
    z = drawn(rng, np.broadcast_to(np.eye(2 * channels), (count, receivers, *[2 * channels] * 2)))
    S = np.broadcast_to(np.eye(2 * channels), (receivers, *[2 * channels] * 2))
    return [epoch(each, S)._replace(time=np.full(receivers, 0.5 * k)) for k, each in enumerate(z)]


def judged(detector, seen):
    """Verdicts, with some receivers started again on the way."""
    detector.bind(context(len(seen[0].time), seen[0].visible.shape[1]))
    found = []
    for k, each in enumerate(seen):
        if k == 5:
            detector.reset(np.arange(len(each.time)) % 2 == 0)
        found.append(detector.judge(each))
    return found


def played(detector, entropy=0, spoofer=RAMP, **options):
    setup = setup_of("tightly-coupled", detector=detector)
    rngs = generators(setup, entropy, "evaluation", np.arange(cheats.RUNS))
    start = WarmStart(setup, rngs, threads=1)
    return play_side_by_side(start, [spoofer], **options)[0]


# --- the same verdicts ------------------------------------------------------------------------


@pytest.mark.parametrize("name", heavy(["aime", "ewma", "windowed-chi2"], "ewma", "windowed-chi2"))
def test_verdicts_are_those_of_this_process_to_the_bit(name):
    seen, plain, apart = epochs(), make_detector(name), Isolated(name)
    pairs = zip(judged(plain, seen), judged(apart, seen), strict=True)
    assert all(same(a, b) for a, b in pairs)
    assert (apart.needs, apart.scope, apart.silent_epochs, apart.memory_epochs) == (
        *(plain.needs, plain.scope, plain.silent_epochs, plain.memory_epochs),
    )
    assert describe_identity(apart) == describe_identity(plain)


def test_runs_are_those_of_this_process_when_receivers_are_dropped():
    plain = {"name": "ewma", "false_alarm": 0.02, "thresholds": "nominal"}
    apart = make_detector({"name": ISOLATED, "detector": plain, "thresholds": "nominal"})
    found = [played(each, drop_alarmed=True) for each in (make_detector(plain), apart)]
    np.testing.assert_array_equal(found[0].alarm, found[1].alarm)
    np.testing.assert_array_equal(found[0].position, found[1].position)
    assert found[0].alarm.any()
    assert has_protection_level(apart)  # it may have one: the process says so


def test_a_detector_goes_on_as_a_copy_in_other_threads_and_processes_and_in_a_pool():
    seen, apart = epochs(), Isolated("cusum")
    expected = judged(make_detector("cusum"), seen)
    judged(apart, seen[:4])
    for other in (copy.deepcopy(apart), pickle.loads(pickle.dumps(apart))):
        assert same(other.judge(seen[4]), expected[4])

    def go_on(_):  # as a search does, whose parts begin from the same one
        mine = copy.deepcopy(apart)
        mine.memory.copy_rows(np.arange(5), apart.memory, np.arange(5))
        return mine.judge(seen[4])

    with ThreadPoolExecutor(4) as pool:
        assert all(same(each, expected[4]) for each in pool.map(go_on, range(8)))
    (found,) = joblib.Parallel(n_jobs=2)([joblib.delayed(judged)(Isolated("cusum"), seen)])
    assert all(same(a, b) for a, b in zip(found, expected, strict=True))
    pools = [PooledDetector(each) for each in (["cusum"], [apart])]
    assert all(same(a, b) for a, b in zip(*(judged(each, seen) for each in pools), strict=True))


def test_thresholds_are_scaled_outside_and_states_inside():
    z = drawn(np.random.default_rng(0), np.broadcast_to(np.eye(12), (12, 3, 12, 12)))
    for name in ("snapshot-chi2", "innovation-rate"):
        pair = (Calibrated(each, scale=0.7) for each in (make_detector(name), Isolated(name)))
        assert same(*(judge_all(each, z) for each in pair))


# --- what is foreign --------------------------------------------------------------------------


def test_what_is_foreign_and_how_it_is_isolated():
    class Disguised(cheats.Outsider):
        __module__ = "spoofgym.detectors.chi_square"

    foreign = cheats.Fails()
    assert [*map(is_foreign, (foreign, Disguised(), Calibrated(foreign, 2.0)))] == [True] * 3
    assert not any(map(is_foreign, ("ewma", make_detector("ewma"), Calibrated(Never(), 1.0))))
    assert isolate("ewma") == "ewma"
    spec = isolate({"name": FAILS, "how": "nan", "thresholds": "nominal"}, limit_s=1.0)
    assert spec["detector"] == {"name": FAILS, "how": "nan"}
    assert make_detector(spec).limit_s == 1.0
    inside = isolate(Calibrated(foreign, 2.0)).detector
    assert isinstance(inside, Isolated)
    pool = isolate({"name": "pool", "members": ["ewma", FAILS]})
    assert pool["members"][0] == "ewma"
    assert is_foreign(pool["members"][1]["detector"])
    with pytest.raises(TypeError, match="not calibrated"):
        Isolated(Calibrated(foreign, 2.0))


# --- cheats -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", heavy(["Frames", "Collected", "Memorizer", "Wrapped"], "Wrapped"))
def test_a_cheat_finds_an_attack_in_this_process_and_none_in_its_own(name):
    for apart in (False, True):
        detector = getattr(cheats, name)()
        detector = Isolated(detector) if apart else detector
        cheats.SEEN.clear()
        played(detector, spoofer="none")
        assert played(detector).alarm.any() == (not apart)


def test_memory_of_the_process_above_is_closed_where_the_kernel_has_landlock():
    secret = b"ENTROPY-IS-" + b"%020d" % secrets.randbelow(10**20)
    assert judged(cheats.Proc(), epochs(2))[0].alarm.all()
    if not can_confine():
        pytest.skip("this kernel has no landlock")
    assert not judged(Isolated(cheats.Proc()), epochs(2))[0].alarm.any()
    assert secret


def can_confine():
    script = f"import {confine_process.__module__} as m; print(m.confine_process())"
    return subprocess.check_output([sys.executable, "-c", script]).strip() == b"True"


def test_public_seeds_are_of_no_use_for_runs_of_a_drawn_entropy():
    guard = Isolated("tests.detectors.cheats:PublicSeeds")
    assert played(guard, entropy=3).alarm.any(axis=0).all()
    drawn_here = secrets.randbits(64)
    assert not played(guard, entropy=drawn_here).alarm.any()


# --- failures ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def failing():
    """A detector that fails as the epoch says; its process outlives the forks that fail."""
    return Isolated(FAILS)


def failing_epochs(how):
    seen = epochs()
    for each in seen[2:]:
        each.innovation[:, 1] = cheats.FIRST_WAY + cheats.WAYS.index(how)
    return seen


def test_what_a_detector_writes_to_its_arrays_changes_nothing_outside(failing):
    for detector, written in ((cheats.Fails(), True), (copy.copy(failing), False)):
        seen = failing_epochs("writes")[:3]
        judged(detector, seen)
        assert written != seen[2].innovation.any()


@pytest.mark.parametrize(
    ("how", "reason", "receiver", "message"),
    [
        ("raises", "raises", 3, r"epoch at 1 s, receiver 3 of 5 .* too much \(cheats.py:\d+\)"),
        ("nan", "raises", 2, "epoch at 1 s: `statistic` must be finite, got nan for receiver 2"),
        ("shape", "raises", None, r"epoch at 1 s: `alarm` must have shape \(5, 1\)"),
        ("undeclared", "raises", None, "reads `epoch.design`, None here, without declaring it"),
        ("leaves", "ends", None, "epoch at 1 s of 5 receivers: Fails ended its process"),
        ("quits", "raises", None, "SystemExit: 3"),
        pytest.param(
            *("truncates", "raises", None, "PermissionError"),
            marks=pytest.mark.skipif(sys.platform != "linux", reason="files are sealed by Linux"),
        ),
        ("lies", "raises", None, "no valid answer"),
        ("hangs", "hangs", None, "epoch at 1 s of 5 receivers: Fails took longer than 0.5 s"),
    ],
)
def test_a_failure_is_named_with_epoch_and_receiver(how, reason, receiver, message, failing):
    seen, detector = failing_epochs(how), copy.copy(failing)
    detector.limit_s = 0.5 if how == "hangs" else 60.0
    seen[2].innovation[3, 0] = 99.0
    start = time.monotonic()
    with pytest.raises(IsolationError, match=message) as found:
        judged(detector, seen)
    error = pickle.loads(pickle.dumps(found.value))
    assert (error.reason, error.time_s, error.receiver) == (reason, 1.0, receiver)
    assert time.monotonic() - start < 20.0
    with pytest.raises(IsolationError):  # it has ended
        detector.judge(seen[3])
    judged(detector, seen[:2])  # and may be bound again


def test_a_detector_that_forks_judges_all_the_same(failing):
    check_judges_all_the_same(copy.copy(failing), failing_epochs("forks"))


@pytest.fixture
def idle_init():
    """Orphans of this process's children come to it, which waits for none: they stay as zombies,
    as in a container without an init."""
    prctl, subreaper = ctypes.CDLL(None).prctl, 36
    prctl(subreaper, 1, 0, 0, 0)
    yield
    prctl(subreaper, 0, 0, 0, 0)


@pytest.mark.skipif(sys.platform != "linux", reason="no /proc says how many there are")
def test_one_that_starts_ever_more_processes_is_ended_with_them(failing, monkeypatch, idle_init):
    monkeypatch.setattr(isolated, "PROCESSES", 20)
    monkeypatch.setattr(isolated, "WATCH_S", 0.0)
    detector = copy.copy(failing)
    with pytest.raises(IsolationError, match="Fails has more than 20 processes") as found:
        judged(detector, failing_epochs("swarms"))
    assert (found.value.reason, found.value.time_s) == ("forks", 2.0)
    with pytest.raises(ProcessLookupError):
        os.killpg(detector._bound._host.process.pid, 0)


@pytest.mark.parametrize("how", ["prints", "floods"])
def test_a_detector_that_prints_judges_all_the_same_and_is_cut(how, capfd):
    detector = Isolated({"name": FAILS, "how": how})
    check_judges_all_the_same(detector, epochs())
    del detector  # with the last of what it prints
    gc.collect()
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("a word of the detector\n")
    cut = f"\n{FAILS} has printed {isolated.MOST_PRINTED} bytes: no more is shown\n"
    assert err.count(cut) == (how == "floods")
    assert len(err.removesuffix(cut)) == (isolated.MOST_PRINTED if how == "floods" else 8 * 23)


def check_judges_all_the_same(detector, seen):
    pairs = zip(judged(detector, seen), judged(cheats.Outsider(), seen), strict=True)
    assert all(same(a, b) for a, b in pairs)


def test_its_processes_and_on_linux_copies_in_a_session_of_their_own_end_with_it():
    detector = Isolated({"name": FAILS, "how": "flees"})
    judged(detector, epochs())
    process = detector._host.process
    assert process.poll() is None
    family = list_children(process.pid) if sys.platform == "linux" else []
    assert len(family) >= 2 or sys.platform != "linux"  # of the batch, and those that fled
    del detector
    gc.collect()
    assert process.poll() is not None
    time.sleep(0.2)
    assert not [each for each in family if Path(f"/proc/{each}").exists()]


def test_a_detector_that_cannot_be_loaded_says_why():
    words = "no_such_module:Guard, when loaded, raises .* there is no module 'no_such_module'"
    with pytest.raises(IsolationError, match=words):
        Isolated("no_such_module:Guard")


ENDING_CHILDREN = """
import os, threading, time
from spoofgym.core.children import list_children
for k in range(200):
    if (child := os.fork()) == 0:
        time.sleep(0.001)
        os._exit(0)
    reaper = threading.Thread(target=os.waitpid, args=(child, 0))
    reaper.start()
    while reaper.is_alive():
        assert list_children(child) == []
    reaper.join()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is of Linux")
def test_a_process_may_end_while_its_children_are_listed():
    subprocess.run([sys.executable, "-c", ENDING_CHILDREN], check=True)
