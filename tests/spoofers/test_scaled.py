"""A factor on what a spoofer commands."""

import numpy as np
import pytest

from spoofgym.spoofers import Ramp, Scaled, SpooferContext, make_spoofer
from spoofgym.spoofers.learned import ModelPolicy
from spoofgym.testing import check_spoofer

AXES = ("north_acceleration", "east_acceleration")
CONTEXT = SpooferContext(2, 0.5, 40, "acceleration", 0.05, 5.0, AXES)
NOTHING = np.zeros((2, 0), dtype=np.float32)


def pushed(spec):
    spoofer = make_spoofer(spec)
    spoofer.bind(CONTEXT)
    spoofer.reset()
    return np.array([spoofer.act(NOTHING)[:, 1] for _ in range(CONTEXT.steps)])


@pytest.mark.parametrize("name", ["step", "profile"])
def test_commands_are_so_many_times_as_large(name):
    whole = pushed(name)
    assert np.abs(whole).max() > 0.0
    np.testing.assert_allclose(pushed({"name": name, "amplitude": 0.3}), 0.3 * whole)
    assert np.abs(pushed({"name": "step", "amplitude": 3.0})).max() == 1.0  # and is cut


def test_a_plan_that_looks_at_its_own_commands_is_scaled_as_a_whole():

    def chases(seen):
        return np.stack([0 * seen[:, 0], 0.3 - 0.5 * seen[:, 0] - 0.2 * seen[:, 1]], axis=1)

    names = ("own_displacement_east", "own_rate_east", "time_since_onset")
    context = CONTEXT._replace(observation_names=names)

    def commanded(amplitude):
        spoofer = Scaled(ModelPolicy(chases), amplitude)
        spoofer.bind(context)
        spoofer.reset()
        rate, moved, found = np.zeros(2), np.zeros(2), []
        for _ in range(20):
            seen = np.stack([moved, rate, np.ones(2)], axis=1).astype(np.float32)
            rate = rate + spoofer.act(seen)[:, 1]
            moved = moved + rate
            found.append(moved)
        return np.array(found)

    np.testing.assert_allclose(commanded(2.0), 2.0 * commanded(1.0), rtol=1e-5)


def test_it_is_what_the_spoofer_is():
    scaled = make_spoofer({"name": "profile", "label": "mine", "amplitude": 2})
    assert (scaled.knowledge, scaled.label, scaled.transmits) == ("blind", "mine", True)
    assert Scaled.tuning_range(CONTEXT)[0] < 1.0 < Scaled.tuning_range(CONTEXT)[1]
    check_spoofer({"name": "profile", "rates_mps": [0.0, 0.4], "amplitude": 0.5})
    with pytest.raises(TypeError, match="`spoofer` must be a Spoofer that is not scaled"):
        Scaled(Scaled(Ramp(), 0.5), 0.5)
    for amplitude in (0.0, float("nan"), "large"):
        with pytest.raises((ValueError, TypeError), match="`amplitude`"):
            make_spoofer({"name": "step", "amplitude": amplitude})
