"""Feedback goes by the statistic: forward while there is room, back when there is none."""

import numpy as np
import pytest

from spoofgym.envs.spoofer_binding import bound_spoofer
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.spoofers import Feedback, FeedbackProfile, Profile


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
