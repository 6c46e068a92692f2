"""One cell: shared warm-ups, dropped runs and observations change no bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.play import (
    SpooferController,
    WarmStart,
    induced_error,
    list_attack_epochs,
    make_bound_spoofer,
    play,
    to_local,
)
from spoofgym.bench.runs.record import compute_displacement, record_runs
from spoofgym.detectors import Ewma
from spoofgym.envs import SpoofCore
from spoofgym.simulation import Engine
from spoofgym.spoofers import Spoofer

from .support import small_suite

FAST = {"name": "ramp", "rate_mps": 0.6}
RUNS = 40


@pytest.fixture(scope="module")
def suite() -> Suite:
    # a low threshold, so that some runs of twenty seconds alarm and others do not
    return small_suite(detectors=(Ewma(false_alarm=0.02),))


@pytest.fixture(scope="module")
def start(suite: Suite) -> WarmStart:
    setup = suite.setup(suite.detector_players[0])
    return WarmStart(setup, suite.generators("evaluation", RUNS), threads=1)


@dataclass
class Mirror(Spoofer):
    """Commands what it observes; all the bits of an observation show in its run."""

    knowledge: ClassVar[str] = "oracle"

    def act(self, observation: np.ndarray) -> np.ndarray:
        a = len(self.context.action_names)
        return np.ascontiguousarray(np.clip(observation[:, -a:].astype(np.float64), -1.0, 1.0))


def test_a_shared_warm_up_gives_the_bits_of_one_of_its_own(suite: Suite, start: WarmStart) -> None:
    play(start, "step")
    runs = play(start, FAST)
    setup = start.setup
    engine = Engine(RUNS, setup, threads=1)
    engine.reset(suite.generators("evaluation", RUNS))
    spoofer, observer, _ = make_bound_spoofer(FAST, setup, RUNS)
    for k in range(setup.steps + setup.hold):
        action = spoofer.act(observer(engine, k)) if k < setup.steps else None
        verdict = engine.step(action)
        np.testing.assert_array_equal(runs.position[k], engine.simulator.position)
        np.testing.assert_array_equal(runs.alarm[k], verdict.alarm.any(axis=1))


def test_neither_cells_before_nor_threads_change_a_bit(suite: Suite, start: WarmStart) -> None:
    """Also of what an observing spoofer sees of the warm-up."""
    play(start, "step")
    fresh = WarmStart(start.setup, suite.generators("evaluation", RUNS), threads=2)
    np.testing.assert_array_equal(fresh._engine.simulator.weights, start.engine().simulator.weights)
    for spec in (FAST, Mirror()):
        for one, other in zip(play(fresh, spec), play(start, spec), strict=True):
            np.testing.assert_array_equal(one, other)


def test_dropping_settled_runs_changes_no_score(start: WarmStart) -> None:
    clean = play(start, "none")
    whole, dropped = play(start, FAST), play(start, FAST, drop_alarmed=True)
    assert 0.3 < whole.alarm.any(axis=0).mean() < 1.0
    assert np.isnan(dropped.position).any()
    np.testing.assert_array_equal(whole.first_alarm, dropped.first_alarm)
    np.testing.assert_array_equal(
        compute_displacement(start.setup, whole, clean),
        compute_displacement(start.setup, dropped, clean),
    )
    known = np.isfinite(dropped.position)
    np.testing.assert_array_equal(whole.position[known], dropped.position[known])


def test_the_course_of_alarms_counts_the_runs_that_have_alarmed_so_far(start: WarmStart) -> None:
    attacked, clean = play(start, FAST), play(start, "none")
    cell = record_runs(start.setup, {}, start.warmup_alarm, attacked, clean, 40.0)
    so_far = np.logical_or.accumulate(attacked.alarm, axis=0)
    np.testing.assert_allclose(cell.series["alarmed"], so_far.mean(axis=1), atol=1e-6)
    assert 0.0 < cell.series["alarmed"][0] < cell.series["alarmed"][-1] < 1.0


def test_a_cell_and_a_search_score_the_same_runs_alike(start: WarmStart) -> None:
    attacked, clean = play(start, {"name": "ramp", "rate_mps": 0.3}), play(start, "none")
    cell = record_runs(start.setup, {}, start.warmup_alarm, attacked, clean, 40.0)
    assert 0.0 < cell.alarmed.mean() < 1.0
    scored = compute_displacement(start.setup, attacked, clean)
    np.testing.assert_allclose(scored, cell.records["undetected_displacement_m"], atol=1e-6)


@pytest.mark.parametrize("interval_s", [None, 2.0])
def test_a_spoofer_decides_nothing_after_the_attack_window(interval_s: float | None) -> None:
    suite = small_suite(decision_interval_s=interval_s)
    setup = suite.setup(suite.detector_players[0])
    start = WarmStart(setup, suite.generators("evaluation", 2), threads=1)
    attacker = SpooferController([FAST], start.engine())
    given = [attacker.command(k) is not None for k in range(setup.steps + setup.hold)]
    assert given == [True] * setup.steps + [False] * setup.hold


def test_fewer_runs_are_the_first_of_all(start: WarmStart) -> None:
    few = play(start.first(7), FAST)
    for one, other in zip(few, play(start, FAST).first(7), strict=True):
        np.testing.assert_array_equal(one, other)


def test_no_attack_induces_nothing(start: WarmStart) -> None:
    clean = play(start, "none")
    still = play(start, {"name": "ramp", "rate_mps": 0.0})
    assert not induced_error(start.setup, still, clean).any()
    assert not compute_displacement(start.setup, still, clean).any()


def test_no_attack_is_not_seen_by_its_tracking_error() -> None:
    """An attack that is commanded nothing is one all the same; `none` transmits nothing."""
    suite = small_suite(attack={"name": "tracking-1m", "tracking": {"sd_m": 5.0}})
    start = WarmStart(suite.setup(suite.detector_players[0]), suite.generators("training", 4))
    clean = play(start, "none", drop_alarmed=True)
    ideal = small_suite(attack="false-position-ideal")
    other = WarmStart(ideal.setup(ideal.detector_players[0]), ideal.generators("training", 4))
    np.testing.assert_array_equal(clean.position, play(other, "none").position)
    still = play(start, {"name": "ramp", "rate_mps": 0.0})
    assert (still.peak > 2.0 * clean.peak).all()


def test_a_slow_ramp_carries_the_victim_along(start: WarmStart) -> None:
    clean, slow = play(start, "none"), play(start, {"name": "ramp", "rate_mps": 0.1})
    error = induced_error(start.setup, slow, clean)
    commanded = 0.1 * (20.0 - 1.0)
    assert error[start.setup.steps - 1].mean() == pytest.approx(commanded, rel=0.5)


@pytest.mark.parametrize("between", ["hold", "linear"])
def test_runs_of_a_domain_are_those_of_the_environment(between: str) -> None:
    """Worlds, begins, decisions: a cell scores what `SpoofEnv` with a twin pays, run by run."""
    settings = {
        "domain": {"start_s": (0.0, 30.0), "turned_deg": (0.0, 360.0), "worlds": 2},
        "target_heading_deg": "worst",
        "decision_interval_s": 2.0,
        "between": between,
    }
    suite = small_suite(detectors=(Ewma(false_alarm=0.02),), **settings)
    setup = suite.setup(suite.detector_players[0])
    start = WarmStart(setup, suite.generators("evaluation", 6), threads=1)
    spec = {"name": "accelerating-ramp", "acceleration_mps2": 0.05}
    attacked, clean = play(start, spec), play(start, "none")
    scored = compute_displacement(setup, attacked, clean)
    assert len(set(attacked.onset)) > 2
    settings = {"knowledge": "blind", "action": "full-command", "end_at_alarm": False}
    core = SpoofCore(6, setup, threads=1, twin=True, **settings)
    core.reset(suite.generators("evaluation", 6))
    spoofer, *_ = make_bound_spoofer(spec, setup, 6)
    for _ in range(setup.steps // setup.repeat):
        result, _ = core.step(spoofer.act(core.observe()))
    np.testing.assert_allclose(result.info["undetected_displacement_m"], scored, rtol=1e-9)
    assert scored.max() > 0.5


def test_local_axes_keep_lengths(start: WarmStart) -> None:
    rng = np.random.default_rng(0)
    frames = start.setup.world.C_en[list_attack_epochs(start.setup, np.full(3, start.setup.onset))]
    vector = rng.standard_normal((len(frames), 3, 3))
    np.testing.assert_allclose(
        np.linalg.norm(to_local(vector, frames), axis=-1), np.linalg.norm(vector, axis=-1)
    )


@dataclass
class Wild(Spoofer):
    """Commands what no attack takes."""

    value: float = float("nan")
    wide: int = 0

    knowledge: ClassVar[str] = "blind"

    def act(self, observation: np.ndarray) -> np.ndarray:
        a = len(self.context.action_names) + self.wide
        return np.full((len(observation), a), self.value)


@pytest.mark.parametrize(
    ("spoofer", "message"),
    [
        (Wild(), r"Wild must return actions within \[-1, 1\], got nan"),
        (Wild(value=1.5), r"within \[-1, 1\], got 1.5"),
        (Wild(value=0.0, wide=1), r"actions of shape \(40, 2\) .* got \(40, 3\)"),
    ],
)
def test_bad_actions_are_refused(start: WarmStart, spoofer: Spoofer, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        play(start, spoofer)
