"""The search for the strongest attack within a budget."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spoofgym.bench import tune as module
from spoofgym.bench.run import Runs, WarmStart, displacement_of, play
from spoofgym.bench.suite import Tuning, spoofer_entry
from spoofgym.bench.tune import RESOLUTION, TuningResult, tune
from spoofgym.detectors import Ewma, SnapshotChi2

from .support import small_suite

RAMP = spoofer_entry({"name": "ramp", "rate_mps": "tuned"})


class Landscape:
    """Alarm rate and displacement by formula instead of simulation; 100 runs."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, alarm: Any, displacement: Any) -> None:
        suite = small_suite()
        self.setup = suite.setup(suite.detector_entries[0])
        self.receivers = 100
        self.warmup_alarm = np.zeros(100, dtype=np.bool_)
        self.tried: list[tuple[float, int]] = []

        def fake_play(start: Any, spec: dict[str, Any], **_: Any) -> Runs:
            value = spec["rate_mps"]
            self.tried.append((value, start.receivers))
            return self.runs(start.receivers, alarm(value), displacement(value))

        def fake_displacement(setup: Any, attacked: Runs, twin: Runs) -> np.ndarray:
            return attacked.peak

        monkeypatch.setattr(module, "play", fake_play)
        monkeypatch.setattr(module, "displacement_of", fake_displacement)

    def runs(self, count: int, alarm: float, displacement: float) -> Runs:
        alarms = np.arange(count)[None, :] < round(alarm * count)
        return Runs(
            np.zeros((1, count, 3)), alarms, np.full(count, displacement), np.zeros(count, int)
        )

    def first(self, count: int) -> Landscape:
        part = object.__new__(Landscape)
        part.__dict__.update(self.__dict__)
        part.receivers = count
        return part


def search(landscape: Any, **settings: Any) -> TuningResult:
    chosen = Tuning(
        **{"runs": 100, "sift_runs": 20, "values": 20, "budget": 0.05, "margin": 0.0, **settings}
    )
    return tune(landscape, landscape.runs(100, 0.1, 0.0), RAMP, "detector", chosen)


def test_the_edge_of_the_budget_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(
        monkeypatch,
        alarm=lambda rate: 0.1 if rate < 0.3 else min(0.1 + (rate - 0.3), 1.0),
        displacement=lambda rate: 100.0 * rate,
    )
    result = search(landscape)
    # up to here 15 of 100 runs alarm
    assert 0.355 / RESOLUTION <= result.value <= 0.355
    assert result.within_budget
    beyond = [t.value for t in result.trials if t.runs == 100 and not t.within_budget]
    assert min(beyond) <= 1.001 * RESOLUTION * result.value  # values are rounded
    assert len({t.value for t in result.trials if t.runs == 100}) <= 2 + 6
    assert len({value for value, _ in landscape.tried}) >= 20
    trials = [t for t in result.trials if t.runs == 100 and t.value == result.value]
    assert len(trials) == 1
    assert trials[0].within_budget


def test_a_peak_within_the_budget_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(
        monkeypatch,
        alarm=lambda rate: 0.1,
        displacement=lambda rate: 50.0 - abs(np.log(rate / 0.77)),
    )
    assert search(landscape).value == pytest.approx(0.77, rel=0.12)


def test_a_margin_is_kept_at_the_edge(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(
        monkeypatch,
        alarm=lambda rate: 0.1 + 0.1 * rate,
        displacement=lambda rate: rate,
    )
    chosen = {margin: search(landscape, margin=margin).chosen for margin in (0.0, 1.0)}
    # 5 of 100 runs more, or 3: then one standard error is 1.7 points
    assert [round(100 * chosen[margin].excess) for margin in (0.0, 1.0)] == [5, 3]
    assert chosen[1.0].value == pytest.approx(0.35, rel=0.02)


def test_more_is_better_up_to_the_end_of_the_range(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(monkeypatch, alarm=lambda rate: 0.1, displacement=lambda rate: rate)
    assert search(landscape).value == 1.0  # 20 s at 0.05 m/s^2


def test_a_sift_that_was_lucky_is_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(
        monkeypatch,
        # with 20 runs these are 3 alarms up to 0.17, and 4 from 0.18 on
        alarm=lambda rate: 0.1 if rate < 0.1 else 0.16 if rate < 0.5 else 0.9,
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


@pytest.mark.parametrize("detector", [SnapshotChi2(), Ewma(false_alarm=1e-3)])
def test_what_is_chosen_keeps_to_the_budget_when_played(detector: Any) -> None:
    suite = small_suite(detectors=(detector,))
    (judge,) = suite.detector_entries
    start = WarmStart(suite.setup(judge), suite.generators("training", 6), threads=1)
    clean = play(start, "none")
    result = tune(start, clean, RAMP, judge.label, suite.tuning)
    attacked = play(start, RAMP.with_value(result.value))
    rate = attacked.alarm.any(axis=0).mean()
    assert rate <= clean.alarm.any(axis=0).mean() + suite.tuning.budget
    (trial,) = [t for t in result.trials if t.runs == 6 and t.value == result.value]
    assert trial.alarm_rate == rate
    assert trial.undetected_displacement_m == displacement_of(start.setup, attacked, clean).mean()
    better = [t for t in result.trials if t.runs == 6 and t.within_budget]
    assert trial.undetected_displacement_m == max(t.undetected_displacement_m for t in better)


def test_a_spoofer_without_a_tuned_setting_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    landscape = Landscape(monkeypatch, alarm=lambda rate: 0.1, displacement=lambda rate: rate)
    with pytest.raises(ValueError, match="'ramp' has no setting that is to be tuned"):
        tune(landscape, landscape.runs(100, 0.1, 0.0), spoofer_entry("ramp"), "", Tuning())  # type: ignore[arg-type]
