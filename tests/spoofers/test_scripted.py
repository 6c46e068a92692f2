"""Scripted spoofers, those of the papers too: closed forms of what they command."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baselines.paper_attacks import PAPER_ATTACKS
from spoofgym.attacks import make_attack
from spoofgym.attacks._kernels import kinematic_step
from spoofgym.spoofers import SPOOFERS, Dash, Intermittent, SpooferContext, make_spoofer

pytestmark = pytest.mark.nojit

PLANE = ("north", "east")
CALM = np.zeros((3, 1), dtype=np.float32)
"""What a spoofer observes that sees nothing but the detector's statistic: there is all room."""


def context(control="acceleration", axes=PLANE, **changes):
    names = tuple(f"{axis}_{control}" for axis in axes)
    told = SpooferContext(3, 0.5, 300, control, 0.05, 5.0, names, ("statistic_ratio",))
    return told._replace(**changes)


def flown(spoofer, told):
    spoofer.bind(told)
    spoofer.reset()
    displacement, rate = np.zeros(len(told.action_names)), np.zeros(len(told.action_names))
    vector = told.action_names[0].startswith(("north", "east", "down"))
    by_rate, fastest = told.control == "rate", told.rate_limit_mps
    unit = fastest if by_rate else told.acceleration_limit_mps2
    how = told.interval_s, vector, by_rate, unit, fastest
    rows = []
    for _ in range(told.steps):
        action = spoofer.act(CALM)
        assert action.shape == (told.receivers, len(told.action_names))
        assert np.abs(action).max() <= 1.0
        kinematic_step(np.ascontiguousarray(action[0]), False, *how, displacement, rate)
        rows.append((displacement.copy(), rate.copy()))
    both = np.array(rows)
    return both[:, 0], both[:, 1]


@pytest.mark.parametrize("name", sorted(SPOOFERS.keys() - {"onnx-policy", "action-curves"}))
@pytest.mark.parametrize("control", ["rate", "acceleration"])
def test_what_is_remembered_is_what_the_attack_does(name, control):
    found = {"rates_mps": (0.0, 0.1, 0.4)} if name == "open-loop" else {}
    spoofer = make_spoofer({"name": name, **found})
    displacement, rate = flown(spoofer, context(control))
    if name == "none":
        assert not displacement.any()
        return
    assert spoofer.memory["displacement"][0] == pytest.approx(displacement[-1, 1], rel=1e-12)
    assert spoofer.memory["rate"][0] == pytest.approx(rate[-1, 1], abs=1e-12)
    assert not displacement[:, 0].any()


def test_a_ramp_and_a_step_by_rate_are_straight_lines_and_opposite_headings_mirror():
    displacement, _ = flown(make_spoofer({"name": "ramp", "rate_mps": 0.2}), context("rate"))
    np.testing.assert_allclose(displacement[:, 1], 0.1 * np.arange(1, 301), rtol=1e-12)
    displacement, rate = flown(make_spoofer({"name": "ramp", "rate_mps": 0.2}), context())
    np.testing.assert_allclose(rate[7:, 1], 0.2)  # 4 s at 0.05 m/s^2, then constant
    assert displacement[-1, 1] == pytest.approx(0.2 * (150.0 - 2.0))
    step, fast = make_spoofer({"name": "step", "size_m": 7.0}), context("rate", rate_limit_mps=4.0)
    np.testing.assert_allclose(flown(step, fast)[0][:5, 1], [2.0, 4.0, 6.0, 7.0, 7.0])
    told = context(axes=("S01", "S07", "S11"))  # all commanded alike
    displacement, _ = flown(make_spoofer({"name": "ramp", "rate_mps": -0.1}), told)
    assert (displacement[-1] < -14.0).all()
    assert np.ptp(displacement, axis=1).max() == 0.0
    one, other = (
        flown(make_spoofer({"name": "ramp", "heading_deg": heading}), context())[0]
        for heading in (30.0, 210.0)
    )
    np.testing.assert_allclose(one, -other, atol=1e-12)
    np.testing.assert_allclose(one[1:, 1] / one[1:, 0], np.tan(np.radians(30.0)), rtol=1e-9)


@pytest.mark.parametrize("control", ["rate", "acceleration"])
def test_an_accelerating_ramp_is_a_parabola_up_to_the_limit_of_the_rate(control):
    told = context(control, rate_limit_mps=1.0)
    spoofer = make_spoofer({"name": "accelerating-ramp", "acceleration_mps2": 0.01})
    displacement, rate = flown(spoofer, told)
    time = 0.5 * np.arange(1, 301)
    np.testing.assert_allclose(rate[:, 1], np.minimum(0.01 * time, 1.0), atol=1e-12)
    # held over the interval, a rate covers a little more than its mean
    more = 0.5 * 0.5 * np.minimum(0.01 * time, 1.0) if control == "rate" else 0.0
    parabola = np.where(time <= 100.0, 0.005 * time**2, 50.0 + (time - 100.0))
    np.testing.assert_allclose(displacement[:, 1], parabola + more, atol=1e-9)


@given(
    size=st.floats(0.01, 400.0),
    limit=st.floats(0.01, 1.0),
    fastest=st.floats(0.2, 10.0),
    interval=st.sampled_from([0.2, 0.5, 1.0]),
)
def test_a_step_arrives_stops_and_never_overshoots(size, limit, fastest, interval):
    told = context(
        acceleration_limit_mps2=limit, rate_limit_mps=fastest, interval_s=interval, steps=400
    )
    displacement, rate = flown(make_spoofer({"name": "step", "size_m": size}), told)
    d, v = displacement[:, 1], rate[:, 1]
    assert d.max() <= size * (1.0 + 1e-9)
    assert (np.diff(d) >= -1e-9).all()
    # bang, cruise, bang takes this long in continuous time; epochs add one or two
    least = 2.0 * np.sqrt(size / limit)
    if fastest**2 / limit < size:
        least = size / fastest + fastest / limit
    arrived = int(np.ceil(least / interval)) + 2
    if arrived < told.steps:
        np.testing.assert_allclose(d[arrived:], size, rtol=1e-9)
        np.testing.assert_allclose(v[arrived:], 0.0, atol=1e-9)


@pytest.mark.parametrize(("last_s", "waits"), [(5.0, 30), (20.0, 0), (1000.0, 0)])
def test_a_dash_waits_and_then_is_as_fast_as_it_may_be(last_s, waits):
    _, rate = flown(Dash(rate_mps=2.0, last_s=last_s), context(steps=40))
    pushes = np.diff(rate[:, 1], prepend=0.0) / (0.05 * 0.5)
    # 2 m/s are 80 epochs at the largest acceleration
    np.testing.assert_allclose(pushes, np.arange(40) >= waits, atol=1e-9)


def test_what_the_attack_does_not_allow_is_refused_with_both_names():
    make_spoofer({"name": "accelerating-ramp", "acceleration_mps2": 0.06}).bind(context("rate"))
    axes = ("east", "down")
    for spec, told, message in (
        ({"name": "ramp", "rate_mps": 6.0}, context(), r"`rate_mps` = 6 .* `rate_limit_mps` = 5"),
        (
            {"name": "accelerating-ramp", "acceleration_mps2": 0.06},
            context(),
            r"0\.06 .* `acceleration_limit_mps2` = 0\.05",
        ),
        ({"name": "ramp", "heading_deg": 0.0}, context(axes=axes), "`heading_deg` = 0 needs a"),
    ):
        with pytest.raises(ValueError, match=message):
            make_spoofer(spec).bind(told)


@pytest.mark.parametrize("name", sorted(SPOOFERS))
@pytest.mark.parametrize("control", ["rate", "acceleration"])
def test_the_range_of_a_search_can_be_bound(name, control):
    kind, told = SPOOFERS[name], context(control)
    if kind.tunable is None:
        with pytest.raises(ValueError, match="has no setting to tune"):
            kind.tuning_range(told)
        return
    low, high = kind.tuning_range(told)
    assert 0.0 < low < high
    for value in (low, high):
        make_spoofer({"name": name, kind.tunable: value}).bind(told)


FAST = context("rate", rate_limit_mps=250.0, steps=360)


def east(spoofer, told=FAST):
    return (each[:, 1] for each in flown(spoofer, told))


def test_ramps_and_steps_take_turns_and_return_within_an_epoch():
    settings = {"shapes": ("ramp", "step"), "on_s": 30.0, "off_s": 10.0}
    burst = np.concatenate([0.5 * np.arange(1, 61), np.zeros(20)])
    step = np.concatenate([np.full(60, -20.0), np.zeros(20)])
    want = np.tile(np.concatenate([burst, step]), 3)[:360]
    found, _ = east(Intermittent(sizes_m=(30.0, -20.0), **settings))
    np.testing.assert_allclose(found, want, atol=1e-9)
    few = Intermittent(sizes_m=(60.0, -40.0), scale=0.5, bursts=3, **settings)
    want[240:] = 0.0  # silence after the last burst
    found, _ = east(few)
    np.testing.assert_allclose(found, want, atol=1e-9)
    # the intermittent attack of zhong2025
    found, _ = east(make_spoofer(dict(PAPER_ATTACKS["zhong2025-intermittent"].spoofer)))
    time = 200.0 + 0.5 * np.arange(1, 361)  # of the epochs that are spoofed
    want = np.where(time <= 270.0, 0.5 * (time - 200.0), 0.0)
    want = np.where((time > 280.0) & (time <= 350.0), 25.0, want)
    np.testing.assert_allclose(found, want, atol=1e-9)


def test_within_limits_it_returns_as_quickly_as_it_can_and_rests():
    spoofer = Intermittent(shapes=("step",), sizes_m=(10.0,), on_s=60.0, off_s=60.0)
    found, rate = east(spoofer, context(steps=240))
    assert found.max() == pytest.approx(10.0)
    assert found.min() >= -1e-9  # no overshoot
    assert found[119] == pytest.approx(10.0)
    # 10 m at 0.05 m/s^2, half of the way up and half down: 28.3 s
    assert found[120 + 58] == pytest.approx(0.0, abs=1e-6)
    assert found[120 + 54] > 1e-3
    assert np.abs(rate[-10:]).max() < 1e-9
    # a ramp that is broken off comes back
    found, rate = east(Intermittent(sizes_m=(40.0,), on_s=60.0, off_s=90.0), context())
    assert found.max() > 25.0
    assert (found[-1], rate[-1]) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_every_shape_is_known_and_has_a_size():
    with pytest.raises(ValueError, match="`shapes` must be 'ramp' or 'step', got 'sine'"):
        Intermittent(shapes=("sine",))
    with pytest.raises(ValueError, match=r"`shapes` and `sizes_m` must be as many, .* got 1 and 2"):
        Intermittent(sizes_m=(1.0, 2.0))
    low, high = Intermittent.tuning_range(None)
    assert (low * 20.0, high * 20.0) == pytest.approx((0.1, 1000.0))


@pytest.mark.parametrize("name", PAPER_ATTACKS)
def test_every_attack_of_a_paper_can_be_made(name):
    found = PAPER_ATTACKS[name]
    satellites = ("S15", "S05", "S11")[: found.satellites]
    assert make_attack(found.attack(satellites)).channels == satellites
    with pytest.raises(ValueError, match="`channels` must name"):
        found.attack(())
    steps = round(found.duration_s / 0.5)
    offset, _ = east(make_spoofer(dict(found.spoofer)), FAST._replace(steps=steps + 10))
    assert offset[0] > 0.0
    assert offset[steps - 1] > 0.0
    np.testing.assert_allclose(offset[steps:], 0.0, atol=1e-9)
