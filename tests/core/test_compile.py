"""The cache of compiled code: named by the sources it comes from, and never in the way."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numba
import pytest
from numba.core import event

from spoofgym.core import compile as compiling
from spoofgym.earth import wgs84

LAYERS = range(len(compiling.COMPILED_LAYERS))


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """Copy of the sources, which `compiling` takes for its own."""
    root = Path(compiling.__file__).parents[1]
    for package in ("core", *compiling.COMPILED_LAYERS):
        shutil.copytree(root / package, tmp_path / package)
    monkeypatch.setattr(compiling, "__file__", str(tmp_path / "core" / "compile.py"))
    return tmp_path


def digests():
    return [compiling.source_digest(layer) for layer in LAYERS]


def changed(before):
    return [
        compiling.COMPILED_LAYERS[layer]
        for layer, (old, new) in enumerate(zip(before, digests(), strict=True))
        if old != new
    ]


def test_copied_sources_have_the_digests_of_the_original(tree, monkeypatch):
    copied = digests()
    monkeypatch.undo()
    assert digests() == copied
    assert len(set(copied)) == len(copied)
    assert all(len(digest) == 16 and int(digest, 16) >= 0 for digest in copied)


@pytest.mark.parametrize("package", compiling.COMPILED_LAYERS)
def test_an_edit_counts_for_its_layer_and_those_above(tree, package):
    before = digests()
    path = next((tree / package).glob("[a-z]*.py"))
    path.write_text(path.read_text() + "\n# a comment\n")
    assert changed(before) == list(
        compiling.COMPILED_LAYERS[compiling.COMPILED_LAYERS.index(package) :]
    )


def test_a_new_a_renamed_and_a_nested_file_count(tree):
    before = digests()
    (tree / "truth" / "weather.py").write_text("RAIN = 1.0\n")
    assert changed(before) == list(compiling.COMPILED_LAYERS[1:])
    before = digests()
    (tree / "truth" / "weather.py").rename(tree / "truth" / "climate.py")
    assert changed(before) == list(compiling.COMPILED_LAYERS[1:])
    before = digests()
    (tree / "envs" / "more").mkdir()
    (tree / "envs" / "more" / "rules.py").write_text("")
    assert changed(before) == ["envs"]


def test_what_is_no_source_does_not_count(tree):
    before = digests()
    (tree / "truth" / "notes.txt").write_text("rain")
    (tree / "spoofers").mkdir()
    (tree / "spoofers" / "idea.py").write_text("")
    assert changed(before) == []


def test_the_decorator_the_vectors_and_numba_s_version_count_for_all(tree, monkeypatch):
    before = digests()
    for name in ("compile.py", "simd.py", "lanes.py"):
        path = tree / "core" / name
        path.write_text(path.read_text() + "\n# a comment\n")
        assert changed(before) == list(compiling.COMPILED_LAYERS)
        before = digests()
    monkeypatch.setattr(numba, "__version__", "0.0.0")
    assert changed(before) == list(compiling.COMPILED_LAYERS)


def test_a_module_belongs_to_its_package_s_layer():
    assert compiling.find_layer("spoofgym.earth.wgs84") == 0
    assert compiling.find_layer("spoofgym.truth._kernels") == 1
    for outside in ("spoofgym.bench.runs.play", "spoofgym", "tests.core.test_compile", "__main__"):
        assert compiling.find_layer(outside) == len(compiling.COMPILED_LAYERS) - 1


def test_the_least_recently_used_digests_are_pruned(tmp_path):
    folders = [tmp_path / f"truth-{k:016x}" for k in range(compiling.MAX_DIGESTS + 5)]
    for age, folder in enumerate(folders):
        folder.mkdir()
        (folder / "code.nbi").write_text("")
        os.utime(folder, (1e9 - age, 1e9 - age))
    (tmp_path / "a file").write_text("")
    keep = folders[-1]  # the oldest of all is the one in use
    compiling._prune(tmp_path, keep)
    left = sorted(path.name for path in tmp_path.iterdir() if path.is_dir())
    assert left == sorted(f.name for f in [*folders[: compiling.MAX_DIGESTS - 1], keep])
    assert (tmp_path / "a file").exists()
    assert keep.stat().st_mtime > 1e9  # used just now


def test_code_that_a_process_may_still_add_to_is_not_pruned(tmp_path):
    folders = [tmp_path / f"truth-{k:016x}" for k in range(compiling.MAX_DIGESTS + 5)]
    for folder in folders:
        folder.mkdir()
    os.utime(folders[3], (1e9, 1e9))
    compiling._prune(tmp_path, folders[0])
    assert sorted(tmp_path.iterdir()) == sorted({*folders} - {folders[3]})


def test_pruning_what_is_not_there_is_no_error(tmp_path):
    compiling._prune(tmp_path / "none", tmp_path / "none" / "truth-0")


@pytest.mark.nojit
def test_compiling_leaves_numba_s_own_settings_alone():
    before = numba.config.CACHE_DIR

    def double(x):
        return 2.0 * x

    for decorator in (compiling.njit, compiling.inline_njit):
        decorated = decorator(double)
        if numba.config.DISABLE_JIT:
            assert decorated is double
        assert decorated(2.0) == 4.0
    assert before == numba.config.CACHE_DIR


NOTICED = """
import sys
import numba
from spoofgym.core import compile as compiling
compiling.NOTICE_S = 0.0
numba.njit(lambda x: x)(1.0)
print("compiled one of the user's", file=sys.stderr)
from spoofgym.earth import wgs84
for _ in range(2):
    wgs84.gravity(6378137.0, 0.0, 0.0)
wgs84.gravity(6378137, 0, 0)  # of whole numbers it is another function
"""


def test_compiling_is_said_once_on_stderr_and_loading_is_not(tmp_path):
    environment = os.environ | {compiling.CACHE_VARIABLE: str(tmp_path)}
    environment.pop("NUMBA_DISABLE_JIT", None)
    said = [
        subprocess.run(
            [sys.executable, "-c", NOTICED],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stderr.splitlines()
        for _ in range(2)
    ]
    assert said == [
        ["compiled one of the user's", compiling.NOTICE],
        ["compiled one of the user's"],
    ]


def test_compiling_is_said_when_it_has_taken_two_seconds_in_all(monkeypatch, capsys):
    monkeypatch.setattr(compiling, "NOTICE_S", 2.0)
    clock = 0.0
    monkeypatch.setattr(compiling, "time", types.SimpleNamespace(monotonic=lambda: clock))
    notice = compiling._Notice()
    ours, theirs = {"dispatcher": wgs84.gravity}, {"dispatcher": numba.njit(lambda x: x)}
    # who compiles, how long, and whether it has been said afterwards
    for compiled, seconds, said in ((theirs, 5.0, ""), (ours, 1.5, ""), (ours, 0.25, "")):
        notice.on_start(event.Event("numba:compile", event.EventStatus.START, compiled))
        clock += seconds
        notice.on_end(event.Event("numba:compile", event.EventStatus.END, compiled))
        clock += 60.0  # in which nothing is compiled
        assert capsys.readouterr().err == said
    notice.on_start(event.Event("numba:compile", event.EventStatus.START, ours))
    clock += 0.3
    notice.on_start(event.Event("numba:compile", event.EventStatus.START, theirs))  # called by it
    assert capsys.readouterr().err == f"{compiling.NOTICE}\n"
    notice.on_end(event.Event("numba:compile", event.EventStatus.END, theirs))
    assert capsys.readouterr().err == ""


SCRIPT = """
import sys, warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from spoofgym.core import compile as compiling
    compiling.NOTICE_S = float("inf")  # whether compiling takes that long depends on the machine
    from spoofgym.earth import attitude, wgs84  # two modules, one warning
    from spoofgym.truth import noise  # another layer
    assert abs(wgs84.gravity(6378137.0, 0.0, 0.0)[0] + 9.78) < 1e-3
told = [str(w.message) for w in caught if issubclass(w.category, RuntimeWarning)]
print(len(told), *told, sep="\\n")
"""


def in_new_processes(folder, temporary, number=1, **variables):
    """Number and texts of warnings, and the lines on stderr, of processes that run at once."""
    temporary.mkdir(exist_ok=True)
    environment = os.environ | {compiling.CACHE_VARIABLE: str(folder), "TMPDIR": str(temporary)}
    environment |= variables
    environment.pop("NUMBA_DISABLE_JIT", None)
    running = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(number)
    ]
    results = []
    for process in running:
        said, errors = process.communicate()
        assert process.returncode == 0, errors
        count, *told = said.splitlines()
        results.append((int(count), told, errors.splitlines()))
    return results


def in_a_new_process(folder, temporary, **variables):
    ((count, told, errors),) = in_new_processes(folder, temporary, **variables)
    assert errors == []
    return count, told


def test_a_folder_that_cannot_be_written_gives_one_warning_and_works(tmp_path):
    (tmp_path / "file").write_text("")  # even root makes no folder below a file
    folder, temporary = tmp_path / "file" / "cache", tmp_path / "temporary"
    count, told = in_a_new_process(folder, temporary)
    assert count == 1
    assert str(folder) in told[0]
    assert compiling.CACHE_VARIABLE in told[0]
    fallback = temporary / f"spoofgym-cache-{os.getuid()}"
    assert str(fallback) in told[0]
    kept = sorted(path.name.split("-")[0] for path in fallback.iterdir())
    assert kept == ["earth", "truth"]
    assert list(fallback.rglob("*.nbi"))


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owner here")
def test_code_is_not_loaded_from_where_others_may_leave_it(tmp_path, monkeypatch):
    """The name of the temporary folder is known to all users of a machine."""
    monkeypatch.setattr(compiling.tempfile, "tempdir", str(tmp_path))
    own = compiling._temporary_parent()
    assert own == tmp_path / f"spoofgym-cache-{os.getuid()}"
    assert own.stat().st_mode & 0o777 == 0o700
    assert compiling._temporary_parent() == own
    own.chmod(0o777)
    other = compiling._temporary_parent()
    assert other != own
    assert other.stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owner here")
@pytest.mark.parametrize("given", [True, False])
def test_a_cache_that_others_can_write_to_is_not_used(tmp_path, monkeypatch, given):
    folder = tmp_path / "cache"
    if given:
        monkeypatch.setenv(compiling.CACHE_VARIABLE, str(folder))
    else:
        monkeypatch.delenv(compiling.CACHE_VARIABLE, raising=False)
        monkeypatch.setattr(
            compiling.platformdirs, "user_cache_dir", lambda name: str(tmp_path / name)
        )
        folder = tmp_path / "spoofgym" / "numba"
    monkeypatch.setattr(compiling.tempfile, "tempdir", str(tmp_path))
    find = compiling.cache_parent.__wrapped__
    assert find() == folder
    assert folder.stat().st_mode & 0o777 == 0o700
    fallback = tmp_path / f"spoofgym-cache-{os.getuid()}"
    for mode in (0o720, 0o702, 0o777):
        folder.chmod(mode)
        with pytest.warns(RuntimeWarning, match=f"writable by you alone, got mode {mode:o}"):
            assert find() == fallback
    folder.chmod(0o755)
    assert find() == folder
    uid = os.getuid()
    monkeypatch.setattr(compiling.os, "getuid", lambda: uid + 1)
    with pytest.warns(RuntimeWarning, match=f"must belong to user {uid + 1}, .* not to {uid}"):
        other = find()
    assert other not in (folder, fallback)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owner here")
def test_a_layer_that_others_could_write_to_is_removed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compiling, "cache_parent", lambda: tmp_path)
    find = compiling.cache_folder.__wrapped__
    folder = find(0)
    (folder / "kept").touch()
    assert (find(0) / "kept").exists()
    folder.chmod(0o770)
    assert find(0) == folder
    assert list(folder.iterdir()) == []
    assert folder.stat().st_mode & 0o777 == 0o700
    assert f"{folder} must be writable by you alone" in capsys.readouterr().err


def test_any_damage_to_a_file_makes_it_absent(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compiling, "cache_parent", lambda: tmp_path)
    compiling._print_note.cache_clear()
    files = compiling._CheckedFiles(str(tmp_path), "function", "stamp")
    files.save("one", [1.0])
    files.save("two", [2.0])
    index, one = tmp_path / "function.nbi", tmp_path / "function.1.nbc"
    assert (files.load("one"), files.load("two"), files.load("three")) == ([1.0], [2.0], None)
    assert capsys.readouterr().err == ""
    for path in (index, one):
        whole = path.read_bytes()
        flipped = [bytes([*whole[:k], whole[k] ^ 4, *whole[k + 1 :]]) for k in range(len(whole))]
        for damaged in (*flipped, *(whole[:k] for k in range(len(whole))), whole + b"x"):
            path.write_bytes(damaged)
            assert files.load("one") is None
        if path == one:
            assert files.load("two") == [2.0]
        files.save("one", [3.0])  # compiled again
        assert files.load("one") == [3.0]
        path.write_bytes(whole)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        f"spoofgym: compiled code in {tmp_path} is damaged; it is compiled again where needed"
    ]


def test_code_of_another_signature_is_not_taken(tmp_path):
    """Of two processes that save a first signature each, one's index may meet the other's code."""
    first = compiling._CheckedFiles(str(tmp_path / "a"), "function", "stamp")
    second = compiling._CheckedFiles(str(tmp_path / "b"), "function", "stamp")
    for files, key in ((first, "one"), (second, "two")):
        Path(files._cache_path).mkdir()
        files.save(key, [key])
    shutil.copy(tmp_path / "b" / "function.1.nbc", tmp_path / "a")
    assert first.load("one") is None
    first.save("one", ["again"])
    assert first.load("one") == ["again"]


@pytest.mark.slow
def test_a_damaged_cache_is_compiled_again_with_one_line(tmp_path):
    folder, temporary = tmp_path / "cache", tmp_path / "temporary"
    results = in_new_processes(folder, temporary, 3)  # compiled by three at once
    assert results == [(0, [], [])] * 3
    written = sorted(folder.rglob("*.nb[ic]"))
    whole = [path.read_bytes() for path in written]

    def flip(content):
        changed = bytearray(content)
        for k in range(0, len(changed), 97):
            changed[k] ^= 0xFF
        return bytes(changed)

    for suffix, damage in (
        (".nbi", lambda content: b""),
        (".nbi", lambda content: content[: len(content) // 2]),
        (".nbc", lambda content: content[: len(content) // 2]),
        (".nbc", flip),
    ):
        for path, content in zip(written, whole, strict=True):
            path.write_bytes(damage(content) if path.suffix == suffix else content)
        ((count, told, errors),) = in_new_processes(folder, temporary)
        assert (count, told) == (0, [])
        assert errors == [
            f"spoofgym: compiled code in {folder} is damaged; it is compiled again where needed"
        ]
    assert in_a_new_process(folder, temporary) == (0, [])


def test_a_folder_that_can_be_written_is_made_and_used(tmp_path):
    folder, temporary = tmp_path / "some" / "cache", tmp_path / "temporary"
    assert in_a_new_process(folder, temporary) == (0, [])
    assert {path.name.split("-")[0] for path in folder.iterdir()} == {"earth", "truth"}
    written = sorted(folder.rglob("*.nbi"))
    assert written
    times = [path.stat().st_mtime_ns for path in written]
    assert in_a_new_process(folder, temporary) == (0, [])  # and found again
    assert [path.stat().st_mtime_ns for path in written] == times
    assert not list(temporary.iterdir())


def test_code_of_this_process_lies_in_the_folder_of_its_layer():
    if numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    wgs84.gravity(7e6, 0.0, 0.0)
    folder = Path(wgs84.gravity.stats.cache_path)
    assert folder.is_relative_to(compiling.cache_folder(0))
    assert compiling.source_digest(0) in folder.as_posix()


PARTS = """
import numpy as np
from spoofgym.core import compile as compiling
compiling.NOTICE_S = float("inf")
from spoofgym.core.compile import is_part
from spoofgym.earth import wgs84
from spoofgym.truth import _kernels

def forms():
    return [is_part(each) for each in wgs84.range_and_rate.overloads.values()]

satellites, visible = np.zeros((1, 1, 8)), np.ones((1, 1), dtype=np.bool_)
satellites[0, 0, :6] = 2e7, 3e6, 1e6, 1.0, 2e3, 3e3
position, velocity = np.array([[6.4e6, 1.0, 2.0]]), np.array([[3.0, 4.0, 5.0]])
assert forms() == []
_kernels.fill_ranges(satellites, visible, position, velocity)
before = forms()
arguments = satellites[0, 0, :3], satellites[0, 0, 3:6], position[0], velocity[0]
found = wgs84.range_and_rate(*arguments)
assert found[:2] == tuple(satellites[0, 0, 6:].tolist()), found
_kernels.fill_ranges(satellites.astype(np.float64), visible, position[::1], velocity)
print(before, forms())
"""


def test_what_only_compiled_code_calls_is_compiled_within_it(tmp_path):
    """Once Python calls it, it is compiled for that too, saved, and found by later processes."""
    environment = os.environ | {compiling.CACHE_VARIABLE: str(tmp_path)}
    environment.pop("NUMBA_DISABLE_JIT", None)

    def run(code):
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        saved = {path.name.split("-")[0] for path in tmp_path.rglob("*.nbi")}
        return done.stdout.strip(), saved

    kernel, _, _ = PARTS.partition("arguments =")
    assert run(kernel + "print(before)") == ("[True]", {"_kernels.fill_ranges"})
    both = {"_kernels.fill_ranges", "wgs84.range_and_rate"}
    assert run(PARTS) == ("[] [False]", both)  # the kernel is loaded, with its parts in it
    for path in tmp_path.rglob("*.nb[ic]"):
        path.unlink()
    assert run(PARTS) == ("[True] [False]", both)


UPDATE = """
import hashlib, sys
import numpy as np
from spoofgym.core.simd import LANES
from spoofgym.receiver import kalman
rng = np.random.default_rng(1)
shapes = ((), (LANES,))
if "callees-first" in sys.argv:
    for shape in shapes:
        kalman._multiply(*np.zeros((3, 64, *shape)), False)
        kalman._subtract_square(np.zeros((153, *shape)), 0, np.zeros((kalman.WORK, *shape)))
        kalman.factor_block(np.ones((kalman.WORK, *shape)), 0)
digest = hashlib.sha256()
for covariance_update in (0, 1, 2):
    for shape in shapes:
        root, rows = rng.normal(size=(17, 17)), rng.normal(size=(6, 4, 4))
        P = (root @ root.T)[np.triu_indices(17)]
        work = np.zeros((kalman.WORK, *shape))
        each = [each[np.triu_indices(4)] for each in rows @ rows.transpose(0, 2, 1)]
        sums = np.concatenate(each).reshape(-1, *np.ones_like(shape))
        P = P.reshape(-1, *np.ones_like(shape)) * np.ones((153, *shape))
        work[kalman.L : kalman.L + 20] = sums[:20]
        work[kalman.A1 : kalman.A1 + 40] = sums[20:]
        work[kalman.Y : kalman.Y + 8] = rng.normal(size=(8, *shape))
        kalman.update(P, 0, covariance_update, work)
        assert np.isfinite(P).all()
        digest.update(P.tobytes() + work[kalman.X : kalman.X + 17].tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
def test_a_process_that_compiles_has_the_bits_of_one_that_loads(tmp_path):
    """A chain of kernels; their sums come out otherwise where LLVM may regroup them."""
    environment = os.environ | {compiling.CACHE_VARIABLE: str(tmp_path)}
    environment.pop("NUMBA_DISABLE_JIT", None)
    digests_of = {}
    for case in ("compiling", "loading", "callees-first"):
        command = [sys.executable, "-c", UPDATE, case]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        digests_of[case] = done.stdout.strip()
    assert len(set(digests_of.values())) == 1, digests_of
