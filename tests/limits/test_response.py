"""Response replay against the simulator that it stands for."""

import functools

import numpy as np
import pytest

from spoofgym.bench.runs.panel import Panel, PanelAttack
from spoofgym.bench.runs.play import induced_error
from spoofgym.detectors import DETECTORS, Calibrated, Ewma, Never, make_detector
from spoofgym.limits import NotReplayable, Replay, response
from spoofgym.limits.response import check_replayable
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.setup import make_generators, seeds_of_runs
from spoofgym.simulation.simulator import weighs
from spoofgym.tasks.v1 import DRAWN

SHORT = {"warmup_s": 60.0, "live_s": 40.0, "attack_s": 60.0, "time_to_alert_s": 5.0}
TOP_MPS = 0.4
RAMP = {"name": "profile", "rates_mps": [0.0, TOP_MPS]}
SPECIAL = {"pool", "oracle-step", "oracle-ramp"}
"""Of other detectors, and of what an attack is."""


def setup_of(**settings):
    return TightlyCoupledSetup(**{"detector": "never", "timeline": SHORT, **settings})


@functools.cache
def sorted_out():
    setup, can, cannot = setup_of(), [], []
    for name in sorted(DETECTORS.keys() - SPECIAL):
        detector = make_detector(name)
        if detector.measures == "position":
            continue
        try:
            check_replayable(detector)
            ok = not weighs(setup, detector)
        except NotReplayable:
            ok = False
        (can if ok else cannot).append(name)
    return can, cannot


def seeds_of(setup, runs):
    return seeds_of_runs(0, "training", setup.name, range(runs))


def panel_of(setup, detectors, runs):
    return Panel(setup, detectors, lambda: make_generators(seeds_of(setup, runs)), 1)


def ramp_of(setup, top=TOP_MPS):
    return top * np.linspace(0.0, 1.0, setup.steps // setup.repeat + 1)[1:]


def test_all_detectors_of_satellites_but_those_that_weigh_are_replayed():
    can, cannot = sorted_out()
    assert len(can) >= 15
    assert {"snapshot-chi2", "aime", "raim", "solution-separation", "never"} <= {*can}
    assert {"ewma", "joint-chart"} <= {*cannot}
    setup = setup_of()
    for detector in map(make_detector, cannot):
        said = rf"^{type(detector).__name__} .*: play it on the engine$"
        with pytest.raises(NotReplayable, match=said):
            Replay(setup, [Never(), detector], seeds_of(setup, 1))


@pytest.mark.parametrize(
    ("settings", "names", "runs"),
    [
        ({}, None, 12),
        ({"decision_interval_s": 10.0, "attack": "quiet"}, ["snapshot-chi2", "aime"], 16),
        ({"target_heading_deg": "random"}, ["snapshot-chi2", "raim"], 16),
        pytest.param({"domain": DRAWN}, None, 16, marks=pytest.mark.nightly),
    ],
)
def test_every_detector_alarms_as_on_the_simulator(settings, names, runs):
    names = names or sorted_out()[0]
    setup, plain = setup_of(**settings), [make_detector(name) for name in names]
    number, heading = range(len(names)), "target" if "target_heading_deg" in settings else 90.0
    still, ramp = (
        [(PanelAttack({**RAMP, "rates_mps": x, "heading_deg": heading}, runs), k) for k in number]
        for x in ([0.0, 0.0], RAMP["rates_mps"])
    )
    panel = panel_of(setup, plain, runs)
    # at thresholds among which alarms come and go
    typical = [[np.median(each.peak) for each in panel.play(x)] for x in (still, ramp)]
    scales = np.where(np.array(typical[1]) > 0.0, np.sqrt(np.prod(typical, axis=0)), 1.0)
    scaled = [
        make_detector({"name": name, "threshold_scale": float(scale)})
        if DETECTORS[name].calibrates
        else make_detector(name)
        for name, scale in zip(names, scales, strict=True)
    ]
    replay = Replay(setup, scaled, seeds_of(setup, runs), threads=1)
    panel, late = panel_of(setup, scaled, runs), 0
    pairs = zip(*(panel.play(x, drop=False) for x in (still, ramp)), strict=True)
    for k, (idle, played) in enumerate(pairs):
        found = replay.play(k, ramp_of(setup)[None])
        assert (found.first_alarm[0] == played.first_alarm).mean() >= 0.9, names[k]
        np.testing.assert_allclose(found.peak[0], played.peak, rtol=0.005, err_msg=names[k])
        induced = induced_error(setup, played, idle)
        np.testing.assert_allclose(found.error[:, 0], induced, atol=5e-4 * induced.max())
        late += int((played.first_alarm > 1).sum())
    assert late > len(names) * runs // 4  # so that something has been compared


def test_no_attack_is_the_clean_run_and_several_attacks_are_those_of_one():
    setup = setup_of()
    detector = make_detector({"name": "snapshot-chi2", "threshold_scale": 0.2})
    replay = Replay(setup, [detector], seeds_of(setup, 8))
    found = replay.play(0, np.zeros((1, setup.steps)))
    (clean,) = panel_of(setup, [detector], 8).clean
    np.testing.assert_allclose(found.peak[0], clean.peak, rtol=1e-5)  # matrices in single precision
    np.testing.assert_array_equal(found.first_alarm[0], clean.first_alarm)
    assert not found.error.any()
    quiet = Replay(setup_of(attack="quiet"), [detector], seeds_of(setup, 8))
    assert (quiet.play(0, np.zeros((1, setup.steps))).peak != found.peak).all()
    setup = setup_of()
    replay = Replay(setup, [make_detector("shewhart")], seeds_of(setup, 6), threads=2)
    curves = np.array([ramp_of(setup, top) for top in (0.1, 0.2, 0.4)])
    rows = np.array([4, 1])
    some = replay.play(0, curves, rows=rows)
    for number, curve in enumerate(curves):
        every = replay.play(0, curve[None])
        np.testing.assert_array_equal(some.first_alarm[number], every.first_alarm[0, rows])
        np.testing.assert_allclose(some.peak[number], every.peak[0, rows], rtol=1e-12)
        np.testing.assert_allclose(some.error[:, number], every.error[:, 0, rows], rtol=1e-9)
    np.testing.assert_allclose(replay.errors(curves, rows), some.error)


@pytest.mark.parametrize(
    ("attack", "why"), [("per-channel", "and .* commands S"), ("meaconer", "")]
)
def test_other_attacks_are_refused(attack, why):
    setup = setup_of(attack=attack)
    with pytest.raises(NotReplayable, match=f"moves a false position north and east.*{why}"):
        Replay(setup, [make_detector("snapshot-chi2")], seeds_of(setup, 1))


class Fixes(Ewma):
    """Looks at a position, whose response is not known."""

    needs = frozenset({"gnss_position"})


@pytest.mark.parametrize("detector", [Fixes(), Calibrated(Fixes(), scale=2.0)])
def test_a_detector_that_needs_a_position_is_refused_by_name(detector):
    with pytest.raises(NotReplayable, match=r"^Fixes looks at gnss_position, whose response"):
        check_replayable(detector)


def test_bits_do_not_depend_on_how_many_runs_are_judged_or_recorded_together(monkeypatch):
    setup = setup_of(domain=DRAWN)
    names, curves = ["snapshot-chi2", "shewhart"], np.array([ramp_of(setup, x) for x in (0.1, 0.4)])

    def play():
        replay = Replay(setup, [make_detector(x) for x in names], seeds_of(setup, 9), threads=1)
        return [replay.play(k, curves, scale=np.linspace(0.5, 1.5, 9)) for k in range(len(names))]

    whole = play()
    monkeypatch.setattr(response, "JUDGED_AT_ONCE", 5)
    monkeypatch.setattr(response, "RUNS_AT_ONCE", 2)
    for one, other in zip(whole, play(), strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
