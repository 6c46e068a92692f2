"""The one ``njit`` of the project, and the folder in which its compiled code is stored.

A function is compiled in full where Python calls it.  What only compiled code calls needs no
wrapper for Python, no machine code and no file of the cache: its callers take its intermediate code
in, and LLVM optimizes that once, as a part of theirs.

numba's own cache notices an edit of the file a function is in, not of the files of the
functions it calls, and then goes on to run the old machine code.  Here the folder is named by a
digest of the sources and of the numba version, so that any edit of them starts afresh.

numba runs whatever its files hold.  Here each ends with a checksum; one that is damaged counts as
absent, so that its function is compiled again and the file replaced.  The checksum is no signature:
against others the folder has to be this user's own, as the files are unpickled.
"""

from __future__ import annotations

import gc
import hashlib
import math
import os
import shutil
import stat
import sys
import tempfile
import time
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
import platformdirs
from numba.core import event, sigutils
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult, Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler  # type: ignore[attr-defined]
from numba.core.registry import CPUDispatcher
from numba.core.types import Array
from numba.core.types.misc import unliteral

# NumPy has no public name for the kind of processor that its loops run on.
from numpy._core._multiarray_umath import (  # type: ignore[import-not-found]
    __cpu_features__,
)
from numpy.typing import NDArray

from .files import write_file


class _Part(JITCodeLibrary):  # type: ignore[misc]
    """Intermediate code of a function that only compiled code calls; not optimized by itself."""

    def finalize(self) -> None:
        """Take in what it calls, and leave all else to its callers."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True


def is_part(result: CompileResult) -> bool:
    """Whether a compiled function can be called from compiled code alone."""
    return isinstance(result.library, _Part)


class _Compiler(_FunctionCompiler):  # type: ignore[misc]
    """Compiles a function in full, or as a `_Part` where that is requested."""

    as_part = False

    def _compile_core(self, args: Any, return_type: Any) -> CompileResult:
        if not self.as_part:
            return super()._compile_core(args, return_type)
        self.as_part = False
        flags = self.targetdescr.options.parse_as_flags(Flags(), self.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        target = self.targetdescr.target_context
        library = _Part(target.codegen(), self.py_func.__qualname__)
        result = compile_extra(
            self.targetdescr.typing_context,
            target,
            self.py_func,
            args=args,
            return_type=return_type,
            flags=flags,
            locals=self.locals,
            library=library,
            pipeline_class=self.pipeline_class,
        )
        target.insert_user_function(library, result.fndesc, [library])
        return result._replace(entry_point=library)


def unify(kind: Any) -> Any:
    """The type that a function is compiled for: a read-only array's is that of any other.

    Their layouts are the same, and so is the code; twice it would take twice as long.  That no
    kernel writes into one is tested where they are distinguished (tests/golden/test_changes.py).
    """
    read_only = isinstance(kind, Array) and not kind.mutable
    return kind.copy(readonly=False) if read_only else kind


@contextmanager
def _rare_collection() -> Iterator[None]:
    """Python's collector looks rarely at what a compilation makes, most of which stays until its
    end: 6 % less time."""
    before = gc.get_threshold()
    gc.set_threshold(*(max(each) for each in zip(before, COLLECT_AFTER, strict=True)))
    try:
        yield
    finally:
        gc.set_threshold(*before)


class Function(CPUDispatcher):  # type: ignore[misc]
    """A compiled function: for Python, or as a part of other compiled functions, or both."""

    _compiler: Any

    # numba rebuilds what was pickled with its code by the first three.
    def __init__(
        self,
        function: Any,
        variables: dict[str, Any],
        options: dict[str, Any],
        cache: FunctionCache | None = None,
    ) -> None:
        super().__init__(function, variables, options)
        self._compiler = _Compiler(
            function, self.targetdescr, options, self.locals, self._compiler.pipeline_class
        )
        self._cache = cache or NullCache()

    def __reduce__(self) -> Any:
        """Pickle a function of a module by its name, as Python does, and any other with its code.

        What another process imports is compiled there already, or loaded from the cache.
        """
        name, module = self.py_func.__qualname__, sys.modules.get(self.py_func.__module__)
        named = module is not None and module.__name__ != "__main__"
        return name if named and getattr(module, name, None) is self else super().__reduce__()

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """How a call from compiled code is compiled.

        By the types of its arguments, not once more for every constant.
        """
        plain = tuple(map(unliteral, args))
        named = {name: unliteral(kind) for name, kind in kws.items()}
        with global_compiler_lock:
            self._compiler.as_part = True
            try:
                return super().get_call_template(plain, named)
            finally:
                self._compiler.as_part = False

    def compile(self, sig: Any) -> Any:
        with global_compiler_lock:
            args, _ = sigutils.normalize_signature(sig)
            if self._compiler.as_part:
                return super().compile(sig)
            unified = tuple(map(unify, args))
            found = self.overloads.get(unified)
            if found is not None and is_part(found):
                del self.overloads[unified]
            with _rare_collection(), _wait_for_others(self._cache):
                code = super().compile(unified if unified != tuple(args) else sig)
            if unified != tuple(args):
                self._insert([kind._code for kind in args], code, False)
            return code

    def add_overload(self, cres: CompileResult) -> None:
        if is_part(cres):
            self.overloads[tuple(cres.signature.args)] = cres
        else:
            super().add_overload(cres)


F = TypeVar("F", bound=Callable[..., object])

CACHE_VARIABLE = "SPOOFGYM_CACHE_DIR"
PACKAGE = __package__.partition(".")[0]
# Packages with compiled code, each of which calls only those before it (import-linter's order).
COMPILED_LAYERS = ("earth", "truth", "attacks", "receiver", "detectors", "simulation", "envs")
FOUNDATION = ("core/compile.py", "core/simd.py", "core/lanes.py")  # code of any layer may be theirs
MAX_DIGESTS = 16
MIN_AGE_S = 86_400.0  # least age of code that is pruned: what began to use it may still add to it
CHECKSUM_SIZE = 16
COLLECT_AFTER = 50_000, 20, 1000  # objects, and collections of the younger ones
WAIT_S = 100.0  # for another process that compiles the same; the longest take a minute
NOTICE_S = 2.0
NOTICE = (
    "spoofgym: compiling {} for this machine; what a first run compiles takes about a minute and "
    "is stored (`spoofgym warmup` does it beforehand)"
)


class _Notice(event.Listener):  # type: ignore[misc]
    """Says once, on stderr, what takes so long: when `NOTICE_S` have gone into compiling."""

    shown = False

    def __init__(self, may_show: Callable[[], bool] = lambda: True) -> None:
        self.may_show = may_show
        self._depth, self._spent, self._since = 0, 0.0, math.inf
        self._what = ""  # package and function that Python called

    def on_start(self, happened: event.Event) -> None:
        function = happened.data["dispatcher"].py_func
        parts = function.__module__.split(".")
        if self._depth == 0 and parts[0] == PACKAGE:
            self._since = time.monotonic()
            self._what = f"{'.'.join(parts[:2])} ({function.__name__})"
        self._depth += 1
        self._look()

    def on_end(self, happened: event.Event) -> None:
        self._look()
        self._depth -= 1
        if self._depth == 0:
            self._spent += max(time.monotonic() - self._since, 0.0)
            self._since = math.inf

    def _look(self) -> None:
        spent = self._spent + time.monotonic() - self._since
        if spent >= NOTICE_S and not self.shown:
            self.shown = True
            if self.may_show():
                print(NOTICE.format(self._what), file=sys.stderr, flush=True)


_notice = _Notice()
event.register("numba:compile", _notice)


def share_notice(claim: Callable[[], bool]) -> None:
    """Of several processes let the one whose `claim` succeeds first say what takes so long."""
    _notice.may_show = claim
    if _notice.shown:
        claim()


def is_disabled() -> bool:
    return bool(numba.config.DISABLE_JIT)


@contextmanager
def compiled_functions() -> Iterator[list[Any]]:
    """Functions that are compiled meanwhile; those loaded from the cache are not among them."""
    with event.install_recorder("numba:compile") as recorder:
        found: list[Any] = []
        yield found
        found += [each for _, each in recorder.buffer if each.is_start]


def find_layer(module: str) -> int:
    parts = module.split(".")
    package = parts[1] if len(parts) > 1 else ""
    last = len(COMPILED_LAYERS) - 1
    return COMPILED_LAYERS.index(package) if package in COMPILED_LAYERS else last


def source_digest(layer: int) -> str:
    """Digest of the numba version and of every source file that a layer's code can come from.

    `layer`: index in `COMPILED_LAYERS`; the layers below count, those above do not.
    """
    root = Path(__file__).parents[1]
    digest = hashlib.sha256(numba.__version__.encode())
    for name in FOUNDATION:
        digest.update((root / name).read_bytes())
    for package in COMPILED_LAYERS[: layer + 1]:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _fault(folder: Path) -> str:
    """Why a folder, made where it is missing, can't hold compiled code; empty if it can."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            status = folder.stat()
    except OSError as error:
        return f"can't be written ({error.strerror})"
    if not hasattr(os, "getuid"):
        return ""
    if status.st_uid != os.getuid():
        return f"must belong to user {os.getuid()}, who runs its code, not to {status.st_uid}"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        mode = stat.S_IMODE(status.st_mode)
        return f"must be writable by you alone, got mode {mode:o} (`chmod go-w` mends it)"
    return ""


def _temporary_parent() -> Path:
    """Folder for when the user's own can't be used: of this user, or else of this process."""
    user = getattr(os, "getuid", lambda: "user")()
    folder = Path(tempfile.gettempdir()) / f"spoofgym-cache-{user}"
    return Path(tempfile.mkdtemp(prefix="spoofgym-cache-")) if _fault(folder) else folder


def _prune(parent: Path, keep: Path) -> None:
    """Drop old digests but for the `MAX_DIGESTS` last used ones; failures do not matter."""
    try:
        found = [path for path in parent.iterdir() if path.is_dir() and path != keep]
        found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        os.utime(keep)
        latest = time.time() - MIN_AGE_S
        old = [path for path in found[MAX_DIGESTS - 1 :] if path.stat().st_mtime < latest]
    except OSError:
        return
    for path in old:
        shutil.rmtree(path, ignore_errors=True)


@lru_cache(maxsize=1)
def cache_parent() -> Path:
    """Folder of all compiled code, created when missing.

    ``SPOOFGYM_CACHE_DIR`` overrides the user's cache folder.  When the folder can't be written,
    or others may write to it, one warning is issued and a temporary folder of this user is taken.
    """
    wanted = os.environ.get(CACHE_VARIABLE)
    parent = Path(wanted) if wanted else Path(platformdirs.user_cache_dir("spoofgym")) / "numba"
    if not (fault := _fault(parent)):
        return parent
    fallback = _temporary_parent()
    warnings.warn(
        f"the cache folder {parent} {fault}; compiled code goes to {fallback} "
        f"(set {CACHE_VARIABLE} to choose another folder)",
        RuntimeWarning,
        stacklevel=2,
    )
    return fallback


@lru_cache(maxsize=len(COMPILED_LAYERS))
def cache_folder(layer: int) -> Path:
    folder = cache_parent() / f"{COMPILED_LAYERS[layer]}-{source_digest(layer)}"
    if fault := _fault(folder):  # left from when others could write to its parent
        _print_note(f"{folder} {fault}; it is removed, and its code compiled again")
        shutil.rmtree(folder)
        folder.mkdir(mode=0o700)
    _prune(cache_parent(), folder)
    return folder


def recall_arrays(
    module: str, name: str, make: Callable[[], dict[str, NDArray[Any]]]
) -> dict[str, NDArray[Any]]:
    """What `make` of a module computes, from the folder of its compiled code if it is there: a file
    for each version of numpy and kind of processor, which NumPy's bits depend on."""
    if is_disabled():
        return make()
    known = np.__version__, sorted(__cpu_features__.items()), numba.config.CPU_NAME
    kind = hashlib.sha256(repr(known).encode()).hexdigest()[:12]
    path = cache_folder(find_layer(module)) / f"{name}-{kind}.npz"
    try:
        return dict(np.load(BytesIO(path.read_bytes())))
    except FileNotFoundError:
        pass
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        _print_note(f"{path} is damaged; it is computed again")
    arrays, content = make(), BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    with suppress(OSError):  # such as a full disk: the next process computes it, too
        write_file(path, content.getvalue())
    return arrays


@cache
def _print_note(line: str) -> None:
    print(f"spoofgym: {line}", file=sys.stderr)


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=CHECKSUM_SIZE).digest()


class _CheckedFiles(IndexDataCacheFile):  # type: ignore[misc]
    """Index and code of one function; every file ends with its checksum, which pickle ignores."""

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[BytesIO]:
        with super()._open_for_write(filepath) as file:
            content = BytesIO()
            yield content
            file.write(content.getvalue() + _checksum(content.getvalue()))

    def _is_whole(self, path: str) -> bool:
        try:
            content = Path(path).read_bytes()
        except FileNotFoundError:
            return False
        whole = _checksum(content[:-CHECKSUM_SIZE]) == content[-CHECKSUM_SIZE:]
        if not whole:
            _print_note(
                f"compiled code in {cache_parent()} is damaged; it is compiled again where needed"
            )
        return whole

    def _load_index(self) -> dict[Any, str]:
        return super()._load_index() if self._is_whole(self._index_path) else {}

    def _load_data(self, name: str) -> Any:
        return super()._load_data(name) if self._is_whole(self._data_path(name)) else (None, None)

    # Two processes that save the first two signatures at once give both the same file name.
    def save(self, key: Any, data: Any) -> None:
        super().save(key, (key, data))

    def load(self, key: Any) -> Any:
        saved_key, data = super().load(key) or (None, None)
        return data if saved_key == key else None


class _CheckedCache(FunctionCache):  # type: ignore[misc]
    """What is compiled by a process is waited for by others that need the same, and loaded then."""

    locks: ExitStack | None = None  # where what is missing is to be compiled in full

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _CheckedFiles(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = super().load_overload(sig, target_context)
        locks, self.locks = self.locks, None
        if found is not None or locks is None:
            return found
        from filelock import FileLock, Timeout

        key = hashlib.sha256(repr(self._index_key(sig, target_context.codegen())).encode())
        path = Path(self._cache_path) / f"{self._impl.filename_base}.{key.hexdigest()[:12]}.lock"
        with suppress(Timeout, OSError, NotImplementedError):  # then both compile it
            self._impl.locator.ensure_cache_path()
            locks.enter_context(FileLock(path).acquire(timeout=WAIT_S))
            found = super().load_overload(sig, target_context)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        if not is_part(data):
            super().save_overload(sig, data)


@contextmanager
def _wait_for_others(cache: Any) -> Iterator[None]:
    """Only one process compiles in the block what is not in the cache."""
    with ExitStack() as cache.locks:
        try:
            yield
        finally:
            cache.locks = None


def _compile(function: F, **how: Any) -> F:
    if is_disabled():
        return function
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder(find_layer(function.__module__)))
    try:
        cache = _CheckedCache(function)
    finally:
        numba.config.CACHE_DIR = before
    settings = {"nopython": True, "nogil": True, "error_model": "numpy", "boundscheck": False}
    return cast(F, Function(function, {}, settings | how, cache))


def njit(function: F) -> F:
    """Compile a function with the project's settings: cached, without the GIL.

    Parameters
    ----------
    function : callable
        A function of numbers, arrays and named tuples of them. Compiled, it would write into an
        array that is read-only as into any other; it must not.

    Returns
    -------
    callable
        The compiled function, or `function` itself under ``NUMBA_DISABLE_JIT=1``.

    Notes
    -----
    No rule of floating point is relaxed, so that a receiver has the same bits in any batch, thread
    and process, and on any kind of processor, as far as the code calls no C library.  With
    ``contract``, a multiplication and an addition may become one operation with one rounding: LLVM
    chooses them in the body of a vectorized loop otherwise than in its remainder.  With
    ``reassoc``, sums may be regrouped, and with ``arcp`` divisions become products, otherwise in
    one copy of a function than in another; which copy runs depends on what has been loaded first.
    There is no ``parallel``: after a parallel region of GNU
    OpenMP a forked child dies, and Gymnasium's ``AsyncVectorEnv`` with it.
    """
    return _compile(function)


def inline_njit(function: F) -> F:
    """Compile as `njit` does, and let every caller take the body in.

    For physics of a few numbers: a loop with a call in it is not vectorized.
    """
    return _compile(function, forceinline=True)
