"""The program's first second, in which its packages are still being imported."""

from __future__ import annotations

import os
import signal
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

PROGRAM = "spoofgym"


def is_program() -> bool:
    """Whether this process is the command line, as a script or by ``python -m``."""
    by_module = ("-m", PROGRAM) in pairwise(sys.orig_argv)
    return by_module or Path("".join(sys.argv[:1])).stem == PROGRAM


def start_program() -> None:
    """Until `cli.app.main` takes over, let Ctrl-C end the program in one line, and not in whatever
    import it meets; NumPy has one thread, as others wait longer than small products take."""
    if is_program():
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
            signal.signal(signal.SIGINT, _end)


def _end(number: int, frame: Any) -> NoReturn:
    os.write(2, b"spoofgym: interrupted\n")
    os._exit(128 + number)
