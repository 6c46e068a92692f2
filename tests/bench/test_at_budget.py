"""Scores at exactly the alarm budget, against answers that are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from spoofgym.bench.experiments.campaign import run_campaign, summarize
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.campaign_page import build_page
from spoofgym.bench.report.page import render_page
from spoofgym.bench.runs.panel import Panel
from spoofgym.bench.runs.play import WarmStart, play
from spoofgym.bench.runs.players import specify_detector, specify_spoofer
from spoofgym.bench.runs.record import compute_displacement
from spoofgym.bench.runs.world import World
from spoofgym.bench.scores.at_budget import (
    AlarmCurve,
    compare_at_budget,
    score_at_budget,
    score_best,
)
from spoofgym.bench.scores.statistics import RESAMPLES, weighted_quantile
from spoofgym.bench.search import open_loop
from spoofgym.bench.search.alarm_amplitude import (
    FACTOR,
    RESOLUTION,
    EngineRuns,
    draw_threshold_factors,
    trace_alarms,
)
from spoofgym.bench.search.amplitude import EXACT, Tuning
from spoofgym.bench.search.open_loop import OpenLoopSearch
from spoofgym.detectors import Calibrated, make_detector
from spoofgym.detectors.calibration_file import Calibration
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.setup import make_generators, seeds_of_runs

from . import support
from .support import WORLD

MOVED = "undetected_displacement_m"
SETTINGS = Tuning(runs=64, sift_runs=16, values=12, rule=EXACT)
RAMP = specify_spoofer(support.RAMP)


class Linear:
    """A statistic that grows with the amplitude from each run's noise, and alarms above 1; half of
    the way is undetected in a run that alarms.  `gap`: runs are silent again beyond 1.3 times their
    alarm amplitude."""

    span = 1e-3, 10.0

    def __init__(self, noise, gap=False):
        self.alarm_amplitude, self.gap = 1.0 - noise, gap
        self.sky = np.arange(len(noise)) % 16

    def _alarms(self, values, rows):
        ratio = values / self.alarm_amplitude[rows]
        return (ratio > 1.0) & ~(self.gap & (ratio > 1.3))

    def play(self, value):
        alarm = self._alarms(value, np.arange(len(self.sky)))
        return alarm, {MOVED: np.where(alarm, 50.0, 100.0) * value}

    def sift(self, values, count):
        rows = np.arange(min(count, len(self.sky)))
        return np.array([self._alarms(value, rows) for value in values])

    def alarms(self, values, rows):
        return self._alarms(values, rows)


def uniform(runs, top=0.5):
    return np.random.default_rng(runs).permutation(top * (np.arange(runs) + 0.5) / runs)


@pytest.mark.parametrize("gap", [False, True])
def test_alarm_amplitudes_of_a_linear_statistic_are_found(gap):
    runs = Linear(uniform(400), gap)
    curve = trace_alarms(runs, SETTINGS)
    low, high = curve.amplitudes[[0, -1]]
    within = (runs.alarm_amplitude > low) & (runs.alarm_amplitude < high)
    assert within.sum() > 30
    np.testing.assert_allclose(
        curve.alarm_amplitude[within], runs.alarm_amplitude[within], rtol=RESOLUTION - 1.0
    )
    # a twentieth of them alarms at 0.525, half of the way of which is undetected in these
    score = score_at_budget(curve, 0.05)
    assert score.amplitude.value == pytest.approx(0.525, rel=0.005)
    assert score.alarm_rate == pytest.approx(0.05, abs=0.003)
    assert score.displacement[MOVED].value == pytest.approx(52.5 * 0.975, rel=0.005)
    assert score.within_range
    assert score.amplitude.low < 0.525 < score.amplitude.high


def test_a_quantile_lies_between_two_runs_in_proportion():
    once = np.ones((1, 4))
    for share, wanted in ((0.25, 1.0), (0.375, 1.5), (0.5, 2.0), (0.1, 1.0), (1.0, 4.0)):
        assert weighted_quantile([3.0, 1.0, 4.0, 2.0], share, once)[0] == pytest.approx(wanted)
    assert weighted_quantile([1.0, 2.0], 0.5, np.array([[3.0, 1.0]]))[0] == 1.0


def population(rng, each=4, common=0.1, level=0.0):
    """Runs whose alarm amplitudes are lognormal, with a part that a sky has in common."""
    sky = np.repeat(np.arange(40), each)
    own = np.sqrt(0.1 - common**2) * rng.normal(size=len(sky))
    edge = np.exp(level + common * rng.normal(size=40)[sky] + own)
    values = np.exp(np.linspace(-1.3, 0.3, 17))
    alarmed = values[:, None] >= edge
    moved = np.where(alarmed, 50.0, 100.0) * values[:, None]
    return AlarmCurve(
        values, np.clip(edge, values[0], values[-1]), {MOVED: moved}, alarmed, sky, 1.0
    )


def test_intervals_hold_the_truth_as_often_as_they_say():
    rng, share = np.random.default_rng(0), 0.2
    truth = 100.0 * np.exp(np.sqrt(0.1) * special.ndtri(share)) * (1.0 - 0.5 * share)
    # with so much in common intervals that forget the skies are too narrow
    curves = [population(rng, common=0.3) for _ in range(60)]
    found = [score_at_budget(each, share).displacement[MOVED] for each in curves]
    held = sum(each.low <= truth <= each.high for each in found)
    # 51 or more of 60 with a probability of 0.99 at the 94 % that 40 skies allow
    assert held >= 51
    pairs = zip(curves[::2], curves[1::2], strict=True)
    differ = [compare_at_budget(first, second, share) for first, second in pairs]
    assert sum(each.low <= 0.0 <= each.high for each in differ) >= 25  # of 30
    assert min([each.high - each.low for each in found]) > 0.0
    assert compare_at_budget(population(rng, level=0.5), curves[0], share).low > 0.0


def test_the_best_of_equal_attacks_is_not_flattered_by_the_choice():
    rng, share = np.random.default_rng(1), 0.2
    truth = 100.0 * np.exp(np.sqrt(0.1) * special.ndtri(share)) * (1.0 - 0.5 * share)
    sets = [[population(rng) for _ in range(4)] for _ in range(8)]
    fair = np.mean([score_best(each, share).value for each in sets])
    best = np.mean(
        [max(score_at_budget(x, share).displacement[MOVED].value for x in each) for each in sets]
    )
    assert fair == pytest.approx(truth, rel=0.025)
    assert best > fair
    same = sets[0][0]
    assert score_best([same] * 2, share).value == pytest.approx(
        score_at_budget(same, share).displacement[MOVED].value, rel=0.02
    )


@pytest.mark.parametrize("runs", [0, 1])
def test_of_few_runs_or_none_a_score_is_what_there_is(runs):
    curve = trace_alarms(Linear(uniform(runs)), SETTINGS)
    score = score_at_budget(curve, 0.05)
    assert score.counted == runs
    assert np.isnan(score.amplitude.value) == (runs == 0)
    assert np.isnan(score_best([curve], 0.05).value)
    assert np.isnan(compare_at_budget(curve, curve, 0.05).value) == (runs == 0)
    assert score.as_json()["counted"] == runs


def test_where_nothing_alarms_the_largest_amplitude_is_played():
    curve = trace_alarms(Linear(uniform(40) - 1000.0), SETTINGS)
    score = score_at_budget(curve, 0.05)
    assert (score.silent_share, score.alarm_rate, score.amplitude.value) == (1.0, 0.0, 10.0)
    assert score.displacement[MOVED].value == pytest.approx(1000.0)
    # and the smallest one where all alarm at any
    curve = trace_alarms(Linear(np.full(40, 1.0 - 1e-9)), SETTINGS)
    score = score_at_budget(curve, 0.05)
    assert not score.within_range
    assert score.amplitude.value == pytest.approx(1e-3)


def test_the_spread_of_the_calibration_enters_the_interval():
    rng = np.random.default_rng(2)
    maxima = 3.0 + rng.exponential(size=2000)
    ranks = tuple(range(1, 401))
    identity = {"world": {}, "detector": {"name": "x"}, "window_s": 160.0, "entropy": 0}
    file = Calibration.from_maxima(maxima, maxima, ranks=ranks, seed_name="x", **identity)
    point = file.point(per_run=0.01)
    factors = file.draw_factors(point, RESAMPLES, rng)
    # an exponential tail: the logarithm of a share, of which 20 runs tell 22 %
    wanted = 1.0 / np.sqrt(point.rank) / point.scale
    assert np.std(factors) == pytest.approx(wanted, rel=0.15)
    curve = population(rng, each=40)
    before = score_at_budget(curve, 0.1).displacement[MOVED]
    drawn = replace(curve, factors=factors)
    after = score_at_budget(replace(drawn, elasticity={MOVED: 5.0}), 0.1).displacement[MOVED]
    assert after.value == before.value
    own, both = (0.25 * (each.high - each.low) / before.value for each in (before, after))
    assert both == pytest.approx(np.hypot(own, 5.0 * wanted), rel=0.2)
    assert score_at_budget(drawn, 0.1).displacement[MOVED] == before


def test_runs_on_the_engine_are_those_that_each_value_plays_alone():
    settings = {key: value for key, value in WORLD.items() if key != "detector"}
    setup = TightlyCoupledSetup(detector="never", **settings)
    named = {key: x for key, x in WORLD["detector"].items() if key != "thresholds"}
    judge, values = make_detector(named), np.array([0.1, 0.3, 1.0])

    def rngs():
        return make_generators(seeds_of_runs(0, "training", setup.name, range(12)))

    engine = EngineRuns(Panel(setup, [judge], rngs, 1), 0, RAMP)
    start = WarmStart(setup.copy_with(detector=judge), rngs(), threads=1)
    clean = play(start, "none")
    alone = [play(start, RAMP.with_value(value)) for value in values.tolist()]
    first = np.array([runs.first_alarm for runs in alone])[:, engine.rows]
    assert 0 < (first > 0).sum() < first.size
    for value, runs, alarm in zip(values.tolist(), alone, first, strict=True):
        alarmed, moved = engine.play(value)
        np.testing.assert_array_equal(alarmed, alarm > 0)
        wanted = compute_displacement(setup, runs, clean)[engine.rows]
        np.testing.assert_allclose(moved[MOVED], wanted, atol=1e-6)
    np.testing.assert_array_equal(engine.sift(values, 6), (first > 0)[:, engine.rows < 6])
    rows = np.arange(len(engine.rows))[::-1]
    each = engine.alarms(values[rows % 3], rows)
    np.testing.assert_array_equal(each, first[rows % 3, rows] > 0)


def test_a_threshold_moves_the_score_by_its_elasticity():
    setup = TightlyCoupledSetup(detector="never", timeline=support.SHORT)
    judge = Calibrated(make_detector("snapshot-chi2"), scale=1.0)

    def rngs():
        return make_generators(seeds_of_runs(0, "training", setup.name, range(16)))

    panel = Panel(setup, [judge], rngs, 1)
    assert panel.at_thresholds(0, FACTOR, 8).judges[0].scale == FACTOR
    assert judge.scale == 1.0
    assert draw_threshold_factors(panel, 0) is None  # nobody calibrated it


def test_a_shipped_threshold_has_the_spread_of_its_clean_runs():
    world = World.of("T1")
    judge = world.judge(specify_detector({"name": "snapshot-chi2", "false_alarms_per_hour": 0.2}))
    found = judge.find_calibration(world.setup)
    assert found.point(judge.point.false_alarms_per_hour) == judge.point
    factors = found.draw_factors(judge.point, RESAMPLES, np.random.default_rng(0))
    low, middle, high = np.percentile(factors, [2.5, 50.0, 97.5])
    assert 0.98 < low < middle < high < 1.02
    assert middle == pytest.approx(1.0, abs=0.003)
    known = np.array(found.interval(judge.point.per_run)) / judge.point.scale
    np.testing.assert_allclose([low, high], known, atol=0.003)


def test_a_campaign_shows_its_scores_at_the_budget(tmp_path):
    tuning = Tuning(runs=6, sift_runs=3, values=4, budget=0.45, rule=EXACT)
    spoofers = (
        {"name": "step", "amplitude": 1.0},
        support.RAMP,
        {"name": "step", "amplitude": "tuned"},
    )
    suite = support.small_suite(tuning=tuning, runs=24, detectors=("shewhart",), spoofers=spoofers)
    results = run_campaign(suite, tmp_path / "campaign")
    summary = summarize(results)
    (cell,) = (each for each in summary["cells"] if each["spoofer"] == "ramp(tuned)")
    assert cell["stealthy_displacement_m"] == cell["at_budget"][MOVED]
    assert cell["within_budget"]
    text = render_page(build_page(results, summary))
    assert "<h2>At exactly 45 % alarms</h2>" in text
    assert sum("at_budget" in each for each in summary["cells"]) == 2
    strongest = summary["detectors"][0]["strongest_at_budget_m"]
    assert strongest["low"] <= strongest["value"] <= strongest["high"]
    assert "<td>the strongest of these</td>" in text


def test_the_best_curve_of_a_search_is_scored_where_it_was_not_chosen(monkeypatch):
    few = OpenLoopSearch(runs=8, batch=4, knots=4, population=4, generations=1)
    monkeypatch.setattr(open_loop, "LONG", few)
    judge = Evaluator(**WORLD, runs=60, fit_runs=60, rule=EXACT)
    found = judge.fit({"name": "open-loop", "amplitude": "tuned"})
    curves = found.found["fitted_m"]
    assert len(curves) > 2
    assert found.score == max(curves.values()) == curves[found.found["played"]["curve"]]
    score = found.at_budget[MOVED]
    assert 0.0 < score["low"] < score["value"] < score["high"]
    assert score["value"] < 1.1 * found.score


def test_the_rule_is_written_only_where_it_is_not_the_default():
    assert "rule" not in support.small_suite().config["tuning"]
    exact = support.small_suite(tuning=Tuning(rule=EXACT))
    assert exact.config["tuning"]["rule"] == EXACT
    assert (exact.fit_runs, exact.tuning.split) == (exact.runs, "evaluation")
    with pytest.raises(ValueError, match="rule"):
        Tuning(rule="best")
