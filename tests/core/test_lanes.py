"""Quantities in the memory order of the kernels: by name in, by name out, and no lane undefined."""

import copy
import pickle

import numpy as np
import pytest

from spoofgym.core.lanes import LaneFields, first_rows
from spoofgym.core.simd import ALIGNMENT, LANES

SHAPES = {"attitude": (3, 3), "speed": (), "bias": (5,), "table": (2, 3)}
ROWS = 9 + 1 + 5 + 6
SIZES = [1, 7, 8, 9, 17]

pytestmark = pytest.mark.nojit


def filled(receivers, seed=0, dtype=np.float64):
    fields, rng = LaneFields(receivers, SHAPES, dtype), np.random.default_rng(seed)
    assert not fields.data.any()
    values = {
        name: rng.integers(1, 10**6, (receivers, *shape)).astype(dtype)
        for name, shape in SHAPES.items()
    }
    for name, value in values.items():
        fields[name] = value
    return fields, values


def check(fields, values):
    for name, value in values.items():
        np.testing.assert_array_equal(fields[name], value, strict=True)
    lanes = 1 if fields.receivers == 1 else LANES
    groups = -(-fields.receivers // lanes)
    assert fields.data.flags.c_contiguous
    assert fields.data.shape == ((ROWS,) if lanes == 1 else (groups * ROWS, LANES))
    assert fields.data.ctypes.data % ALIGNMENT == 0
    rows = np.hstack([v.reshape(fields.receivers, -1) for v in values.values()])
    rows = np.concatenate([rows, rows[-1:].repeat(groups * lanes - len(rows), axis=0)])
    grouped = fields.data.reshape(groups, ROWS, lanes).transpose(0, 2, 1)
    np.testing.assert_array_equal(grouped.reshape(-1, ROWS), rows)


@pytest.mark.parametrize("dtype", [np.float64, np.uint64])
@pytest.mark.parametrize("receivers", SIZES)
def test_what_is_put_in_comes_out_and_copies_have_memory_of_their_own(receivers, dtype):
    assert first_rows(SHAPES) == {"attitude": 0, "speed": 9, "bias": 10, "table": 15}
    fields, values = filled(receivers, dtype=dtype)
    check(fields, values)
    copies = [copy.deepcopy(fields), pickle.loads(pickle.dumps(fields))]
    for copied in copies * 3:  # memory may be aligned by chance
        again = copy.deepcopy(copied)
        check(again, values)
        assert not np.shares_memory(again.data, copied.data)
        again["speed"] = 1
    for copied in (*copies, fields):
        check(copied, values)
    for rows in (1, 3, 50):
        work = fields.scratch(rows)
        assert work.shape == ((rows,) if receivers == 1 else (rows, LANES))
        assert (work.dtype, work.ctypes.data % ALIGNMENT) == (np.float64, 0)
        assert not np.shares_memory(work, fields.data)
    with pytest.raises(ValueError, match="read-only"):
        fields["bias"][0] = 1
    fields.get("bias")[:] = 2
    fields.get("bias", np.array([receivers - 1]))[:] = 2
    check(fields, values)


@pytest.mark.parametrize("receivers", SIZES)
def test_some_receivers_are_put_and_got_and_values_are_broadcast(receivers):
    fields, values = filled(receivers)
    rng = np.random.default_rng(1)
    for rows in (
        np.array([receivers - 1]),
        rng.permutation(receivers),
        np.arange(receivers) > 0,  # a mask; of nobody where there is one
        slice(0, receivers, 2),
        np.array([], dtype=int),
    ):
        count = len(np.arange(receivers)[rows])
        for name, shape in SHAPES.items():
            new = rng.standard_normal((count, *shape))
            fields.put(name, rows, new)
            values[name][rows] = new
            np.testing.assert_array_equal(fields.get(name, rows), new)
        check(fields, values)
    last = np.array([receivers - 1])
    fields["bias"], fields["attitude"] = np.arange(5.0), 0.5
    fields.put("table", last, np.arange(3.0))
    values["bias"][:], values["attitude"][:], values["table"][last] = np.arange(5.0), 0.5, range(3)
    check(fields, values)
    with pytest.raises(ValueError, match="broadcast"):
        fields["bias"] = np.zeros(4)
    with pytest.raises(KeyError, match="colour"):
        fields["colour"] = 1.0
    check(fields, values)


@pytest.mark.parametrize("there", SIZES)
@pytest.mark.parametrize("here", SIZES)
def test_receivers_are_taken_over_from_a_batch_of_any_width(here, there):
    fields, values = filled(here)
    other, others = filled(there, seed=1)
    rng, count = np.random.default_rng(2), min(here, there)
    # the last one, too, which lanes behind it follow; one several times, and from the same batch
    for to, rows, batch, theirs in (
        (rng.permutation(here)[:count], rng.permutation(there)[:count], other, others),
        (np.array([here - 1]), np.array([0]), other, others),
        (np.arange(here)[:3], np.arange(here)[[-1, -1, 0]][:here], fields, values),
    ):
        taken = {name: theirs[name][rows].copy() for name in SHAPES}
        fields.copy_rows(to, batch, rows)
        for name in SHAPES:
            values[name][to] = taken[name]
        check(fields, values)
        check(other, others)


@pytest.mark.parametrize("receivers", [1, 8, 9])
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


@pytest.mark.parametrize("there", [1, 9])
@pytest.mark.parametrize("here", [1, 9])
@pytest.mark.parametrize("shared", [(True, True), (True, False), (False, True)])
def test_what_is_shared_is_taken_over_for_all(here, there, shared):
    mine, theirs = shared
    fields = LaneFields(here, SHAPES, shared=mine)
    other = LaneFields(there, SHAPES, shared=theirs)
    other["bias"], other["speed"] = np.arange(5.0), 3.0
    fields.copy_rows(np.array([here - 1]), other, np.array([there - 1]))
    fields.copy_rows(np.array([], dtype=int), other, np.array([], dtype=int))
    first = 0 if mine else here - 1
    assert (fields["speed"][first:] == 3.0).all()
    assert (fields["bias"][first:] == np.arange(5.0)).all()
    assert not fields["speed"][:first].any()


def test_what_is_shared_cannot_differ():
    fields, other = LaneFields(3, SHAPES, shared=True), LaneFields(3, SHAPES)
    other["speed"] = np.arange(3.0)
    with pytest.raises(ValueError, match="share their values can't have different values"):
        fields["speed"] = np.arange(3.0)
    with pytest.raises(ValueError, match="share their values can't have different values"):
        fields.copy_rows(np.arange(3), other, np.arange(3))
    assert not fields.data.any()
