"""Feedback and the threshold rider: forward while the statistic leaves room, else back."""

import numpy as np
import pytest

from spoofgym.envs.spoofer_binding import bound_spoofer
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.spoofers import Feedback, FeedbackProfile, Profile, ThresholdRider


def bound(receivers=3, kind=Feedback, **settings):
    setup = TightlyCoupledSetup(detector="ewma")
    spoofer = kind(**settings)
    context, observer, _ = bound_spoofer(spoofer, setup, receivers)
    spoofer.bind(context)
    spoofer.reset()
    return spoofer, observer.names


def wanted(spoofer, names, ratios):
    seen = np.zeros((len(ratios), len(names)), dtype=np.float32)
    seen[:, names.index("statistic_ratio")] = ratios
    return spoofer.wanted_rate(seen)


def test_the_wanted_rate_is_the_rule_or_along_a_curve_a_part_of_its_rate():
    spoofer, names = bound(rate_mps=0.2, growth=4.0, full_ratio=0.5, zero_ratio=1.0, back=-0.8)
    rates = wanted(spoofer, names, [0.2, 0.75, 2.0])
    np.testing.assert_allclose(rates, [0.2, 0.1, -0.16], rtol=1e-6)
    spoofer.memory["step"][:] = 150.0
    np.testing.assert_allclose(wanted(spoofer, names, [0.2, 1.0, 1.1]), [0.5, 0.0, -0.1], rtol=1e-5)
    settings = {"rates_mps": CURVE, "full_ratio": 0.5, "zero_ratio": 1.0, "back": 0.0}
    spoofer, names = bound(kind=FeedbackProfile, **settings)
    spoofer.memory["step"][:] = 149.0  # the knot in the middle of 300 epochs
    rates = wanted(spoofer, names, [0.2, 0.75, 2.0])
    np.testing.assert_allclose(rates, [0.3, 0.15, 0.0], rtol=1e-5)
    curve, _ = bound(kind=Profile, receivers=2, rates_mps=CURVE)
    settings = {"rates_mps": CURVE, "full_ratio": 1.0, "zero_ratio": 1.01}
    spoofer, names = bound(kind=FeedbackProfile, receivers=2, **settings)
    seen = np.zeros((2, len(names)), dtype=np.float32)
    seen[:, names.index("statistic_ratio")] = [0.3, 0.999]
    for _ in range(40):
        np.testing.assert_array_equal(spoofer.act(seen), curve.act(seen[:, :0]))


CURVE = (0.1, 0.3, 0.2)


def test_what_cannot_be_played_is_refused():
    with pytest.raises(ValueError, match=r"`zero_ratio` must be above `full_ratio` = 0\.47"):
        Feedback(zero_ratio=0.4)
    with pytest.raises(ValueError, match="`rates_mps` = 7 is more than the attack allows"):
        bound(kind=FeedbackProfile, rates_mps=(0.1, 7.0))
    spoofer, names = bound()
    assert names.count("statistic_ratio") == 1
    with pytest.raises(ValueError, match="Feedback needs statistic_ratio among the observations"):
        Feedback().bind(spoofer.context._replace(observation_names=("time_left",)))


RESPONSE, RHO, QUIET = 0.9, 0.6, 0.2
"""Of a statistic that a horizon later is QUIET (1 - RHO) + RHO q + RESPONSE u, u the mean rate."""


def rider(**settings):
    return bound(kind=ThresholdRider, receivers=2, **settings)


def ridden(spoofer, names, noise=0.0, seed=0, epochs=300):
    """Ratios (epochs, B) of a statistic that follows the rate by a law that it does not know."""
    many = spoofer.context.receivers
    h, tau = spoofer.memory["past"].shape[1], spoofer.context.interval_s
    rng = np.random.default_rng(seed)
    ratios = np.full((epochs + 1, many), QUIET)
    displaced = np.zeros((epochs + 1, many))
    for k in range(epochs):
        seen = np.zeros((many, len(names)), dtype=np.float32)
        seen[:, names.index("statistic_ratio")] = ratios[k]
        spoofer.act(seen)
        displaced[k + 1] = spoofer.memory["displacement"]
        past = max(k + 1 - h, 0)
        moved = (displaced[k + 1] - displaced[past]) / (h * tau)
        level = (1.0 - RHO) * QUIET + RHO * ratios[past] + RESPONSE * moved
        ratios[k + 1] = level + noise * rng.standard_normal(many)
    return ratios


def test_it_learns_the_law_of_the_statistic():
    spoofer, names = rider(rates_mps=(0.0, 0.4) * 6, horizon_s=5.0, margin=100.0)
    ridden(spoofer, names, noise=0.02)
    c, rho, response = spoofer.memory["found"].T
    np.testing.assert_allclose(response, RESPONSE, atol=0.15)
    np.testing.assert_allclose(rho, RHO, atol=0.15)
    np.testing.assert_allclose(c, (1.0 - RHO) * QUIET, atol=0.05)
    np.testing.assert_allclose(np.sqrt(spoofer.memory["variance"]), 0.02, rtol=0.5)


def test_the_statistic_stays_below_the_margin_and_more_margin_goes_farther():
    free, names = rider(rates_mps=(0.1, 0.9), margin=100.0, horizon_s=5.0)
    assert ridden(free, names).max() > 1.5
    held, names = rider(rates_mps=(0.1, 0.9), margin=0.9, horizon_s=5.0)
    ratios = ridden(held, names)
    assert ratios.max() <= 0.9
    assert ratios[-50:].min() > 0.6  # and it rides there
    waiting, names = rider(rates_mps=(0.3, 0.3))  # without room, and never goes back
    seen = np.zeros((2, len(names)), dtype=np.float32)
    seen[:, names.index("statistic_ratio")] = [0.0, 5.0]
    np.testing.assert_array_equal(waiting.wanted_rate(seen), [0.3, 0.0])
    far = []
    for settings in ({"margin": 0.6}, {"margin": 0.9}, {"margin": 0.9, "deviations": 2.0}):
        spoofer, names = rider(rates_mps=(0.1, 0.9), horizon_s=5.0, **settings)
        ridden(spoofer, names, noise=0.03)
        far.append(spoofer.memory["displacement"].mean())
    assert far[0] < far[1]
    assert far[2] < far[1]
