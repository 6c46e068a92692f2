"""Zero-alarm bounds over the worlds of a setup."""

import json
from dataclasses import replace

import numpy as np
import pytest

from spoofgym.detectors import make_detector
from spoofgym.limits import Bound, Replay, bounds
from spoofgym.limits.bounds import draw_worlds, zero_alarm_bounds
from spoofgym.limits.no_alarm import Timing, judge_run
from spoofgym.simulation import LooselyCoupledSetup, TightlyCoupledSetup
from spoofgym.simulation.setup import seeds_of_runs

LINE = {"warmup_s": 60.0, "live_s": 30.0, "attack_s": 30.0, "time_to_alert_s": 5.0}
SKY = {"turned_deg": (0.0, 360.0), "constellation_time_s": (0.0, 86_400.0), "worlds": 4}


def setup_of(**settings):
    return TightlyCoupledSetup(**{"detector": "never", "timeline": LINE, **settings})


@pytest.fixture(scope="module")
def drawn():
    setup = setup_of(domain=SKY)
    return setup, draw_worlds(setup, 3)


def test_bounds_are_means_over_the_worlds(drawn):
    setup, cases = drawn
    ticks = []
    shewhart = make_detector({"name": "shewhart", "signals": "both"})
    found = zero_alarm_bounds(setup, shewhart, cases, ticks.append)
    alone = [zero_alarm_bounds(setup, shewhart, [case]) for case in cases]
    assert sum(ticks) == pytest.approx(1.0)
    assert found.free_m == pytest.approx(np.mean([each.free_m for each in alone]))
    assert found.restricted_m == pytest.approx(np.mean([each.restricted_m for each in alone]))
    assert np.ptp([each.restricted_m for each in alone]) > 0.0
    assert (found.kind, found.why, len(found.rates_mps)) == ("exact", "", 3)
    assert found.restricted_m < found.free_m


def test_the_rates_of_a_bound_raise_the_statistic_to_the_threshold_and_no_further():
    setup = setup_of(attack={"name": "false-position", "control": "rate"})
    detector = make_detector({"name": "snapshot-chi2", "threshold_scale": 0.02})
    (case,) = draw_worlds(setup, 1)
    found = zero_alarm_bounds(setup, detector, [case])
    attacker = case.attacker
    u = found.rates_mps[0]
    replay = Replay(setup, [detector], seeds_of_runs(0, "training", setup.name, range(1)))
    rates = attacker.rates @ u
    assert np.abs(rates).max() <= setup.attack.rate_limit_mps * (1.0 + 1e-6)
    moved = replay.errors(rates[None], np.array([0]))[setup.steps - 1, 0, 0]
    assert moved == pytest.approx(found.restricted_m, rel=0.01)
    innovation = attacker.response.innovation @ u
    judged = judge_run(detector, case.run, Timing.of(setup), innovation)
    ratio = (judged.statistic / judged.threshold).max(axis=1)
    assert ratio.max() == pytest.approx(1.0, abs=1e-5)
    assert (ratio > 0.999).sum() > 5  # it is held there


def test_a_detector_without_a_bound_says_why_and_what_has_no_end_is_a_word(drawn):
    setup, cases = drawn
    found = zero_alarm_bounds(setup, make_detector("ewma"), cases)
    assert (found.free_m, found.restricted_m, found.rates_mps) == (None, None, [])
    assert "weight" in found.why
    assert json.loads(json.dumps(found.as_json()))["why"] == found.why
    found = zero_alarm_bounds(setup, make_detector("never"), cases)
    assert (found.free_m, found.as_json()["free_m"]) == (np.inf, "unbounded")
    assert 0.0 < found.restricted_m < setup.attack.rate_limit_mps * LINE["attack_s"]


def test_a_bound_is_kept_where_the_other_fails_and_an_upper_one_says_so(drawn, monkeypatch):
    setup, cases = drawn
    exact = [Bound(value, "exact", 0, (1.0, 0.0)) for value in (3.0, 4.0, 5.0)]
    upper = [exact[0], replace(exact[1], kind="upper", note="almost solved"), exact[2]]
    for free, restricted, expected in (
        (exact, [exact[0]] + ["no optimum"] * 2, (4.0, None, "exact", "restricted: no optimum")),
        (["no optimum"] * 3, exact, (None, 4.0, "exact", "free: no optimum")),
        (exact, upper, (4.0, 4.0, "upper", "restricted: almost solved")),
    ):
        said = {True: iter(free), False: iter(restricted)}

        def solve(*_, attacker=None, said=said, **__):
            bound = next(said[attacker is None])
            if isinstance(bound, str):
                raise RuntimeError(bound)
            return bound

        monkeypatch.setattr(bounds, "compute_zero_alarm", solve)
        found = zero_alarm_bounds(setup, make_detector("snapshot-chi2"), cases)
        assert (found.free_m, found.restricted_m, found.kind, found.why) == expected


@pytest.mark.parametrize("attack", ["meaconer", "per-channel"])
def test_an_attack_that_moves_no_position_has_the_free_bound_alone(attack):
    setup = setup_of(attack=attack)
    cases = draw_worlds(setup, 1)
    assert cases[0].attacker is None
    found = zero_alarm_bounds(setup, make_detector("snapshot-chi2"), cases)
    assert found.restricted_m is None
    assert found.free_m > 0.0
    assert found.kind == "exact"
    with pytest.raises(ValueError, match="tightly coupled receivers alone"):
        draw_worlds(LooselyCoupledSetup(detector="never"), 1)
