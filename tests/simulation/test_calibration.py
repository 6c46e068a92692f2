"""Clean runs, their calibrations, and what shows that these hold."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.stats import betabinom

from spoofgym.bench.report.results import print_hold_outs
from spoofgym.bench.runs.world import DEFAULTS
from spoofgym.calibration import thresholds as calibration
from spoofgym.calibration.clean_runs import Player
from spoofgym.calibration.holdouts import HoldOut, check, hold_out, transfer
from spoofgym.calibration.thresholds import bisect, calibrate_detectors, suitable_detectors
from spoofgym.detectors import Calibrated, Cusum, Ewma, make_detector
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE, TOLERANCE, hourly_rate
from spoofgym.envs import SpoofEnv, SpoofVectorEnv
from spoofgym.envs.factory import make_setup
from spoofgym.envs.spoofer_binding import SETUPS
from spoofgym.simulation import Engine, SnapshotSetup, TightlyCoupledSetup
from spoofgym.simulation.simulator import run_serially, weighs

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}
RATE = 10.0
"""False alarms an hour: 4.6 % of the runs."""
ASKED = {"false_alarms_per_hour": RATE}
AVIATION = {"turn_on": "drawn", "events": {"clock_step": 0.1, "satellite_loss": 0.1, "front": 0.1}}
"""What `aviation-actual` has itself."""


@pytest.fixture(scope="module")
def setup():
    return TightlyCoupledSetup(detector="never", timeline=SHORT)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "own"))
    return tmp_path / "own"


CHART = {"name": "joint-chart", "smoothing": 0.3}
SPECS = ["snapshot-chi2", "cusum", "ewma", CHART]
RUNS = 120


@pytest.fixture(scope="module")
def calibrated(setup, tmp_path_factory):
    settings = {"runs": RUNS, "folder": tmp_path_factory.mktemp("calibrated"), "threads": 2}
    rates = [RATE, 3.0 * RATE]
    found = calibrate_detectors(setup, SPECS, false_alarms_per_hour=rates, **settings)
    assert calibrate_detectors(setup, SPECS, false_alarms_per_hour=rates, **settings) == found
    return found


def test_passive_detectors_in_one_pass_see_the_same_as_in_the_loop_chunks_and_threads(setup):
    names = ("snapshot-chi2", "cusum", "clock-drift", "raim")
    detectors = [make_detector(name) for name in names]
    together = Player(setup, threads=1).play(detectors, range(12))
    for k, detector in enumerate(detectors):
        assert not weighs(setup, detector)
        alone = Player(setup, threads=1).play([detector], range(12), in_loop=True)
        for one, other in zip(together.column(k), alone.column(0), strict=True):
            np.testing.assert_array_equal(one, other)
    assert (together.alarmed == (together.judged > 1.0)).all()
    detectors = [Cusum(), Ewma(weight_scale=None)]
    whole = Player(setup, threads=1).play(detectors, range(20))
    again = Player(setup, threads=2, chunk=3).play(detectors, range(20))
    for one, other in zip(whole, again, strict=True):
        np.testing.assert_array_equal(one, other)
    some = Player(setup, threads=1).play(detectors, [17, 4])
    np.testing.assert_array_equal(some.judged, whole.judged[[17, 4]])


def test_the_judged_window_is_the_attack_and_the_time_to_alert_once_alarms_are_on(setup):
    cusum = Cusum()
    engine = Engine(3, setup.copy_with(detector=cusum), threads=1)
    player = Player(setup, threads=1)
    engine.reset(player.generators("calibration", range(3)))
    largest = np.zeros(3)
    for _ in range(setup.steps + setup.hold):
        engine.simulator.step(attacked=False)
        largest = np.maximum(largest, engine.simulator.ratio())
    found = player.play([cusum], range(3))
    np.testing.assert_array_equal(found.judged[:, 0], largest)
    assert setup.window_s == 17.0
    late = {"name": "innovation-rate", "weight_scale": None, "settled_s": 30.0}
    detector, always = make_detector(late), make_detector({**late, "settled_s": 0.0})
    found = Player(setup, threads=1).play([detector, always], range(10))
    assert (found.before[:, 0] == 0.0).all()
    assert (found.before[:, 1] > 0.0).all()
    assert (found.judged[:, 0] <= found.judged[:, 1]).all()
    assert (found.judged[:, 0] > 0.0).all()


def test_a_calibration_keeps_its_rate_on_the_runs_that_it_is_made_of(setup, calibrated):
    assert [each.detector["name"] for each in calibrated] == [*SPECS[:3], "joint-chart"]
    player = Player(setup, threads=2)
    for each, spec in list(zip(calibrated, SPECS, strict=True))[:3]:
        point = each.point(RATE)
        scaled = Calibrated(make_detector(spec), point.scale)
        counted = player.play([scaled], range(RUNS), in_loop=weighs(setup, scaled))
        assert counted.alarmed.sum() == point.rank - 1 == 4
        assert point.warmup_alarms == pytest.approx(counted.early.mean(), abs=0.03)
    check(setup, calibrated, SPECS)


def test_an_alarm_that_is_a_state_is_bisected_to_its_rate(setup, calibrated):
    (found,) = calibrate_detectors(setup, CHART, runs=RUNS, false_alarms_per_hour=RATE)
    assert found.bisected
    point, both = found.point(RATE), calibrated[3]
    assert both.point(3.0 * RATE).scale <= point.scale == both.point(RATE).scale
    with pytest.raises(ValueError, match="is a state: its scale comes from a bisection, and"):
        found.point(2.0 * RATE)
    scales = (point.scale, 0.97 * point.scale)
    charts = [make_detector({**CHART, "threshold_scale": scale}) for scale in scales]
    player = Player(setup, threads=2)
    few, more = (player.play([chart], range(RUNS), in_loop=True).alarmed.sum() for chart in charts)
    assert few <= point.rank - 1 <= more
    before = np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0])
    judged = np.array([1.0, 2.0, 3.0, 4.0, 0.5, 0.2])
    played = []

    def alarms(scale, rows):
        played.append(rows.tolist())
        return np.ones(len(rows), dtype=np.bool_)  # the alarm outlasts the warm-up

    assert bisect(before, judged, 1, alarms) == pytest.approx(5.0)
    assert bisect(before, judged, 2, alarms) == pytest.approx(4.0)
    assert bisect(before, judged, 3, alarms) == pytest.approx(2.0)
    assert {tuple(rows) for rows in played} == {(2,)}


def test_hold_outs_are_other_runs_and_lie_in_the_predicted_interval(setup, calibrated):
    rates, runs = [RATE, 3.0 * RATE], 100
    settings = {"runs": runs, "cells": 30}
    held = hold_out(setup, calibrated, SPECS, false_alarms_per_hour=rates, **settings)
    assert held[4:] == hold_out(
        setup, calibrated, SPECS, false_alarms_per_hour=rates[1], **settings
    )
    assert [each.false_alarms_per_hour for each in held] == [RATE] * 4 + [3.0 * RATE] * 4
    assert all(each.holds for each in held)
    assert {each.runs for each in held} == {runs}
    assert all(b.alarms > a.alarms for a, b in zip(held[:4], held[4:], strict=True))
    point, low, high = calibrated[0].point(RATE), held[0].low, held[0].high
    law = betabinom(runs, point.rank, RUNS + 1 - point.rank)
    assert law.cdf(high) - law.cdf(low - 1) >= 1.0 - 0.01 / 30
    assert law.sf(high - 1) > 0.005 / 30
    fresh = Player(setup).play([Cusum()], range(5), split="holdout").judged
    assert (fresh != Player(setup).play([Cusum()], range(5)).judged).all()


def test_a_hold_out_tells_the_worst_world_by_chance_and_the_hazard_by_age():
    domain = {"constellation_time_s": [0.0, 86_400.0], "worlds": 3}
    several = TightlyCoupledSetup(detector="never", timeline=SHORT, domain=domain)
    asked = {"false_alarms_per_hour": RATE, "runs": 100}
    found = calibrate_detectors(several, "snapshot-chi2", **asked)
    (held,) = hold_out(several, found, "snapshot-chi2", **asked)
    runs, alarms = np.array(held.worlds).T
    assert (len(runs), runs.sum(), alarms.sum()) == (3, 100, held.alarms)
    largest, by_chance = held.worst_world
    assert largest == hourly_rate((alarms / runs).max(), held.window_s)
    assert largest >= held.per_hour
    json.dumps(held.as_dict(), allow_nan=False)
    assert held.as_dict()["worst_world_by_chance"] == by_chance
    alike = HoldOut("x", 4000, 40, 0.01, None, None, 0.0, 0, 160.0, ((1000, 10),) * 4, 0.2)
    drawn = np.random.default_rng(1).binomial(1000, 0.01, (20_000, 4)).max(axis=1)
    assert alike.worst_world[1] == hourly_rate(np.median(drawn) / 1000, 160.0)
    assert alike._replace(worlds=((4000, 40),)).worst_world is None
    none = alike._replace(alarms=0, worlds=((2000, 0), (2000, 0)))
    assert none.worst_world == (0.0, 0.0)
    timeline = {**SHORT, "warmup_s": 20.0, "live_s": 15.0}
    aged = TightlyCoupledSetup(
        detector="never", timeline=timeline, domain={"age_s": (30.0, 200.0)}, scenario="ke2022"
    )
    asked = {"false_alarms_per_hour": RATE, "runs": 100}
    found = calibrate_detectors(aged, "snapshot-chi2", **asked)
    (held,) = hold_out(aged, found, "snapshot-chi2", **asked)
    ages, runs, alarms = zip(*held.ages, strict=True)
    assert ages == (0.0, 60.0, 180.0)
    assert runs[1] > runs[0] > runs[2] > 0
    assert (sum(runs), sum(alarms)) == (100, held.alarms)
    assert held.per_hour_by_age[60.0] == hourly_rate(alarms[1] / runs[1], held.window_s)
    json.dumps(held.as_dict(), allow_nan=False)
    print_hold_outs("aged", [held])


def test_the_rate_elsewhere_is_another_one(setup, calibrated):
    ewma, asked = [calibrated[2]], {"false_alarms_per_hour": RATE, "runs": 50}
    timelines = SHORT, {**SHORT, "attack_s": 3.0 * SHORT["attack_s"]}
    elsewhere, longer = (
        TightlyCoupledSetup(scenario="groves", detector="never", timeline=each)
        for each in timelines
    )
    (there,) = transfer(elsewhere, ewma, "ewma", **asked)
    (later,) = transfer(longer, ewma, "ewma", **asked)
    assert (there.low, there.high, there.holds) == (None, None, None)
    assert there.window_s == elsewhere.window_s < longer.window_s == later.window_s
    assert later.promised == pytest.approx(1.0 - np.exp(-RATE * longer.window_s / 3600.0))
    assert later.per_hour == hourly_rate(later.alarms / later.runs, longer.window_s)
    json.dumps(there.as_dict(), allow_nan=False)
    with pytest.raises(ValueError, match=r"for something else than ewma in groves: world scenario"):
        check(elsewhere, ewma, "ewma")


def test_rescaled_innovations_are_as_large_as_believed(setup):
    (found,) = calibrate_detectors(
        setup, "cusum", runs=60, false_alarms_per_hour=RATE, rescaled=True, threads=2
    )
    player = Player(setup, threads=2)
    factors = np.array(calibration.rescale_factors(player, 60))
    np.testing.assert_allclose(found.rescale, factors, rtol=1e-9)
    rescaled = make_detector({"name": "cusum", "thresholds": "rescaled", **ASKED})
    rescaled.look_up(setup)
    assert rescaled.rescale == found.rescale
    counted = Player(setup).play([rescaled], range(60)).alarmed.sum()
    assert counted == found.point(RATE).rank - 1
    assert SpoofEnv(timeline=SHORT, detector=rescaled).core.setup.detector.scale == rescaled.scale
    check(setup, [found], "cusum")
    plain = make_detector({"name": "cusum", **ASKED})
    with pytest.raises(ValueError, match="there is no calibration of cusum in zhong2025"):
        plain.look_up(setup)


def test_a_sum_that_stays_at_zero_is_refused(setup):
    """The world's range rates are far smaller than the filter believes."""
    specs = [{"name": "cusum", "signals": "range_rate"}, "snapshot-chi2"]
    settings = {"runs": 60, "false_alarms_per_hour": RATE}
    with pytest.raises(ValueError, match=r"cusum is degenerate: its largest value is 0 in 100 %"):
        calibrate_detectors(setup, specs, **settings)
    # the other one is done, and neither is played again
    opened = []
    found = calibrate_detectors(setup, specs, **settings, strict=False, progress=opened.append)
    assert not opened
    assert found[1].point(RATE).scale > 0.0
    with pytest.raises(ValueError, match="is degenerate"):
        SpoofEnv(timeline=SHORT, detector={**specs[0], **ASKED})
    mended = calibrate_detectors(setup, specs[0], **settings, rescaled=True)
    assert mended[0].point(RATE).scale > 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"runs": 20}, r"for which 20 clean runs are too few: it takes at least 21"),
        ({"false_alarms_per_hour": [1.0, -1.0]}, "must be a number above 0, got -1.0"),
        ({"runs": 30, "false_alarms_per_hour": 1e4}, "must be at most .* for 30 runs of 17 s"),
        ({"rescaled": True}, "'rescaled' is for detectors with a drift term, which SnapshotChi2"),
    ],
)
def test_bad_requests(setup, settings, message):
    with pytest.raises(ValueError, match=message):
        calibrate_detectors(setup, "snapshot-chi2", **{**ASKED, "runs": 60, **settings})


def test_environments_look_a_calibration_up_and_never_run_one(setup, folder, monkeypatch):
    def play(*_, **__):
        raise AssertionError("an environment has played clean runs")

    settings = {"timeline": SHORT, "detector": {"name": "snapshot-chi2", **ASKED}}
    (found,) = calibrate_detectors(setup, "snapshot-chi2", runs=60, false_alarms_per_hour=RATE)
    assert found.path.is_relative_to(folder)
    monkeypatch.setattr(Player, "play", play)
    env = SpoofEnv(**settings)
    assert env.core.setup.detector.scale == found.point(RATE).scale
    assert env.core.setup.detector.point.runs == 60
    env.reset(seed=1)
    # target, attack and random direction do not make it another world
    SpoofVectorEnv(2, **settings, target_heading_deg="random", attack="tracking-1m", twin=True)
    SpoofEnv(timeline=SHORT, watch=[settings["detector"]], detector="never").reset(seed=1)
    other_signals = {**settings["detector"], "signals": "range_rate"}
    longer = {**SHORT, "attack_s": 20.0}
    for changed, said in [
        ({"timeline": longer}, "world timeline.attack_s: 15 there, 20 here"),
        ({"scenario": "groves"}, "world scenario.errors: 'zhong2025' there, 'groves' here"),
        ({"detector": other_signals}, "detector signals: "),
    ]:
        with pytest.raises(ValueError, match="there is no calibration of snapshot-chi2") as told:
            SpoofEnv(**{**settings, **changed})
        asked = {**settings, **changed}["detector"]
        nominal = {k: v for k, v in asked.items() if k not in ASKED} | {"thresholds": "nominal"}
        command = "`spoofgym calibrate --env spoofgym/Zhong2025-v0 --set "
        for part in (said, command, "--false-alarms-per-hour 10`", json.dumps(nominal)):
            assert part in str(told.value)


@pytest.mark.parametrize(
    ("scenario", "domain", "same"),
    [
        ("zhong2025", {"turn_on": "specimen", "events": {}}, True),
        ("zhong2025", {"turn_on": "drawn"}, False),
        ("zhong2025", {"events": {"clock_step": 0.1}}, False),
        ("aviation-actual", {"turn_on": "specimen"}, False),
        ("aviation-actual", {"events": {}}, False),
        ("aviation-actual", AVIATION, True),
    ],
)
def test_a_domain_that_repeats_its_scenario_is_no_other_world(scenario, domain, same):
    plain, other = (
        TightlyCoupledSetup(detector="never", scenario=scenario, domain=each)
        for each in ({}, domain)
    )
    assert (plain.conditions.digest == other.conditions.digest) is same


def test_a_file_in_another_folder_is_for_who_names_it(setup, folder, calibrated):
    asked = {"name": "ewma", **ASKED, "calibration": str(calibrated[2].path)}
    env = SpoofEnv(timeline=SHORT, detector=asked)
    assert env.core.setup.detector.scale == calibrated[2].point(RATE).scale
    assert not folder.exists()
    # no lock is in the way of what is shipped
    beside = calibrated[2].path.parent.iterdir()
    assert {path.suffix for path in beside if path.is_file()} == {".json"}
    with pytest.raises(ValueError, match=r"else than ewma .* smoothing: 0.1 there, 0.2 h"):
        SpoofEnv(timeline=SHORT, detector={**asked, "smoothing": 0.2})
    with pytest.raises(ValueError, match=r"in snapshot: world kind: 'tightly-coupled' there"):
        SpoofEnv("snapshot", detector={**asked, "name": "snapshot-chi2"})


def test_what_no_longer_behaves_so_is_told_and_draws_by_last_bits_are_not(setup, calibrated):
    def altered(error):
        kept = list(calibrated[2].witnesses)
        run, before, judged = kept[3]
        kept[3] = (run, before, judged * (1.0 + error))
        return dataclasses.replace(calibrated[2], witnesses=tuple(kept))

    check(setup, [altered(0.5 * TOLERANCE)], "ewma")
    with pytest.raises(ValueError, match=r"no longer holds: .* of run 3 in it is"):
        check(setup, [altered(3.0 * TOLERANCE)], "ewma")
    # one bit of one innovation, as NumPy for other instructions computes it, is another draw
    (found,) = calibrate_detectors(setup, "lottery", runs=30, false_alarms_per_hour=2.0 * RATE)
    drawn = [(run, before / 3.0, judged / 3.0) for run, before, judged in found.witnesses]
    check(setup, [dataclasses.replace(found, witnesses=tuple(drawn))], "lottery")
    with pytest.raises(ValueError, match="something else than lottery"):
        check(setup, [found], {"name": "lottery", "mean_wait_s": 7.0})


def test_a_smaller_victim_is_calibrated_by_the_same_call():
    setup = SnapshotSetup(detector="never", timeline={"attack_s": 30.0, "warmup_s": 10.0})
    specs = ["raim", {"name": "srv-raim", "exclude": True}]
    found = calibrate_detectors(setup, specs, runs=60, false_alarms_per_hour=5.0)
    held = hold_out(setup, found, specs, false_alarms_per_hour=5.0, runs=60)
    assert [each.holds for each in held] == [True, True]
    check(setup, found, specs)


@pytest.mark.parametrize("name", sorted(SETUPS))
def test_every_suitable_detector_fits(name):
    setup = make_setup(SETUPS[name], {"detector": "never"})
    found = suitable_detectors(setup)
    assert len(found) > 1
    for detector in found:
        setup.copy_with(detector=detector).simulator(1, run_serially)
    names = {type(each) for each in found}
    assert {type(make_detector(spec)) for spec in DEFAULTS[SETUPS[name]]} <= names
