"""The cache of compiled code: named by the sources it comes from, and never in the way."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from spoofgym import _jit
from spoofgym.earth import wgs84

LAYERS = range(len(_jit.COMPILED_LAYERS))


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """Copy of the sources, which `_jit` takes for its own."""
    root = Path(_jit.__file__).parent
    for package in _jit.COMPILED_LAYERS:
        shutil.copytree(root / package, tmp_path / package)
    shutil.copy(root / "_jit.py", tmp_path)
    monkeypatch.setattr(_jit, "__file__", str(tmp_path / "_jit.py"))
    return tmp_path


def digests():
    return [_jit.source_digest(layer) for layer in LAYERS]


def changed(before):
    return [
        _jit.COMPILED_LAYERS[layer]
        for layer, (old, new) in enumerate(zip(before, digests(), strict=True))
        if old != new
    ]


def test_copied_sources_have_the_digests_of_the_original(tree, monkeypatch):
    copied = digests()
    monkeypatch.undo()
    assert digests() == copied
    assert len(set(copied)) == len(copied)
    assert all(len(digest) == 16 and int(digest, 16) >= 0 for digest in copied)


@pytest.mark.parametrize("package", _jit.COMPILED_LAYERS)
def test_an_edit_counts_for_its_layer_and_those_above(tree, package):
    before = digests()
    path = next((tree / package).glob("[a-z]*.py"))
    path.write_text(path.read_text() + "\n# a comment\n")
    assert changed(before) == list(_jit.COMPILED_LAYERS[_jit.COMPILED_LAYERS.index(package) :])


def test_a_new_a_renamed_and_a_nested_file_count(tree):
    before = digests()
    (tree / "sim" / "weather.py").write_text("RAIN = 1.0\n")
    assert changed(before) == list(_jit.COMPILED_LAYERS[1:])
    before = digests()
    (tree / "sim" / "weather.py").rename(tree / "sim" / "climate.py")
    assert changed(before) == list(_jit.COMPILED_LAYERS[1:])
    before = digests()
    (tree / "envs" / "more").mkdir()
    (tree / "envs" / "more" / "rules.py").write_text("")
    assert changed(before) == ["envs"]


def test_what_is_no_source_does_not_count(tree):
    before = digests()
    (tree / "sim" / "notes.txt").write_text("rain")
    (tree / "spoofers").mkdir()
    (tree / "spoofers" / "idea.py").write_text("")
    assert changed(before) == []


def test_the_decorator_and_numba_s_version_count_for_all(tree, monkeypatch):
    before = digests()
    path = tree / "_jit.py"
    path.write_text(path.read_text().replace('"arcp"', '"fast"'))
    assert changed(before) == list(_jit.COMPILED_LAYERS)
    before = digests()
    monkeypatch.setattr(numba, "__version__", "0.0.0")
    assert changed(before) == list(_jit.COMPILED_LAYERS)


def test_a_module_belongs_to_its_package_s_layer():
    assert _jit.layer_of("spoofgym.earth.wgs84") == 0
    assert _jit.layer_of("spoofgym.sim._kernels") == 1
    for outside in ("spoofgym.bench.run", "spoofgym", "tests.test_jit", "__main__"):
        assert _jit.layer_of(outside) == len(_jit.COMPILED_LAYERS) - 1


def test_the_least_recently_used_digests_are_pruned(tmp_path):
    folders = [tmp_path / f"sim-{k:016x}" for k in range(_jit.KEPT_DIGESTS + 5)]
    for age, folder in enumerate(folders):
        folder.mkdir()
        (folder / "code.nbi").write_text("")
        os.utime(folder, (1e9 - age, 1e9 - age))
    (tmp_path / "a file").write_text("")
    keep = folders[-1]  # the oldest of all is the one in use
    _jit._prune(tmp_path, keep)
    left = sorted(path.name for path in tmp_path.iterdir() if path.is_dir())
    assert left == sorted(f.name for f in [*folders[: _jit.KEPT_DIGESTS - 1], keep])
    assert (tmp_path / "a file").exists()
    assert keep.stat().st_mtime > 1e9  # used just now


def test_pruning_what_is_not_there_is_no_error(tmp_path):
    _jit._prune(tmp_path / "none", tmp_path / "none" / "sim-0")


@pytest.mark.nojit
def test_compiling_leaves_numba_s_own_settings_alone():
    before = numba.config.CACHE_DIR

    def double(x):
        return 2.0 * x

    for decorator in (_jit.njit, _jit.inlined):
        decorated = decorator(double)
        if numba.config.DISABLE_JIT:
            assert decorated is double
        assert decorated(2.0) == 4.0
    assert before == numba.config.CACHE_DIR


SCRIPT = """
import sys, warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from spoofgym.earth import ranging, wgs84  # two modules, one warning
    from spoofgym.sim import noise  # another layer
    assert abs(wgs84.gravity(6378137.0, 0.0, 0.0)[0] + 9.78) < 1e-3
told = [str(w.message) for w in caught if issubclass(w.category, RuntimeWarning)]
print(len(told), *told, sep="\\n")
"""


def in_a_new_process(folder, temporary):
    temporary.mkdir(exist_ok=True)
    environment = os.environ | {_jit.CACHE_VARIABLE: str(folder), "TMPDIR": str(temporary)}
    environment.pop("NUMBA_DISABLE_JIT", None)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    count, *told = done.stdout.splitlines()
    return int(count), told


def test_a_folder_that_cannot_be_written_gives_one_warning_and_works(tmp_path):
    (tmp_path / "file").write_text("")  # even root makes no folder below a file
    folder, temporary = tmp_path / "file" / "cache", tmp_path / "temporary"
    count, told = in_a_new_process(folder, temporary)
    assert count == 1
    assert str(folder) in told[0]
    assert _jit.CACHE_VARIABLE in told[0]
    fallback = temporary / f"spoofgym-cache-{os.getuid()}"
    assert str(fallback) in told[0]
    kept = sorted(path.name.split("-")[0] for path in fallback.iterdir())
    assert kept == ["earth", "sim"]
    assert list(fallback.rglob("*.nbi"))


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owner here")
def test_code_is_not_loaded_from_where_others_may_leave_it(tmp_path, monkeypatch):
    """The name of the temporary folder is known to all users of a machine."""
    monkeypatch.setattr(_jit.tempfile, "tempdir", str(tmp_path))
    own = _jit._temporary_parent()
    assert own == tmp_path / f"spoofgym-cache-{os.getuid()}"
    assert own.stat().st_mode & 0o777 == 0o700
    assert _jit._temporary_parent() == own
    own.chmod(0o777)
    other = _jit._temporary_parent()
    assert other != own
    assert other.stat().st_mode & 0o777 == 0o700


def test_a_folder_that_can_be_written_is_made_and_used(tmp_path):
    folder, temporary = tmp_path / "some" / "cache", tmp_path / "temporary"
    assert in_a_new_process(folder, temporary) == (0, [])
    assert {path.name.split("-")[0] for path in folder.iterdir()} == {"earth", "sim"}
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
    assert folder.is_relative_to(_jit.cache_folder(0))
    assert _jit.source_digest(0) in folder.as_posix()


GAIN = """
import hashlib, sys
import numpy as np
from spoofgym.receiver.kalman import _multiply, gain_solution, product, subtract
rng = np.random.default_rng(1)
if "callees-first" in sys.argv:
    subtract(np.zeros(289), np.zeros(136), np.zeros(136))
    product(np.zeros(64), np.zeros(136), np.zeros(136))
    _multiply(*np.zeros((3, 8, 8)))
digest = hashlib.sha256()
for covariance_update in (0, 1, 2):
    root = rng.normal(size=(17, 17))
    P, sums, dx = (root @ root.T).ravel(), np.zeros((3, 8, 8)), np.zeros(17)
    for k in (0, 4):
        rows = rng.normal(size=(3, 4, 4))
        sums[:, k : k + 4, k : k + 4] = rows @ rows.transpose(0, 2, 1)
    scratch = (*np.zeros((2, 8, 8)), np.zeros(64), *np.zeros((2, 136)))
    gain_solution(P, *sums, rng.normal(size=8), covariance_update, *scratch, dx)
    digest.update(P.tobytes() + dx.tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
def test_a_process_that_compiles_has_the_bits_of_one_that_loads(tmp_path):
    """A chain of four kernels; their sums come out otherwise where LLVM may regroup them."""
    environment = os.environ | {_jit.CACHE_VARIABLE: str(tmp_path)}
    environment.pop("NUMBA_DISABLE_JIT", None)
    digests_of = {}
    for case in ("compiling", "loading", "callees-first"):
        command = [sys.executable, "-c", GAIN, case]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        digests_of[case] = done.stdout.strip()
    assert len(set(digests_of.values())) == 1, digests_of
