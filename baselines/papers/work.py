"""What a process of the pool does; it loads no more than its part needs."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable
from typing import Any


def end_with_parent() -> None:
    """Let this process end when the one that started it does, however that was killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def work(
    function: Callable[..., dict[str, Any]], settings: dict[str, Any]
) -> tuple[dict[str, Any], float]:
    """Run one part."""
    begin = time.process_time()
    result = function(**settings)
    return result, time.process_time() - begin
