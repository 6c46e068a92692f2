"""The paper's figures, redrawn from our runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.core.plots import save_figure

from .rows import joined_sweep

Data = dict[str, dict[str, Any]]
ALGORITHMS = ("EKF", "RIO", "ACNA", "ACNA, production")
SET_NAMES = {"jump": "jump", "slow": "slow change", "both": "jump and slow change"}
RULES = {"jump": ("j", "1.5 m", 2), "slow": ("s", "1.28 m", 5)}


def draw(data: Data, folder: Path) -> list[Path]:
    """Draw all figures."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    for kind, numbers in (("jump", ("09", "10")), ("slow", ("11", "12"))):
        sweep = joined_sweep(data, kind)
        drawn.append((f"song2021-fig{numbers[0]}.png", _surfaces(plt, sweep, kind)))
        drawn.append((f"song2021-fig{numbers[1]}.png", _curves(plt, sweep, kind)))
    for data_set, number in (("jump", 13), ("slow", 15), ("both", 17)):
        drawn.append((f"song2021-fig{number}.png", _errors(plt, data["traces"], data_set)))
        drawn.append((f"song2021-fig{number + 1}.png", _tracks(plt, data["traces"], data_set)))
    paths = []
    for name, figure in drawn:
        paths.append(save_figure(figure, folder / name, dpi=110))
        plt.close(figure)
    return paths


def _surfaces(plt: Any, sweep: dict[str, Any], kind: str) -> Any:
    """Figs. 9 and 11: accuracy rate and sum of the error rates over both settings."""
    letter = RULES[kind][0]
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for ax, values, title in (
        (axes[0], sweep["P_D"], "accuracy rate $P_D$"),
        (axes[1], sweep["P_FA"] + sweep["P_MD"], "$P_{FA} + P_{MD}$"),
    ):
        mesh = ax.pcolormesh(
            sweep["thresholds"], sweep["windows"], values, vmin=0.0, shading="nearest"
        )
        figure.colorbar(mesh, ax=ax)
        ax.set(title=title, xlabel=f"$Th_{letter}$ [m]", ylabel=f"$n_{letter}$ [fixes]")
    figure.suptitle(f"{SET_NAMES[kind]} rule alone: window and threshold")
    return figure


def _curves(plt: Any, sweep: dict[str, Any], kind: str) -> Any:
    """Figs. 10 and 12: best values by window, and the chosen window by threshold."""
    letter, chosen, window = RULES[kind]
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    left.plot(sweep["windows"], sweep["P_D"].max(axis=1), "o-", label="max $P_D$, causal")
    if kind == "jump":
        left.plot(sweep["windows"], sweep["P_D held"].max(axis=1), "s-", label="max $P_D$, held")
    left.plot(sweep["windows"], sweep["P_D told"].max(axis=1), "^-", label="max $P_D$, retroactive")
    sums = (sweep["P_FA"] + sweep["P_MD"]).min(axis=1)
    left.plot(sweep["windows"], sums, "v-", label="min $P_{FA} + P_{MD}$, causal")
    left.set(title="best over thresholds", xlabel=f"$n_{letter}$ [fixes]", ylabel="rate")
    i = int(np.argmax(sweep["windows"] == window))
    right.plot(sweep["thresholds"], sweep["P_D"][i], label="$P_D$")
    right.plot(sweep["thresholds"], (sweep["P_FA"] + sweep["P_MD"])[i], label="$P_{FA} + P_{MD}$")
    right.axvline(float(chosen.split()[0]), color="0.5", linestyle="--", label=f"paper: {chosen}")
    right.set(title=f"$n_{letter}$ = {window}", xlabel=f"$Th_{letter}$ [m]", ylabel="rate")
    left.legend()
    right.legend()
    figure.suptitle(f"{SET_NAMES[kind]} rule alone")
    return figure


def _errors(plt: Any, traces: dict[str, Any], data_set: str) -> Any:
    """Figs. 13, 15 and 17: errors in east and north over time."""
    figure, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
    for axis, name in ((1, "east"), (0, "north")):
        ax = axes[1 - axis]
        for word in ALGORITHMS:
            error = np.asarray(traces[f"{data_set}/{word}"])[:, axis]
            ax.plot(np.arange(1, len(error) + 1), error, label=word)
        ax.set_ylabel(f"error {name} [m]")
    axes[0].legend()
    axes[1].set_xlabel("time [s]")
    axes[0].set_title(f"one run: {SET_NAMES[data_set]}")
    return figure


def _tracks(plt: Any, traces: dict[str, Any], data_set: str) -> Any:
    """Figs. 14, 16 and 18: what each algorithm believes to have driven."""
    figure, axes = plt.subplots(1, 4, figsize=(15, 4), layout="constrained")
    truth = np.asarray(traces["truth"])
    gnss = truth + np.asarray(traces[f"{data_set}/GNSS"])
    for ax, word in zip(axes, ALGORITHMS, strict=True):
        estimate = truth + np.asarray(traces[f"{data_set}/{word}"])
        ax.plot(gnss[:, 1], gnss[:, 0], ".", markersize=2, color="0.7", label="GNSS")
        ax.plot(truth[:, 1], truth[:, 0], label="truth")
        ax.plot(estimate[:, 1], estimate[:, 0], label="estimate")
        ax.set(title=word, xlabel="east [m]", ylabel="north [m]", aspect="equal")
        if word != "EKF":
            ax.set(xlim=(-22.0, 18.0), ylim=(-12.0, 22.0))
    axes[0].legend()
    figure.suptitle(f"one run: {SET_NAMES[data_set]}")
    return figure
