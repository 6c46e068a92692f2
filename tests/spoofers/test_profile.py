"""Profiles: the curve goes through its knots, and is flown within the attack's limits."""

import numpy as np
import pytest

from spoofgym.spoofers import Profile, make_spoofer
from spoofgym.spoofers.profile import sample_curve

from .test_scripted import PLANE, context, flown

pytestmark = pytest.mark.nojit

RATES = (0.1, 0.4, 0.35, 0.35, 0.9, 0.2)


def test_the_curve_meets_its_knots_and_stays_between_them():
    curve = sample_curve(RATES, 300)
    # five spans of 60 epochs; the first knot is at the onset, before the first epoch's end
    np.testing.assert_allclose(curve[[59, 119, 179, 239, 299]], RATES[1:], rtol=1e-12)
    assert abs(curve[0] - RATES[0]) < 0.02
    for i, span in enumerate(curve.reshape(5, 60)):
        low, high = sorted(RATES[i : i + 2])
        assert low - 1e-12 <= span.min()
        assert span.max() <= high + 1e-12


@pytest.mark.parametrize("control", ["rate", "acceleration"])
def test_knots_on_a_straight_line_are_a_ramp_and_a_curve_across_goes_to_the_right(control):
    told = context(control)
    ramp = flown(make_spoofer({"name": "accelerating-ramp", "acceleration_mps2": 0.01}), told)
    line = make_spoofer({"name": "profile", "rates_mps": np.linspace(0.0, 1.5, 7).tolist()})
    np.testing.assert_allclose(flown(line, told), ramp, atol=1e-9)
    ramp = flown(make_spoofer({"name": "ramp", "rate_mps": 0.3, "heading_deg": 30.0}), told)
    nothing_across = {"cross_rates_mps": (0.0, 0.0), "heading_deg": 30.0}
    for settings in ({"heading_deg": 30.0}, nothing_across):
        profile = flown(Profile(rates_mps=(0.3, 0.3, 0.3), **settings), told)
        np.testing.assert_allclose(profile, ramp, atol=1e-9)
    told = context(control)
    along, across = (0.0, 0.4, 0.2), (0.0, -0.1, 0.3, 0.3)
    profile = Profile(rates_mps=along, cross_rates_mps=across, heading_deg=0.0)
    displacement, rate = flown(profile, told)
    np.testing.assert_allclose(rate[:, 0], sample_curve(along, 300), atol=1e-12)
    np.testing.assert_allclose(rate[:, 1], sample_curve(across, 300), atol=1e-12)
    for i, name in enumerate(("displacement", "cross_displacement")):
        assert profile.memory[name][0] == pytest.approx(displacement[-1, i], rel=1e-9)


def test_what_is_wanted_too_fast_comes_later_and_limits_hold_for_both_curves():
    told = context()
    _, rate = flown(Profile(rates_mps=(2.0, 2.0, -2.0, -2.0)), told)
    east = rate[:, 1]
    assert np.abs(np.diff(east, prepend=0.0)).max() <= 0.05 * 0.5 * (1.0 + 1e-12)
    np.testing.assert_allclose(east[:80], 0.025 * np.arange(1, 81))
    np.testing.assert_allclose(east[80:100], 2.0)
    told = context(rate_limit_mps=3.0)
    profile = Profile(rates_mps=(2.0, -2.0, 2.0), cross_rates_mps=(2.0, 2.0, -2.0))
    displacement, rate = flown(profile, told)
    size = np.hypot(*np.diff(rate, axis=0, prepend=0.0).T)
    assert size.max() <= 0.025 * (1.0 + 1e-9)
    assert size.min() < 0.024
    # what it remembers is what the attack did, so that the attack had nothing to shorten
    assert profile.memory["rate"][0] == pytest.approx(rate[-1, 1], abs=1e-9)
    assert profile.memory["cross_rate"][0] == pytest.approx(-rate[-1, 0], abs=1e-9)
    assert profile.memory["displacement"][0] == pytest.approx(displacement[-1, 1], rel=1e-9)


@pytest.mark.parametrize(
    ("settings", "axes", "message"),
    [
        ({"rates_mps": (0.1,)}, PLANE, "`rates_mps` must have 2 to 64 rates, got 1"),
        ({"cross_rates_mps": (0.1,) * 65}, PLANE, "`cross_rates_mps` must have 2 to 64 rates"),
        ({"rates_mps": (0.0, -6.0)}, PLANE, "`rates_mps` = 6 .* `rate_limit_mps` = 5"),
        (
            {"rates_mps": (4.0, 4.0), "cross_rates_mps": (4.0, 4.0)},
            PLANE,
            r"`rates_mps` and `cross_rates_mps` together = 5\.65685 .* `rate_limit_mps` = 5",
        ),
        ({"cross_rates_mps": (0.0, 0.1)}, ("S01", "S07"), "needs an attack that moves a false"),
        ({"cross_rates_mps": (0.0, 0.1)}, ("east",), "needs .* `heading_deg` = 90, .* only"),
    ],
)
def test_what_the_attack_does_not_allow_is_refused(settings, axes, message):
    told = context(axes=axes)
    Profile(rates_mps=(0.0, 0.1), heading_deg=90.0).bind(told)
    with pytest.raises(ValueError, match=message):
        make_spoofer({"name": "profile", "heading_deg": 90.0, **settings}).bind(told)
