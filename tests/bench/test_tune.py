"""The search for the strongest attack within a budget."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spoofgym.bench.runs.panel import Panel, play_searches
from spoofgym.bench.runs.play import Runs, play
from spoofgym.bench.runs.players import specify_spoofer
from spoofgym.bench.runs.record import compute_displacement, mask_valid_runs
from spoofgym.bench.scores.scores import score_stealth
from spoofgym.bench.scores.statistics import most_alarms
from spoofgym.bench.search import amplitude as module
from spoofgym.bench.search.amplitude import RESOLUTION, Trial, Tuning, TuningResult, tune_amplitude
from spoofgym.bench.search.open_loop import fit
from spoofgym.detectors import Ewma, SnapshotChi2

from .support import small_suite

RAMP = specify_spoofer({"name": "ramp", "rate_mps": "tuned"})


class Landscape:
    """Alarm rate and displacement by formula instead of simulation; a panel of 100 runs."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, alarm: Any, displacement: Any) -> None:
        suite = small_suite()
        self.setup, self.runs = suite.world.setup, 100
        self.warmup_alarm = np.zeros((100, 1), dtype=np.bool_)
        self.tried: list[tuple[float, int]] = []
        self.formulas = alarm, displacement
        self.without(0.0)
        monkeypatch.setattr(
            module, "compute_displacement", lambda setup, attacked, twin: attacked.peak
        )

    def without(self, alarm: float) -> None:
        """Runs without an attack, of which some alarm."""
        self.clean = [self.made(100, alarm, 0.0)]
        self.twin_alarm = self.clean[0].first_alarm[:, None]

    @property
    def counts(self) -> Any:
        return mask_valid_runs(self.warmup_alarm, self.twin_alarm)

    def play(self, attacks: Any, **_: Any) -> list[Runs]:
        alarm, displacement = self.formulas
        found = []
        for attack, _number in attacks:
            value = attack.spec["rate_mps"]
            self.tried.append((value, attack.runs))
            found.append(self.made(attack.runs, alarm(value), displacement(value)))
        return found

    def made(self, count: int, alarm: float, displacement: float) -> Runs:
        alarms = np.arange(count)[None, :] < round(alarm * count)
        none = np.zeros(count, dtype=int)
        return Runs(
            position=np.zeros((1, count, 3)),
            alarm=alarms,
            peak=np.full(count, displacement),
            onset=none,
            heading=np.zeros(count),
            coasting=np.zeros_like(alarms),
            blamed=none,
        )


def search(landscape: Any, clean: float = 0.0, **settings: Any) -> TuningResult:
    chosen = Tuning(**{"runs": 100, "sift_runs": 20, "values": 20, "budget": 0.1, **settings})
    landscape.without(clean)
    (found,) = play_searches(
        landscape, [(0, tune_amplitude(landscape, 0, RAMP, "detector", chosen))]
    )
    return found


def test_the_edge_of_the_budget_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(
        monkeypatch,
        alarm=lambda rate: 0.0 if rate < 0.3 else min(rate - 0.3, 1.0),
        displacement=lambda rate: 100.0 * rate,
    )
    result = search(landscape)
    # of 100 runs 4 may alarm for a limit below 10 %, and up to here they do
    assert most_alarms(100, 0.1) == 4
    assert 0.345 / RESOLUTION <= result.value <= 0.345
    assert result.within_budget
    beyond = [t.value for t in result.trials if t.runs == 100 and not t.within_budget]
    assert min(beyond) <= 1.001 * RESOLUTION * result.value  # values are rounded
    assert len({t.value for t in result.trials if t.runs == 100}) <= 2 + 6
    assert len({value for value, _ in landscape.tried}) >= 20
    trials = [t for t in result.trials if t.runs == 100 and t.value == result.value]
    assert len(trials) == 1
    assert trials[0].within_budget
    assert (trials[0].alarm_rate, trials[0].counted) == (0.04, 100)


def test_alarms_that_come_without_the_attack_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    # the first 30 runs alarm anyway, and are no part of the budget
    landscape = Landscape(
        monkeypatch,
        alarm=lambda rate: 0.3 if rate < 0.5 else 0.9,
        displacement=lambda rate: rate,
    )
    result = search(landscape, clean=0.3)
    assert (result.counted, result.clean_alarm_rate) == (70, 0.3)
    assert result.within_budget
    assert 0.5 / RESOLUTION <= result.value < 0.5
    assert result.chosen.alarm_rate == 0.0


def test_runs_that_alarm_before_the_onset_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(monkeypatch, alarm=lambda rate: 0.3, displacement=lambda rate: rate)
    landscape.warmup_alarm = np.arange(100)[:, None] < 30
    result = search(landscape)
    assert (result.counted, result.warmup_alarms, result.value) == (70, 30, 1.0)


def test_a_peak_within_the_budget_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(
        monkeypatch,
        alarm=lambda rate: 0.0,
        displacement=lambda rate: 50.0 - abs(np.log(rate / 0.77)),
    )
    assert search(landscape).value == pytest.approx(0.77, rel=0.12)


def test_more_is_better_up_to_the_end_of_the_range(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(monkeypatch, alarm=lambda rate: 0.0, displacement=lambda rate: rate)
    assert search(landscape).value == 1.0  # 20 s at 0.05 m/s^2


def test_a_sift_that_was_lucky_is_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(
        monkeypatch,
        # two of 20 runs are 10 %, which a sift takes for kept, and ten of 100 are too many
        alarm=lambda rate: 0.0 if rate < 0.1 else 0.1 if rate < 0.5 else 0.9,
        displacement=lambda rate: rate,
    )
    result = search(landscape)
    assert result.within_budget
    assert 0.1 / RESOLUTION <= result.value < 0.1


def test_nothing_within_the_budget_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(monkeypatch, alarm=lambda rate: 0.9, displacement=lambda rate: rate)
    result = search(landscape)
    assert not result.within_budget
    assert result.value == min(value for value, _ in landscape.tried)
    assert TuningResult.from_dict(result.as_dict()) == result


def test_where_no_run_counts_nothing_is_within_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(monkeypatch, alarm=lambda rate: 1.0, displacement=lambda rate: rate)
    result = search(landscape, clean=1.0)
    assert (result.within_budget, result.counted) == (False, 0)
    assert (result.chosen.alarm_rate, result.chosen.stealthy_displacement_m) == (1.0, 0.0)


@pytest.mark.parametrize("detector", [SnapshotChi2(), Ewma(false_alarm=1e-3)])
def test_what_is_chosen_keeps_to_the_budget_when_played(detector: Any) -> None:
    tuning = Tuning(runs=16, sift_runs=6, values=5, refined=2, budget=0.3)
    suite = small_suite(detectors=(detector,), tuning=tuning)
    (judge,) = suite.detector_players
    panel = Panel(suite.world.setup, [detector], lambda: suite.generators("training", 16), 1)
    (result,) = fit(panel, {0: judge}, RAMP, suite.tuning, suite.optima)
    start, clean = panel.start, panel.clean[0]
    attacked = play(start, RAMP.with_value(result.value))
    counts = mask_valid_runs(start.warmup_alarm, clean.first_alarm)
    moved = compute_displacement(start.setup, attacked, clean)
    found = score_stealth(moved, attacked.first_alarm > 0, counts)
    assert found.keeps(suite.tuning.budget)
    (trial,) = [t for t in result.trials if t.runs == 16 and t.value == result.value]
    assert trial == Trial.of(result.value, 16, found, True)
    better = [t for t in result.trials if t.runs == 16 and t.within_budget]
    assert trial.stealthy_displacement_m == max(t.stealthy_displacement_m for t in better)


def test_a_spoofer_without_a_tuned_setting_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(monkeypatch, alarm=lambda rate: 0.1, displacement=lambda rate: rate)
    with pytest.raises(ValueError, match="'ramp' has no setting that is to be tuned"):
        next(tune_amplitude(landscape, 0, specify_spoofer("ramp"), "", Tuning()))  # type: ignore[arg-type]
