"""Quantities in the memory order of the kernels: by name in, by name out, and no lane undefined."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from spoofgym.core.lanes import LaneFields, first_rows
from spoofgym.core.simd import ALIGNMENT, LANES

SHAPES = {"attitude": (3, 3), "speed": (), "bias": (5,), "table": (2, 3)}
ROWS = 9 + 1 + 5 + 6
SIZES = [1, 2, 7, 8, 9, 17]

pytestmark = pytest.mark.nojit


def filled(receivers, seed=0, dtype=np.float64):
    """Fields with other numbers everywhere, and what was put in."""
    fields, rng = LaneFields(receivers, SHAPES, dtype), np.random.default_rng(seed)
    values = {
        name: rng.integers(1, 10**6, (receivers, *shape)).astype(dtype)
        for name, shape in SHAPES.items()
    }
    for name, value in values.items():
        fields[name] = value
    return fields, values


def check(fields, values):
    for name, value in values.items():
        np.testing.assert_array_equal(fields[name], value, err_msg=name)
    assert fields.data.flags.c_contiguous
    if fields.lanes == LANES:
        assert fields.data.ctypes.data % ALIGNMENT == 0
        last = (fields.receivers - 1) % LANES
        group = fields.data.reshape(fields.groups, fields.rows, LANES)[-1]
        for index in range(last, LANES):
            np.testing.assert_array_equal(group[:, index], group[:, last])


def test_rows_follow_one_another():
    assert first_rows(SHAPES) == {"attitude": 0, "speed": 9, "bias": 10, "table": 15}
    assert first_rows({}) == {}


@pytest.mark.parametrize("dtype", [np.float64, np.uint64])
@pytest.mark.parametrize("receivers", SIZES)
def test_what_is_put_in_comes_out(receivers, dtype):
    fields, values = filled(receivers, dtype=dtype)
    check(fields, values)
    assert fields.data.dtype == dtype
    single = receivers == 1
    groups = -(-receivers // LANES)
    assert fields.data.shape == ((ROWS,) if single else (groups * ROWS, LANES))
    for name, value in values.items():
        assert fields[name].shape == value.shape
        assert fields[name].dtype == dtype


@pytest.mark.parametrize("receivers", SIZES)
def test_a_receiver_has_its_lane_in_the_group_s_rows(receivers):
    fields, values = filled(receivers)
    lanes = 1 if receivers == 1 else LANES
    rows = fields.data.reshape(-1, lanes)
    for b in range(receivers):
        mine = rows[b // lanes * ROWS : (b // lanes + 1) * ROWS, b % lanes]
        np.testing.assert_array_equal(mine, np.hstack([np.ravel(v[b]) for v in values.values()]))


def test_new_fields_are_zero_and_have_no_receiver_in_common():
    fields = LaneFields(9, SHAPES)
    assert not fields.data.any()
    other = LaneFields(9, SHAPES)
    fields["speed"] = 1.0
    assert not other.data.any()


@pytest.mark.parametrize("receivers", SIZES)
def test_some_receivers_are_put_and_got(receivers):
    fields, values = filled(receivers)
    rng = np.random.default_rng(1)
    for rows in (
        np.array([receivers - 1]),
        np.flatnonzero(np.arange(receivers) % 2 == 0),
        rng.permutation(receivers),
        np.arange(receivers) > 0,  # a mask; of nobody where there is one
        slice(0, receivers),
        np.array([], dtype=int),
    ):
        count = len(np.arange(receivers)[rows])
        for name, shape in SHAPES.items():
            new = rng.standard_normal((count, *shape))
            fields.put(name, rows, new)
            values[name][rows] = new
            np.testing.assert_array_equal(fields.get(name, rows), new)
        check(fields, values)


@pytest.mark.parametrize("receivers", SIZES)
def test_values_are_broadcast(receivers):
    fields, values = filled(receivers)
    fields["bias"] = np.arange(5.0)
    fields["attitude"] = 0.5
    fields.put("table", np.array([receivers - 1]), np.arange(3.0))
    values["bias"][:], values["attitude"][:] = np.arange(5.0), 0.5
    values["table"][receivers - 1] = np.arange(3.0)
    check(fields, values)
    with pytest.raises(ValueError, match="broadcast"):
        fields["bias"] = np.zeros(4)
    with pytest.raises(KeyError, match="colour"):
        fields["colour"] = 1.0
    check(fields, values)


def test_what_is_got_is_a_copy():
    fields, values = filled(9)
    gathered = fields["bias"]
    with pytest.raises(ValueError, match="read-only"):
        gathered[0] = 1.0
    mine = fields.get("bias")
    mine[:] = -1.0
    some = fields.get("bias", np.array([2]))
    some[:] = -1.0
    check(fields, values)


@pytest.mark.parametrize("there", SIZES)
@pytest.mark.parametrize("here", SIZES)
def test_receivers_are_taken_over_from_a_batch_of_any_width(here, there):
    fields, values = filled(here)
    other, others = filled(there, seed=1)
    rng = np.random.default_rng(2)
    count = min(here, there)
    to, rows = rng.permutation(here)[:count], rng.permutation(there)[:count]
    fields.copy_rows(to, other, rows)
    for name in SHAPES:
        values[name][to] = others[name][rows]
    check(fields, values)
    check(other, others)
    fields.copy_rows(np.array([here - 1]), other, np.array([0]))  # which lanes behind it follow
    for name in SHAPES:
        values[name][here - 1] = others[name][0]
    check(fields, values)


def test_a_receiver_may_be_taken_over_several_times_and_from_the_same_batch():
    fields, values = filled(9)
    fields.copy_rows(np.array([0, 1, 8]), fields, np.array([8, 8, 3]))
    for value in values.values():
        value[[0, 1, 8]] = value[[8, 8, 3]]
    check(fields, values)


@pytest.mark.parametrize("receivers", SIZES)
def test_what_is_shared_is_kept_once_for_all(receivers):
    fields = LaneFields(receivers, SHAPES, shared=True)
    assert fields.data.shape == ((ROWS,) if receivers == 1 else (ROWS, LANES))
    fields["attitude"] = np.arange(9.0).reshape(3, 3)
    fields.put("speed", np.array([receivers - 1]), 7.0)
    fields.put("bias", np.array([], dtype=int), 1.0)
    assert fields["attitude"].shape == (receivers, 3, 3)
    np.testing.assert_array_equal(fields["attitude"][-1], np.arange(9.0).reshape(3, 3))
    np.testing.assert_array_equal(fields["speed"], np.full(receivers, 7.0))
    np.testing.assert_array_equal(fields.get("speed", np.array([0, 0])), [7.0, 7.0])
    assert not fields["bias"].any()
    rows = fields.data.reshape(ROWS, -1)
    np.testing.assert_array_equal(rows, rows[:, :1].repeat(fields.lanes, axis=1))
    other = copy.deepcopy(fields)
    other["speed"] = 8.0
    np.testing.assert_array_equal(fields["speed"], np.full(receivers, 7.0))


@pytest.mark.parametrize("there", [1, 9])
@pytest.mark.parametrize("here", [1, 9])
@pytest.mark.parametrize("shared", [(True, True), (True, False), (False, True)])
def test_what_is_shared_is_taken_over_for_all(here, there, shared):
    mine, theirs = shared
    fields = LaneFields(here, SHAPES, shared=mine)
    other = LaneFields(there, SHAPES, shared=theirs)
    other["bias"], other["speed"] = np.arange(5.0), 3.0
    fields.copy_rows(np.array([here - 1]), other, np.array([there - 1]))
    taken = slice(None) if mine else slice(here - 1, None)
    assert (fields["speed"][taken] == 3.0).all()
    assert (fields["bias"][taken] == np.arange(5.0)).all()
    assert not fields["speed"][: 0 if mine else here - 1].any()
    fields.copy_rows(np.array([], dtype=int), other, np.array([], dtype=int))


def test_what_is_shared_cannot_differ():
    fields = LaneFields(3, SHAPES, shared=True)
    with pytest.raises(ValueError, match="share their values can't have different values"):
        fields["speed"] = np.arange(3.0)
    other = LaneFields(3, SHAPES)
    other["speed"] = np.arange(3.0)
    with pytest.raises(ValueError, match="share their values can't have different values"):
        fields.copy_rows(np.arange(3), other, np.arange(3))
    assert not fields.data.any()


@pytest.mark.parametrize("receivers", SIZES)
def test_scratch_memory_is_as_wide_as_the_fields_and_aligned(receivers):
    fields = LaneFields(receivers, SHAPES)
    for rows in (1, 2, 3, 50):
        work = fields.scratch(rows)
        assert work.shape == ((rows,) if receivers == 1 else (rows, LANES))
        assert work.dtype == np.float64
        assert work.flags.c_contiguous
        assert work.ctypes.data % ALIGNMENT == 0
        assert not np.shares_memory(work, fields.data)


@pytest.mark.parametrize("way", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
@pytest.mark.parametrize("receivers", SIZES)
def test_a_copy_is_aligned_and_has_memory_of_its_own(way, receivers):
    fields, values = filled(receivers)
    copies = [way(fields) for _ in range(5)]  # memory may be aligned by chance
    for copied in copies:
        check(copied, values)
        assert not np.shares_memory(copied.data, fields.data)
        copied["speed"] = -1.0
    check(fields, values)
