"""One inertial sample: coefficients, closed forms, and the same bits in any lane."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.core.compile import njit
from spoofgym.core.simd import LANES, load, store
from spoofgym.earth.wgs84 import EARTH_RATE, dcm_e_from_n, geodetic_to_ecef, gravity
from spoofgym.receiver._kernels import show_transition
from spoofgym.receiver.states import STATES, TERMS, transition_terms
from spoofgym.receiver.strapdown import rotation_coefficients, strapdown_step
from spoofgym.truth._kernels import load3, store3

from ..lanes import in_all_lanes, side_by_side
from .batches import WORLD, Batch
from .reference import transition

ULP = 2.0**-53


@pytest.mark.nojit
@given(st.floats(1e-4, 1.0, exclude_min=True))
def test_coefficients_are_exact_to_rounding(angle):
    s, c, d = rotation_coefficients(angle * angle)
    assert s == pytest.approx(math.sin(angle) / angle, rel=4e-16)
    assert c == pytest.approx(0.5 * (math.sin(0.5 * angle) / (0.5 * angle)) ** 2, rel=6e-16)
    x = np.longdouble(angle) ** 2
    if angle > 0.1:
        closed = float((1 - np.sin(np.longdouble(angle)) / np.longdouble(angle)) / x)
    else:
        closed = float((1 - x / 20 * (1 - x / 42 * (1 - x / 72 * (1 - x / 110)))) / 6)
    assert d == pytest.approx(closed, rel=6e-16)


@pytest.mark.nojit
@given(st.floats(1e-8, 1e-4, exclude_min=True, exclude_max=True))
def test_a_small_angle_is_rounded_as_its_cosine_is(angle):
    s, c, d = rotation_coefficients(angle * angle)
    assert s == pytest.approx(1.0 - angle**2 / 6.0, rel=2e-16)
    assert d == pytest.approx(1.0 / 6.0, rel=1e-9)
    assert c * angle**2 == pytest.approx(1.0 - math.cos(angle), abs=1.01 * ULP)
    steps = c * angle**2 / ULP
    assert abs(steps - round(steps)) < 1e-6  # one less a double below one


@pytest.mark.nojit
@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 0.999e-8])
def test_what_turns_no_more_than_a_quantized_gyro_at_rest_does_not_turn(angle):
    assert rotation_coefficients(angle * angle) == (1.0, 0.0, 0.0)


def at(latitude_deg, height=0.0):
    latitude = math.radians(latitude_deg)
    return np.array(dcm_e_from_n(latitude, 0.4)), geodetic_to_ecef(latitude, 0.4, height)


@pytest.mark.parametrize("latitude_deg", [-90.0, 0.0, 55.0])
def test_what_stands_still_stays_still(latitude_deg):
    C, r = at(latitude_deg)
    felt = tuple(-C.T @ np.array(gravity(*r))), tuple(C.T @ [0.0, 0.0, EARTH_RATE])
    after = tuple(C.ravel()), (0.0, 0.0, 0.0), tuple(r)
    for _ in range(6000):
        after = strapdown_step(*after, *felt, 0.01)
    np.testing.assert_allclose(after[0], C.ravel(), rtol=0, atol=1e-11)
    # the rounded coefficient of small angles is worth up to 5e-9 of the specific force
    np.testing.assert_allclose(after[1], 0.0, rtol=0, atol=5e-9 * 9.8 * 60.0)
    np.testing.assert_allclose(after[2], r, rtol=0, atol=5e-9 * 9.8 * 60.0**2)


@njit
def step_of(state, sample):
    C = load3(state, 0) + load3(state, 3) + load3(state, 6)
    v, r, f, w = load3(state, 9), load3(state, 12), load3(sample, 0), load3(sample, 3)
    C, v, r = strapdown_step(C, v, r, f, w, load(sample, 6))
    for i in range(9):
        store(state, i, C[i])
    store3(state, 9, v)
    store3(state, 12, r)


@pytest.mark.nojit
def test_eight_receivers_step_as_each_alone():
    rng = np.random.default_rng(5)
    states = []
    for latitude in (-90.0, -45.0, -1e-6, 0.0, 30.0, 60.0, 89.999, 90.0):
        C, r = at(latitude, rng.uniform(0.0, 1e4))
        states.append(np.concatenate([C.ravel(), rng.normal(0.0, 100.0, 3), r]))
    state = side_by_side(states)
    sample = np.vstack([rng.normal(0.0, 10.0, (3, LANES)), rng.normal(0.0, 1.0, (4, LANES))])
    sample[3:6] *= [1.0, 0.1, 1e-3, 1e-6, 1e-9, 0.0, 10.0, 3.0]
    sample[6] = 0.01
    first = state.copy()
    in_all_lanes(step_of, state, sample)
    for i in range(LANES):
        parts = np.split(np.concatenate([first[:, i], sample[:6, i]]), [9, 12, 15, 18])
        after = strapdown_step(*map(tuple, parts), 0.01)
        np.testing.assert_array_equal(state[:, i], np.concatenate(after))


@pytest.mark.parametrize("receivers", [1, LANES + 3])
def test_lanes_go_the_steps_of_single_samples(receivers):
    batch, start = Batch(range(receivers)), Batch(range(receivers))
    batch.predict()
    after, before, counts = batch.fields, start.fields, set()
    for b in range(receivers):
        first, last = WORLD.epoch_end[start.sensors.epoch[b] : start.sensors.epoch[b] + 2]
        counts.add(last - first)
        C, v, r = (tuple(before[name][b].ravel()) for name in ("C_eb", "velocity_e", "position_e"))
        delta = np.zeros(6)
        for sample in WORLD.run.T[first:last]:
            dt = sample[6]
            f = sample[:3] - before["accel_bias_b"][b]
            w = sample[3:6] - before["gyro_bias_b"][b]
            delta += np.concatenate([f, w]) * dt
            C, v, r = strapdown_step(C, v, r, tuple(f), tuple(w), dt)
        np.testing.assert_allclose(after["C_eb"][b].ravel(), C, rtol=0, atol=1e-14)
        np.testing.assert_allclose(after["velocity_e"][b], v, rtol=0, atol=1e-12)
        np.testing.assert_allclose(after["position_e"][b], r, rtol=0, atol=2e-8)
        np.testing.assert_allclose(after["imu_delta"][b], delta, rtol=1e-12, atol=1e-15)
        f_e = after["C_eb"][b] @ f * batch.buffers.interval[b]
        Phi = batch.buffers.seen["transition"][b]
        np.testing.assert_allclose([Phi[5, 1], Phi[3, 2], Phi[4, 0]], -f_e, rtol=1e-12)
    assert len(counts) > 3 or receivers == 1


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


def eight_intervals(rng):
    places = rng.uniform((-1.5, -3.0, -100.0), (1.5, 3.0, 2e4), (8, 3))
    taus = [0.01, 0.5, 3.0, *rng.uniform(0.01, 3.0, 5)]
    turns = np.linalg.qr(rng.standard_normal((8, 3, 3)))[0]
    return [
        (turn, geodetic_to_ecef(*place), rng.normal(0.0, 10.0, 3), tau)
        for turn, place, tau in zip(turns, places, taus, strict=True)
    ]


@pytest.mark.nojit
def test_the_transition_is_the_printed_one():
    intervals = eight_intervals(np.random.default_rng(0))
    for Phi, each in zip(transitions(intervals), intervals, strict=True):
        np.testing.assert_allclose(Phi, transition(*each), rtol=1e-14, atol=1e-18)
