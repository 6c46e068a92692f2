"""A full disk and a full memory at any point leave a folder that is gone on with."""

import errno
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from spoofgym.bench.experiments import Cell, Result, Store, store
from spoofgym.core import files

from ..bench.experiments.support import content

CELLS = [Cell("a", {"seed": 1}), Cell("Sum of b", {"seed": 2})]
RESULTS = [
    Result({"x": np.arange(7.0)}, {"n": 1}, {"a.onnx": bytes(range(9))}),
    Result({"y": np.ones((2, 3))}, {"n": [2]}, deflated=True),
]
SOURCES = {store.__file__, files.__file__}
FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def fill(path):
    made = Store(path)
    made.open("numbers", {"size": 2})
    for cell, result in zip(CELLS, RESULTS, strict=True):
        made.put(cell, result)
        assert made.get(cell).record == result.record


def resume(path, whole):
    """No half cell is read, what lacks is written; the bytes are those of an undisturbed run."""
    again = Store(path)
    again.open("numbers", {"size": 2})
    for cell, result in zip(CELLS, RESULTS, strict=True):
        found = again.get(cell)
        if found is None:
            again.put(cell, result)
        else:
            assert found.record == result.record
            for name, array in result.arrays.items():
                np.testing.assert_array_equal(found.arrays[name], array)
    assert content(path) == whole


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    fill(folder := tmp_path_factory.mktemp("whole"))
    return content(folder)


def exhaust_memory(path, at):
    """Fail at the n-th line that the store executes, as an allocation there would; whether it
    came so far."""
    left = [at]

    def trace(frame, event, _):
        if frame.f_code.co_filename not in SOURCES:
            return None
        if event == "line":
            left[0] -= 1
            if left[0] == -1:
                raise MemoryError(f"line {frame.f_lineno}")
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        fill(path)
    except MemoryError:
        return True
    finally:
        sys.settrace(before)
    return left[0] < 0


def fill_disk(path, at, patch):
    """Fail at the n-th write after half of its bytes, and at all that follow; returns the error."""
    left = [at]

    def write_bytes(self, data):
        left[0] -= 1
        with self.open("wb") as file:
            file.write(data if left[0] >= 0 else data[: len(data) // 2])
        if left[0] < 0:
            raise FULL

    patch.setattr(Path, "write_bytes", write_bytes)
    try:
        fill(path)
    except OSError as error:
        return error
    finally:
        patch.undo()
    return None


def test_a_full_disk_at_every_write_names_its_file_and_is_gone_on_from(
    tmp_path, whole, monkeypatch
):
    at = 0
    while raised := fill_disk(path := tmp_path / str(at), at, monkeypatch):
        assert raised.errno == errno.ENOSPC
        assert Path(raised.filename).suffix in {".npz", ".json"}
        resume(path, whole)
        at += 1
    assert at == 1 + len(CELLS)


# a line that fails between an open file and its block leaves the file to the collector
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    "every", [17, pytest.param(1, marks=pytest.mark.nightly)], ids=["some lines", "all lines"]
)
def test_a_full_memory_at_every_line_of_the_store_is_gone_on_from(tmp_path, whole, every):
    at = tried = 0
    while exhaust_memory(path := tmp_path / str(at), at):
        resume(path, whole)
        at, tried = at + every, tried + 1
    assert at > 200
    assert tried > 10
