"""Gauss-Markov errors of a position, and the other errors of a loosely coupled world."""

import numpy as np
import pytest

from spoofgym.truth._kernels import first_errors, measure_loose
from spoofgym.truth.gnss_errors import PositionErrors
from spoofgym.truth.run import InertialErrors, flown_world

from ..lazily import Lazily

WORLD = Lazily(flown_world, "shadmehri2025", 0.1)


def measured(decay, receivers=300, epochs=30):
    errors, inertial = PositionErrors(decay=decay), InertialErrors()
    keys = np.random.default_rng(1).integers(0, 2**63, (receivers, 3, 2)).astype(np.uint64)
    first, error = np.empty((receivers, 15)), np.empty((receivers, 3))
    deviates = np.empty(128)
    first_errors(keys, inertial.initial_sd, errors.sd, deviates, first, error)
    epoch, displacement = np.zeros(receivers, dtype=np.int64), np.zeros((receivers, 3))
    displacement[:, 1] = 7.0
    samples, fix = np.empty((receivers, WORLD.samples, 6)), np.empty((receivers, 3))
    world = WORLD.run, WORLD.position_e, WORLD.C_el, WORLD.imu_interval_s
    given = inertial.noise, first[:, 9:].copy(), decay, errors.sd, displacement
    noise, seen = [], []
    for k in range(1, epochs + 1):
        measure_loose(keys, epoch, *world, *given, deviates, error, samples, fix)
        seen.append((fix - WORLD.position_e[k]) @ WORLD.C_el[k])
        truth = WORLD.run[(k - 1) * WORLD.samples : k * WORLD.samples]
        bias = np.hstack([first[:, 12:], first[:, 9:12]])
        noise.append(samples - truth - bias[:, None])
    return first, np.array(seen), np.concatenate(noise, axis=1)


@pytest.mark.parametrize("decay", [0.0, 0.9, 0.999])
def test_fixes_err_by_their_errors_and_the_displacement(decay):
    _, seen, _ = measured(decay)
    apart, sd = seen - [0.0, 7.0, 0.0], np.array([1.6, 1.6, 3.0])
    assert np.abs(apart.mean(axis=(0, 1))).max() < 0.6
    np.testing.assert_allclose(apart.std(axis=(0, 1)), sd, rtol=0.1)
    steps = np.diff(apart, axis=0).std(axis=(0, 1))
    np.testing.assert_allclose(steps, np.sqrt(2.0 - 2.0 * decay) * sd, rtol=0.05)


def test_inertial_noise_and_biases_have_their_density():
    first, _, noise = measured(0.999)
    np.testing.assert_allclose(first.std(axis=0), InertialErrors().initial_sd, rtol=0.15)
    level = InertialErrors().noise.repeat(3) / np.sqrt(WORLD.imu_interval_s)
    np.testing.assert_allclose(noise.std(axis=(0, 1)), level, rtol=0.02)
    assert np.abs(np.corrcoef(noise.reshape(-1, 6).T) - np.eye(6)).max() < 0.02
