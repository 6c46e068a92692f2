"""Ke et al. (2022): innovation rates, robust weights, and two methods that are told the attack."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..frame import Part, Row, Settings, fill_origins
from .campaign import attack, misses_by_satellite
from .drawing import draw
from .tables import CHANNELS, IN_VIEW, ORACLES, RAMPS, STEPS, Data, all_rows
from .text import CLAIMS, FINDINGS, READINGS, TITLE

__all__ = ["CLAIMS", "FINDINGS", "READINGS", "TITLE", "figures", "parts", "rows"]

RUNS, QUICK_RUNS = 50, 16


def count_runs(settings: Settings) -> int:
    """Runs of every part."""
    return QUICK_RUNS if settings.quick else RUNS


def parts(settings: Settings) -> list[Part]:
    """Work of a run."""
    third, low = CHANNELS[2], CHANNELS[4]
    found = []

    def add(
        name: str,
        kind: str,
        size: float,
        methods: list[str],
        satellites: tuple[str, ...] = (third,),
        **more: Any,
    ) -> None:
        """One more part."""
        told = {
            "kind": kind,
            "size": size,
            "satellites": list(satellites),
            "methods": methods,
            "runs": count_runs(settings),
            "seed": settings.seed,
        }
        weight = sum(2.0 if method == "watchers" else 1.0 for method in methods)
        found.append(Part(name, attack, {**told, **more}, weight))

    everything = ["M2", "M2 adaptive", "watchers"]
    for kind, known in (("step", STEPS), ("ramp", RAMPS)):
        for size in known:
            oracle = ["oracle"] if (kind, size) in ORACLES else []
            add(f"{kind} {size:g}", kind, size, [*everything, *oracle])
    for kind, size in ORACLES:
        for suffix, scenario in (("", "ke2022"), (" white", "ke2022-white")):
            name = f"clean, told {kind} {size:g}{suffix}"
            add(name, kind, 0.0, ["oracle"], told_size=size, scenario=scenario)
        add(f"{kind} {size:g} white", kind, size, ["M2", "oracle"], scenario="ke2022-white")
    for kind, size in (("step", 5.0), ("ramp", 0.05)):
        add(f"{kind} {size:g} S11", kind, size, ["M2", "oracle"], (low,))
    add("step 10, told C4", "step", 10.0, ["oracle"], told_satellites=[CHANNELS[3]])
    for kind, size in (("step", 30.0), ("ramp", 0.3)):
        three = ["M2", "watchers"]
        add(f"three {kind}", kind, size, three, CHANNELS[:3])
        add(f"three {kind} white", kind, size, three, CHANNELS[:3], scenario="ke2022-white")
    add("clean", "step", 0.0, everything)
    add("clean white", "step", 0.0, everything, scenario="ke2022-white")
    for update in ("plain", "general"):
        for kind, size in (("step", 10.0), ("ramp", 0.1)):
            add(f"{kind} {size:g} {update}", kind, size, ["M2"], update=update)
    return found + satellite_parts(settings)


def satellite_parts(settings: Settings) -> list[Part]:
    """The smallest step and ramp on every satellite in view, since the paper names none."""
    found = []
    for kind, size in (("step", 5.0), ("ramp", 0.05)):
        for suffix, scenario in (("", "ke2022"), (" white", "ke2022-white")):
            told = {"kind": kind, "size": size, "satellites": list(IN_VIEW), "scenario": scenario}
            told |= {"runs": count_runs(settings), "seed": settings.seed}
            name = f"{kind} {size:g}, each satellite{suffix}"
            found.append(Part(name, misses_by_satellite, told, 3.0))
    return found


def rows(data: Data, settings: Settings) -> list[Row]:
    """Figures of the paper beside ours."""
    runs = count_runs(settings)
    return fill_origins(all_rows(data, runs), runs=runs, seed=settings.seed)


def figures(data: Data, folder: Path) -> list[Path]:
    """Draw figures 6 to 10 from our runs."""
    return draw(data, folder)
