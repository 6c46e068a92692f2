"""Thresholds against scipy.stats, weights against their definition."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.detectors.innovation import (
    chi2_thresholds,
    igg3_weight,
    two_sided_quantile,
)

PROBABILITIES = [1e-9, 1e-3, 0.5, 0.999]


@pytest.mark.parametrize("alpha", PROBABILITIES)
def test_quantiles_are_those_of_the_distributions(alpha):
    z = two_sided_quantile(alpha)
    assert z == pytest.approx(scipy.stats.norm.isf(alpha / 2.0), rel=1e-12)
    assert 2.0 * scipy.stats.norm.sf(z) == pytest.approx(alpha, rel=1e-9)
    thresholds = chi2_thresholds(alpha, 24)
    want = scipy.stats.chi2.isf(alpha, np.arange(1, 25))
    np.testing.assert_allclose(thresholds[1:], want, rtol=1e-9)
    assert thresholds[0] == thresholds[1]  # finite where there is nothing to exceed it
    assert (np.diff(thresholds[1:]) > 0.0).all()


@pytest.mark.nojit
@given(st.floats(0.0, 10.0), st.floats(0.01, 5.0), st.floats(0.01, 5.0))
def test_a_weight_is_that_of_its_definition(size, accept, width):
    reject = accept + width
    weight = igg3_weight(size, accept, reject)
    if size <= accept:
        assert weight == 1.0
    elif size > reject:
        assert weight == 0.0
    else:
        want = accept / size * ((reject - size) / (reject - accept)) ** 2
        assert weight == pytest.approx(want, rel=1e-12)
    assert 0.0 <= weight <= 1.0


@pytest.mark.nojit
def test_a_weight_falls_without_a_jump():
    sizes = np.linspace(0.0, 3.0, 3001)
    weights = np.array([igg3_weight(size, 1.0, 2.0) for size in sizes])
    assert (np.diff(weights) <= 0.0).all()
    assert np.abs(np.diff(weights)).max() < 4e-3
    assert igg3_weight(1.0, 1.0, 2.0) == 1.0
    assert igg3_weight(2.0, 1.0, 2.0) == 0.0
