"""Bursts and pauses, and the papers' attacks that are made of them."""

import numpy as np
import pytest

from baselines.paper_attacks import PAPER_ATTACKS
from spoofgym.attacks import make_attack
from spoofgym.spoofers import Intermittent, make_spoofer

from .test_scripted import context, flown

pytestmark = pytest.mark.nojit

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
