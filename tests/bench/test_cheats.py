"""Audits of detectors that cheat: in a process of their own they score as `never` does."""

import secrets
import time

import pytest

import spoofgym
from spoofgym.detectors.isolated import ISOLATED, IsolationError

from ..detectors import cheats
from ..detectors.test_isolated import can_confine
from ..nightly import heavy
from .detector_support import NOMINAL, small_task

SIZES = {"runs": cheats.RUNS, "selection_runs": 4, "families": ["ramps"], "threads": 1}
TRICKS = {
    "frames": "Frames",
    "collected objects": "Collected",
    "a wrapper around a stand-in": "Wrapped",
    "public seeds": "PublicSeedsOfTask",
    "memory of processes": "ProcOfTask",
}
FIGURES = "p_hmi", "exceeded_m", "false_alarms_per_hour"


def audited(detector, entropy):
    with pytest.MonkeyPatch.context() as patch:  # their contract is not what is in question
        patch.setattr("spoofgym.testing.detector.check_detector", lambda judge: None)
        found = spoofgym.audit(detector, small_task(), "quick", entropy=entropy, **SIZES)
    return found.as_dict()


def apart(name, **settings):
    return {"name": f"{cheats.__name__}:{name}", **settings, **NOMINAL}


@pytest.fixture(scope="module")
def drawn():
    """Entropy of the runs, which is marked in the memory of this process, and figures of `never`
    on them."""
    entropy = secrets.randbits(32)
    marked = b"ENTROPY-IS-%020d" % entropy
    yield entropy, audited("never", entropy)
    assert marked


def check_scores_as_never(detector, drawn):
    entropy, never = drawn
    mine = audited(detector, entropy)
    assert {name: mine[name] for name in FIGURES} == {name: never[name] for name in FIGURES}


@pytest.mark.parametrize("trick", heavy(TRICKS, *[each for each in TRICKS if each != "frames"]))
def test_a_cheat_scores_better_in_this_process_and_as_never_does_in_its_own(trick, drawn):
    if trick == "memory of processes" and not can_confine():
        pytest.skip("this kernel has no landlock")
    check_scores_as_never(apart(TRICKS[trick]), drawn)
    cheats.SEEN.clear()
    entropy, never = drawn
    known = 3 if trick == "public seeds" else entropy
    here = audited(getattr(cheats, TRICKS[trick])(), known)
    assert here["exceeded_m"]["0.5"]["value"] < 0.5 * never["exceeded_m"]["0.5"]["value"]


def test_one_that_compares_attacks_on_the_same_runs_is_warned_of(drawn):
    words = "two calls on the same epochs differ"
    assert any(text.startswith(words) for text in audited(apart("Memorizer"), drawn[0])["warnings"])


@pytest.mark.nightly
def test_what_is_written_to_an_epoch_changes_no_score(drawn):
    check_scores_as_never(apart("Fails", how="writes"), drawn)


def test_one_that_hangs_costs_an_audit_its_time_limit():
    hangs = {"name": f"{cheats.__name__}:Fails", "how": "hangs"}
    spec = {"name": ISOLATED, "detector": hangs, "limit_s": 1.0, **NOMINAL}
    begun = time.monotonic()
    with pytest.raises(IsolationError, match=r"epoch at .* s of .* took longer than 1 s"):
        audited(spec, 0)
    assert time.monotonic() - begun < 20.0
