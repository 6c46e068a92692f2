"""Files of cells are whole or absent, whatever ends a process, and taken for what they are."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from spoofgym.bench.experiments import Cell, Reader, Result, Store, run_experiment
from spoofgym.core import files as _files

from .support import Numbers, content, expected


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return expected(tmp_path_factory.mktemp("whole"))


@pytest.fixture
def opened(tmp_path: Path) -> Store:
    made = Store(tmp_path / "out")
    made.open("numbers", {"size": 3})
    return made


CELL = Cell("a", {"seed": 1})


class Killed(BaseException):
    """A process is gone: nothing that it would still do is done."""


class Failing:
    """Lets the n-th write fail, and all that follow; a write may leave a half."""

    def __init__(self, patch: pytest.MonkeyPatch, at: int, error: BaseException) -> None:
        self.left, self.error, self.dead = at, error, isinstance(error, Killed)
        for place, name in (
            (Path, "write_bytes"),
            (Path, "mkdir"),
            (os, "fsync"),
            (os, "replace"),
            (os, "link"),
            (Path, "unlink"),
        ):
            patch.setattr(place, name, self._guarded(getattr(place, name), name))

    def _guarded(self, function, name):
        def guarded(*args, **kwargs):
            if name != "unlink" or self.dead:  # what only fails still cleans up
                self.left -= name != "unlink"
                if self.left < 0:
                    if name == "write_bytes":
                        with args[0].open("wb") as file:
                            file.write(args[1][: len(args[1]) // 2])
                    raise self.error
            return function(*args, **kwargs)

        return guarded


def interrupted_at(path: Path, at: int, error: BaseException) -> bool:
    """Whether the experiment has met the n-th write."""
    with pytest.MonkeyPatch.context() as patch:
        Failing(patch, at, error)
        try:
            run_experiment(Numbers(), Store(path))
        except (Killed, OSError):
            return True
    return False


def test_killed_at_every_write_it_goes_on_to_the_same_bytes(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    at = 0
    while interrupted_at(tmp_path / str(at), at, Killed()):
        left = content(tmp_path / str(at)) if (tmp_path / str(at)).is_dir() else {}
        assert left.items() <= whole.items(), f"write {at} left something else"
        run_experiment(Numbers(), Store(tmp_path / str(at)))
        assert content(tmp_path / str(at)) == whole
        at += 1
    assert at >= 3 * len(whole)
    assert content(tmp_path / str(at)) == whole


def test_a_write_that_fails_names_its_file_and_leaves_nothing_half(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    number = errno.ENOSPC
    for at in range(0, 3 * len(whole), 4):
        path = tmp_path / str(at)
        assert interrupted_at(path, at, OSError(number, os.strerror(number)))
        assert content(path).items() <= whole.items() if path.is_dir() else True
        assert not list(path.rglob("*.part"))
        run_experiment(Numbers(), Store(path))
        assert content(path) == whole
    with pytest.MonkeyPatch.context() as patch:
        Failing(patch, 6, OSError(number, os.strerror(number)))
        with pytest.raises(OSError, match=os.strerror(number)) as caught:
            run_experiment(Numbers(), Store(tmp_path / "named"))
    assert caught.value.errno == number
    assert Path(caught.value.filename).suffix == ".npz"


def test_a_full_disk_is_named_and_gone_on_with(tmp_path: Path, whole: dict[str, bytes]) -> None:
    full = tmp_path / "full"
    full.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=16k", "tmpfs", str(full)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        return  # only where a test may mount one; else the injection above stands for it
    try:
        with pytest.raises(OSError, match="No space left on device"):
            run_experiment(Numbers(), Store(full / "out"))
        subprocess.run(["mount", "-o", "remount,size=4m", str(full)], check=True)
        run_experiment(Numbers(), Store(full / "out"))
        assert content(full / "out") == whole
    finally:
        subprocess.run(["umount", str(full)], check=True)


def test_a_killed_process_leaves_whole_files_and_its_leftovers_go(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "tests.bench.experiments.support", str(out), "1.0", "1"]
    with subprocess.Popen(command) as process:
        while len(list((out / "cells").glob("*.npz"))) < 2 and process.poll() is None:
            time.sleep(0.01)
        stale = out / "cells" / f"spoofgym-{_files._machine()}-{process.pid}-{'0' * 32}.part"
        stale.write_bytes(b"half")
        Store(out).open("numbers", {"size": 3})
        assert stale.exists()  # its writer lives
        process.send_signal(signal.SIGKILL)
    assert content(out).items() < whole.items()
    run_experiment(Numbers(), Store(out))
    assert content(out) == whole
    assert not stale.exists()


def test_leftovers_of_other_machines_go_when_they_are_old(opened: Store) -> None:
    young, old = (opened.path / f"spoofgym-0badcafe-{k}-{'0' * 32}.part" for k in (1, 2))
    for part in (young, old):
        part.write_bytes(b"half")
    os.utime(old, (time.time() - 30 * 86_400,) * 2)
    opened.open("numbers", {"size": 3})
    assert young.exists()
    assert not old.exists()


def test_two_writers_at_once_leave_the_same_bytes(tmp_path: Path, whole: dict[str, bytes]) -> None:
    failed: list[BaseException] = []

    def writer() -> None:
        try:
            store = Store(tmp_path)
            for _ in range(5):  # both write every cell, finished or not
                run_experiment(Numbers(), store)
                for key, result in Reader(store, Numbers().cells()).items():
                    store.put(next(c for c in Numbers().cells() if c.key == key), result)
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=writer) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert content(tmp_path) == whole


def test_what_is_put_comes_back(opened: Store) -> None:
    arrays = {
        "empty": np.zeros((0, 3), np.float32),
        "single": np.array(2.5),
        "flags": np.array([[True], [False]]),
        "words": np.array(["", "größe"]),
        "transposed": np.arange(6.0).reshape(2, 3).T,
    }
    for deflated in (False, True):
        result = Result(arrays, {"a": [1, np.float64(0.5)]}, {"x.onnx": b"\0\1"}, deflated)
        opened.put(CELL, result)
        found = opened.get(CELL)
        assert found is not None
        for name, array in arrays.items():
            np.testing.assert_array_equal(found.arrays[name], array, strict=True)
        assert found.record == {"a": [1, 0.5]}
        assert found.files == result.files
    with np.load(opened.build_path("a")) as plain:
        np.testing.assert_array_equal(plain["transposed"], arrays["transposed"])


def test_bytes_do_not_depend_on_the_layout_of_an_array_or_the_time(opened: Store) -> None:
    array = np.arange(6.0).reshape(2, 3)
    written = []
    for same in (array, np.asfortranarray(array), np.arange(12.0).reshape(2, 6)[:, :3] * 0 + array):
        opened.put(CELL, Result({"x": same}))
        written.append(opened.build_path("a").read_bytes())
    assert written[0] == written[1] == written[2]


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (Result(record={"x": float("nan")}), "record of cell 'a'"),
        (Result(record={"x": Path("x")}), "record of cell 'a'.*PosixPath"),
        (Result({"x": np.array([None])}), "cell 'a' returns 'x'"),
        (Result({"files/x": np.zeros(1)}), "'files/x'"),
    ],
)
def test_what_cannot_be_stored_is_named(opened: Store, result: Result, said: str) -> None:
    with pytest.raises((ValueError, TypeError), match=said):
        opened.put(CELL, result)
    assert not opened.has(CELL)


def test_keys_that_no_file_can_have_get_files_of_their_own(opened: Store) -> None:
    keys = ["a b", "a/b", "a-b", "../a", "x" * 300, "x" * 299, "größe"]
    paths = {opened.build_path(key) for key in keys}
    assert len(paths) == len(keys)
    assert all(path.parent == opened.path / "cells" for path in paths)
    for key in keys:
        opened.put(Cell(key, {}), Result(record=key))
    assert [opened.get(Cell(key, {})).record for key in keys] == keys  # type: ignore[union-attr]


def rewritten(path: Path, head=None, extra=None) -> None:
    with zipfile.ZipFile(path) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    if head:
        parts["head.json"] = json.dumps({**json.loads(parts["head.json"]), **head}).encode()
    with zipfile.ZipFile(path, "w") as file:
        for name, data in {**parts, **(extra or {})}.items():
            file.writestr(name, data)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:-30]), "is damaged"),
        (lambda path: path.write_bytes(b""), "is damaged"),
        (lambda path: rewritten(path, extra={"more.npy": b""}), r"other arrays.*\(more.npy\)"),
        (lambda path: rewritten(path, {"members": ["y.npy"]}), "other arrays.*y.npy"),
        (lambda path: rewritten(path, {"identity": {"seed": 7}}), "identity.seed: 7, not 1"),
        (lambda path: rewritten(path, {"key": "b"}), "key: 'b', not 'a'"),
        (lambda path: rewritten(path, {"format": 0}), "format: 0, not 1"),
        (lambda path: rewritten(path, {"experiment": "words"}), "experiment: 'words'"),
        (lambda path: rewritten(path, {"config": "0" * 16}), "config: '0000"),
    ],
)
def test_a_file_that_is_not_the_cell_is_refused_by_name(opened: Store, damage, said: str) -> None:
    opened.put(CELL, Result({"x": np.zeros(3)}, {"y": 1}))
    path = opened.build_path("a")
    damage(path)
    for look in (opened.has, opened.get):
        with pytest.raises(ValueError, match=said) as caught:
            look(CELL)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_flipped_bit_is_found_when_a_cell_is_read(opened: Store) -> None:
    opened.put(CELL, Result({"x": np.zeros(300)}))
    path = opened.build_path("a")
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(ValueError, match="is damaged"):
        opened.get(CELL)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"detectors": [], "runs": 4}', "older format, or of another program"),
        ("[]", "older format, or of another program"),
        ('{"expe', "is damaged"),
        ('{"experiment": "numbers", "config": {}, "format": 0}', "has the format 0"),
        ('{"experiment": "words", "config": {}, "format": 1}', "experiment 'words' and not"),
    ],
)
def test_a_folder_of_something_else_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(ValueError, match=said) as caught:
        Store(tmp_path).open("numbers", {"size": 3})
    assert str(tmp_path) in str(caught.value)
    assert content(tmp_path) == {"config.json": text.encode()}


def test_other_settings_are_named(opened: Store) -> None:
    with pytest.raises(ValueError, match=r"config.size: 3, not 4") as caught:
        Store(opened.path).open("numbers", {"size": 4})
    assert "choose another folder" in str(caught.value)


def test_a_folder_of_a_user_and_a_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match=r"not empty and holds no config.json.*thesis.tex"):
        Store(tmp_path).open("numbers", {})
    with pytest.raises(ValueError, match=r"thesis.tex is not a folder"):
        Store(tmp_path / "thesis.tex").open("numbers", {})
    with pytest.raises(NotADirectoryError) as caught:
        Store(tmp_path / "thesis.tex" / "out").open("numbers", {})
    assert "thesis.tex" in str(caught.value.filename)


def test_overwriting_removes_what_the_experiment_wrote_and_nothing_else(opened: Store) -> None:
    opened.put(CELL, Result())
    opened.write("report.json", b"{}")
    opened.write("notes.txt", b"mine")
    other = Store(opened.path)
    other.open("numbers", {"size": 4}, outputs=["report.json"], overwrite=True)
    assert {*content(opened.path)} == {"config.json", "notes.txt"}
    with pytest.raises(ValueError, match="taken by another experiment meanwhile"):
        opened.put(CELL, Result())


def test_a_reader_has_finished_cells_alone(opened: Store) -> None:
    cells = [CELL, Cell("b", {})]
    opened.put(CELL, Result(record=1))
    reader = Reader(opened, cells)
    assert {key: reader[key].record for key in reader} == {"a": 1}
    assert reader.missing == ["b"]
    assert "b" not in reader
    assert reader.get("b") is None
    with pytest.raises(KeyError, match="'b' is not finished"):
        reader["b"]
    with pytest.raises(KeyError, match=r"not among the cells.*'a', 'b'"):
        reader["c"]


def test_a_store_has_to_be_opened(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="has not been opened"):
        Store(tmp_path).put(CELL, Result())
