"""Figures of the paper, redrawn from our runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.core.plots import save_figure

from .runs import RAMPS, THRESHOLD

NAMES = {"conventional": "common filter, R x 0.26", "tuned": "self-tuning filter, w = 100"}
ATTACK = (20.0, 25.0)


def draw(run: dict[str, Any], folder: Path) -> list[Path]:
    """Draw figures 1 to 5."""
    from matplotlib.figure import Figure

    paths = []

    def save(figure: Figure, name: str) -> None:
        paths.append(save_figure(figure, folder / f"shadmehri2025_{name}.png", dpi=120))

    save(_track(run), "fig1")
    time = np.asarray(run["time"])
    for number, name in ((2, "conventional"), (3, "tuned")):
        figure = Figure(figsize=(7.0, 5.0), layout="constrained")
        axes = figure.subplots(2, 1, sharex=True)
        figure.suptitle(f"Fig. {number}: position errors, ramp of 2 m/s, {NAMES[name]}")
        for i, (ax, word) in enumerate(zip(axes, ("north", "east"), strict=True)):
            ax.plot(time, run[name]["gnss"][i], ".", ms=2, label="position by GNSS")
            ax.plot(time, run[name]["solution"][i], label="solution")
            ax.axvspan(*ATTACK, color="0.9")
            ax.set_ylabel(f"error {word} [m]")
        axes[0].legend()
        axes[1].set_xlabel("time [s]")
        save(figure, f"fig{number}")
    for number, name in ((4, "conventional"), (5, "tuned")):
        figure = Figure(figsize=(7.0, 3.5), layout="constrained")
        ax = figure.subplots()
        ax.set_title(f"Fig. {number}: test statistic, {NAMES[name]}")
        for ramp in RAMPS:
            ax.semilogy(time, run[name]["statistic"][f"{ramp:g}"], lw=1, label=f"{ramp:g} m/s")
        ax.axhline(THRESHOLD, color="r", label="threshold 25.9")
        ax.axvspan(*ATTACK, color="0.9")
        ax.set(xlabel="time [s]", ylabel="normalized innovation squared", ylim=(1e-3, None))
        ax.legend(loc="upper left")
        save(figure, f"fig{number}")
    return paths


def _track(run: dict[str, Any]) -> Any:
    """Figure 1, the flight seen from above and from the side."""
    from matplotlib.figure import Figure

    east, north, up = np.asarray(run["track"])
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    top, side = figure.subplots(2, 1, sharex=True)
    figure.suptitle("Fig. 1: flight (ours; the paper's is not named)")
    top.plot(east, north)
    top.set_ylabel("north [m]")
    side.plot(east, up)
    side.set(xlabel="east [m]", ylabel="up [m]")
    return figure
