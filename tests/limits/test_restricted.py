"""Bounds of every detector with a convex no-alarm set, against its own verdicts and a solver."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from spoofgym.detectors import (
    DETECTORS,
    Aime,
    Calibrated,
    ClockDrift,
    CumulativeBank,
    Cusum,
    Ewma,
    FiniteMovingAverage,
    GlrRamp,
    GlrStep,
    InnovationRate,
    JointChart,
    LagCusum,
    Never,
    SequentialChi2,
    Shewhart,
    SnapshotChi2,
    WindowedChi2,
)
from spoofgym.limits import convex
from spoofgym.limits.no_alarm import SETS, Timing, judge_run, judged_by

from .toy import TIMING, bound_of, false_position, toy_run

RUN = toy_run()
SETTING = toy_run(setting=(12, 22))
YOUNG = Timing(0.5, live=0)
PASSIVE = [
    SnapshotChi2(),
    SnapshotChi2(signals="pseudorange", bias_window_s=5.0),
    WindowedChi2(signals="range_rate", window=5),
    SequentialChi2(signals="both", window_s=5.0),
    Aime(signals="both", windows_s=(1.0, 4.0), bias_window_s=10.0),
    Ewma(weight_scale=None),
    JointChart(weight_scale=None, alarm_scale=1.2),
    Shewhart(signals="both", bias_window_s=3.0),
    Cusum(signals="both"),
    LagCusum(threshold=4.0, lag=3, baseline=5, signals="range_rate"),
    ClockDrift(signals="pseudorange", window_s=4.0),
    GlrStep(window=12, baseline=20),
    GlrRamp(window=30, baseline=10, signals="both"),
    FiniteMovingAverage(window_s=3.0, shape="ramp", signals="both", bias_window_s=4.0),
    FiniteMovingAverage(window_s=40.0, shape="ramp", signals="range_rate"),
    CumulativeBank(windows_s=(1.0, 4.0, 9.0), signals="pseudorange", bias_window_s=3.0),
    CumulativeBank(windows_s=(2.0, 40.0), signals="range_rate"),
    InnovationRate(memory_s=20.0, settled_s=18.0, start_s=3.0, alarm_scale=0.5),
]
CASES = {f"{type(each).__name__}-{i}": each for i, each in enumerate(PASSIVE)}
FREE = [
    each
    for each in PASSIVE
    if getattr(each, "signals", "pseudorange") == "both" and not isinstance(each, ClockDrift)
]
WITHOUT = {name for name, kind in DETECTORS.items() if kind not in SETS}
LOOSE = {"rate": 1e3, "change": np.inf}


def check_edge(detector, run, timing, bound):
    assert bound.kind == "exact"
    for part, alarms in ((0.999, False), (1.02, True)):
        verdicts = judge_run(detector, run, timing, part * bound.innovation)
        ratio = verdicts.statistic / verdicts.threshold
        assert (ratio[verdicts.armed].max() > 1.0) == alarms


@pytest.mark.parametrize(
    ("run", "timing"), [(SETTING, TIMING), (RUN, YOUNG)], ids=["setting", "young"]
)
@pytest.mark.parametrize("name", CASES)
def test_a_restricted_bound_is_the_edge_of_the_detector_s_own_alarm(name, run, timing):
    detector, attacker = CASES[name], false_position(run, **LOOSE)
    bound = bound_of(detector, run, timing, attacker)
    check_edge(detector, run, timing, bound)
    wanted = attacker.response.position[45, 1] @ bound.commands
    assert bound.value_m == pytest.approx(wanted)


@pytest.mark.parametrize("detector", FREE, ids=lambda each: type(each).__name__)
def test_a_free_bound_is_the_edge_of_the_detector_s_own_alarm(detector):
    run = RUN if isinstance(detector, GlrRamp) else SETTING
    check_edge(detector, run, TIMING, bound_of(detector, run))


@pytest.mark.parametrize("detector", [Ewma(weight_scale=None), SnapshotChi2(signals="pseudorange")])
def test_a_filter_of_pseudoranges_alone_has_a_free_bound(detector):
    run = RUN._replace(gain=RUN.gain * ([1.0] * 4 + [0.0] * 4))
    check_edge(detector, run, TIMING, bound_of(detector, run))


@pytest.mark.parametrize("kind", [GlrStep, GlrRamp])
def test_a_scan_knows_no_satellite_that_was_offset_when_it_rose(kind):
    detector = kind(window=12, baseline=20, signals="both")
    for run, timing in [(SETTING, TIMING), (RUN, YOUNG)]:
        assert bound_of(detector, run, timing).kind == "unbounded"


ATTACKER = false_position(RUN, **LOOSE)
LIMITED = false_position(RUN, rate=12.0, change=3.0)


@pytest.mark.parametrize(
    ("detector", "loose", "limited"),
    [
        (SnapshotChi2(), 299.795, 218.660),
        (WindowedChi2(), 188.397, 179.763),
        (SequentialChi2(), 351.475, 265.078),
        (Aime(windows_s=(2.0, 5.0)), 217.313, 197.674),
        (Ewma(weight_scale=None), 206.412, 190.349),
        (Cusum(limit=4.0), 99.4821, 99.0203),
        (FiniteMovingAverage(window_s=5.0, shape="ramp"), 276.394, 240.167),
        (CumulativeBank(windows_s=(2.0, 10.0)), 177.407, 174.051),
        (GlrStep(window=12, baseline=20), 577.140, 259.031),
    ],
    ids=lambda each: type(each).__name__ if not isinstance(each, float) else "",
)
def test_a_restricted_bound_is_the_optimum_of_its_cone_program(detector, loose, limited):
    """As cvxpy found it from the detector's definition, written out, with Clarabel."""
    for attacker, optimum in ((ATTACKER, loose), (LIMITED, limited)):
        assert bound_of(detector, attacker=attacker).value_m == pytest.approx(optimum, rel=1e-5)


@pytest.mark.parametrize(
    ("detector", "optimum"),
    [
        (FiniteMovingAverage(window_s=4.0, shape="step", signals="both"), 154.685),
        (FiniteMovingAverage(window_s=4.0, shape="ramp", signals="both"), 165.567),
        (CumulativeBank(windows_s=(1.0, 4.0, 60.0)), 212.811),
    ],
    ids=["step", "ramp", "bank"],
)
def test_a_free_bound_is_the_optimum_of_its_program(detector, optimum):
    """The same, with HiGHS for sums and Clarabel for the bank."""
    assert bound_of(detector).value_m == pytest.approx(optimum, rel=1e-5)


@pytest.mark.parametrize("attacker", [None, ATTACKER], ids=["free", "restricted"])
def test_a_calibration_takes_its_factor_along(attacker):
    scaled = Calibrated(SnapshotChi2(), scale=4.0)
    plain, bound = (bound_of(each, attacker=attacker) for each in (SnapshotChi2(), scaled))
    assert bound.value_m == pytest.approx(2.0 * plain.value_m, rel=1e-5)
    check_edge(scaled, RUN, TIMING, bound)


RESCALED = {"rescaled": True, "rescale": (2.0, 0.5, 1.5, 3.0)}


@pytest.mark.parametrize(
    ("inner", "how"),
    [
        (Cusum(signals="both"), RESCALED),
        (LagCusum(lag=10, baseline=20), RESCALED),
        (JointChart(weight_scale=None), {}),
        (InnovationRate(settled_s=18.0), {}),
    ],
)
def test_rescaled_innovations_and_scaled_flags_are_judged_as_they_are(inner, how):
    detector = Calibrated(inner, scale=0.7, **how)
    for run in (RUN, SETTING) if how else (RUN,):
        bound = bound_of(detector, run, attacker=false_position(run, **LOOSE))
        check_edge(detector, run, TIMING, bound)


class Mine(SnapshotChi2):
    """Another detector than its base."""


@pytest.mark.parametrize(
    ("detector", "why"),
    [
        (Ewma(), "Ewma: its weights change the gains; the optimized open-loop attack"),
        (Shewhart(weight_scale=0.3), "Shewhart: its weights change the gains"),
        (SnapshotChi2(two_sided=True), "SnapshotChi2: it alarms at innovations that are too small"),
        (WindowedChi2(covariance="estimated"), "WindowedChi2: an estimated covariance lets"),
        (Mine(), "Mine: nothing is known of its statistic"),
        *((DETECTORS[name](), f"{DETECTORS[name].__name__}: ") for name in sorted(WITHOUT)),
    ],
)
def test_a_refusal_says_why_and_what_holds_instead(detector, why):
    with pytest.raises(ValueError, match=f"no zero-alarm bound for {why}.*;? "):
        judged_by(detector, RUN, TIMING)


def test_without_the_solver_it_is_said_how_to_get_it(monkeypatch):
    assert {type(each) for each in PASSIVE} | {Never} == {*SETS}  # every detector is decided
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(ImportError, match=r"pip install 'spoofgym\[limits\]'"):
        convex.clarabel_module()


@pytest.mark.parametrize("attacker", [None, ATTACKER], ids=["free", "restricted"])
def test_a_solver_that_stops_short_has_an_upper_bound_or_none(monkeypatch, attacker):
    clarabel, detector = convex.clarabel_module(), WindowedChi2(window=7)
    exact = bound_of(detector, attacker=attacker).value_m

    def stop_after(iterations):
        def settings():
            found = clarabel.DefaultSettings()
            found.max_iter = iterations
            return found

        short = SimpleNamespace(**{**vars(clarabel), "DefaultSettings": settings})
        monkeypatch.setattr(convex, "clarabel_module", lambda: short)

    stop_after(2)
    with pytest.raises(RuntimeError, match="Clarabel found no optimum: MaxIterations"):
        bound_of(detector, attacker=attacker)
    stop_after(8)
    bound = bound_of(detector, attacker=attacker)
    assert (bound.kind, bound.innovation, bound.commands) == ("upper", None, None)
    assert bound.note.startswith("Clarabel found no optimum: ")
    assert bound.note.endswith("; upper bound by the dual")
    assert exact <= bound.value_m <= 1.2 * exact


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_energies_of_any_size_are_solved(scale):
    detector = SequentialChi2(signals="range_rate")
    plain = bound_of(detector, attacker=ATTACKER)
    bound = bound_of(Calibrated(detector, scale=scale), attacker=ATTACKER)
    assert bound.kind == "exact"
    assert bound.value_m <= max(np.sqrt(scale), 1.0) * plain.value_m * (1.0 + 1e-6)
