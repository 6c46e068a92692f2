"""Compile, or load, what the first episode of every environment needs."""

from __future__ import annotations

import time
import warnings
from typing import Any

from typer import Argument

from . import options as opt
from .app import print_json, print_lines, progress

PREFIX, DETECTORS = "spoofgym/", "all detectors"
FORMS: dict[str, int | None] = {"single": None, "batch": 8}
"""Receivers by form; None is the single environment."""


def warmup(
    ids: list[str] | None = Argument(
        None, help="Environments, such as Snapshot-v0. Default: all that are registered."
    ),
    as_json: opt.Json = False,
) -> None:
    """Compile for this machine what first episodes need, so that none of them waits for it.

    Every environment plays an episode, single and vector; one of them is then played with all
    detectors. It takes three to eight minutes of processor time. The compiled code is stored for
    all later processes, until spoofgym or numba changes. After a warmup `bench` and `limits` still
    compile for some 3 s, `demo` for less than 1 s.
    """
    import gymnasium as gym

    from ..bench.report.table import Table
    from ..core import compile as compiling
    from ..core.registry import check_choice

    if compiling.is_disabled():
        raise ValueError("nothing can be compiled where NUMBA_DISABLE_JIT is set; unset it")
    known = sorted(name for name in gym.registry if name.startswith(PREFIX))
    wanted = [name if name.startswith(PREFIX) else PREFIX + name for name in ids or known]
    for name in wanted:
        check_choice("environment", name, known)
    wanted += [] if ids else [DETECTORS]
    table = Table(
        ("environment", "id"),
        ("", "form"),
        ("seconds", "seconds"),
        ("functions compiled", "compiled", lambda count: str(count or "cached")),
    )
    rows = []
    with progress(len(wanted) * len(FORMS)) as shown:
        for name in wanted:
            for form, receivers in FORMS.items():
                shown.advance(0.0, "")
                start = time.perf_counter()
                with compiling.compiled_functions() as functions:
                    _play(name, receivers)
                seconds = round(time.perf_counter() - start, 3)
                rows.append(
                    {"id": name, "form": form, "seconds": seconds, "compiled": len(functions)}
                )
                shown.advance(1.0, f"{name} {form}")
    cache = str(compiling.cache_parent())
    if as_json:
        print_json({"cache": cache, "environments": table.json(rows)})
        return
    table.print("first episodes", rows)
    print_lines([f"compiled code is in {cache}"])


def _play(name: str, receivers: int | None) -> None:
    """Play until the first end, and go on after it; random actions soon raise an alarm."""
    import gymnasium as gym
    import numpy as np

    from ..calibration.thresholds import suitable_detectors
    from ..detectors.base import YoungMemoryWarning

    options: dict[str, Any] = {}
    if name == DETECTORS:
        name = f"{PREFIX}Zhong2025-v0"
        inner: Any = gym.make(name).unwrapped
        watch = suitable_detectors(inner.core.setup)
        options = {"detector": "never", "watch": watch, "attack": "meaconer"}  # as no id has it
    how = {} if receivers is None else {"num_envs": receivers}
    make: Any = gym.make if receivers is None else gym.make_vec
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*is out of date", DeprecationWarning)
        warnings.simplefilter("ignore", YoungMemoryWarning)  # what is found is not looked at
        env: Any = make(name, **how, **options)
        env.action_space.seed(0)
        env.reset(seed=0)
        ended = False
        while not ended:
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            ended = bool(np.any(terminated | truncated))
        if receivers is None:
            env.reset()
        env.step(env.action_space.sample())
        env.close()
