"""Campaign figure, animation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.plots import COLOURS, GREY, figure_class, save_figure, style
from ...core.registry import whole_number
from ...envs.core import SpoofCore
from ...envs.rendering import CoreRecorder, Screen
from ...envs.spoofer_binding import make_command_map
from ...spoofers import make_spoofer
from ..experiments.campaign import PICTURE, CampaignResults
from ..experiments.suite import Suite
from ..runs.play import SpooferController
from ..runs.players import PlayerSpec
from ..runs.record import RunRecord
from ..scores.campaign import STEALTHY
from .table import format_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

MARKERS = {
    **dict.fromkeys(("none", "step", "accelerating-ramp", "ramp"), ("o", "-")),
    "profile": ("s", "-."),
}
"""Marker and dashes of spoofers by name; those of all others are a star and dashes."""
SMALLEST_M = 0.05  # displacements below it lie on the edge of the picture


class Look(NamedTuple):
    """How one spoofer is drawn: what it is by marker and dashes, which one by colour. `width`: of
    lines; thinner for later ones, so that earlier ones show beneath them."""

    colour: str
    marker: str
    dashes: str
    width: float


def looks(spoofers: list[dict[str, Any]]) -> dict[str, Look]:
    """How the spoofers of a campaign are drawn."""
    played = [entry for entry in spoofers if entry["label"] != "none"]
    return {
        entry["label"]: Look(
            COLOURS[i % len(COLOURS)],
            *MARKERS.get(entry["spec"]["name"], ("*", "--")),
            max(3.2 - 0.7 * i, 1.5),
        )
        for i, entry in enumerate(played)
    }


def _log_metres(ax: Axes) -> None:
    """Vertical axis of displacements, by powers of ten in plain numbers."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def _note(ax: Axes, text: str, xy: tuple[float, float], apart: tuple[int, int], **how: Any) -> None:
    """Write a small text at a point, by default at a place of the data and a height of the axes."""
    own: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "color": GREY, **how}
    ax.annotate(text, xy, xytext=apart, textcoords="offset points", fontsize=8, **own)


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
        x, spread = _errors(mean)
        ax.errorbar(x, row, xerr=spread, capsize=2, **_point(look[name], scores[name]))
        place = (mean["high"], row)
        _note(ax, format_number(x), place, (5, 0), xycoords="data", va="center", color="black")
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    highs = (score["stealthy_displacement_m"]["high"] for score in scores.values())
    top = max((high for high in highs if high is not None), default=0)
    _draw_bounds(ax, bracket, 1.18 * max(top, SMALLEST_M))
    ax.set_xlabel("stealthy displacement [m] (hollow: over budget)")


def _draw_bounds(ax: Axes, bracket: dict[str, Any], end: float) -> None:
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
        f"{signs[name]} {name} {format_number(x)} m" + ("" if name in shown else ", farther right")
        for name, x in numbers.items()
    ]
    if texts:
        _note(ax, "   ".join(texts), (0.0, 1.0), (0, 3), xycoords="axes fraction")


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


def _errors(
    estimate: dict[str, Any], scale: float = 1.0, least: float = -math.inf
) -> tuple[float, list[list[float]]]:
    """Value, and how far it is to the ends of its interval, both at least so large."""
    low, value, high = (max(scale * estimate[key], least) for key in ("low", "value", "high"))
    return value, [[value - low], [high - value]]


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
    _note(ax, "budget", (100 * budget, 0.02), (4, 0), rotation=90, va="bottom")
    for search in searches:
        by_runs = sorted(search["trials"], key=itemgetter("runs"))
        last = {trial["value"]: trial for trial in by_runs}  # that on the most runs
        trials = sorted(last.values(), key=itemgetter("value"))
        rates = [100 * trial["alarm_rate"] for trial in trials]
        moved = [max(trial["stealthy_displacement_m"], SMALLEST_M) for trial in trials]
        ax.plot(
            rates,
            moved,
            ".-",
            color=look[search["spoofer"]].colour,
            lw=1,
            ms=4,
            alpha=0.45,
            zorder=2,
        )
    for label, score in scores.items():
        if label == "none" or score["stealthy_displacement_m"]["value"] is None:
            continue
        x, width = _errors(score["alarm_rate"], 100.0)
        y, height = _errors(score["stealthy_displacement_m"], least=SMALLEST_M)
        ax.errorbar(x, y, xerr=width, yerr=height, capsize=2, **_point(look[label], score))
    ax.set_xlim(-3, 103)
    _log_metres(ax)
    ax.set_xlabel("P(alarm | silent twin) [%] (hollow: over budget)")


def draw_exceedance(
    ax: Axes, cells: dict[str, RunRecord], look: dict[str, Look], limit_m: float
) -> None:
    """Probability that the undetected displacement exceeds a limit."""
    style(ax)
    ax.axvline(limit_m, color=GREY, lw=1, ls=":")
    _note(ax, f"{limit_m:g} m", (limit_m, 1.0), (3, -10))
    far = [float(cell.displacement_m.max()) for cell in cells.values()]
    decades = max(math.ceil(math.log10(max(*far, 1000.0))), 3) if far else 3
    limits = np.geomspace(1.0, 10.0**decades, 400)
    for label, cell in cells.items():
        x = cell.displacement_m[cell.counts]
        part = (x[None, :] > limits[:, None]).sum(axis=1) / max(len(x), 1)
        colour, _, dashes, width = look[label]
        ax.plot(limits, part, dashes, color=colour, lw=width)
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
        colour, _, dashes, width = look[label]
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
        _note(ax, "hold", (end, 0.02), (2, 0), rotation=90, va="bottom")
        ax.set_xlim(0.0, time[-1])
    _log_metres(ax)
    ax.set_xlabel("time since the onset [s] (X: half of the runs have alarmed)")


COLUMNS = 4  # detectors side by side; more of them start another block
ROWS_IN = (3.2, 3.2, 3.2)  # heights of the panels below the one of the means, in inches
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
            row[0].set_ylim(bottom=SMALLEST_M)  # of all, now that none is drawn any more
        for ax, text in zip(rows[1:, 0], LABELS, strict=True):
            ax.set_ylabel(text)
    kinds = ", ".join(sorted({cell["attack"] for cell in summary["cells"]}))
    title = f"{summary['scenario']}: {kinds} attacks, {summary['runs']} runs each"
    figure.suptitle(title, fontsize=13)
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
    kind, size = look.dashes + look.marker, 11.0 if look.marker == "*" else 8.0
    return ax.plot([], [], kind, color=look.colour, lw=2.0, ms=size, mec="white", label=label)[0]


def play_frames(
    suite: Suite, detector: PlayerSpec, spoofer: PlayerSpec, run: int = 0, *, every: int = 1
) -> Iterator[NDArray[np.uint8]]:
    """Play one of the evaluation runs, and draw it; an alarm does not end it. Yields (H, W, 3)
    uint8."""
    run, every = whole_number("`run`", run), whole_number("`every`", every, 1)
    setup = suite.setup(detector, [spoofer])
    action = make_command_map(make_spoofer(spoofer.spec), setup).terms
    core = SpoofCore(1, setup, action=action, end_at_alarm=False, threads=1)
    screen = Screen("rgb_array", CoreRecorder(core))
    core.reset(suite.generators("evaluation", run + 1, run))
    attacker = SpooferController([spoofer.spec], core.engine)
    # where the world has decisions, the environment makes epochs of them
    action_of = attacker.action if setup.repeat == 1 else attacker.decide
    screen.start_episode({name: array[0] for name, array in core.reset_info().items()})
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
