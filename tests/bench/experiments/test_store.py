"""Files of cells are whole or absent, whatever ends a process, and taken for what they are."""

import errno
import json
import os
import subprocess
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from spoofgym.bench.experiments import Cell, Reader, Result, Store, run_experiment
from spoofgym.core import files as _files

from .support import Numbers, content

CELL = Cell("a", {"seed": 1})
WRITES = (
    *((Path, name) for name in ("write_bytes", "mkdir", "unlink")),
    *((os, name) for name in ("fsync", "replace", "link")),
)


@pytest.fixture
def opened(tmp_path):
    made = Store(tmp_path / "out")
    made.open("numbers", {"size": 3})
    return made


class Killed(BaseException):
    """A process is gone: nothing that it would still do is done."""


def interrupted_at(path, at, error):
    """Let the n-th write of an experiment and all that follow fail; returns what it raises."""
    left = [at]

    def guard(function, name):
        def guarded(*args, **kwargs):
            if name == "unlink" and not isinstance(error, Killed):
                return function(*args, **kwargs)  # what only fails still cleans up
            left[0] -= name != "unlink"
            if left[0] >= 0:
                return function(*args, **kwargs)
            if name == "write_bytes":
                with args[0].open("wb") as file:
                    file.write(args[1][: len(args[1]) // 2])
            raise error

        return guarded

    with pytest.MonkeyPatch.context() as patch:
        for place, name in WRITES:
            patch.setattr(place, name, guard(getattr(place, name), name))
        try:
            run_experiment(Numbers(), Store(path))
        except (Killed, OSError) as raised:
            return raised
    return None


def test_killed_at_every_write_it_goes_on_to_the_same_bytes(tmp_path, whole):
    at = 0
    while interrupted_at(path := tmp_path / str(at), at, Killed()):
        left = content(path) if path.is_dir() else {}
        assert left.items() <= whole.items(), f"write {at} left something else"
        run_experiment(Numbers(), Store(path))
        assert content(path) == whole
        at += 1
    assert at >= 3 * len(whole)
    assert content(path) == whole


def test_a_write_that_fails_names_its_file_and_leaves_nothing_half(tmp_path, whole):
    full = errno.ENOSPC, os.strerror(errno.ENOSPC)
    for at in (0, 4, 6, 17):
        path = tmp_path / str(at)
        caught = interrupted_at(path, at, OSError(*full))
        assert (caught.errno, caught.strerror) == full
        assert Path(caught.filename).suffix == (".npz" if at else ".json")
        assert not path.is_dir() or content(path).items() <= whole.items()
        assert not list(path.rglob("*.part"))
        run_experiment(Numbers(), Store(path))
        assert content(path) == whole


def test_leftovers_of_a_writer_go_when_it_is_gone(tmp_path):
    store = Store(tmp_path)
    store.open("numbers", {"size": 3})
    store.put(CELL, Result())
    command = [sys.executable, "-c", "input()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        stale = tmp_path / "cells" / f"spoofgym-{_files._machine()}-{process.pid}-{'0' * 32}.part"
        stale.write_bytes(b"half")
        Store(tmp_path).open("numbers", {"size": 3})
        assert stale.exists()  # its writer lives
        process.kill()
    Store(tmp_path).open("numbers", {"size": 3})
    assert not stale.exists()


def test_two_writers_at_once_leave_the_same_bytes(tmp_path, whole):
    cells = {cell.key: cell for cell in Numbers().cells()}

    def write(store):
        for _ in range(3):  # both write every cell, finished or not
            for key, result in run_experiment(Numbers(), store).items():
                store.put(cells[key], result)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(write, [Store(tmp_path), Store(tmp_path)]))
    assert content(tmp_path) == whole


def test_of_two_different_experiments_at_once_one_is_refused_and_nothing_is_mixed(tmp_path):
    def write(size):
        store = Store(tmp_path)
        try:
            store.open("numbers", {"size": size})
            for k in range(5):
                store.put(Cell(f"c{k}", {"size": size}), Result(record=size))
        except ValueError as error:
            return str(error)

    for _ in range(5):
        with ThreadPoolExecutor(2) as pool:
            first, second = pool.map(write, (3, 4))
        assert (first is None) != (second is None)
        assert f"{tmp_path} holds other results (config.size: " in (first or second)
        left = Store(tmp_path)
        size = left.reopen()["size"]
        assert {found.record for _, found in left.read_all()} == {size}
        assert size == (3 if first is None else 4)
        left._remove(())


def test_members_of_a_cell_never_leave_its_file(opened):
    """No name in a cell or its head becomes a path."""
    result = Result({"../../config.json": np.zeros(1), "/tmp/x": np.zeros(1)})
    before = (opened.path / "config.json").read_bytes()
    opened.put(CELL, result)
    assert opened.get(CELL).arrays == result.arrays
    assert (opened.path / "config.json").read_bytes() == before
    assert opened.build_path("../../x").parent == opened.path / "cells"


def test_what_is_put_comes_back_also_of_keys_that_no_file_can_have(opened):
    arrays = {
        "empty": np.zeros((0, 3), np.float32),
        "single": np.array(2.5),
        "flags": np.array([[True], [False]]),
        "words": np.array(["", "größe"]),
        "transposed": np.arange(6.0).reshape(2, 3).T,
    }
    for deflated in (False, True):
        result = Result(arrays, {"a": [1, np.float64(0.5)]}, deflated)
        opened.put(CELL, result)
        found = opened.get(CELL)
        for name, array in arrays.items():
            np.testing.assert_array_equal(found.arrays[name], array, strict=True)
        assert found.record == {"a": [1, 0.5]}
    with np.load(opened.build_path("a")) as plain:
        np.testing.assert_array_equal(plain["transposed"], arrays["transposed"])
    before = opened.build_path("a").read_bytes()
    # neither the layout of an array nor the time is in the bytes
    others = {**arrays, "transposed": np.ascontiguousarray(arrays["transposed"])}
    opened.put(CELL, result._replace(arrays=others))
    assert opened.build_path("a").read_bytes() == before
    keys = ["a b", "a/b", "a-b", "../a", "x" * 300, "x" * 299, "größe"]
    assert {opened.build_path(key).parent for key in keys} == {opened.path / "cells"}
    for key in keys:
        opened.put(Cell(key, {}), Result(record=key))
    assert [opened.get(Cell(key, {})).record for key in keys] == keys


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (Result(record={"x": float("nan")}), "record of cell 'a'"),
        (Result(record={"x": Path("x")}), "record of cell 'a'.*PosixPath"),
        (Result({"x": np.array([None])}), "cell 'a' returns 'x'"),
    ],
)
def test_what_cannot_be_stored_is_named(opened, result, said):
    with pytest.raises((ValueError, TypeError), match=said):
        opened.put(CELL, result)
    assert not opened.has(CELL)


def rewritten(path, head=None, extra=None):
    with zipfile.ZipFile(path) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    parts["head.json"] = json.dumps({**json.loads(parts["head.json"]), **(head or {})}).encode()
    with zipfile.ZipFile(path, "w") as file:
        for name, data in {**parts, **(extra or {})}.items():
            file.writestr(name, data)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:-30]), "is damaged"),
        (lambda path: rewritten(path, extra={"more.npy": b""}), r"other arrays.*\(more.npy\)"),
        (lambda path: rewritten(path, {"members": ["y.npy"]}), "other arrays.*y.npy"),
        (lambda path: rewritten(path, {"identity": {"seed": 7}}), "identity.seed: 7, not 1"),
        (lambda path: rewritten(path, {"key": "b"}), "key: 'b', not 'a'"),
        (lambda path: rewritten(path, {"format": 0}), "format: 0, not 1"),
        (lambda path: rewritten(path, {"experiment": "words"}), "experiment: 'words'"),
        (lambda path: rewritten(path, {"config": "0" * 16}), "config: '0000"),
    ],
)
def test_a_file_that_is_not_the_cell_is_refused_by_name(opened, damage, said):
    opened.put(CELL, Result({"x": np.zeros(3)}, {"y": 1}))
    path = opened.build_path("a")
    damage(path)
    for look in (opened.has, opened.get):
        with pytest.raises(ValueError, match=said) as caught:
            look(CELL)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("config.json", '{"detectors": [], "runs": 4}', "older format, or of another program"),
        ("config.json", '{"expe', "is damaged"),
        ("config.json", '{"experiment": "numbers", "config": {}, "format": 0}', "the format 0"),
        ("config.json", '{"experiment": "words", "config": {}, "format": 1}', "'words' and not"),
        ("thesis.tex", "years of work", r"not empty and holds no config.json.*thesis.tex"),
    ],
)
def test_a_folder_of_something_else_is_refused(tmp_path, name, text, said):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ValueError, match=said) as caught:
        Store(tmp_path).open("numbers", {"size": 3})
    assert str(tmp_path) in str(caught.value)
    assert content(tmp_path) == {name: text.encode()}
    with pytest.raises(ValueError, match="is not a folder"):
        Store(path).open("numbers", {})
    with pytest.raises(NotADirectoryError) as failed:
        Store(path / "out").open("numbers", {})
    assert name in str(failed.value.filename)


def test_other_settings_are_named_and_overwriting_removes_its_own_files_alone(opened):
    opened.put(CELL, Result())
    opened.write("report.json", b"{}")
    opened.write("notes.txt", b"mine")
    other = Store(opened.path)
    with pytest.raises(ValueError, match=r"config.size: 3, not 4.*choose another folder"):
        other.open("numbers", {"size": 4})
    other.open("numbers", {"size": 4}, outputs=["report.json"], overwrite=True)
    assert {*content(opened.path)} == {"config.json", "notes.txt"}
    with pytest.raises(ValueError, match="taken by another experiment meanwhile"):
        opened.put(CELL, Result())
    with pytest.raises(ValueError, match="has not been opened"):
        Store(opened.path).put(CELL, Result())


def test_a_reader_has_finished_cells_alone(opened):
    opened.put(CELL, Result(record=1))
    reader = Reader(opened, [CELL, Cell("b", {})])
    assert {key: reader[key].record for key in reader} == {"a": 1}
    assert (reader.missing, len(reader), "b" in reader, reader.get("b")) == (["b"], 1, False, None)
    with pytest.raises(KeyError, match="'b' is not finished"):
        reader["b"]
    with pytest.raises(KeyError, match=r"not among the cells.*'a', 'b'"):
        reader["c"]


def test_a_folder_may_hold_those_of_other_experiments(tmp_path):
    Store(tmp_path / "detectors").open("words", {})
    Store(tmp_path).open("numbers", {"size": 3})
    assert (tmp_path / "detectors" / "config.json").is_file()
