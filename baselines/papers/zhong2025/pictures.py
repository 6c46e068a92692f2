"""The paper's figures, redrawn from our runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.core.plots import save_figure
from spoofgym.detectors.innovation import two_sided_quantile
from spoofgym.earth.wgs84 import ecef_to_geodetic

from .bands import LABELS, NOISES, ONSET_S
from .runs import EPOCH_S, FIRST_S, INTERMITTENT, METHODS, TABLED, Several, build_setup

Data = Mapping[str, Mapping[str, Any]]
RAMP, STEP = TABLED[3], TABLED[0]


def _time(count: int) -> Any:
    return ONSET_S + FIRST_S + EPOCH_S * np.arange(count)


def _save(figure: Any, folder: Path, name: str) -> Path:
    return save_figure(figure, folder / f"zhong2025_{name}.png")


def _panels(count: int, title: str) -> tuple[Any, list[Any]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0 * count, 3.6), dpi=110)
    margin = 0.7 / (5.0 * count)
    figure.subplots_adjust(margin, 0.15, 1.0 - 0.3 * margin, 0.88, wspace=0.2)
    figure.suptitle(title)
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


def metric_figures(data: Data, folder: Path) -> list[Path]:
    """Figures 2 to 5: innovation, chart, their ratio, and what it is tested by."""
    paths = []
    usual = data[f"metric-{NOISES[0]:g}m"]
    for number, attack in ((2, RAMP), (3, STEP)):
        figure, (left, right) = _panels(2, f"Figure {number}: {LABELS[attack]}")
        time = _time(len(usual[f"xi_{attack}"]))
        left.plot(time, usual[f"innovation_{attack}"], lw=0.8, label="F")
        left.plot(time, usual[f"average_{attack}"], label=r"$\Lambda$")
        left.set_ylabel("innovation, chart [m]")
        right.plot(time, usual[f"xi_{attack}"], label=r"$\xi = F / \Lambda$", color="tab:green")
        right.set_ylabel("ratio")
        _finish((left, right))
        paths.append(_save(figure, folder, f"figure_{number}"))
    figure, axes = _panels(3, "Figure 4: joint detection metric")
    for attack in TABLED:
        xi = usual[f"xi_{attack}"]
        axes[0].plot(_time(len(xi)), xi, lw=0.8, label=LABELS[attack])
    for axis, attack in zip(axes[1:], (RAMP, STEP), strict=True):
        for sd in NOISES:
            xi = data[f"metric-{sd:g}m"][f"xi_{attack}"]
            axis.plot(_time(len(xi)), xi, lw=0.8, label=f"{LABELS[attack]}, SD {sd:g} m")
    for axis in axes:
        axis.set_ylabel(r"$\xi$")
    _finish(axes)
    paths.append(_save(figure, folder, "figure_4"))
    figure, (axis,) = _panels(1, "Figure 5: distance from the median")
    for attack in (RAMP, STEP):
        delta = usual[f"delta_{attack}"]
        axis.plot(_time(len(delta)), delta, lw=0.8, label=LABELS[attack])
    axis.axhline(0.6, color="k", ls="--", lw=0.8, label="$T_3$")
    axis.set_ylabel(r"$\Delta Y$")
    axis.set_ylim(0.0, 2.0)
    _finish((axis,))
    return [*paths, _save(figure, folder, "figure_5")]


def _finish(axes: Sequence[Any]) -> None:
    for axis in axes:
        axis.set_xlabel("time [s]")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)


def flight_figure(folder: Path) -> Path:
    """Figure 7: the flight."""
    world = build_setup(STEP, Several([METHODS["M2"]])).world
    latitude, longitude, height = np.array([ecef_to_geodetic(p) for p in world.position_e]).T
    figure, (left, right) = _panels(2, "Figure 7: flight")
    left.plot(np.degrees(longitude), np.degrees(latitude))
    left.set_xlabel("longitude [deg]")
    left.set_ylabel("latitude [deg]")
    right.plot(world.epoch_time, height)
    right.set_xlabel("time [s]")
    right.set_ylabel("height [m]")
    for axis in (left, right):
        axis.grid(alpha=0.3)
    return _save(figure, folder, "figure_7")


def chart_figure(data: Data, folder: Path, name: str, title: str, attacks: Sequence[str]) -> Path:
    """Figures 8 to 10: statistics of the three methods and their limits."""
    figure, axes = _panels(3, title)
    quantile = two_sided_quantile(METHODS["M1"]["false_alarm"])
    for axis, method in zip(axes, ("M1", "M2", "M3"), strict=True):
        for attack in attacks:
            innovation, sd, average, threshold = data[attack][f"trace_{method}"]
            time = _time(len(sd))
            values = innovation if method == "M1" else average
            limit = quantile * sd if method == "M1" else threshold
            axis.plot(time, values, lw=0.8, label=LABELS.get(attack, "ramp, pause, step"))
        axis.plot(time, limit, "k--", lw=0.8, label="limits")
        axis.plot(time, -limit, "k--", lw=0.8)
        axis.set_ylabel(f"{method} statistic [m]")
    _finish(axes)
    return _save(figure, folder, name)


def all_figures(data: Data, folder: Path) -> list[Path]:
    """Figures 2 to 5 and 7 to 10; 1 and 6 are flow charts."""
    folder.mkdir(parents=True, exist_ok=True)
    steps, ramps = TABLED[:3], TABLED[3:]
    return [
        *metric_figures(data, folder),
        flight_figure(folder),
        chart_figure(data, folder, "figure_8", "Figure 8: steps", steps),
        chart_figure(data, folder, "figure_9", "Figure 9: ramps", ramps),
        chart_figure(data, folder, "figure_10", "Figure 10: intermittent", (INTERMITTENT,)),
    ]
