"""Campaign figure, animation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...core.plots import COLOURS, GREY, figure_class, save_figure, style
from ...core.registry import whole_number
from ...envs.core import SpoofCore
from ...envs.rendering import CoreRecorder, Screen
from ...envs.spoofer_binding import commands_of
from ...spoofers import make_spoofer
from ..experiments.campaign import PICTURE, CampaignResults
from ..experiments.suite import Suite
from ..runs.play import Attacker
from ..runs.players import PlayerSpec
from ..runs.record import RunRecord
from ..scores.campaign import STEALTHY
from .table import number

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
    ax: Axes, cells: dict[str, RunRecord], look: dict[str, Look], limit_m: float
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


def draw_course(ax: Axes, cells: dict[str, RunRecord], look: dict[str, Look]) -> None:
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


def draw_campaign(results: CampaignResults, summary: dict[str, Any]) -> Path:
    look = looks(results.config["spoofers"])
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
            _draw_column(rows[:, c], detector, results, summary, look)
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
    return save_figure(figure, results.path / PICTURE, dpi=130)


def _draw_column(
    column: NDArray[np.object_],
    detector: str,
    results: CampaignResults,
    summary: dict[str, Any],
    look: dict[str, Look],
) -> None:
    cells = {name: found for name in look if (found := results.runs(detector, name)) is not None}
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


def play_frames(
    suite: Suite, detector: PlayerSpec, spoofer: PlayerSpec, run: int = 0, *, every: int = 1
) -> Iterator[NDArray[np.uint8]]:
    """Play one of the evaluation runs, and draw it; an alarm does not end it. Yields (H, W, 3)
    uint8."""
    run, every = whole_number("`run`", run), whole_number("`every`", every, 1)
    setup = suite.setup(detector, [spoofer])
    action = commands_of(make_spoofer(spoofer.spec), setup).terms
    core = SpoofCore(1, setup, action=action, end_at_alarm=False, threads=1)
    screen = Screen("rgb_array", CoreRecorder(core))
    core.reset(suite.generators("evaluation", run + 1, run))
    attacker = Attacker([spoofer.spec], core.engine)
    # where the world has decisions, the environment makes epochs of them
    action_of = attacker.action if setup.repeat == 1 else attacker.decide
    screen.begin({name: array[0] for name, array in core.reset_info().items()})
    yield screen.frame()
    for step in range(1, core.episode_steps + 1):
        result, _ = core.step(action_of((step - 1) * setup.repeat))
        screen.add({name: array[0] for name, array in result.info.items()})
        if step % every == 0 or step == core.episode_steps:
            yield screen.frame()
    core.close()


def frame_count(suite: Suite, detector: PlayerSpec, every: int = 1) -> int:
    """How many frames `play_frames` yields."""
    setup = suite.setup(detector)
    return 1 + -(-(setup.steps // setup.repeat) // every)
