"""The search for the strongest attack within a budget."""

import numpy as np
import pytest

from spoofgym.bench.report.campaign import tuning_table
from spoofgym.bench.runs.panel import Panel, play_searches
from spoofgym.bench.runs.play import Runs, play
from spoofgym.bench.runs.players import specify_spoofer
from spoofgym.bench.runs.record import compute_displacement, mask_valid_runs
from spoofgym.bench.scores.scores import score_stealth
from spoofgym.bench.scores.statistics import most_alarms
from spoofgym.bench.search import amplitude as module
from spoofgym.bench.search.amplitude import RESOLUTION, Trial, Tuning, TuningResult, tune_amplitude
from spoofgym.bench.search.open_loop import fit
from spoofgym.detectors import Ewma

from . import support

RAMP = specify_spoofer(support.RAMP)


class Landscape:
    """Alarm rate and displacement by formula instead of simulation; a panel of 100 runs.

    A part `clean` of the runs alarms without an attack; `early` ones before the onset.
    """

    def __init__(self, alarm, displacement, clean, early):
        self.setup, self.runs = support.small_suite().world.setup, 100
        self.warmup_alarm = np.arange(100)[:, None] < early
        self.tried, self.formulas = [], (alarm, displacement)
        self.clean = [self.made(100, clean, 0.0)]
        self.twin_alarm = self.clean[0].first_alarm[:, None]

    @property
    def counts(self):
        return mask_valid_runs(self.warmup_alarm, self.twin_alarm)

    def play(self, attacks, **_):
        alarm, displacement = self.formulas
        values = [(attack.spec["rate_mps"], attack.runs) for attack, _ in attacks]
        self.tried += values
        return [self.made(runs, alarm(value), displacement(value)) for value, runs in values]

    def made(self, count, alarm, displacement):
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


@pytest.fixture
def search(monkeypatch):
    monkeypatch.setattr(module, "compute_displacement", lambda setup, attacked, twin: attacked.peak)

    def search(alarm, displacement=lambda rate: rate, clean=0.0, early=0):
        landscape = Landscape(alarm, displacement, clean, early)
        tuning = Tuning(runs=100, sift_runs=20, values=20, budget=0.1)
        playing = tune_amplitude(landscape, 0, RAMP, "detector", tuning)
        (found,) = play_searches(landscape, [(0, playing)])
        return found, [value for value, _ in landscape.tried]

    return search


def test_the_edge_of_the_budget_is_found(search):
    result, tried = search(
        lambda rate: 0.0 if rate < 0.3 else min(rate - 0.3, 1.0), lambda rate: 100.0 * rate
    )
    # of 100 runs 4 may alarm for a limit below 10 %, and up to here they do
    assert most_alarms(100, 0.1) == 4
    assert 0.345 / RESOLUTION <= result.value <= 0.345
    assert result.within_budget
    whole = [trial for trial in result.trials if trial.runs == 100]
    beyond = [trial.value for trial in whole if not trial.within_budget]
    assert min(beyond) <= 1.001 * RESOLUTION * result.value  # values are rounded
    assert len({trial.value for trial in whole}) <= 2 + 6
    assert len({*tried}) >= 20
    (trial,) = (trial for trial in whole if trial.value == result.value)
    assert (trial.alarm_rate, trial.counted, trial.within_budget) == (0.04, 100, True)


def test_only_runs_count_that_the_attack_alone_lets_alarm(search):
    # the first 30 runs alarm anyway, and are no part of the budget
    result, _ = search(lambda rate: 0.3 if rate < 0.5 else 0.9, clean=0.3)
    assert (result.counted, result.clean_alarm_rate) == (70, 0.3)
    assert result.within_budget
    assert 0.5 / RESOLUTION <= result.value < 0.5
    assert result.chosen.alarm_rate == 0.0
    # and neither do those that alarm before the onset
    result, _ = search(lambda rate: 0.3, early=30)
    assert (result.counted, result.warmup_alarms, result.value) == (70, 30, 1.0)


def test_a_peak_within_the_budget_is_found_or_the_end_of_the_range(search):
    result, _ = search(lambda rate: 0.0, lambda rate: 50.0 - abs(np.log(rate / 0.77)))
    assert result.value == pytest.approx(0.77, rel=0.12)
    assert search(lambda rate: 0.0)[0].value == 1.0  # 20 s at 0.05 m/s^2


def test_a_sift_that_was_lucky_is_corrected(search):
    # two of 20 runs are 10 %, which a sift takes for kept, and ten of 100 are too many
    result, _ = search(lambda rate: 0.0 if rate < 0.1 else 0.1 if rate < 0.5 else 0.9)
    assert result.within_budget
    assert 0.1 / RESOLUTION <= result.value < 0.1


def test_nothing_within_the_budget_is_said(search):
    result, tried = search(lambda rate: 0.9)
    assert not result.within_budget
    assert result.value == min(tried)
    assert TuningResult.from_dict(result.as_dict()) == result
    result, _ = search(lambda rate: 1.0, clean=1.0)  # no run counts
    assert (result.within_budget, result.counted) == (False, 0)
    assert (result.chosen.alarm_rate, result.chosen.stealthy_displacement_m) == (1.0, 0.0)


def test_what_is_chosen_keeps_to_the_budget_when_played():
    tuning, detector = Tuning(runs=16, sift_runs=6, values=5, refined=2, budget=0.3), Ewma()
    suite = support.small_suite(detectors=(detector,), tuning=tuning)
    (judge,) = suite.detector_players
    panel = Panel(suite.world.setup, [detector], lambda: suite.generators("training", 16), 1)
    (result,) = fit(panel, {0: judge}, RAMP, suite.tuning, suite.optima)
    start, clean = panel.start, panel.clean[0]
    attacked = play(start, RAMP.with_value(result.value))
    counts = mask_valid_runs(start.warmup_alarm, clean.first_alarm)
    moved = compute_displacement(start.setup, attacked, clean)
    found = score_stealth(moved, attacked.first_alarm > 0, counts)
    assert found.keeps(suite.tuning.budget)
    whole = [trial for trial in result.trials if trial.runs == 16]
    (trial,) = (trial for trial in whole if trial.value == result.value)
    assert trial == Trial.of(result.value, 16, found, True)
    kept = [each.stealthy_displacement_m for each in whole if each.within_budget]
    assert trial.stealthy_displacement_m == max(kept)


def test_a_spoofer_without_a_tuned_setting_is_refused():
    landscape = Landscape(None, None, 0.0, 0)
    with pytest.raises(ValueError, match="'ramp' has no setting that is to be tuned"):
        next(tune_amplitude(landscape, 0, specify_spoofer("ramp"), "", Tuning()))


def test_why_a_value_is_over_the_budget_can_be_read():
    kept = Trial(0.2, 400, 390, 0.02, 0.04, 30.0, True)
    sifted = Trial(0.3, 32, 30, 0.035, 0.12, 36.0, True)  # a few runs sift by the rate
    trials = kept, sifted, Trial(0.3, 400, 390, 0.035, 0.055, 40.0, False)
    found = TuningResult("ewma", "ramp", "rate_mps", 0.2, True, 0.05, 400, 390, 0.02, 2, trials)
    search = found.as_dict()
    table = tuning_table(search)
    names = ("rate_mps", "P(alarm | silent twin) [%]", "its upper limit [%]", "within budget")
    assert [tuple(table[name].text(trial) for name in names) for trial in search["trials"]] == [
        ("0.2 (chosen)", "2.0", "4.0", "yes"),
        ("0.3", "3.5", "12.0", "yes"),
        ("0.3", "3.5", "5.5", "no"),
    ]
    assert TuningResult.from_dict(search) == found
