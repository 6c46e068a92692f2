"""The picture of a campaign: what each detector lets pass, in one column of panels each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._pictures import figure_class, save_figure
from .panels import Look, draw_course, draw_exceedance, draw_means, draw_trade, looks, start_at_edge
from .store import PICTURE, ResultsFolder

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

COLUMNS = 4
"""Detectors side by side; more of them start another block."""
ROWS_IN = (3.2, 3.2, 3.2)
"""Heights of the panels below the one of the means, in inches."""
LABELS = (
    "stealthy displacement [m]",
    "P(undetected displacement > limit)",
    "distance from the clean twin [m]",
)
"""Their vertical axes."""


def draw_campaign(folder: ResultsFolder, summary: dict[str, Any]) -> Path:
    look = looks(folder.config()["spoofers"])
    detectors = [row["detector"] for row in summary["detectors"]]
    columns = max(min(len(detectors), COLUMNS), 1)
    blocks = [detectors[i : i + COLUMNS] for i in range(0, len(detectors), COLUMNS)]
    heights = (0.24 * len(look) + 0.8, *ROWS_IN)
    figure = figure_class()(
        figsize=(max(5.2 * columns, 8.0), sum(heights) * len(blocks) + 1.0), layout="constrained"
    )
    axes = figure.subplots(
        len(heights) * len(blocks),
        columns,
        sharey="row",
        squeeze=False,
        height_ratios=heights * len(blocks),
    )
    for b, block in enumerate(blocks):
        rows = axes[len(heights) * b : len(heights) * (b + 1)]
        for ax in rows[:, len(block) :].flat:
            ax.set_visible(False)
        for c, detector in enumerate(block):
            _draw_column(rows[:, c], detector, folder, summary, look)
        for row in (rows[1], rows[3]):
            start_at_edge(row[:1])
        for ax, text in zip(rows[1:, 0], LABELS, strict=True):
            ax.set_ylabel(text)
    runs, name = summary["runs"], summary["scenario"]
    kinds = ", ".join(sorted({cell["attack"] for cell in summary["cells"]}))
    figure.suptitle(f"{name}: {kinds} attacks, {runs} runs each", fontsize=13)
    if look:
        figure.legend(
            handles=[_key(axes[0, 0], label, drawn) for label, drawn in look.items()],
            loc="outside lower center",
            ncols=min(len(look), 2 * columns),
            frameon=False,
            handlelength=3.5,
        )
    return save_figure(figure, folder.path / PICTURE, dpi=130)


def _draw_column(
    column: NDArray[np.object_],
    detector: str,
    folder: ResultsFolder,
    summary: dict[str, Any],
    look: dict[str, Look],
) -> None:
    cells = {name: folder.cell(detector, name) for name in look if folder.has_cell(detector, name)}
    scores = {cell["spoofer"]: cell for cell in summary["cells"] if cell["detector"] == detector}
    searches = [search for search in summary["tuning"] if search["detector"] == detector]
    (bracket,) = (row["bracket"] for row in summary["detectors"] if row["detector"] == detector)
    draw_means(column[0], scores, look, bracket)
    draw_trade(column[1], scores, searches, summary["budget"], look)
    draw_exceedance(column[2], cells, look, summary["alert_limit_m"])
    draw_course(column[3], cells, look)
    column[0].set_title(detector, fontweight="bold", pad=16)


def _key(ax: Axes, label: str, look: Look) -> Line2D:
    (line,) = ax.plot(
        [], [], look.dashes, marker=look.marker, color=look.colour, lw=2.0, mec="white", label=label
    )
    line.set_markersize(11.0 if look.marker == "*" else 8.0)
    return line
