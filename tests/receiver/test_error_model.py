"""How errors grow, against the printed transition and dense algebra."""

import numpy as np
import pytest

from spoofgym.core.compile import njit
from spoofgym.core.simd import LANES, load
from spoofgym.earth.wgs84 import EARTH_RATE, geocentric_surface_radius, geodetic_to_ecef, gravity
from spoofgym.receiver._kernels import show_transition
from spoofgym.receiver.states import (
    CLOCK_BIAS,
    CLOCK_DRIFT,
    INDEX,
    PACKED,
    STATES,
    TERMS,
    propagate_covariance,
    transition_terms,
)
from spoofgym.truth._kernels import load3

from ..lanes import in_all_lanes, side_by_side
from .reference import skew

SD = np.array([*np.repeat([1e-4, 0.1, 10.0, 3e-4, 5e-9], 3), 10.0, 0.1])


def rotation(rng):
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return Q * np.sign(np.linalg.det(Q))


@njit
def terms_of(interval, terms):
    """`interval`: rows of C (9), r (3), f (3) and tau."""
    C = load3(interval, 0) + load3(interval, 3) + load3(interval, 6)
    transition_terms(C, load3(interval, 9), load3(interval, 12), load(interval, 15), terms)


def terms_and_interval(intervals):
    """Lane arrays of up to eight (C, r, f, tau); the first fill up."""
    filled = [intervals[i % len(intervals)] for i in range(LANES)]
    interval = side_by_side([np.concatenate([np.ravel(x) for x in each]) for each in filled])
    terms = np.full((TERMS, LANES), np.nan)
    in_all_lanes(terms_of, interval, terms)
    return terms, interval


def transitions(intervals):
    """Matrices of up to eight (C, r, f, tau), each written over the one before."""
    terms, interval = terms_and_interval(intervals)
    Phi, found = np.zeros(STATES * STATES), []
    for i in range(len(intervals)):
        show_transition(terms, float(interval[15, i]), i, Phi)
        found.append(Phi.reshape(STATES, STATES).copy())
    return found


def as_printed(C, r, f, tau):
    """Groves (2013), eqs. 14.48 to 14.50."""
    Phi = np.eye(STATES)
    a, v, p, ba, bg = (slice(3 * i, 3 * i + 3) for i in range(5))
    omega = skew([0.0, 0.0, EARTH_RATE])
    g = np.array(gravity(*r))
    Phi[a, a] -= omega * tau
    Phi[a, bg] = C * tau
    Phi[v, a] = -skew(C @ f) * tau
    Phi[v, v] -= 2.0 * omega * tau
    Phi[v, p] = -2.0 * tau / geocentric_surface_radius(*r) * np.outer(g, r / np.linalg.norm(r))
    Phi[v, ba] = C * tau
    Phi[p, v] = np.eye(3) * tau
    Phi[CLOCK_BIAS, CLOCK_DRIFT] = tau
    return Phi


def eight_intervals(rng):
    places = rng.uniform((-1.5, -3.0, -100.0), (1.5, 3.0, 2e4), (8, 3))
    taus = [0.01, 0.5, 3.0, *rng.uniform(0.01, 3.0, 5)]
    return [
        (rotation(rng), geodetic_to_ecef(*place), rng.normal(0.0, 10.0, 3), tau)
        for place, tau in zip(places, taus, strict=True)
    ]


@pytest.mark.nojit
def test_the_transition_is_the_printed_one():
    intervals = eight_intervals(np.random.default_rng(0))
    for Phi, each in zip(transitions(intervals), intervals, strict=True):
        np.testing.assert_allclose(Phi, as_printed(*each), rtol=1e-14, atol=1e-18)


@njit
def grow(P, terms, interval, psd, work):
    propagate_covariance(P, 0, terms, load(interval, 15), psd, 0, work)


@pytest.mark.nojit
def test_propagation_is_that_of_dense_matrices():
    rng = np.random.default_rng(3)
    intervals = eight_intervals(rng)
    root = rng.standard_normal((8, 17, 17))
    P = root @ root.transpose(0, 2, 1) * np.outer(SD, SD)
    psd = SD**2 * rng.uniform(0.0, 1.0, (8, 17))
    packed = side_by_side([each[np.triu_indices(STATES)] for each in P])
    assert packed.shape == (PACKED, LANES)
    work = np.full((187, LANES), np.nan)
    in_all_lanes(grow, packed, *terms_and_interval(intervals), side_by_side(psd), work)
    for i, each in enumerate(intervals):
        Phi, Q = as_printed(*each), np.diag(psd[i] * each[3])
        want = Phi @ (P[i] + Q / 2.0) @ Phi.T + Q / 2.0
        scale = np.sqrt(np.outer(np.diag(want), np.diag(want)))
        mine = packed[:, i][INDEX]
        np.testing.assert_allclose(mine / scale, want / scale, rtol=0, atol=1e-13)
