"""Figures 1 and 2: numbers of hybrids by constellation, and by direction of the displacement."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.core.plots import save_figure

from .draws import displacements, subsets
from .geometry import SATELLITES, sky
from .separation import separate

SKY = 0
PAIR = 2
CONSTELLATION = 616
"""One of the 924 with six spoofed satellites, in which all numbers of hybrids are frequent."""
CAP = 5
"""Numbers of hybrids from here on are drawn as one."""


def run_pictures(draws: int, seed: int) -> dict[str, Any]:
    """Cases of figures 1 and 2.  `draws`: displacements of a constellation in figure 1; figure 2
    has five times as many.  Returns (66, draws) numbers of hybrids with two spoofed satellites, and
    (5 draws, 4) displacements [m] with their numbers in one constellation of six."""
    lines, rng = sky(SKY), np.random.default_rng([seed, SKY, 1])
    pairs = np.repeat(subsets(SATELLITES, PAIR, 1), draws, axis=0)
    by_pair, _, _ = separate(lines, pairs, displacements(rng, lines, pairs))
    one = np.tile(subsets(SATELLITES, SATELLITES // 2, 1)[CONSTELLATION], (5 * draws, 1))
    moved = displacements(rng, lines, one)
    by_direction, _, _ = separate(lines, one, moved)
    return {"pairs": by_pair.reshape(-1, draws), "displacement": moved, "hybrids": by_direction}


def draw_figures(data: dict[str, dict[str, Any]], folder: Path) -> list[Path]:
    """Redraw figures 1 and 2."""
    from matplotlib.figure import Figure

    picture = {name: np.asarray(value) for name, value in data["pictures"].items()}
    colours = ("#2b6cb0", "#68a357", "#e0a030", "#d0603a", "#8b2f4a")
    labels = ("0", "2", "3", "4", "5 or more")

    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    axes = figure.subplots()
    pairs, below = picture["pairs"], np.zeros(len(picture["pairs"]))
    for j, (colour, label) in enumerate(zip(colours, labels, strict=True)):
        part = 100.0 * np.mean(np.clip(pairs - 1, 0, CAP - 1) == j, axis=1)
        place = np.arange(1, len(pairs) + 1)
        axes.bar(place, part, bottom=below, width=1.0, color=colour, label=label)
        below += part
    axes.set(
        title="Figure 1: numbers of hybrids with two spoofed satellites",
        xlabel="constellation of spoofed satellites",
        ylabel="part of the displacements [%]",
        xlim=(0.5, len(pairs) + 0.5),
        ylim=(70.0, 100.0),
    )
    axes.legend(title="NH0", loc="lower right")
    first = save_figure(figure, folder / "wu2024_figure_1.png")

    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    space = figure.add_subplot(projection="3d")
    moved, bins = picture["displacement"] / 1e3, np.clip(picture["hybrids"] - 1, 0, CAP - 1)
    for j, (colour, label) in enumerate(zip(colours, labels, strict=True)):
        chosen = moved[bins == j]
        space.scatter(
            chosen[:, 0],
            chosen[:, 1],
            chosen[:, 2],
            s=4 if j == 0 else 14,
            color=colour,
            label=label,
        )
    space.set(
        title="Figure 2: numbers of hybrids by displacement, six spoofed",
        xlabel="x, ECEF [km]",
        ylabel="y, ECEF [km]",
        zlabel="z, ECEF [km]",
    )
    space.legend(title="NH0")
    return [first, save_figure(figure, folder / "wu2024_figure_2.png")]
