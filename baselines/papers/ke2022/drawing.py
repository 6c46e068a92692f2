"""The paper's figures 6 to 10, drawn from the first run of each part."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spoofgym.core.plots import save_figure

from .campaign import SEEN_FROM, THRESHOLD
from .tables import RAMPS, STEPS, Data, unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def rate_panel(axes: Axes, title: str, traces: dict[str, Any], limit: float) -> None:
    """Innovation rates over time, with the paper's threshold. `traces`: (K,) size of the rate, by
    label [1/s]; `limit`: upper end of the axis [1/s]."""
    for label, trace in traces.items():
        axes.plot(SEEN_FROM + np.arange(len(trace)), trace, label=label, linewidth=1.0)
    axes.axhline(THRESHOLD, color="black", linestyle="--", linewidth=1.0, label="threshold")
    axes.set(title=title, xlabel="time [s]", ylabel="size of the innovation rate [1/s]")
    axes.set_ylim(0.0, limit)
    axes.legend(fontsize="small", ncols=2)


def three_channels(data: Data, kind: str, path: Path) -> Path:
    """Figures 6 and 7: all channels under M1 and M2, three of them attacked. `kind`: ``step``,
    ``ramp``: of the attack."""
    from matplotlib.figure import Figure

    part = data[f"three {kind}"]
    figure = Figure(figsize=(11.0, 4.5), layout="constrained")
    for axes, method in zip(figure.subplots(1, 2), ("M1", "M2"), strict=True):
        trace = part[f"{method}/trace"]
        traces = {f"C{c + 1}": trace[:, c] for c in range(trace.shape[1])}
        rate_panel(axes, f"{method}, {kind} on C1, C2 and C3", traces, 6.0 * THRESHOLD)
    return save_figure(figure, path, dpi=120)


def sizes(data: Data, path: Path) -> Path:
    """Figure 8: channel 3 under M2, for all sizes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.5), layout="constrained")
    panels = zip(figure.subplots(1, 2), (("step", STEPS), ("ramp", RAMPS)), strict=True)
    for axes, (kind, known) in panels:
        traces = {
            f"{size:g} {unit(kind)}": data[f"{kind} {size:g}"]["M2/trace"][:, 2] for size in known
        }
        rate_panel(axes, f"M2, {kind} on C3", traces, 6.0 * THRESHOLD)
    return save_figure(figure, path, dpi=120)


def oracle_and_error(data: Data, kind: str, path: Path) -> Path:
    """Figures 9 and 10: M2 beside the oracle, and the position error under it. `kind`: ``step``,
    ``ramp``: of the attack."""
    from matplotlib.figure import Figure

    name, pair = ("M3", (10.0, 5.0)) if kind == "step" else ("M4", (0.1, 0.05))
    figure = Figure(figsize=(11.0, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    traces = {}
    for size in pair:
        part, told = data[f"{kind} {size:g}"], f"{size:g} {unit(kind)}"
        traces[f"M2, {told}"] = part["M2/trace"][:, 2]
        traces[f"{name} (oracle), {told}"] = part["oracle/trace"][:, 2]
        error = part["oracle/position_trace"]
        for axis, direction in enumerate(("north", "east", "down")):
            right.plot(
                SEEN_FROM + np.arange(len(error)),
                error[:, axis],
                label=f"{direction}, {told}",
                linewidth=1.0,
            )
    rate_panel(left, f"M2 and {name}, {kind} on C3", traces, 6.0 * THRESHOLD)
    right.set(title=f"Error of the position under {name}", xlabel="time [s]", ylabel="error [m]")
    right.legend(fontsize="small", ncols=2)
    return save_figure(figure, path, dpi=120)


def draw(data: Data, folder: Path) -> list[Path]:
    """Draw figures 6 to 10."""
    return [
        three_channels(data, "step", folder / "ke2022_fig6.png"),
        three_channels(data, "ramp", folder / "ke2022_fig7.png"),
        sizes(data, folder / "ke2022_fig8.png"),
        oracle_and_error(data, "step", folder / "ke2022_fig9.png"),
        oracle_and_error(data, "ramp", folder / "ke2022_fig10.png"),
    ]
