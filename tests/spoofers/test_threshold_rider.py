"""The threshold rider learns how the statistic follows its rate, and stays below the margin."""

import numpy as np

from spoofgym.spoofers import ThresholdRider

from .test_feedback import bound

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
