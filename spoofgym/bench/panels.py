"""Panels of the picture of a campaign."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._pictures import COLOURS, GREY, style
from .bracketed import STEALTHY
from .cells import Cell
from .tables import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PROFILE, SCRIPTED = "profile", ("none", "step", "accelerating-ramp", "ramp")
"""Kinds of spoofers with a marker of their own."""
SMALLEST_M = 0.05
"""Displacements below it lie on the edge of the picture."""


@dataclass(frozen=True)
class Look:
    """How one spoofer is drawn: what it is by marker and dashes, which one by colour. `width`: of
    lines; thinner for later ones, so that earlier ones show beneath them."""

    colour: str
    marker: str
    dashes: str
    width: float


def looks(spoofers: list[dict[str, Any]]) -> dict[str, Look]:
    """How the spoofers of a campaign are drawn."""
    played = [entry for entry in spoofers if entry["label"] != "none"]
    found = {}
    for i, entry in enumerate(played):
        kind = entry["spec"]["name"]
        marker, dashes = ("o", "-") if kind in SCRIPTED else ("*", "--")
        if kind == PROFILE:
            marker, dashes = "s", "-."
        width = max(3.2 - 0.7 * i, 1.5)
        found[entry["label"]] = Look(COLOURS[i % len(COLOURS)], marker, dashes, width)
    return found


def _log_metres(ax: Axes) -> None:
    """Vertical axis of displacements, by powers of ten in plain numbers."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def start_at_edge(row: Iterable[Axes]) -> None:
    """Let the shared axis of displacements begin at the edge, once all of its panels are drawn. An
    axis whose end is set no longer follows what is drawn later."""
    for ax in row:
        ax.set_ylim(bottom=SMALLEST_M)


def _note(ax: Axes, text: str, x: float, apart: tuple[int, int], *, top: bool = False) -> None:
    """Write at a vertical line, upwards from its foot, or at its top."""
    ax.annotate(
        text,
        (x, 1.0 if top else 0.02),
        xycoords=("data", "axes fraction"),
        xytext=apart,
        textcoords="offset points",
        color=GREY,
        fontsize=8,
        rotation=0 if top else 90,
        va="baseline" if top else "bottom",
    )


def draw_means(
    ax: Axes, scores: dict[str, dict[str, Any]], look: dict[str, Look], bracket: dict[str, Any]
) -> None:
    """Mean displacement of every spoofer, below each other on one linear scale; the bracket."""
    style(ax)
    names = list(look)
    for row, name in enumerate(names):
        if name not in scores or scores[name]["stealthy_displacement_m"]["value"] is None:
            continue
        mean = scores[name]["stealthy_displacement_m"]
        spread = [[mean["value"] - mean["low"]], [mean["high"] - mean["value"]]]
        ax.errorbar(mean["value"], row, xerr=spread, capsize=2, **_point(look[name], scores[name]))
        ax.annotate(
            number(mean["value"]),
            (mean["high"], row),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    highs = (score["stealthy_displacement_m"]["high"] for score in scores.values())
    top = max((high for high in highs if high is not None), default=0)
    _draw_bracket(ax, bracket, 1.18 * max(top, SMALLEST_M))
    ax.set_xlabel("stealthy displacement [m] (hollow: over budget)")


def _draw_bracket(ax: Axes, bracket: dict[str, Any], end: float) -> None:
    """Floor and zero-alarm bound as lines, within twice the axis `end` of what was achieved."""
    floor, bound = bracket["floor_m"][STEALTHY], bracket["zero_alarm"]["value"]
    found = {"floor": floor, "zero-alarm bound": bound}
    numbers = {name: x for name, x in found.items() if isinstance(x, float | int)}
    shown = {name: x for name, x in numbers.items() if x <= 2.0 * end}
    end = max([end, *(1.1 * x for x in shown.values())])
    ax.set_xlim(0.0, end)
    for name, x in shown.items():
        ax.axvline(x, color=GREY, lw=1.6, ls="--" if name == "floor" else "-", zorder=1)
    signs = {"floor": "- -", "zero-alarm bound": "\u2014"}
    texts = [
        f"{signs[name]} {name} {number(x)} m" + ("" if name in shown else ", farther right")
        for name, x in numbers.items()
    ]
    if texts:
        ax.annotate(
            "   ".join(texts),
            (0.0, 1.0),
            xycoords="axes fraction",
            xytext=(0, 3),
            textcoords="offset points",
            color=GREY,
            fontsize=8,
        )


def _point(look: Look, score: dict[str, Any]) -> dict[str, Any]:
    """How a cell is marked: filled unless it is over the alarm budget."""
    fair = score["within_budget"] is not False
    return {
        "fmt": look.marker,
        "ms": 11 if look.marker == "*" else 7,
        "color": look.colour,
        "mec": "white" if fair else look.colour,
        "mfc": look.colour if fair else "white",
        "zorder": 4,
        "clip_on": False,
    }


def draw_trade(
    ax: Axes,
    scores: dict[str, dict[str, Any]],
    searches: list[dict[str, Any]],
    budget: float,
    look: dict[str, Look],
) -> None:
    """Mean displacement against the alarm rate: points of the cells, lines of the searches."""
    style(ax)
    ax.axvline(100 * budget, color=GREY, lw=1, ls=":")
    _note(ax, "budget", 100 * budget, (4, 0))
    for search in searches:
        trials = [trial for trial in search["trials"] if trial["runs"] == search["runs"]]
        trials += [
            trial
            for trial in search["trials"]
            if trial["runs"] < search["runs"] and all(trial["value"] != t["value"] for t in trials)
        ]
        trials.sort(key=lambda trial: trial["value"])
        x = [100 * trial["alarm_rate"] for trial in trials]
        y = [max(trial["stealthy_displacement_m"], SMALLEST_M) for trial in trials]
        ax.plot(x, y, ".-", color=look[search["spoofer"]].colour, lw=1, ms=4, alpha=0.45, zorder=2)
    for label, score in scores.items():
        x, y = score["alarm_rate"], score["stealthy_displacement_m"]
        if label == "none" or y["value"] is None:
            continue
        middle = max(y["value"], SMALLEST_M)
        ax.errorbar(
            100 * x["value"],
            middle,
            xerr=[[100 * (x["value"] - x["low"])], [100 * (x["high"] - x["value"])]],
            yerr=[[middle - max(y["low"], SMALLEST_M)], [max(y["high"], SMALLEST_M) - middle]],
            capsize=2,
            **_point(look[label], score),
        )
    ax.set_xlim(-3, 103)
    _log_metres(ax)
    ax.set_xlabel("P(alarm | silent twin) [%] (hollow: over budget)")


def draw_exceedance(
    ax: Axes, cells: dict[str, Cell], look: dict[str, Look], limit_m: float
) -> None:
    """Probability that the undetected displacement exceeds a limit."""
    style(ax)
    ax.axvline(limit_m, color=GREY, lw=1, ls=":")
    _note(ax, f"{limit_m:g} m", limit_m, (3, -10), top=True)
    far = [float(cell.displacement_m.max()) for cell in cells.values()]
    decades = max(math.ceil(math.log10(max(*far, 1000.0))), 3) if far else 3
    limits = np.geomspace(1.0, 10.0**decades, 400)
    for label, cell in cells.items():
        x = cell.displacement_m[cell.counts]
        part = (x[None, :] > limits[:, None]).sum(axis=1) / max(len(x), 1)
        drawn = look[label]
        ax.plot(limits, part, drawn.dashes, color=drawn.colour, lw=drawn.width)
    ax.set_xscale("log")
    ax.set_xlim(1.0, 10.0**decades)
    marks = [10**k for k in range(decades + 1)]
    ax.set_xticks(marks, [str(mark) for mark in marks])
    ax.set_ylim(-0.03, 1.05)
    ax.set_xlabel("alert limit [m]")


def draw_course(ax: Axes, cells: dict[str, Cell], look: dict[str, Look]) -> None:
    """Induced error over time, and when most runs have alarmed."""
    style(ax)
    alpha = 0.15 if len(cells) <= 4 else 0.07
    for label, cell in cells.items():
        colour, dashes, width = look[label].colour, look[label].dashes, look[label].width
        time = np.array(cell.series["time_s"])
        low, middle, high = (
            np.maximum(cell.series["error_m"][key], SMALLEST_M) for key in ("p05", "p50", "p95")
        )
        ax.fill_between(time, low, high, color=colour, alpha=alpha, lw=0)
        alarmed = np.array(cell.series["alarmed"]) >= 0.5
        known = int(alarmed.argmax()) if alarmed.any() else len(time)
        ax.plot(time[: known + 1], middle[: known + 1], dashes, color=colour, lw=width)
        ax.plot(time[known:], middle[known:], color=colour, lw=1.2, ls=":")
        if known < len(time):
            ax.plot(time[known], middle[known], "X", color=colour, ms=10, mec="white")
        end = cell.head["steps"] * cell.interval_s
    if cells:
        ax.axvspan(end, time[-1], color=GREY, alpha=0.12, lw=0)
        _note(ax, "hold", end, (2, 0))
        ax.set_xlim(0.0, time[-1])
    _log_metres(ax)
    ax.set_xlabel("time since the onset [s] (X: half of the runs have alarmed)")
