"""The program's first second, in which its packages are still being imported."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any, NoReturn

PROGRAM = "spoofgym"
OLDEST_PYTHON = 3, 11
NUMPY_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "NUMPY_MADVISE_HUGEPAGE": "0"}
"""Other threads would wait longer than small products take; of large pages those parts of a world
that nothing needs would take memory, too."""


def is_program() -> bool:
    """Whether this process is the command line, as a script or by ``python -m``."""
    words = getattr(sys, "orig_argv", ["-m", PROGRAM])  # which Python 3.9 lacks
    by_module = PROGRAM in words and words[words.index(PROGRAM) - 1] == "-m"
    return by_module or Path("".join(sys.argv[:1])).stem == PROGRAM


def check_python() -> None:
    """Refuse an older Python: the program in one line, an import by its error."""
    if sys.version_info[:2] < OLDEST_PYTHON:
        text = f"spoofgym needs Python 3.11 or newer, this is {sys.version.split()[0]}"
        raise SystemExit(f"spoofgym: error: {text}") if is_program() else ImportError(text)


def start_program() -> None:
    """Until `cli.app.main` takes over, let Ctrl-C end the program in one line, and not in whatever
    import it meets; NumPy takes what pays here."""
    if is_program():
        for name, value in NUMPY_ENVIRONMENT.items():
            os.environ.setdefault(name, value)
        if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
            signal.signal(signal.SIGINT, _end)


def _end(number: int, frame: Any) -> NoReturn:
    os.write(2, b"spoofgym: interrupted\n")
    os._exit(128 + number)
