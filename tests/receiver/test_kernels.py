"""The compiled calls of an epoch, over batches of receivers that differ in all."""

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spoofgym.core.simd import LANES
from spoofgym.receiver._kernels import MEASURE, PREDICT, SHOW, UPDATE, solve_in_place
from spoofgym.receiver.kalman import COVARIANCE_UPDATES, normalized_innovation_squared

from .batches import EPOCHS, WORLD, Batch, N, check_same
from .reference import design, skew, sky, textbook

ROOT = Path(__file__).resolve().parents[2]
VECTORS = ("velocity_e", "position_e", "accel_bias_b", "gyro_bias_b", "clock")
ATOL = (1e-9, 1e-8, 1e-9, 1e-15, 1e-9)


def check_all_same(mine, theirs):
    for row in range(len(mine.numbers)):
        check_same(mine.everything(row), theirs.everything(row))


def seeing(counts):
    batch = Batch(range(len(counts)))
    seen = np.arange(N)[None, :] < counts[:, None]
    u = np.array([sky(np.random.default_rng(number), N) for number in range(len(counts))])
    batch.fields["visible"] = seen
    batch.fields["innovation"] = np.tile(seen, 2) * 3.0
    batch.fields["line_of_sight"] = u * seen[:, :, None]
    return batch


SINGULAR = (
    np.tile([0.6, 0.0, 0.8], (N, 1)),  # all in one direction
    np.repeat([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]], N // 2, axis=0),  # in two
    np.array([[0.6 * np.cos(a), 0.6 * np.sin(a), 0.8] for a in range(N)]),  # on a cone
    np.array([[np.cos(a), np.sin(a), 0.0] for a in range(N)]),  # in a plane
)


def hard_cases():
    batch = seeing(np.array([6, 6, 6, 6, 0, 1, 2, 3, 4, 5, 6, 6]))
    batch.fields["line_of_sight"] = np.concatenate([SINGULAR, batch.fields["line_of_sight"][4:]])
    for row, scale in ((10, 1e-6), (11, 1e4)):
        batch.buffers.put_covariance(np.array([row]), scale * batch.buffers.covariance[row])
    return batch


@pytest.mark.nojit
@pytest.mark.parametrize("update", COVARIANCE_UPDATES)
@pytest.mark.parametrize("make", [lambda: Batch(range(17)), hard_cases], ids=["usual", "hard"])
def test_corrections_are_those_of_the_textbook_with_any_weights(make, update):
    batch, before, rng = make(), make(), np.random.default_rng(9)
    weights = rng.uniform(0.0, 1.0, batch.weights.shape)
    weights[rng.uniform(size=weights.shape) < 0.2] = 0.0
    weights[::4] = 1.0
    batch.update(weights, update=update, least=0)
    old, new, R = before.fields, batch.fields, before.buffers.assumed["noise_variance"]
    P, u, z = before.buffers.covariance, old["line_of_sight"], old["innovation"]
    for b in range(len(weights)):
        seen = old["visible"][b] > 0.0
        x, after = textbook(P[b], u[b], z[b], R[b], weights[b], seen, update)
        turned = (np.eye(3) - skew(x[:3])) @ old["C_eb"][b]
        np.testing.assert_allclose(new["C_eb"][b], turned, rtol=0, atol=1e-9)
        changes = -x[3:6], -x[6:9], x[9:12], x[12:15], x[15:]
        for name, change, atol in zip(VECTORS, changes, ATOL, strict=True):
            np.testing.assert_allclose(new[name][b], old[name][b] + change, rtol=0, atol=atol)
        scale = np.sqrt(np.outer(np.diag(P[b]), np.diag(P[b])))
        mine = batch.buffers.covariance[b]
        np.testing.assert_allclose(mine / scale, after / scale, rtol=0, atol=1e-9)
    assert not batch.buffers.coasting.any()


def test_errors_that_nobody_replaces_all_stay():
    told, untold = Batch(range(9)), Batch(range(9), with_authentic=False)
    told.sensors.authentic[:] = 1.0
    for batch in (told, untold):
        batch.run(MEASURE + PREDICT + SHOW)
    check_all_same(untold, told)


@pytest.mark.parametrize("receivers", [1, 17])
def test_what_all_assume_is_kept_once_and_used_by_all(receivers):
    each, together = Batch(range(receivers)), Batch(range(receivers), alike=True)
    assert together.buffers.assumed.groups == 1
    last = {name: each.buffers.assumed[name][-1] for name in each.buffers.assumed.shapes}
    for batch in (each, together):
        for name, value in last.items():
            batch.buffers.assumed[name] = value
        batch.run(MEASURE + PREDICT + SHOW)
        batch.update()
    check_all_same(together, each)


@pytest.mark.parametrize(
    ("receivers", "covariance_update", "orthonormal"),
    [
        pytest.param(3, "general", False, marks=pytest.mark.nojit),
        (8, "general", False),
        (9, "unweighted", False),
        (17, "plain", True),
    ],
)
def test_a_receiver_is_the_same_alone_and_in_any_batch(receivers, covariance_update, orthonormal):
    settings = {"update": covariance_update, "least": 4, "orthonormal": orthonormal}
    numbers = np.random.default_rng(receivers).permutation(EPOCHS - 6)[:receivers]
    batch, coasted = Batch(numbers), np.zeros(receivers, dtype=bool)
    singles = [Batch([number]) for number in numbers]
    for each in (batch, *singles):
        for _ in range(2):
            each.run(MEASURE + PREDICT + SHOW, **settings)
            each.run(UPDATE, **settings)
            if each is batch:
                coasted |= batch.buffers.coasting
        each.run(MEASURE + PREDICT + UPDATE, count=2, **settings)
        each.run(MEASURE, **settings)
        each.run(PREDICT + SHOW, **settings)
    assert receivers <= LANES or 0 < coasted.sum() < receivers
    for row, single in enumerate(singles):
        check_same(batch.everything(row), single.everything(0))


def digests():
    """A line for every quantity of some receivers, after three calls of the kernel."""
    for numbers, update in (([3], "general"), ([4], "unweighted"), (range(9), "plain")):
        batch = Batch(numbers)
        for what in (MEASURE + PREDICT + SHOW, UPDATE, MEASURE + PREDICT + UPDATE):
            batch.run(what, update=update, orthonormal=True)
        for row in range(len(numbers)):
            for name, array in batch.everything(row).items():
                yield f"{update} {row} {name} {hashlib.sha256(array.tobytes()).hexdigest()}"


def test_what_is_compiled_computes_what_the_source_says():
    code = "from tests.receiver.test_kernels import digests\nprint(*digests(), sep='\\n')"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) > 300
    assert lines == [*digests()]


@pytest.mark.parametrize("what", [PREDICT, MEASURE + PREDICT + SHOW])
def test_lanes_without_a_receiver_follow_the_last(what):
    batch = Batch(range(11))
    for _ in range(3):
        batch.run(what)
        batch.run(UPDATE)
    sensors = batch.sensors.fields, batch.sensors.constants
    for fields in (batch.fields, batch.buffers.assumed, *sensors):
        group = fields.data.reshape(2, fields.rows, LANES)[1]
        assert group[:, 3:].tobytes() == np.repeat(group[:, 2:3], LANES - 3, axis=1).tobytes()


@pytest.mark.parametrize(
    ("least", "orthonormal", "update"), [(0, True, "general"), (4, False, "unweighted")]
)
def test_with_fewer_satellites_than_it_wants_a_receiver_coasts(least, orthonormal, update):
    counts = np.array([0, 1, 2, 3, 4, 5, 6, 3, 6])
    batch, before = seeing(counts), seeing(counts)
    weights = np.random.default_rng(1).uniform(0.1, 1.0, (len(counts), 2 * N))
    batch.update(weights, least=least, update=update, orthonormal=orthonormal)
    coasting = counts < least
    np.testing.assert_array_equal(batch.buffers.coasting, coasting)
    for b, count in enumerate(counts):
        mine, theirs = batch.everything(b), before.everything(b)
        same = [
            mine[name].tobytes() == theirs[name].tobytes()
            for name in ("C_eb", *VECTORS, "packed_covariance")
        ]
        if count == 0 and not coasting[b] and orthonormal:
            same = same[1:]  # an update without satellites, too, makes the attitude orthonormal
        assert all(same) == (coasting[b] or count == 0)


@pytest.mark.nojit
def test_what_is_shown_of_an_epoch_is_what_the_update_uses():
    batch, before = Batch(range(9)), Batch(range(9))
    batch.predict()
    buffers, fields, seen = batch.buffers, batch.fields, batch.buffers.seen
    assumed, tau, epoch = buffers.assumed, buffers.interval, batch.sensors.epoch
    np.testing.assert_array_equal(epoch, before.sensors.epoch + 1)
    np.testing.assert_array_equal(buffers.time, WORLD.epoch_time[epoch])
    np.testing.assert_array_equal(tau, WORLD.epoch_time[epoch] - WORLD.epoch_time[epoch - 1])
    for shown, used in (
        (seen["innovation"], fields["innovation"]),
        (seen["predicted_cov"], buffers.covariance),
        (seen["imu_delta"], fields["imu_delta"]),
        (buffers.position_e, fields["position_e"]),
        (buffers.velocity_e, fields["velocity_e"]),
        (np.hstack([seen["pseudorange"], seen["range_rate"]]), before.measured),
        (seen["satellite_position"], WORLD.satellites[epoch, :, :3]),
        (seen["satellite_velocity"], WORLD.satellites[epoch, :, 3:6]),
        (buffers.visible, WORLD.satellites[epoch, :, 6] > 0.0),
    ):
        np.testing.assert_array_equal(shown, used)
    for b in range(9):
        visible, R = buffers.visible[b], assumed["noise_variance"][b]
        H, P, S = seen["design"][b], seen["predicted_cov"][b], seen["innovation_cov"][b]
        np.testing.assert_array_equal(H, design(fields["line_of_sight"][b], visible))
        want = H @ P @ H.T + np.diag(np.where(np.tile(visible, 2), R, 1.0))
        np.testing.assert_allclose(S, want, rtol=1e-11, atol=1e-11)
        np.testing.assert_array_equal(S, S.T)
        np.testing.assert_allclose(seen["innovation_variance"][b], np.diag(S), rtol=1e-12)
        Phi = seen["transition"][b]
        Q = np.diag(assumed["noise_psd"][b] * tau[b])
        want = Phi @ (before.buffers.covariance[b] + Q / 2) @ Phi.T + Q / 2
        scale = np.sqrt(np.outer(np.diag(want), np.diag(want)))
        np.testing.assert_allclose(P / scale, want / scale, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("receivers", "update"), [(1, "general"), (9, "unweighted")])
def test_an_invisible_slot_tells_nothing_whatever_it_holds(receivers, update):
    satellites = WORLD.satellites.copy()
    hidden = satellites[:, :, 6] == 0.0
    satellites[hidden, :6] = np.nan
    wanted = ("innovation_cov", "design")
    clean = Batch(range(receivers), wanted)
    odd = Batch(range(receivers), wanted, replace(WORLD, satellites=satellites))
    unseen = np.tile(hidden[clean.sensors.epoch + 1], 2)
    assert unseen.any()
    R = odd.buffers.assumed.get("noise_variance")
    R[unseen] = odd.measured[unseen] = np.nan
    odd.buffers.assumed["noise_variance"] = R
    for batch in (clean, odd):
        batch.predict()
        batch.update(batch.weights, update=update)
    for row in range(receivers):
        mine, theirs = odd.everything(row), clean.everything(row)
        del mine["assumed noise_variance"], theirs["assumed noise_variance"]
        check_same(mine, theirs)


@pytest.mark.nojit
@pytest.mark.parametrize("k", [1, 4, 8])
def test_elimination_solves_what_needs_pivots(k):
    rng = np.random.default_rng(k)
    M, y = rng.standard_normal((k, k)), rng.standard_normal(k)
    if k > 1:
        M[0, 0], M[1, 1] = 0.0, 0.0
    x = M @ y
    solve_in_place(M.copy(), x)
    np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-12)


@pytest.mark.nojit
@pytest.mark.parametrize(("first", "last"), [(0, 8), (4, 8), (2, 3)])
def test_normalized_innovations_are_the_quadratic_form(first, last):
    rng = np.random.default_rng(0)
    root = rng.standard_normal((5, 8, 8))
    S = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(8)
    z = rng.standard_normal((5, 8))
    rows = [r for r in range(first, last) if r != 5]  # that of an invisible satellite adds nothing
    z[:, 5], S[:, 5], S[:, :, 5] = 0.0, 0.0, 0.0
    S[:, 5, 5] = 1.0
    want = [
        a[rows] @ np.linalg.solve(B[np.ix_(rows, rows)], a[rows]) for a, B in zip(z, S, strict=True)
    ]
    np.testing.assert_allclose(normalized_innovation_squared(z, S, first, last), want, rtol=1e-10)
    assert not normalized_innovation_squared(0.0 * z, S, first, last).any()
    S[1, 2, 2] = -1.0  # which is no covariance
    found = normalized_innovation_squared(z, S, first, last)
    assert np.isinf(found).tolist() == [False, first <= 2, False, False, False]
