"""Drawings of a report as inline SVG, animation."""

from __future__ import annotations

import copy
import io
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.plots import BLUE, COLOURS, GREY, GRID, figure_class, save_figure, style
from ...core.registry import whole_number
from ...envs.core import SpoofCore
from ...envs.rendering import CoreRecorder, Screen
from ...envs.spoofer_binding import make_command_map
from ...spoofers import make_spoofer
from ..experiments.suite import Suite
from ..runs.play import SpooferController
from ..runs.players import PlayerSpec
from .table import in_percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#010203"
"""Colour of texts and axes: that of the page's text, light or dark."""
PAPER = "#fdfcfb"
"""Colour behind labels: that of the page."""
PAGE_COLOURS = {INK: "currentColor", "#000000": "currentColor", GRID: "var(--grid)"}
PAGE_COLOURS[PAPER] = "var(--paper)"
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "spoofgym",
    "font.size": 9,
    "legend.fontsize": 8,
    "legend.frameon": False,
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor"), INK),
    **dict.fromkeys(("xtick.color", "ytick.color"), INK),
}
WIDTH_IN, CURVES_IN, LEGEND_IN = 5.2, 3.2, 0.18
"""Width of a drawing, height of one with curves, and of a row of its legend."""
MARKERS = "os^Dv*PX"
DASHES = ("-", "--", "-.", ":")
SMALLEST_M = 0.05  # displacements below it lie on the edge of the drawing
LIMITS_M = np.geomspace(1.0, 20_000.0, 173)
"""Alert limits of the curves of P(HMI)."""
HAZARD = "P(HMI) [% of the runs]"
Draw = Callable[["Axes"], None]


class Dot(NamedTuple):
    """A score with its interval (``value``, ``low``, ``high``); hollow where it is not `fair`."""

    series: str
    estimate: Mapping[str, Any]
    fair: bool = True


class DotRow(NamedTuple):
    """Scores of one thing, and the band that its limits leave, None where one is unknown."""

    label: str
    dots: Sequence[Dot]
    band: tuple[float | None, float | None] = (None, None)


class Line(NamedTuple):
    """A curve, with its band; `grey`: of a control; `end`: index from which it is dotted."""

    label: str
    x: ArrayLike
    y: ArrayLike
    band: tuple[ArrayLike, ArrayLike] | None = None
    grey: bool = False
    end: int | None = None


def make_curve(
    label: str,
    x: ArrayLike,
    estimates: Sequence[Mapping[str, Any]],
    *,
    few: bool = True,
    grey: bool = False,
) -> Line:
    """Curve of estimates, with their intervals where there are `few` curves."""
    y, low, high = (
        np.array([each[key] for each in estimates], dtype=np.float64)
        for key in ("value", "low", "high")
    )
    return Line(label, x, y, (low, high) if few else None, grey)


def make_hazard_curve(
    label: str, score: Callable[[float], Mapping[str, Any]], *, few: bool = True, grey: bool = False
) -> Line:
    """Curve of P(HMI) [%], whose `score` has an estimate at any alert limit, up to where it is
    0."""
    found: list[Mapping[str, Any]] = []
    for limit in LIMITS_M:
        found.append(in_percent(score(limit)))
        if not found[-1]["value"]:
            break
    return make_curve(label, LIMITS_M[: len(found)], found, few=few, grey=grey)


@contextmanager
def _drawing(draw: Draw, height_in: float) -> Iterator[Figure]:
    figure_type = figure_class()
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = figure_type(figsize=(WIDTH_IN, height_in), layout="constrained")
        ax = figure.subplots()
        style(ax)
        draw(ax)
        labels = ax.get_legend_handles_labels()[1]
        if labels:
            longest = max(map(len, labels))
            columns = 1 if longest > 36 else 2 if longest > 17 else 3
            figure.set_figheight(height_in + LEGEND_IN * -(-len(labels) // columns))
            figure.legend(loc="outside lower left", ncols=columns)
        yield figure


def render_svg(draw: Draw, height_in: float) -> str:
    """Drawing as an SVG element whose bytes depend on it alone, in the colours of the page."""
    buffer = io.StringIO()
    with _drawing(draw, height_in) as figure:
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(buffer, format="svg", transparent=True, metadata=nothing)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    box = re.search(r'viewBox="[^"]*"', text)
    assert box is not None
    text = f'<svg role="img" {box[0]}>' + text[text.index(">") + 1 :]
    text = re.sub(r'<g id="[^"]*">', "<g>", re.sub(r"\n\s*", "\n", text))
    for colour, own in PAGE_COLOURS.items():
        text = text.replace(colour, own)
    return text


def save_drawing(draw: Draw, height_in: float, path: Path) -> Path:
    with _drawing(draw, height_in) as figure:
        return save_figure(figure, path, dpi=130)


def dots_height(rows: Sequence[DotRow]) -> float:
    return 0.42 * len(rows) + 0.9


def draw_dots(
    rows: Sequence[DotRow], text: str, *, limit_m: float | None = None, log: bool = True
) -> Draw:
    """Rows of scores on a common axis, of displacements [m] if `log`, else [%]; one marker for each
    series."""
    names = list(dict.fromkeys(dot.series for row in rows for dot in row.dots))

    def draw(ax: Axes) -> None:
        for k, row in enumerate(rows):
            low, high = row.band
            if low is not None and high is not None:
                ax.barh(k, high - low, left=low, height=0.3, color=GREY, alpha=0.25, lw=0)
            for edge in (low, high):
                if edge is not None:
                    ax.plot([edge, edge], [k - 0.15, k + 0.15], color=GREY, lw=2)
            for dot in row.dots:
                _draw_dot(ax, k, dot, names.index(dot.series))
            place: dict[str, Any] = {"transform": ax.get_yaxis_transform(), "va": "center"}
            place["bbox"] = {"fc": PAPER, "ec": "none", "pad": 0.5}
            ax.text(0.005, k - 0.36, row.label, fontsize=8, parse_math=False, **place)
        ax.set_yticks([])
        ax.set_ylim(len(rows) - 0.5, -0.95)
        if log:
            _scale_metres(ax, "x")
            if limit_m is not None:
                _draw_limit(ax, limit_m)
            ax.set_xlim(left=max(ax.get_xlim()[0], SMALLEST_M))
        else:
            ax.set_xlim(-2.0, 102.0)
        for k, name in enumerate(names):
            ax.plot([], [], MARKERS[k % 8], color=_colour(k), label=_plain(name))
        ax.set_xlabel(text)

    return draw


def heat_height(rows: Sequence[str], columns: Sequence[str]) -> float:
    return 0.3 * len(rows) + 0.2 * len(columns) + 0.6


def draw_heat(
    rows: Sequence[str], columns: Sequence[str], values: Sequence[Sequence[float | None]]
) -> Draw:
    """Shares from 0 to 1 by row and column [%], the larger the darker."""

    def draw(ax: Axes) -> None:
        from matplotlib.patches import Rectangle

        for y, own in enumerate(values):
            for x, value in enumerate(own):
                if value is not None:
                    shade = min(max(value, 0.0), 1.0) * 0.7
                    ax.add_patch(Rectangle((x, y), 1.0, 1.0, color=BLUE, alpha=shade, lw=0))
                text = "-" if value is None else f"{100.0 * value:.0f}"
                ax.text(x + 0.5, y + 0.5, text, ha="center", va="center", fontsize=8)
        ax.grid(visible=False)
        ax.set(xlim=(0, len(columns)), ylim=(len(rows), 0))
        letters = [_letter(k) for k in range(len(columns))]
        names = [f"{letter}: {name}" for letter, name in zip(letters, columns, strict=True)]
        ax.set_xticks(np.arange(len(columns)) + 0.5, letters)
        short = [x if len(x) <= 32 else f"{x[:30]} ..." for x in rows]
        ax.set_yticks(np.arange(len(rows)) + 0.5, short, parse_math=False)
        ax.set_xlabel("\n".join(names), loc="left", parse_math=False)

    return draw


def _draw_dot(ax: Axes, row: float, dot: Dot, series: int) -> None:
    value, low, high = (dot.estimate[key] for key in ("value", "low", "high"))
    if value is None:
        return
    value, low, high = (max(x, 1e-9) for x in (value, value if low is None else low, high or value))
    colour = _colour(series)
    filled: dict[str, Any] = {"mfc": colour if dot.fair else "none", "mec": colour}
    spread = [[max(value - low, 0.0)], [max(high - value, 0.0)]]
    look: dict[str, Any] = {"fmt": MARKERS[series % 8], "ms": 6, "capsize": 2, "color": colour}
    ax.errorbar(value, row, xerr=spread, zorder=3, **look, **filled)


def _letter(k: int) -> str:
    """Name of a column, as in spreadsheets: a to z, aa, ab."""
    return (_letter(k // 26 - 1) if k > 25 else "") + chr(ord("a") + k % 26)


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]


def _plain(label: str) -> str:
    """Label of a legend that is no formula, and is not left out, as one with a dash is."""
    words = re.sub(r",(?=\S)", ", ", label).replace("$", r"\$")
    return re.sub("^_", " _", textwrap.fill(words, 60, break_long_words=False))


def _scale_metres(ax: Axes, name: str) -> None:
    """Logarithmic axis of displacements, in plain numbers; linear where all are zero."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis = getattr(ax, f"{name}axis")
    if not axis.get_data_interval()[1] > 0.0:
        return
    getattr(ax, f"set_{name}scale")("log")
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 500.0 * low else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _draw_limit(ax: Axes, limit_m: float) -> None:
    ax.axvline(limit_m, color=GREY, lw=1, ls=":")
    place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    text = f"alert limit {limit_m:g} m"
    ax.annotate(text, (limit_m, 1.0), xytext=(3, -2), color=GREY, fontsize=8, va="top", **place)


def draw_lines(
    lines: Sequence[Line], x: str, y: str, *, log: str = "", limit_m: float | None = None
) -> Draw:
    """Curves of several detectors; `log`: which axes, of ``xy``, have powers of ten."""

    def draw(ax: Axes) -> None:
        count = 0
        for line in lines:
            look: dict[str, Any] = {"color": GREY, "ls": ":", "lw": 1.2}
            if not line.grey:
                dashes = DASHES[count // len(COLOURS) % len(DASHES)]
                look, count = {"color": _colour(count), "ls": dashes, "lw": 1.6}, count + 1
            _draw_line(ax, line, look)
        for axis in log:
            _scale_metres(ax, axis)
        if limit_m is not None:
            _draw_limit(ax, limit_m)
        if "%" in y:
            ax.set_ylim(-2.0, 110.0)  # with room for the name of a limit
        ax.set(xlabel=x, ylabel=y)

    return draw


def _draw_line(ax: Axes, line: Line, look: dict[str, Any]) -> None:
    x, y = np.asarray(line.x), np.asarray(line.y)
    end = len(x) if line.end is None else line.end + 1
    marker = "o" if len(x) < 9 else None
    ax.plot(x[:end], y[:end], marker=marker, label=_plain(line.label), **look)
    if line.end is not None:
        ax.plot(x[line.end :], y[line.end :], **{**look, "lw": 1, "ls": ":"})
        ax.plot(x[line.end], y[line.end], "X", color=look["color"], ms=8)
    if line.band is not None:
        ax.fill_between(x, *line.band, color=look["color"], alpha=0.12, lw=0)


def play_frames(
    suite: Suite,
    detector: PlayerSpec,
    spoofer: PlayerSpec,
    run: int = 0,
    *,
    every: int = 1,
    largest_m: float = 0.0,
) -> Iterator[NDArray[np.uint8]]:
    """Play one of the evaluation runs, and draw it; no alarm ends it. Up to an error of `largest_m`
    the map keeps its scale. Yields (H, W, 3) uint8."""
    run, every = whole_number("`run`", run), whole_number("`every`", every, 1)
    setup = suite.setup(detector, [spoofer])
    commands = make_command_map(make_spoofer(spoofer.spec), setup)
    if not commands.along_target:  # the score of a campaign counts any direction
        setup = copy.copy(setup)
        setup.target_heading_deg = "worst"
    core = SpoofCore(1, setup, action=commands.terms, end_at_alarm=False, twin=True, threads=1)
    screen = Screen("rgb_array", CoreRecorder(core), largest_m)
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
