"""One cell: shared warm-ups, dropped runs and observations change no bit."""

import json
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from spoofgym.bench.report.figures import Screen, play_frames
from spoofgym.bench.runs.episode import TWIN, alarm_intervals, draw_episode, play_episode
from spoofgym.bench.runs.play import (
    SpooferController,
    WarmStart,
    induced_error,
    make_bound_spoofer,
    play,
    play_side_by_side,
)
from spoofgym.bench.runs.record import compute_displacement, record_runs
from spoofgym.detectors import Ewma
from spoofgym.simulation import Engine
from spoofgym.simulation.monitors import PastPositions
from spoofgym.spoofers import Ramp, Spoofer

from .support import Mirror, small_suite

FAST = {"name": "ramp", "rate_mps": 0.6}
RUNS = 40


def start_of(runs=RUNS, threads=1, split="evaluation", **changes):
    # a low threshold, so that some runs of twenty seconds alarm and others do not
    suite = small_suite(**{"detectors": (Ewma(false_alarm=0.02),), **changes})
    setup = suite.setup(suite.detector_players[0])
    return WarmStart(setup, suite.generators(split, runs), threads=threads), suite


@pytest.fixture(scope="module")
def start():
    return start_of()[0]


@pytest.fixture(scope="module")
def clean(start):
    return play(start, "none")


@pytest.fixture(scope="module")
def fast(start):
    play(start, "step")
    return play(start, FAST)


def test_neither_shared_warm_ups_nor_other_cells_threads_or_runs_change_a_bit(start, fast):
    setup = start.setup
    _, suite = start_of()
    engine = Engine(RUNS, setup, threads=1)
    engine.reset(suite.generators("evaluation", RUNS))
    spoofer, observer, _ = make_bound_spoofer(FAST, setup, RUNS)
    for k in range(setup.steps + setup.hold):
        action = spoofer.act(observer(engine, k)) if k < setup.steps else None
        verdict = engine.step(action)
        np.testing.assert_array_equal(fast.position[k], engine.simulator.position)
        np.testing.assert_array_equal(fast.alarm[k], verdict.alarm.any(axis=1))
    fresh, _ = start_of(threads=2)
    np.testing.assert_array_equal(fresh._engine.simulator.weights, start.engine().simulator.weights)
    for one, other in (
        (play(fresh, FAST), fast),
        (play(fresh, Mirror()), play(start, Mirror())),
        (play(start.first(7), FAST), fast.first(7)),
    ):
        for mine, theirs in zip(one, other, strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_dropping_settled_runs_changes_no_score_and_a_cell_scores_as_a_search_does(
    start, clean, fast
):
    (dropped,) = play_side_by_side(start, [FAST], drop_alarmed=True)
    assert 0.3 < fast.alarm.any(axis=0).mean() < 1.0
    assert np.isnan(dropped.position).any()
    np.testing.assert_array_equal(fast.first_alarm, dropped.first_alarm)
    scores = [compute_displacement(start.setup, each, clean) for each in (fast, dropped)]
    np.testing.assert_array_equal(*scores)
    known = np.isfinite(dropped.position)
    np.testing.assert_array_equal(fast.position[known], dropped.position[known])
    cell = record_runs(start.setup, {}, start.warmup_alarm, fast, clean, 40.0)
    so_far = np.logical_or.accumulate(fast.alarm, axis=0)
    np.testing.assert_allclose(cell.series["alarmed"], so_far.mean(axis=1), atol=1e-6)
    assert 0.0 < cell.series["alarmed"][0] < cell.series["alarmed"][-1] < 1.0
    scored = compute_displacement(start.setup, fast, clean)
    np.testing.assert_allclose(scored, cell.records["undetected_displacement_m"], atol=1e-6)


def test_the_last_run_that_is_left_has_company_which_changes_no_bit(start, fast):
    still = {**FAST, "rate_mps": 0.0}
    expected, half = play(start, still), len(fast.alarm) // 2
    loud = np.flatnonzero((fast.first_alarm > 0) & (fast.first_alarm < half))
    alone = np.flatnonzero(expected.first_alarm == 0)[-1]
    rows = np.sort(np.append(loud[loud != alone], alone))
    which = (rows == alone).astype(np.intp)
    (left,) = play_side_by_side(start.take(rows), [FAST, still], which, drop_alarmed=True)
    there = np.isfinite(left.position[-1]).all(axis=1)
    assert there.sum() == 2
    assert there[which == 1].all()
    np.testing.assert_array_equal(left.position[:, which == 1], expected.position[:, [alone]])


@pytest.mark.parametrize("interval_s", [None, 2.0])
def test_a_spoofer_decides_nothing_after_the_attack_window(interval_s):
    start, _ = start_of(2, decision_interval_s=interval_s)
    attacker, setup = SpooferController([FAST], start.engine()), start.setup
    given = [attacker.command(k) is not None for k in range(setup.steps + setup.hold)]
    assert given == [True] * setup.steps + [False] * setup.hold


def test_no_attack_induces_nothing_and_a_slow_one_carries_the_victim_along(start, clean):
    still, slow = (play(start, {**FAST, "rate_mps": rate}) for rate in (0.0, 0.1))
    assert not induced_error(start.setup, still, clean).any()
    assert not compute_displacement(start.setup, still, clean).any()
    error = induced_error(start.setup, slow, clean)[start.setup.steps - 1]
    assert error.mean() == pytest.approx(0.1 * (20.0 - 1.0), rel=0.5)


def test_no_attack_is_not_seen_by_its_tracking_error():
    few = {"runs": 4, "split": "training", "detectors": ("snapshot-chi2",)}
    tracked = {"name": "tracking-1m", "tracking": {"sd_m": 5.0}}
    start, other = (start_of(**few, attack=x)[0] for x in (tracked, "false-position-ideal"))
    (clean,) = play_side_by_side(start, ["none"], drop_alarmed=True)
    np.testing.assert_array_equal(clean.position, play(other, "none").position)
    assert (play(start, {"name": "ramp", "rate_mps": 0.0}).peak > 2.0 * clean.peak).all()


@dataclass
class Wild(Spoofer):
    value: float = 0.0
    wide: int = 0
    knowledge: ClassVar[str] = "blind"

    def act(self, observation):
        a = len(self.context.action_names) + self.wide
        return np.full((len(observation), a), self.value)


def test_bad_actions_are_refused(start):
    for spoofer, message in (
        (Wild(float("nan")), r"Wild must return actions within \[-1, 1\], got nan"),
        (Wild(wide=1), r"actions of shape \(40, 2\) .* got \(40, 3\)"),
    ):
        with pytest.raises(ValueError, match=message):
            play(start, spoofer)


SPOOFER = {"name": "ramp", "rate_mps": 0.4}


@pytest.fixture(scope="module")
def suite():
    return small_suite(detectors=("ewma",), spoofers=(SPOOFER,))


@pytest.fixture(scope="module")
def episode(suite):
    return play_episode(suite.world, suite.detector_players[0], suite.spoofer_players[1], run=3)


def test_it_is_the_run_of_that_number_with_the_intervals_of_its_alarms(suite, episode):
    setup = suite.setup(suite.detector_players[0])
    start = WarmStart(setup, suite.generators("evaluation", 5), threads=1)
    attacked, clean = play(start, SPOOFER), play(start, "none")
    onset = episode.onset
    np.testing.assert_array_equal(episode.alarm[onset:, 0], attacked.alarm[:, 3])
    np.testing.assert_allclose(episode.induced_error_m, induced_error(setup, attacked, clean)[:, 3])
    summary = episode.summary()
    expected = compute_displacement(setup, attacked, clean)[3]
    assert summary["undetected_displacement_m"] == pytest.approx(expected, abs=1e-4)
    assert summary["warmup_alarm"] == start.warmup_alarm[3]
    assert summary["peak_ratio"] == pytest.approx(attacked.peak[3], abs=1e-4)
    # the twin is not attacked
    np.testing.assert_array_equal(episode.ratio[:onset, 0], episode.ratio[:onset, TWIN])
    assert episode.time[onset - 1] == 0.0
    assert np.abs(episode.error_n[:, TWIN, :2]).max() < 10.0
    assert episode.displacement[-1, 1] > 5.0
    # a number may be one of NumPy
    again = play_episode(suite.world, episode.detector, episode.spoofer, run=np.int64(3))
    assert json.dumps(again.summary()) == json.dumps(summary)
    with pytest.raises(ValueError, match="`run` must be a whole number of at least 0, got -1"):
        play_episode(suite.world, episode.detector, episode.spoofer, run=-1)
    assert episode.intervals == alarm_intervals(episode.alarm[:, 0], episode.time)
    told = episode.summary()["spoofing_intervals_s"]
    assert [onset for onset, _ in told] == [onset for onset, _ in episode.intervals]


def test_it_can_be_drawn(tmp_path):
    some = {"detectors": (Ewma(false_alarm=0.5),), "spoofers": ("step",)}
    suite = small_suite(**some, attack="per-channel")
    drawn = play_episode(suite.world, suite.detector_players[0], suite.spoofer_players[1])
    assert drawn.summary()["alarm"]
    written = draw_episode(drawn, tmp_path / "new" / "picture")
    assert written == tmp_path / "new" / "picture.png"
    assert written.stat().st_size > 10_000


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("......", []),
        ("x.x.x.", [(0.0, 0.5), (1.0, 1.5), (2.0, 2.5)]),
        ("x..xx", [(0.0, 0.5), (1.5, math.inf)]),
        ("xx", [(0.0, math.inf)]),
    ],
)
def test_an_interval_is_from_the_first_alarm_to_the_first_epoch_without(text, found):
    alarm = np.array([letter == "x" for letter in text])
    assert alarm_intervals(alarm, 0.5 * np.arange(len(text))) == found


def test_a_spoofer_of_a_campaign_sees_what_the_victim_reports(monkeypatch, episode):
    monkeypatch.setattr(Ramp, "knowledge", "blind+reported")
    reported = small_suite(detectors=("ewma",), spoofers=(SPOOFER,))
    reported.check_fit()
    judge, none, ramp = (*reported.detector_players, *reported.spoofer_players)
    assert [type(each) for each in reported.setup(judge).monitors] == [PastPositions]
    assert reported.setup(judge, [none]).monitors == ()
    again = play_episode(reported.world, judge, ramp, run=3)
    assert json.dumps(again.summary()) == json.dumps(episode.summary())
    assert len(list(play_frames(reported, judge, ramp, every=1000))) == 2


def test_an_animation_counts_displacement_in_any_direction_as_the_score_does(monkeypatch):
    across = {"name": "ramp", "heading_deg": 0.0, "rate_mps": 0.2}  # the target is east
    suite = small_suite(detectors=("never",), spoofers=(across,))
    judge, ramp = suite.detector_players[0], suite.spoofer_players[-1]
    shown, add = [], Screen.add

    def record(screen, info):
        shown.append(float(info.get("undetected_displacement_m", 0.0)))
        add(screen, info)

    monkeypatch.setattr(Screen, "add", record)
    list(play_frames(suite, judge, ramp, every=1000))
    summary = play_episode(suite.world, judge, ramp).summary()
    assert shown[-1] == pytest.approx(summary["undetected_displacement_m"], abs=1e-4)
    assert shown[-1] > 1.0
