"""The one ``njit`` of the project, and the folder in which its compiled code is kept.

numba's own cache notices an edit of the file a function stands in, not of the files of the
functions it calls, and then goes on to run the old machine code.  Here the folder is named by a
digest of the sources and of the numba version, so that any edit of them starts afresh.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import shutil
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numba
import platformdirs
from numba.core import event

F = TypeVar("F", bound=Callable[..., object])

CACHE_VARIABLE = "SPOOFGYM_CACHE_DIR"
COMPILED_LAYERS = ("earth", "sim", "attacks", "receiver", "detectors", "envs")
"""Packages with compiled code, each of which calls only those before it (import-linter's order)."""
KEPT_DIGESTS = 16
FASTMATH = {"contract", "arcp", "nsz"}
"""Relaxed rules of floating point; ``reassoc`` is left out, see the notes of `njit`."""

NOTICE_S = 2.0
NOTICE = "spoofgym: compiling for this machine, once; takes about a minute"


class _Notice(event.Listener):  # type: ignore[misc]
    """Says once, on stderr, what takes so long: when `NOTICE_S` have gone into compiling."""

    said = False

    def __init__(self) -> None:
        self._depth, self._spent, self._since = 0, 0.0, math.inf

    def on_start(self, happened: event.Event) -> None:
        """Count from the outermost function, where it is one of the package."""
        of = happened.data["dispatcher"].py_func.__module__
        if self._depth == 0 and of.partition(".")[0] == __package__:
            self._since = time.monotonic()
        self._depth += 1
        self._look()

    def on_end(self, happened: event.Event) -> None:
        """Keep what the outermost function took."""
        self._look()
        self._depth -= 1
        if self._depth == 0:
            self._spent += max(time.monotonic() - self._since, 0.0)
            self._since = math.inf

    def _look(self) -> None:
        spent = self._spent + time.monotonic() - self._since
        if spent >= NOTICE_S and not self.said:
            self.said = True
            print(NOTICE, file=sys.stderr, flush=True)


event.register("numba:compile", _Notice())


def layer_of(module: str) -> int:
    """Place of a module in `COMPILED_LAYERS`."""
    parts = module.split(".")
    package = parts[1] if len(parts) > 1 else ""
    last = len(COMPILED_LAYERS) - 1
    return COMPILED_LAYERS.index(package) if package in COMPILED_LAYERS else last


def source_digest(layer: int) -> str:
    """Digest of the numba version and of every source file that a layer's code can come from.

    `layer`: index in `COMPILED_LAYERS`; the layers below count, those above do not.
    """
    root = Path(__file__).parent
    digest = hashlib.sha256(numba.__version__.encode())
    digest.update(Path(__file__).read_bytes())
    for package in COMPILED_LAYERS[: layer + 1]:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _is_own(folder: Path) -> bool:
    """Whether nobody else can leave code there, which is loaded unseen."""
    if not hasattr(os, "getuid"):
        return True
    status = folder.stat()
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _temporary_parent() -> Path:
    """Folder for when the user's own cannot be written: of this user, or else of this process."""
    user = getattr(os, "getuid", lambda: "user")()
    folder = Path(tempfile.gettempdir()) / f"spoofgym-cache-{user}"
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700)
    if _is_writable(folder) and _is_own(folder):
        return folder
    return Path(tempfile.mkdtemp(prefix="spoofgym-cache-"))


def _prune(parent: Path, keep: Path) -> None:
    """Drop all but the `KEPT_DIGESTS` most recently used digests; failures do not matter."""
    try:
        found = [path for path in parent.iterdir() if path.is_dir() and path != keep]
        found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        os.utime(keep)
    except OSError:
        return
    for path in found[KEPT_DIGESTS - 1 :]:
        shutil.rmtree(path, ignore_errors=True)


@lru_cache(maxsize=1)
def cache_parent() -> Path:
    """Folder of all compiled code, created when missing.

    ``SPOOFGYM_CACHE_DIR`` overrides the user's cache folder.  When the folder can't be written,
    one warning is issued and a temporary folder of this user is taken.
    """
    wanted = os.environ.get(CACHE_VARIABLE)
    parent = Path(wanted) if wanted else Path(platformdirs.user_cache_dir("spoofgym")) / "numba"
    if _is_writable(parent):
        return parent
    fallback = _temporary_parent()
    warnings.warn(
        f"the cache folder {parent} is not writable; compiled code goes to {fallback} "
        f"(set {CACHE_VARIABLE} to choose another folder)",
        RuntimeWarning,
        stacklevel=2,
    )
    return fallback


@lru_cache(maxsize=len(COMPILED_LAYERS))
def cache_folder(layer: int) -> Path:
    """Folder of one layer's compiled code."""
    folder = cache_parent() / f"{COMPILED_LAYERS[layer]}-{source_digest(layer)}"
    folder.mkdir(parents=True, exist_ok=True)
    _prune(cache_parent(), folder)
    return folder


def _compile(function: F, forceinline: bool) -> F:
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder(layer_of(function.__module__)))
    try:
        compiled: F = numba.njit(
            cache=True,
            nogil=True,
            fastmath=FASTMATH,
            error_model="numpy",
            boundscheck=False,
            forceinline=forceinline,
        )(function)
    finally:
        numba.config.CACHE_DIR = before
    return compiled


def njit(function: F) -> F:
    """Compile a function with the project's settings: cached, without the GIL.

    Parameters
    ----------
    function : callable
        A function of numbers, arrays and named tuples of them.

    Returns
    -------
    callable
        The compiled function, or `function` itself under ``NUMBA_DISABLE_JIT=1``.

    Notes
    -----
    The relaxed floating-point rules leave NaN and infinity alone, since inputs are screened for
    them.  Sums are not regrouped (``reassoc``): LLVM optimizes a function once by itself and once
    more within each caller, and would group otherwise each time.  Which of these copies runs
    depends on what the process has loaded first, so that one that compiles, whose callees are all
    loaded, would end in other last bits than one that finds the callers in the cache.  There is no
    ``parallel``: after a parallel region of GNU OpenMP a forked child dies, and
    Gymnasium's ``AsyncVectorEnv`` with it.
    """
    return _compile(function, forceinline=False)


def inlined(function: F) -> F:
    """Compile as `njit` does, and let every caller take the body in.

    For physics of a few scalars: a loop with a call in it is not vectorized.
    """
    return _compile(function, forceinline=True)
