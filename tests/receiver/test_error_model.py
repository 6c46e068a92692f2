"""How errors grow: against dense algebra, and against the mechanization itself."""

import numpy as np
import pytest

from spoofgym.core.compile import njit
from spoofgym.core.simd import LANES, load, store
from spoofgym.earth.wgs84 import EARTH_RATE, geocentric_surface_radius, geodetic_to_ecef, gravity
from spoofgym.receiver._kernels import show_transition
from spoofgym.receiver.states import (
    ACCEL_BIAS,
    ATTITUDE,
    CLOCK_BIAS,
    CLOCK_DRIFT,
    GYRO_BIAS,
    IN_ORDER,
    INDEX,
    PACKED,
    POSITION,
    STATES,
    TERMS,
    VELOCITY,
    propagate_covariance,
    transition_product,
    transition_terms,
)
from spoofgym.receiver.strapdown import strapdown_step

from ..lanes import in_all_lanes, side_by_side
from .reference import skew

R_E = geodetic_to_ecef(0.7, 0.3, 9000.0)
FORCE = np.array([0.8, -0.3, -9.7])
SD = np.repeat([1e-4, 0.1, 10.0, 3e-4, 5e-9, 0.0], 3)[:17].copy()
SD[15:] = 10.0, 0.1


def rotation(rng):
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return Q * np.sign(np.linalg.det(Q))


@njit
def terms_of(interval, terms):
    """`interval`: rows of C (9), r (3), f (3) and tau."""
    C = (
        load(interval, 0),
        load(interval, 1),
        load(interval, 2),
        load(interval, 3),
        load(interval, 4),
        load(interval, 5),
        load(interval, 6),
        load(interval, 7),
        load(interval, 8),
    )
    r = load(interval, 9), load(interval, 10), load(interval, 11)
    f = load(interval, 12), load(interval, 13), load(interval, 14)
    transition_terms(C, r, f, load(interval, 15), terms)


def terms_and_interval(intervals):
    """Lane arrays of up to eight (C, r, f, tau); the first fill up."""
    filled = [intervals[i % len(intervals)] for i in range(LANES)]
    interval = side_by_side([np.concatenate([np.ravel(x) for x in each]) for each in filled])
    terms = np.full((TERMS, LANES), np.nan)
    in_all_lanes(terms_of, interval, terms)
    return terms, interval


def transitions(intervals):
    """Matrices of up to eight (C, r, f, tau), from lanes side by side."""
    terms, interval = terms_and_interval(intervals)
    matrices = np.zeros((len(intervals), STATES * STATES))
    for i, Phi in enumerate(matrices):
        show_transition(terms, float(interval[15, i]), i, Phi)
    return matrices.reshape(-1, STATES, STATES)


def transition(C, tau, r=R_E, f=FORCE):
    return transitions([(C, r, f, tau)])[0]


def as_printed(C, tau, r=R_E, f=FORCE):
    """Groves (2013), eqs. 14.48 to 14.50."""
    Phi = np.eye(STATES)
    a, v, p, ba, bg = (
        slice(o, o + 3) for o in (ATTITUDE, VELOCITY, POSITION, ACCEL_BIAS, GYRO_BIAS)
    )
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


def eight_intervals(seed=0):
    """Receivers in different attitudes, places, forces and intervals."""
    rng = np.random.default_rng(seed)
    places = [
        geodetic_to_ecef(*x) for x in rng.uniform((-1.5, -3.0, -100.0), (1.5, 3.0, 2e4), (8, 3))
    ]
    taus = [0.01, 0.5, 3.0, *rng.uniform(0.01, 3.0, 5)]
    return [
        (rotation(rng), place, rng.normal(0.0, 10.0, 3), tau)
        for place, tau in zip(places, taus, strict=True)
    ]


@pytest.mark.nojit
def test_the_transition_is_the_printed_one():
    intervals = eight_intervals()
    for Phi, (C, r, f, tau) in zip(transitions(intervals), intervals, strict=True):
        np.testing.assert_allclose(Phi, as_printed(C, tau, r, f), rtol=1e-14, atol=1e-18)


@pytest.mark.nojit
def test_a_matrix_is_written_over_for_every_interval():
    intervals, Phi = eight_intervals(1), np.zeros(STATES * STATES)
    terms, _ = terms_and_interval(intervals)
    for i, (C, r, f, tau) in enumerate(intervals):
        show_transition(terms, tau, i, Phi)
        np.testing.assert_array_equal(Phi.reshape(STATES, STATES), transition(C, tau, r, f))


CHANGED = [*range(9), CLOCK_BIAS]


@njit
def product_of(terms, interval, x, y):
    found = transition_product(terms, load(interval, 15), x, 0, IN_ORDER)
    store(y, 0, found[0])
    store(y, 1, found[1])
    store(y, 2, found[2])
    store(y, 3, found[3])
    store(y, 4, found[4])
    store(y, 5, found[5])
    store(y, 6, found[6])
    store(y, 7, found[7])
    store(y, 8, found[8])
    store(y, 9, found[9])


@pytest.mark.nojit
def test_the_product_is_that_of_the_matrix():
    intervals = eight_intervals(2)
    terms, interval = terms_and_interval(intervals)
    x = np.random.default_rng(3).standard_normal((STATES, LANES)) * SD[:, None]
    y = np.full((10, LANES), np.nan)
    in_all_lanes(product_of, terms, interval, x, y)
    for i, Phi in enumerate(transitions(intervals)):
        want = Phi @ x[:, i]
        scale = np.abs(Phi) @ np.abs(x[:, i])
        assert (np.abs(y[:, i] - want[CHANGED]) <= 1e-15 * 8.0 * scale[CHANGED]).all()
        same = [k for k in range(STATES) if k not in CHANGED]
        np.testing.assert_array_equal(want[same], x[same, i])


def step(C, v, r, f, w, tau):
    C, v, r = strapdown_step(tuple(C.ravel()), tuple(v), tuple(r), tuple(f), tuple(w), tau)
    return np.reshape(C, (3, 3)), np.array(v), np.array(r)


def test_errors_grow_as_those_of_the_mechanization():
    """To first order in the interval; the error is estimate minus truth, biases what is left."""
    rng, tau = np.random.default_rng(2), 0.1
    for _ in range(20):
        C, v = rotation(rng), 200.0 * rng.standard_normal(3)
        w = 0.02 * rng.standard_normal(3)
        error = rng.standard_normal(15) * np.repeat([1e-5, 0.5, 50.0, 1e-3, 1e-6], 3)
        error[6:9] = 50.0 * rng.standard_normal() * R_E / np.linalg.norm(R_E)  # up or down
        truth = step(C, v, R_E, FORCE, w, tau)
        psi, dv, dr, ba, bg = error.reshape(5, 3)
        turn = np.eye(3) + skew(psi)
        estimate = step(turn @ C, v + dv, R_E + dr, FORCE + ba, w + bg, 0.1)
        skewed = estimate[0] @ truth[0].T
        grown = np.concatenate(
            [
                0.5 * np.array([skewed[2, 1] - skewed[1, 2], skewed[0, 2] - skewed[2, 0], 0.0]),
                estimate[1] - truth[1],
                estimate[2] - truth[2],
            ]
        )
        grown[2] = 0.5 * (skewed[1, 0] - skewed[0, 1])
        Phi = transition(truth[0], tau)[:15, :15]
        F = np.abs(Phi - np.eye(15)) / tau
        left_out = (F @ F * tau**2) @ np.abs(error)
        # the attitude turns on within the interval
        turned = tau**2 * np.linalg.norm(w)
        left_out[:3] += turned * np.linalg.norm(bg)
        left_out[3:6] += turned * np.linalg.norm(FORCE) * np.linalg.norm(psi)
        left_out[3:6] += turned * np.linalg.norm(ba)
        # gravity falls with the square of the distance, but for flattening and centrifugal force
        left_out[3:6] += 0.02 * np.abs(Phi[3:6, 6:9] @ error[6:9]) + 1e-12
        difference = np.abs(grown - (Phi @ error)[:9])
        rounding = np.repeat([1e-13, 1e-11, 2e-8], 3)
        assert (difference <= left_out[:9] + rounding).all()


@njit
def grow(P, terms, interval, psd, work):
    propagate_covariance(P, 0, terms, load(interval, 15), psd, 0, work)


def propagated(P, intervals, psd):
    """(8, 17, 17) covariances after an interval, side by side."""
    packed = side_by_side([each[np.triu_indices(STATES)] for each in P])
    assert packed.shape == (PACKED, LANES)
    work = np.full((187, LANES), np.nan)
    in_all_lanes(grow, packed, *terms_and_interval(intervals), side_by_side(psd), work)
    return packed.T[:, INDEX]


@pytest.mark.nojit
def test_propagation_is_that_of_dense_matrices():
    rng, intervals = np.random.default_rng(3), eight_intervals(3)
    root = rng.standard_normal((8, 17, 17))
    P = root @ root.transpose(0, 2, 1) * np.outer(SD, SD)
    psd = SD**2 * rng.uniform(0.0, 1.0, (8, 17))
    after = propagated(P, intervals, psd)
    for i, Phi in enumerate(transitions(intervals)):
        Q = np.diag(psd[i] * intervals[i][3])
        want = Phi @ (P[i] + Q / 2.0) @ Phi.T + Q / 2.0
        scale = np.sqrt(np.diag(want))
        np.testing.assert_allclose(
            after[i] / np.outer(scale, scale), want / np.outer(scale, scale), rtol=0, atol=1e-13
        )


def test_an_interval_of_no_length_changes_nothing():
    rng = np.random.default_rng(4)
    P = np.array([np.cov(rng.standard_normal((17, 40))) for _ in range(8)])
    still = [(C, r, f, 0.0) for C, r, f, _ in eight_intervals()]
    np.testing.assert_array_equal(propagated(P, still, np.ones((8, 17))), P)
