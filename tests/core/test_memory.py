"""What objects remember of every receiver: reset, moved and copied by rows."""

import copy
import pickle

import numpy as np
import pytest

from spoofgym.core.memory import Memory


@pytest.fixture
def memory():
    memory = Memory(3)
    memory.declare("count", np.zeros(3, dtype=np.int64))
    memory.declare("mean", np.arange(6.0).reshape(3, 2))
    return memory


def test_an_array_begins_as_it_was_declared(memory):
    np.testing.assert_array_equal(memory["count"], [0, 0, 0])
    assert memory["count"].dtype == np.int64
    np.testing.assert_array_equal(memory["mean"], [[0, 1], [2, 3], [4, 5]])
    assert list(memory.declared) == ["count", "mean"]


@pytest.mark.parametrize("initial", [np.zeros(2), np.zeros((2, 3)), np.float64(0.0)])
def test_the_leading_axis_must_be_the_receivers(memory, initial):
    with pytest.raises(ValueError, match=r"memory 'sum' needs a leading axis of 3 receivers, got"):
        memory.declare("sum", initial)
    assert "sum" not in memory


def test_the_given_array_is_copied():
    initial = np.zeros(2)
    memory = Memory(2)
    memory.declare("x", initial)
    initial[:] = 7.0
    np.testing.assert_array_equal(memory["x"], 0.0)
    memory["x"][:] = 5.0  # written in place
    memory.reset()
    np.testing.assert_array_equal(memory["x"], 0.0)


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
    memory.reset()
    np.testing.assert_array_equal(memory["mean"], [[0, 1], [2, 3], [4, 5]])
    memory["mean"] += 1.0
    memory.reset()  # and again
    np.testing.assert_array_equal(memory["mean"], [[0, 1], [2, 3], [4, 5]])


def test_rows_are_taken_over_from_another_memory(memory):
    other = Memory(2)
    other.declare("count", np.array([8, 9]))
    other.declare("mean", np.full((2, 2), -1.0))
    memory.copy_rows(np.array([2, 0]), other, np.array([1, 0]))
    np.testing.assert_array_equal(memory["count"], [8, 0, 9])
    np.testing.assert_array_equal(memory["mean"], [[-1, -1], [2, 3], [-1, -1]])
    memory.reset()
    np.testing.assert_array_equal(memory["count"], 0)  # begins are not taken over


def test_rows_may_be_exchanged_within_one_memory(memory):
    memory.copy_rows(np.array([0, 1]), memory, np.array([1, 0]))
    np.testing.assert_array_equal(memory["mean"], [[2, 3], [0, 1], [4, 5]])


@pytest.mark.parametrize("way", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_a_copy_goes_on_for_itself_and_can_be_reset(memory, way):
    memory["count"] += 4
    copied = way(memory)
    assert isinstance(copied, Memory)
    assert copied.receivers == 3
    np.testing.assert_array_equal(copied["count"], 4)
    copied["count"] += 1
    np.testing.assert_array_equal(memory["count"], 4)
    copied.reset()
    np.testing.assert_array_equal(copied["count"], 0)
    np.testing.assert_array_equal(memory["count"], 4)


@pytest.mark.parametrize("way", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_no_two_memories_have_one_stamp(memory, way):
    # a number from another process would be that of one of this process's own, sooner or later
    copied = way(memory)
    before = copied.stamp
    assert before != memory.stamp
    copied["count"] = copied["count"]
    assert copied.stamp != before
