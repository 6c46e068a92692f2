"""Reproduction of shadmehri2025: the self-tuning Kalman filter monitor.

Run by ``python -m baselines.papers shadmehri2025``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..frame import Part, Row, Settings, fill_origins
from .cases import CASES, DECAYS, FALSE_ALARMS, SINCE_START, SMALL_R, SPREADS, WHITE_WINDOWS
from .figures import draw
from .runs import (
    MARKOV,
    WHITE,
    alarms_since_start,
    false_alarms,
    latencies,
    make_self_tuning,
    sample,
    stability,
)
from .tables import (
    absorption_rows,
    decay_rows,
    false_alarm_rows,
    latency_rows,
    stability_rows,
    test_rows,
)
from .words import CLAIMS, FINDINGS, READINGS

TITLE = "Shadmehri & Mahboobi Esfanjani (2025)"

__all__ = ["CLAIMS", "FINDINGS", "READINGS", "TITLE", "figures", "parts", "rows"]


def count_runs(settings: Settings) -> tuple[int, int]:
    """Runs of an attack, and clean ones."""
    return (40, 60) if settings.quick else (200, 300)


def parts(settings: Settings) -> list[Part]:
    """Work of a run. Returns cases of latency, then clean runs, then stability, then one run for
    the figures."""
    runs, clean = count_runs(settings)
    common: dict[str, Any] = {"runs": runs, "seed": settings.seed}
    made = []
    for name, case in CASES.items():
        given = {"errors": case.errors, "receiver": case.receiver}
        given["tests"] = {"paper": {}, **case.tests}
        made.append(Part(name, latencies, given | common, 3.0 * runs))
    for decay in DECAYS:
        given = {"errors": MARKOV | {"decay": decay}, "receiver": make_self_tuning(100)}
        given |= {"tests": {"paper": {}}, "ramps": [2.0]}
        made.append(Part(f"decay {decay:g}", latencies, given | common, 1.0 * runs))
    common = common | {"runs": clean}
    for name, errors in (("white", WHITE), ("correlated", MARKOV)):
        given = {"errors": errors, "receiver": {}, "window": 0}
        made.append(Part(f"clean, conventional, {name}", false_alarms, given | common, 2.0 * clean))
    for window in WHITE_WINDOWS:
        given = {"errors": WHITE, "receiver": make_self_tuning(window), "window": window}
        made.append(Part(f"clean, w = {window}, white", false_alarms, given | common, 2.0 * clean))
    for name in SMALL_R:
        given = {"errors": MARKOV, "receiver": CASES[name].receiver, "window": 0}
        made.append(Part(f"clean, {name}", false_alarms, given | common, 2.0 * clean))
    for window in FALSE_ALARMS:
        given = {"errors": MARKOV, "receiver": make_self_tuning(window), "window": window}
        made.append(Part(f"clean, w = {window}", false_alarms, given | common, 2.0 * clean))
    for rule, window, name in SPREADS:
        given = {"errors": WHITE if name == "white" else MARKOV, "window": window, "process": rule}
        given |= {"runs": runs, "seed": settings.seed}
        made.append(Part(f"Q {rule}, w = {window}, {name}", stability, given, 1.0 * runs))
    for name, errors in SINCE_START.items():
        given = {"errors": errors, "receiver": CASES["R of 0.17 m"].receiver, **common}
        made.append(Part(name, alarms_since_start, given, 2.0 * clean))
    made.append(Part("sample", sample, {"seed": settings.seed}, 10.0))
    return made


def rows(data: dict[str, dict[str, Any]], settings: Settings) -> list[Row]:
    """Figures of the paper beside ours. Returns table 1 in all readings, then what the paper does
    not measure."""
    made = [*latency_rows(data), *test_rows(data), *decay_rows(data), *false_alarm_rows(data)]
    made += [*stability_rows(data), *absorption_rows(data)]
    runs, clean = count_runs(settings)
    return fill_origins(made, runs=runs, clean=clean, seed=settings.seed)


def figures(data: dict[str, dict[str, Any]], folder: Path) -> list[Path]:
    """Redraw the paper's figures from our runs."""
    return draw(data["sample"], folder)
