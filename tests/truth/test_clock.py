"""The receiver's clock: its covariance and its settings."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.truth.clock import TCXO, advance_clock

PSD = st.floats(0.0, 100.0)


@pytest.mark.nojit
@given(st.floats(0.01, 30.0), PSD, PSD)
def test_the_noise_of_an_interval_has_the_covariance_of_a_two_state_clock(tau, phase, frequency):
    # the step is linear in its two independent deviates
    columns = ((1.0, 0.0), (0.0, 1.0))
    G = np.array([advance_clock(0.0, 0.0, tau, phase, frequency, *each) for each in columns]).T
    cross = frequency * tau**2 / 2.0
    Q = [[phase * tau + frequency * tau**3 / 3.0, cross], [cross, frequency * tau]]
    np.testing.assert_allclose(G @ G.T, Q, rtol=1e-12, atol=1e-300)


@pytest.mark.nojit
def test_without_noise_the_bias_runs_with_the_drift():
    assert advance_clock(10.0, 3.0, 0.5, 0.0, 0.0, 1.3, -0.7) == (11.5, 3.0)


def test_a_crystal_oscillator_is_as_stable_as_its_coefficients():
    """Allan variance h0 / (2 tau) + (2 pi)^2 tau h_-2 / 6, and the book's typical densities."""
    tau, c = 10.0, 299_792_458.0
    p, f = TCXO.phase_psd, TCXO.frequency_psd
    allan = (p / tau + f * tau / 3.0) / c**2  # of the two-state clock
    assert allan == pytest.approx(2e-19 / (2 * tau) + (2 * math.pi) ** 2 * tau * 2e-20 / 6.0)
    assert p == pytest.approx(0.01, rel=0.15)  # Groves (2013), section 9.4.2
    assert f == pytest.approx(0.04, rel=0.15)
