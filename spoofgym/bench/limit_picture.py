"""Picture of the floor of a world over the time since the onset, with its assumptions."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._pictures import BLUE, ORANGE, figure_class, save_figure, style
from .limit_tables import UNBOUNDED, Record, percent, rate_text, worlds_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"half": BLUE, "certain": ORANGE}
LABELS = {
    "half": "found in half of the runs",
    "certain": "missed in one of a thousand",
}
WIDTH = 140
"""Characters of a line of the caption."""


def draw_floors(record: Record, path: Path) -> Path:
    lines = _caption(record)
    figure = figure_class()(figsize=(8.0, 4.8 + 0.16 * len(lines)), layout="constrained")
    ax = figure.subplots()
    style(ax)
    course = record["course"]
    time = np.array(course["times_s"])
    ends = [_draw_floor(ax, time, purpose, cells) for purpose, cells in course["floors_m"].items()]
    if not any(ends):
        ax.text(0.5, 0.5, f"the floor is {UNBOUNDED}", transform=ax.transAxes, ha="center")
    ax.set_xlim(0.0, time[-1])
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("time since the onset that the attack aims at [s]")
    ax.set_ylabel("displacement [m]")
    ax.set_title(f"{record['scenario']}, {record['attack']['name']}: floor of a perfect detector")
    if any(ends):
        ax.legend(frameon=False, loc="upper left")
    figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=7.5)
    return save_figure(figure, path, dpi=150)


def _draw_floor(ax: Axes, time: NDArray[np.float64], purpose: str, cells: dict[str, Any]) -> bool:
    """Median, from 0 at the onset, and its range; whether there is any that is finite."""
    low, middle, high = (_finite(cells[name]) for name in ("low", "value", "high"))
    since, colour = np.append(0.0, time), COLOURS[purpose]
    label = f"P_D {percent(cells['p_d'])}: {LABELS[purpose]} (d = {cells['deflection']:.2f})"
    ax.plot(since, np.append(0.0, middle), "o-", color=colour, ms=4, label=label)
    if not np.array_equal(low, high, equal_nan=True):
        bounds = np.append(0.0, low), np.append(0.0, high)
        ax.fill_between(since, *bounds, color=colour, alpha=0.15, lw=0)
    return bool(np.isfinite(middle).any())


def _finite(values: list[float | str]) -> NDArray[np.float64]:
    """Values, NaN where there is no bound."""
    return np.array([np.nan if isinstance(x, str) else x for x in values])


def _caption(record: Record) -> list[str]:
    text = (
        f"{worlds_text(record).capitalize()}. {rate_text(record)}. The detector does not know "
        "the heading of the attack. "
        f"Assumptions: {'; '.join(record['assumptions']['floor'])}."
    )
    return textwrap.wrap(text, WIDTH)
