"""A factor on what a spoofer commands."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.spoofers import Ramp, Scaled, SpooferContext, make_spoofer
from spoofgym.testing import check_spoofer

CONTEXT = SpooferContext(
    receivers=2,
    interval_s=0.5,
    steps=40,
    control="acceleration",
    acceleration_limit_mps2=0.05,
    rate_limit_mps=5.0,
    action_names=("north_acceleration", "east_acceleration"),
)
NOTHING = np.zeros((2, 0), dtype=np.float32)


def pushed(spec):
    """East command of every epoch."""
    spoofer = make_spoofer(spec)
    spoofer.bind(CONTEXT)
    spoofer.reset()
    return np.array([spoofer.act(NOTHING)[:, 1] for _ in range(CONTEXT.steps)])


@pytest.mark.parametrize("name", ["step", "profile", "accelerating-ramp"])
def test_commands_are_so_many_times_as_large(name):
    whole = pushed(name)
    assert np.abs(whole).max() > 0.0
    np.testing.assert_allclose(pushed({"name": name, "amplitude": 0.3}), 0.3 * whole)


def test_what_the_attack_does_not_allow_is_cut():
    found = pushed({"name": "step", "size_m": 2.0, "amplitude": 3.0})
    assert np.abs(found).max() == 1.0


def test_it_keeps_the_contract_of_a_spoofer():
    check_spoofer({"name": "profile", "rates_mps": [0.0, 0.4], "amplitude": 0.5})


def test_it_is_what_the_spoofer_is():
    scaled = make_spoofer({"name": "profile", "label": "mine", "amplitude": 2})
    assert (scaled.knowledge, scaled.label, scaled.transmits) == ("blind", "mine", True)
    assert Scaled.tuning_range(CONTEXT)[0] < 1.0 < Scaled.tuning_range(CONTEXT)[1]


@pytest.mark.parametrize("amplitude", [0.0, -1.0, float("nan"), "large"])
def test_an_amplitude_is_a_positive_number(amplitude):
    with pytest.raises((ValueError, TypeError), match="`amplitude`"):
        make_spoofer({"name": "step", "amplitude": amplitude})


def test_it_is_not_scaled_twice():
    with pytest.raises(TypeError, match="`spoofer` must be a Spoofer that is not scaled"):
        Scaled(Scaled(Ramp(), 0.5), 0.5)
