"""The one ``njit`` of the project, and the folder in which its compiled code is kept.

numba's own cache notices an edit of the file a function stands in, not of the files of the
functions it calls, and then goes on to run the old machine code.  Here the folder is named by a
digest of the sources and of the numba version, so that any edit of them starts afresh.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numba
import platformdirs

F = TypeVar("F", bound=Callable[..., object])

CACHE_VARIABLE = "SPOOFGYM_CACHE_DIR"
COMPILED_FOLDERS = ("earth", "sim", "attacks", "receiver")
KEPT_DIGESTS = 4
FASTMATH = {"contract", "reassoc", "arcp", "nsz"}


def source_digest() -> str:
    """Digest of the numba version and of every source file that compiled code can come from.

    Compiled code and its constants stand in `COMPILED_FOLDERS` and in files named ``_kernels.py``;
    a test keeps it so.

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    root = Path(__file__).parent
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(root.rglob("*.py")):
        folder = path.relative_to(root).parts[0]
        if folder not in COMPILED_FOLDERS and path.name not in ("_jit.py", "_kernels.py"):
            continue
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


def cache_folder() -> Path:
    """Folder of this version's compiled code, created when missing.

    ``SPOOFGYM_CACHE_DIR`` overrides the user's cache folder.  When the folder can't be written,
    one warning is issued and a temporary folder of this user is taken.

    Returns
    -------
    Path
        A writable folder whose name is the digest of the sources.
    """
    wanted = os.environ.get(CACHE_VARIABLE)
    parent = Path(wanted) if wanted else Path(platformdirs.user_cache_dir("spoofgym")) / "numba"
    folder = parent / source_digest()
    if not _is_writable(folder):
        user = getattr(os, "getuid", lambda: "user")()
        fallback = Path(tempfile.gettempdir()) / f"spoofgym-cache-{user}"
        warnings.warn(
            f"the cache folder {parent} is not writable; compiled code goes to {fallback} "
            f"(set {CACHE_VARIABLE} to choose another folder)",
            RuntimeWarning,
            stacklevel=2,
        )
        parent, folder = fallback, fallback / folder.name
        if not _is_writable(folder):
            parent = Path(tempfile.mkdtemp(prefix="spoofgym-cache-"))
            folder = parent / folder.name
            folder.mkdir()
    _prune(parent, folder)
    return folder


_FOLDER = cache_folder()


def _compile(function: F, forceinline: bool) -> F:
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_FOLDER)
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
    them.  There is no ``parallel``: after a parallel region of GNU OpenMP a forked child dies, and
    Gymnasium's ``AsyncVectorEnv`` with it.
    """
    return _compile(function, forceinline=False)


def inlined(function: F) -> F:
    """Compile as `njit` does, and let every caller take the body in.

    For physics of a few scalars: a loop with a call in it is not vectorized.

    Parameters
    ----------
    function : callable
        A function of scalars.

    Returns
    -------
    callable
        The compiled function.
    """
    return _compile(function, forceinline=True)
