"""How errors grow: against dense algebra, and against the mechanization itself."""

import math

import numpy as np
import pytest

from spoofgym.earth.attitude import skew
from spoofgym.earth.frames import geodetic_to_ecef
from spoofgym.earth.wgs84 import EARTH_RATE, geocentric_surface_radius, gravity
from spoofgym.receiver.error_model import (
    ACCEL_BIAS,
    ATTITUDE,
    CLOCK_BIAS,
    CLOCK_DRIFT,
    GYRO_BIAS,
    POSITION,
    STATES,
    VELOCITY,
    fill_transition,
    propagate_covariance,
)
from spoofgym.receiver.strapdown import strapdown_step

R_E = geodetic_to_ecef(0.7, 0.3, 9000.0)
FORCE = np.array([0.8, -0.3, -9.7])


def rotation(rng):
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return Q * np.sign(np.linalg.det(Q))


def transition(C, tau, r=R_E, f=FORCE):
    Phi = np.eye(STATES)
    fill_transition(Phi, C, r, *f, tau)
    return Phi


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


@pytest.mark.nojit
@pytest.mark.parametrize("tau", [0.01, 0.5, 3.0])
def test_the_transition_is_the_printed_one(tau):
    C = rotation(np.random.default_rng(0))
    np.testing.assert_allclose(transition(C, tau), as_printed(C, tau), rtol=1e-14, atol=1e-18)


@pytest.mark.nojit
def test_a_matrix_is_filled_anew_for_every_interval():
    rng = np.random.default_rng(1)
    Phi = np.eye(STATES)
    for tau in (2.0, 0.1):
        C, f = rotation(rng), rng.standard_normal(3)
        fill_transition(Phi, C, R_E, *f, tau)
        np.testing.assert_array_equal(Phi, transition(C, tau, f=f))


def step(C, v, r, f, w, tau):
    C, v, r = strapdown_step(tuple(C.ravel()), tuple(v), tuple(r), tuple(f), tuple(w), tau)
    return np.reshape(C, (3, 3)), np.array(v), np.array(r)


@pytest.mark.parametrize("tau", [0.02, 0.1])
def test_errors_grow_as_those_of_the_mechanization(tau):
    """To first order in the interval; the error is estimate minus truth, biases what is left."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        C, v = rotation(rng), 200.0 * rng.standard_normal(3)
        w = 0.02 * rng.standard_normal(3)
        error = rng.standard_normal(15) * np.repeat([1e-5, 0.5, 50.0, 1e-3, 1e-6], 3)
        error[6:9] = 50.0 * rng.standard_normal() * R_E / np.linalg.norm(R_E)  # up or down
        truth = step(C, v, R_E, FORCE, w, tau)
        psi, dv, dr, ba, bg = error.reshape(5, 3)
        turn = np.eye(3) + skew(psi)
        estimate = step(turn @ C, v + dv, R_E + dr, FORCE + ba, w + bg, tau)
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


@pytest.mark.nojit
@pytest.mark.parametrize("tau", [0.1, 1.0])
def test_propagation_is_that_of_dense_matrices(tau):
    rng = np.random.default_rng(3)
    sd = np.repeat([1e-4, 0.1, 10.0, 3e-4, 5e-9, 0.0], 3)[:17].copy()
    sd[15:] = 10.0, 0.1
    root = rng.standard_normal((17, 17))
    P = (root @ root.T) * np.outer(sd, sd)
    psd = sd**2 * rng.uniform(0.0, 1.0, 17)
    Phi, Q = transition(rotation(rng), tau), np.diag(psd * tau)
    flat = P.ravel().copy()
    propagate_covariance(flat, Phi, psd, tau, np.empty(289))
    want = Phi @ (P + Q / 2.0) @ Phi.T + Q / 2.0
    after = flat.reshape(17, 17)
    scale = np.sqrt(np.diag(want))
    np.testing.assert_allclose(
        after / np.outer(scale, scale), want / np.outer(scale, scale), rtol=0, atol=1e-13
    )
    np.testing.assert_array_equal(after, after.T)


def test_an_interval_of_no_length_changes_nothing():
    rng = np.random.default_rng(4)
    P = np.cov(rng.standard_normal((17, 40)))
    flat = P.ravel().copy()
    propagate_covariance(flat, transition(rotation(rng), 0.0), np.ones(17), 0.0, np.empty(289))
    np.testing.assert_array_equal(flat.reshape(17, 17), P)


def test_the_clock_is_apart_from_all_else():
    Phi = transition(rotation(np.random.default_rng(5)), 0.7)
    assert Phi[CLOCK_BIAS, CLOCK_DRIFT] == 0.7
    assert not Phi[:CLOCK_BIAS, CLOCK_BIAS:].any()
    assert not Phi[CLOCK_BIAS:, :CLOCK_BIAS].any()
    assert math.isclose(np.linalg.det(Phi[CLOCK_BIAS:, CLOCK_BIAS:]), 1.0)
