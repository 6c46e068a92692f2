"""The picture of a campaign: what each detector lets pass, in one column of panels each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .cells import Cell
from .store import PICTURE, ResultsFolder
from .summary import TABLE_LIMIT_M

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind people tell apart
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
GREY = "#777777"
COLUMNS = 4
SMALLEST_M = 0.05
"""Displacements below it lie on the edge of the picture."""


def figure_class() -> type[Figure]:
    """Matplotlib's figure.

    Returns
    -------
    type
        `matplotlib.figure.Figure`.

    Raises
    ------
    ImportError
        When matplotlib is not installed; says how to install it.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install spoofgym[report]") from error
    return Figure


def draw_campaign(folder: ResultsFolder, summary: dict[str, Any]) -> Path:
    """Draw the picture of a campaign into its folder.

    Parameters
    ----------
    folder : ResultsFolder
        With finished cells.
    summary : dict
        Of `summarize`.

    Returns
    -------
    Path
        The picture.
    """
    config = folder.config()
    detectors = [row["detector"] for row in summary["detectors"]]
    spoofers = [entry["label"] for entry in config["spoofers"] if entry["label"] != "none"]
    colour = {label: COLOURS[i % len(COLOURS)] for i, label in enumerate(spoofers)}
    columns = max(min(len(detectors), COLUMNS), 1)
    blocks = [detectors[i : i + COLUMNS] for i in range(0, len(detectors), COLUMNS)]
    figure = figure_class()(
        figsize=(max(4.6 * columns, 7.5), 9.6 * max(len(blocks), 1) + 1.0), layout="constrained"
    )
    axes = figure.subplots(3 * len(blocks), columns, sharey="row", squeeze=False)
    for b, block in enumerate(blocks):
        for c in range(columns):
            column = axes[3 * b : 3 * b + 3, c]
            if c >= len(block):
                for ax in column:
                    ax.set_visible(False)
                continue
            detector = block[c]
            cells = {s: folder.cell(detector, s) for s in spoofers if folder.has_cell(detector, s)}
            scores = {
                cell["spoofer"]: cell for cell in summary["cells"] if cell["detector"] == detector
            }
            searches = [x for x in summary["tuning"] if x["detector"] == detector]
            _trade(column[0], scores, searches, colour)
            _exceedance(column[1], cells, colour)
            _course(column[2], cells, colour)
            column[0].set_title(detector, fontweight="bold")
        for ax, text in zip(
            axes[3 * b : 3 * b + 3, 0],
            (
                "undetected displacement [m], mean",
                "P(undetected displacement > limit)",
                "distance from the clean twin [m]",
            ),
            strict=True,
        ):
            ax.set_ylabel(text)
    runs, name = summary["runs"], summary["scenario"]
    kinds = ", ".join(sorted({cell["attack"] for cell in summary["cells"]}))
    figure.suptitle(f"{name}: {kinds} attacks, {runs} runs each", fontsize=13)
    handles = [axes[0, 0].plot([], [], color=colour[s], lw=2.5, label=s)[0] for s in spoofers]
    if handles:
        figure.legend(
            handles=handles, loc="outside lower center", ncols=min(len(handles), 4), frameon=False
        )
    path = folder.path / PICTURE
    part = path.with_name(path.name + ".part")
    figure.savefig(part, format="png", dpi=130)
    part.replace(path)
    return path


def _style(ax: Axes) -> None:
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, color="#dddddd", lw=0.6)
    ax.set_axisbelow(True)


def _width(label: str, colour: dict[str, str]) -> float:
    """Width of a line, thinner for later ones, so that earlier ones show beneath them."""
    return max(3.2 - 0.7 * list(colour).index(label), 1.2)


def _log_metres(ax: Axes) -> None:
    """Vertical axis of displacements, by powers of ten in plain numbers."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    ax.set_yscale("log")
    ax.set_ylim(bottom=SMALLEST_M)
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def _trade(
    ax: Axes,
    scores: dict[str, dict[str, Any]],
    searches: list[dict[str, Any]],
    colour: dict[str, str],
) -> None:
    """Mean displacement against the alarm rate: points of the cells, lines of the searches."""
    _style(ax)
    clean = scores.get("none")
    if clean is not None:
        rate = clean["alarm_rate"]
        ax.axvspan(100 * rate["low"], 100 * rate["high"], color=GREY, alpha=0.15, lw=0)
        ax.axvline(100 * rate["value"], color=GREY, lw=1.2)
        ax.annotate(
            "no attack",
            (100 * rate["value"], 0.02),
            xycoords=("data", "axes fraction"),
            xytext=(4, 0),
            textcoords="offset points",
            color=GREY,
            fontsize=8,
            rotation=90,
            va="bottom",
        )
    for search in searches:
        most = 100 * (search["clean_alarm_rate"] + search["budget"])
        ax.axvline(most, color=GREY, lw=1, ls=":")
        trials = [trial for trial in search["trials"] if trial["runs"] == search["runs"]]
        trials += [
            trial
            for trial in search["trials"]
            if trial["runs"] < search["runs"] and all(trial["value"] != t["value"] for t in trials)
        ]
        trials.sort(key=lambda trial: trial["value"])
        x = [100 * trial["alarm_rate"] for trial in trials]
        y = [max(trial["undetected_displacement_m"], SMALLEST_M) for trial in trials]
        ax.plot(x, y, "-", color=colour[search["spoofer"]], lw=1, alpha=0.45, zorder=2)
        ax.plot(x, y, ".", color=colour[search["spoofer"]], ms=4, alpha=0.45, zorder=2)
    for label, score in scores.items():
        if label == "none":
            continue
        x, y = score["alarm_rate"], score["undetected_displacement_m"]
        middle = max(y["value"], SMALLEST_M)
        ax.errorbar(
            100 * x["value"],
            middle,
            xerr=[[100 * (x["value"] - x["low"])], [100 * (x["high"] - x["value"])]],
            yerr=[[middle - max(y["low"], SMALLEST_M)], [max(y["high"], SMALLEST_M) - middle]],
            fmt="o",
            ms=8,
            color=colour[label],
            mec="white",
            capsize=3,
            zorder=4,
            clip_on=False,
        )
    ax.set_xlim(-3, 103)
    _log_metres(ax)
    ax.set_xlabel("runs with an alarm [%]")


def _exceedance(ax: Axes, cells: dict[str, Cell], colour: dict[str, str]) -> None:
    """Probability that the undetected displacement exceeds a limit."""
    _style(ax)
    ax.axvline(TABLE_LIMIT_M, color=GREY, lw=1, ls=":")
    ax.annotate(
        f"{TABLE_LIMIT_M:g} m",
        (TABLE_LIMIT_M, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(3, -10),
        textcoords="offset points",
        color=GREY,
        fontsize=8,
    )
    limits = np.geomspace(1.0, 1000.0, 400)
    for label, cell in cells.items():
        x = cell.records["undetected_displacement_m"]
        part = (x[None, :] > limits[:, None]).mean(axis=1)
        ax.plot(limits, part, color=colour[label], lw=_width(label, colour))
    ax.set_xscale("log")
    ax.set_xlim(1.0, 1000.0)
    ax.set_xticks([1, 10, 100, 1000], ["1", "10", "100", "1000"])
    ax.set_ylim(-0.03, 1.05)
    ax.set_xlabel("alert limit [m]")


def _course(ax: Axes, cells: dict[str, Cell], colour: dict[str, str]) -> None:
    """Induced error over time, and when most runs have alarmed."""
    _style(ax)
    for label, cell in cells.items():
        time = np.array(cell.series["time_s"])
        low, middle, high = (
            np.maximum(cell.series["error_m"][key], SMALLEST_M) for key in ("p05", "p50", "p95")
        )
        ax.fill_between(time, low, high, color=colour[label], alpha=0.15, lw=0)
        alarmed = np.array(cell.series["alarmed"]) >= 0.5
        known = int(alarmed.argmax()) if alarmed.any() else len(time)
        width = _width(label, colour)
        ax.plot(time[: known + 1], middle[: known + 1], color=colour[label], lw=width)
        ax.plot(time[known:], middle[known:], color=colour[label], lw=1.2, ls=":")
        if known < len(time):
            ax.plot(time[known], middle[known], "X", color=colour[label], ms=10, mec="white")
        end = cell.head["steps"] * cell.interval_s
    if cells:
        ax.axvspan(end, time[-1], color=GREY, alpha=0.12, lw=0)
        ax.annotate(
            "hold",
            (end, 0.02),
            xycoords=("data", "axes fraction"),
            xytext=(2, 0),
            textcoords="offset points",
            color=GREY,
            fontsize=8,
            rotation=90,
            va="bottom",
        )
        ax.set_xlim(0.0, time[-1])
    _log_metres(ax)
    ax.set_xlabel("time since the onset [s] (X: half of the runs have alarmed)")
