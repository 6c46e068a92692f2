"""What objects remember of every receiver: reset, moved and copied by rows."""

import copy
import pickle

import numpy as np
import pytest

from spoofgym.core.memory import Memory


@pytest.fixture
def memory():
    memory, count = Memory(3), np.zeros(3, dtype=np.int64)
    memory.declare_all(count=count, mean=np.arange(6.0).reshape(3, 2))
    count[:] = 7  # which is copied
    return memory


def test_arrays_begin_as_they_were_declared_and_rows_are_taken_over(memory):
    np.testing.assert_array_equal(memory["count"], np.zeros(3, dtype=np.int64), strict=True)
    np.testing.assert_array_equal(memory["mean"], [[0, 1], [2, 3], [4, 5]])
    assert list(memory.declared) == ["count", "mean"]
    for initial in (np.zeros(2), np.zeros((2, 3)), np.float64(0.0)):
        with pytest.raises(ValueError, match="memory 'sum' needs a leading axis of 3 receivers"):
            memory.declare("sum", initial)
    assert "sum" not in memory
    other = Memory(2)
    other.declare_all(count=np.array([8, 9]), mean=np.full((2, 2), -1.0))
    memory.copy_rows(np.array([2, 0]), other, np.array([1, 0]))
    np.testing.assert_array_equal(memory["count"], [8, 0, 9])
    np.testing.assert_array_equal(memory["mean"], [[-1, -1], [2, 3], [-1, -1]])
    memory.reset()
    np.testing.assert_array_equal(memory["count"], 0)  # begins are not taken over
    memory.copy_rows(np.array([0, 1]), memory, np.array([1, 0]))
    np.testing.assert_array_equal(memory["mean"], [[2, 3], [0, 1], [4, 5]])


@pytest.mark.parametrize("assign", [True, False])
def test_a_reset_restores_the_masked_rows(memory, assign):
    if assign:
        memory["mean"] = memory["mean"] + 10.0
    else:
        memory["mean"] += 10.0
    before = memory["mean"]
    memory.reset(np.array([True, False, True]))
    np.testing.assert_array_equal(memory["mean"], [[0, 1], [12, 13], [4, 5]])
    np.testing.assert_array_equal(before[0], [10, 11])  # who holds the old array keeps it
    for _ in range(2):
        memory.reset()
        np.testing.assert_array_equal(memory["mean"], [[0, 1], [2, 3], [4, 5]])
        memory["mean"][:] = 1.0  # written in place


@pytest.mark.parametrize("way", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_a_copy_goes_on_for_itself_with_a_stamp_of_its_own(memory, way):
    memory["count"] += 4
    copied = way(memory)
    assert (type(copied), copied.receivers) == (Memory, 3)
    np.testing.assert_array_equal(copied["count"], 4)
    # a number from another process would be that of one of this process's own, sooner or later
    before = copied.stamp
    assert before != memory.stamp
    copied["count"] += 1
    assert copied.stamp != before
    copied.reset()
    np.testing.assert_array_equal(copied["count"], 0)
    np.testing.assert_array_equal(memory["count"], 4)
