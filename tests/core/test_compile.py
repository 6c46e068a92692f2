"""The cache of compiled code: named by the sources it comes from, and never in the way."""

import os
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import event

from spoofgym.core import compile as compiling
from spoofgym.earth import wgs84

ORIGINAL = compiling.__file__


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """Copy of the sources, which `compiling` takes for its own."""
    root = Path(compiling.__file__).parents[1]
    for package in ("core", *compiling.COMPILED_LAYERS):
        shutil.copytree(root / package, tmp_path / package)
    monkeypatch.setattr(compiling, "__file__", str(tmp_path / "core" / "compile.py"))
    return tmp_path


def digests():
    return [*map(compiling.source_digest, range(len(compiling.COMPILED_LAYERS)))]


def changed(before):
    layers = zip(compiling.COMPILED_LAYERS, before, digests(), strict=True)
    return [layer for layer, old, new in layers if old != new]


def test_edits_count_for_their_layer_and_those_above(tree, monkeypatch):
    copied = digests()
    with monkeypatch.context() as patch:
        patch.setattr(compiling, "__file__", ORIGINAL)
        assert digests() == copied
    assert len(set(copied)) == len(copied)
    assert all(len(digest) == 16 and int(digest, 16) >= 0 for digest in copied)
    layers = list(compiling.COMPILED_LAYERS)
    in_packages = [next((tree / each).glob("[a-z]*.py")) for each in layers]
    foundation = [tree / "core" / name for name in ("compile.py", "simd.py", "lanes.py")]
    for path in (*in_packages, *foundation):
        before = digests()
        path.write_text(path.read_text() + "\n# a comment\n")
        package = path.relative_to(tree).parts[0]
        assert changed(before) == layers[layers.index(package) if package in layers else 0 :]
    before = digests()
    (tree / "truth" / "weather.py").write_text("RAIN = 1.0\n")
    assert changed(before) == layers[1:]
    before = digests()
    (tree / "truth" / "weather.py").rename(tree / "truth" / "climate.py")
    assert changed(before) == layers[1:]
    before = digests()
    (tree / "envs" / "more").mkdir()
    (tree / "envs" / "more" / "rules.py").write_text("")
    assert changed(before) == ["envs"]
    before = digests()
    (tree / "truth" / "notes.txt").write_text("rain")
    (tree / "spoofers").mkdir()
    (tree / "spoofers" / "idea.py").write_text("")
    assert changed(before) == []
    monkeypatch.setattr(numba, "__version__", "0.0.0")
    assert changed(before) == layers


def test_the_least_recently_used_digests_are_pruned(tmp_path):
    folders = [tmp_path / f"truth-{k:016x}" for k in range(compiling.MAX_DIGESTS + 5)]
    for age, folder in enumerate(folders):
        folder.mkdir()
        (folder / "code.nbi").write_text("")
        os.utime(folder, (1e9 - age, 1e9 - age))
    (tmp_path / "a file").write_text("")
    # of those that would go, one may still be added to by a process, and the oldest is in use
    young, keep = folders[-3], folders[-1]
    os.utime(young)
    compiling._prune(tmp_path, keep)
    left = {path for path in tmp_path.iterdir() if path.is_dir()}
    assert left == {*folders[: compiling.MAX_DIGESTS - 2], young, keep}
    assert (tmp_path / "a file").exists()
    assert keep.stat().st_mtime > 1e9
    for folder in left - {keep}:
        os.utime(folder)
    (tmp_path / "more").mkdir()
    compiling._prune(tmp_path, keep)  # all of today
    assert {path for path in tmp_path.iterdir() if path.is_dir()} == {*left, tmp_path / "more"}
    compiling._prune(tmp_path / "none", tmp_path / "none" / "truth-0")  # no error


@pytest.mark.nojit
@pytest.mark.parametrize("decorator", [compiling.njit, compiling.inline_njit])
def test_compiling_leaves_numba_s_own_settings_alone(decorator):
    before = numba.config.CACHE_DIR

    def double(x):
        return 2.0 * x

    assert decorator(double)(2.0) == 4.0
    assert (decorator(double) is double) == bool(numba.config.DISABLE_JIT)
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


def processes(cache, *commands, **variables):
    """Processes that run at once and compile to a folder: what each prints and says on stderr."""
    environment = {**os.environ, compiling.CACHE_VARIABLE: str(cache), **variables}
    environment.pop("NUMBA_DISABLE_JIT", None)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    running = [
        subprocess.Popen([sys.executable, "-c", *command], env=environment, **pipes)
        for command in commands
    ]
    done = [(process.communicate(), process.returncode) for process in running]
    assert not any(code for _, code in done), done
    return [(printed.splitlines(), said.splitlines()) for (printed, said), _ in done]


NOTICE = compiling.NOTICE.format("spoofgym.earth (gravity)")


def test_compiling_is_said_once_on_stderr_and_loading_is_not(tmp_path):
    assert "`spoofgym warmup`" in NOTICE
    for expected in ([NOTICE], []):
        ((_, said),) = processes(tmp_path, (NOTICED,))
        assert said == ["compiled one of the user's", *expected]


SHARED = """
from spoofgym.core.compile import compiled_functions
from spoofgym.earth import wgs84
with compiled_functions() as found:
    wgs84.gravity(6378137.0, 0.0, 0.0)
print(bool(found))
"""


def test_of_processes_that_need_the_same_one_compiles_it(tmp_path):
    found = [printed for printed, _ in processes(tmp_path, (SHARED,), (SHARED,))]
    assert sorted(found) == [["False"], ["True"]]


def test_compiling_is_said_when_it_has_taken_two_seconds_in_all(monkeypatch, capsys):
    monkeypatch.setattr(compiling, "NOTICE_S", 2.0)
    clock = 0.0
    monkeypatch.setattr(compiling, "time", types.SimpleNamespace(monotonic=lambda: clock))
    claims = iter([True, False])
    notice = compiling._Notice(lambda: next(claims))
    ours, theirs = {"dispatcher": wgs84.gravity}, {"dispatcher": numba.njit(lambda x: x)}
    for compiled, seconds, said in ((theirs, 5.0, ""), (ours, 1.5, ""), (ours, 0.25, "")):
        notice.on_start(event.Event("numba:compile", event.EventStatus.START, compiled))
        clock += seconds
        notice.on_end(event.Event("numba:compile", event.EventStatus.END, compiled))
        clock += 60.0  # in which nothing is compiled
        assert capsys.readouterr().err == said
    notice.on_start(event.Event("numba:compile", event.EventStatus.START, ours))
    clock += 0.3
    notice.on_start(event.Event("numba:compile", event.EventStatus.START, theirs))  # called by it
    assert capsys.readouterr().err == f"{NOTICE}\n"
    notice.on_end(event.Event("numba:compile", event.EventStatus.END, theirs))
    notice.shown = False  # as in another process, after which it is no longer its turn
    notice.on_end(event.Event("numba:compile", event.EventStatus.END, ours))
    assert capsys.readouterr().err == ""
    assert list(claims) == []


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


def started(folder, temporary, number=1):
    """Numbers and texts of warnings, and the lines on stderr, of processes that run at once."""
    temporary.mkdir(exist_ok=True)
    return processes(folder, *[(SCRIPT,)] * number, TMPDIR=str(temporary))


def test_a_folder_that_cannot_be_written_gives_one_warning_and_works(tmp_path):
    (tmp_path / "file").write_text("")  # even root makes no folder below a file
    folder, temporary = tmp_path / "file" / "cache", tmp_path / "temporary"
    (((count, told), errors),) = started(folder, temporary)
    fallback = temporary / f"spoofgym-cache-{os.getuid()}"
    assert (count, errors) == ("1", [])
    assert all(each in told for each in (str(folder), compiling.CACHE_VARIABLE, str(fallback)))
    kept = sorted(path.name.split("-")[0] for path in fallback.iterdir())
    assert kept == ["earth", "truth"]
    assert list(fallback.rglob("*.nbi"))


owned = pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owner here")


@owned
def test_code_is_not_loaded_from_where_others_may_leave_it(tmp_path, monkeypatch):
    """The name of the temporary folder is known to all users of a machine."""
    monkeypatch.setattr(compiling.tempfile, "tempdir", str(tmp_path))
    own = compiling._temporary_parent()
    assert own == compiling._temporary_parent() == tmp_path / f"spoofgym-cache-{os.getuid()}"
    assert own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o777)
    other = compiling._temporary_parent()
    assert other != own
    assert other.stat().st_mode & 0o777 == 0o700


@owned
@pytest.mark.parametrize("given", [True, False])
def test_a_cache_that_others_can_write_to_is_not_used(tmp_path, monkeypatch, given):
    folder = tmp_path / "spoofgym" / "numba"
    if given:
        monkeypatch.setenv(compiling.CACHE_VARIABLE, str(folder))
    else:
        monkeypatch.delenv(compiling.CACHE_VARIABLE, raising=False)
        monkeypatch.setattr(compiling.platformdirs, "user_cache_dir", lambda n: str(tmp_path / n))
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


@owned
def test_a_layer_that_others_could_write_to_is_removed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compiling, "cache_parent", lambda: tmp_path)
    find = compiling.cache_folder.__wrapped__
    folder = find(0)
    (folder / "kept").touch()
    assert (find(0) / "kept").exists()
    folder.chmod(0o770)
    assert find(0) == folder == tmp_path / f"earth-{compiling.source_digest(0)}"
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
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"spoofgym: compiled code in {tmp_path} is damaged; it is compiled")
    # of two processes that save a first signature each, one's index may meet the other's code
    first, second = (
        compiling._CheckedFiles(str(tmp_path / name), "function", "stamp") for name in "ab"
    )
    for files, key in ((first, "one"), (second, "two")):
        Path(files._cache_path).mkdir()
        files.save(key, [key])
    shutil.copy(tmp_path / "b" / "function.1.nbc", tmp_path / "a")
    assert first.load("one") is None
    first.save("one", ["again"])
    assert first.load("one") == ["again"]


@pytest.mark.nightly
def test_a_damaged_cache_is_compiled_again_with_one_line(tmp_path):
    folder, temporary = tmp_path / "some" / "cache", tmp_path / "temporary"
    quiet = (["0"], [])
    assert started(folder, temporary, 3) == [quiet] * 3  # compiled by three at once
    assert {path.name.split("-")[0] for path in folder.iterdir()} == {"earth", "truth"}
    assert not list(temporary.iterdir())
    written = sorted(folder.rglob("*.nb[ic]"))
    whole = [path.read_bytes() for path in written]

    def flip(content):
        changed = bytearray(content)
        for k in range(0, len(changed), 97):
            changed[k] ^= 0xFF
        return bytes(changed)

    for suffix, damage in (
        (".nbi", lambda content: b""),
        (".nbc", lambda content: content[: len(content) // 2]),
        (".nbc", flip),
    ):
        for path, content in zip(written, whole, strict=True):
            path.write_bytes(damage(content) if path.suffix == suffix else content)
        line = f"spoofgym: compiled code in {folder} is damaged; it is compiled again where needed"
        assert started(folder, temporary) == [(["0"], [line])]
    times = [path.stat().st_mtime_ns for path in written]
    assert started(folder, temporary) == [quiet]  # and found again
    assert [path.stat().st_mtime_ns for path in written] == times


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
    def run(code):
        (((printed,), _),) = processes(tmp_path, (code,))
        return printed, {path.name.split("-")[0] for path in tmp_path.rglob("*.nbi")}

    kernel, _, _ = PARTS.partition("arguments =")
    assert run(kernel + "print(before)") == ("[True]", {"_kernels.fill_ranges"})
    both = {"_kernels.fill_ranges", "wgs84.range_and_rate"}
    assert run(PARTS) == ("[] [False]", both)  # the kernel is loaded, with its parts in it


UPDATE = """
import hashlib, sys
import numpy as np
from spoofgym.core.simd import LANES
from spoofgym.receiver import kalman
rng = np.random.default_rng(1)
if "callees-first" in sys.argv:
    kalman._multiply(*np.zeros((3, 64, LANES)), False)
    kalman._subtract_square(np.zeros((153, LANES)), 0, np.zeros((kalman.WORK, LANES)))
    kalman.factor_block(np.ones((kalman.WORK, LANES)), 0)
digest = hashlib.sha256()
for covariance_update in (0, 1, 2):
    root, rows = rng.normal(size=(17, 17)), rng.normal(size=(6, 4, 4))
    P = np.tile((root @ root.T)[np.triu_indices(17)][:, None], LANES)
    work = np.zeros((kalman.WORK, LANES))
    each = [each[np.triu_indices(4)] for each in rows @ rows.transpose(0, 2, 1)]
    sums = np.concatenate(each)[:, None]
    work[kalman.L : kalman.L + 20] = sums[:20]
    work[kalman.A1 : kalman.A1 + 40] = sums[20:]
    work[kalman.Y : kalman.Y + 8] = rng.normal(size=(8, LANES))
    kalman.update(P, 0, covariance_update, work)
    assert np.isfinite(P).all()
    digest.update(P.tobytes() + work[kalman.X : kalman.X + 17].tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
def test_a_process_that_compiles_has_the_bits_of_one_that_loads(tmp_path):
    """Sums of a chain of kernels come out otherwise where LLVM may regroup them."""
    cases = ("compiling", "loading", "callees-first")
    first, *others = (processes(tmp_path, (UPDATE, case))[0][0] for case in cases)
    assert others == [first, first]


def test_a_read_only_array_has_the_code_of_any_other():
    @compiling.njit
    def total(values):
        return values.sum()

    values, sealed = np.arange(3.0), np.arange(4.0)
    sealed.flags.writeable = False
    assert (total(sealed), total(values), total(sealed)) == (6.0, 3.0, 6.0)
    assert len(total.signatures) == 1
