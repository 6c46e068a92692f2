"""Draw `attack.webp`, the attack of `spoofgym demo` across the flight: python docs/attack.py."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.bench.experiments.suite import RATE, Suite
from spoofgym.bench.runs.episode import ATTACKED, Episode, play_episode
from spoofgym.cli.demo import DETECTORS, RATE_MPS, SCENARIO
from spoofgym.cli.suites import calibrate_suite
from spoofgym.core.plots import BLUE, ORANGE, figure_class, style
from spoofgym.envs.factory import choose_env_id
from spoofgym.envs.rendering import save_animation

EVERY, FPS = 4, 15.0


def play_demo() -> list[Episode]:
    detectors = [{"name": name, "false_alarms_per_hour": RATE} for name in DETECTORS]
    ramp = {"name": "ramp", "rate_mps": RATE_MPS, "heading_deg": 0.0}
    env = choose_env_id(["scenario"])
    suite = Suite(env=env, scenario=SCENARIO, detectors=detectors, spoofers=[ramp])
    suite = calibrate_suite(suite, None, None)
    return [play_episode(suite.world, x, suite.spoofer_players[-1]) for x in suite.detector_players]


def draw_frame(axes: Sequence[Any], episodes: Sequence[Episode], end: int) -> None:
    """Map of the false positions and the statistics, up to an epoch after the onset."""
    track, chart = axes
    for ax, name, at in (
        (track, "where the receiver believes to be", "position error across the flight [m]"),
        (chart, "detector's statistic over its threshold", "time since the attack began [s]"),
    ):
        ax.clear()
        style(ax)
        ax.set(title=name, xlabel=at)
    track.plot(0.0, 0.0, "k^", ms=11, label="true position")
    chart.axhline(1.0, color="black", lw=1, ls=":")
    for episode, colour, up in zip(episodes, (ORANGE, BLUE), (6.0, -12.0), strict=True):
        name, first = episode.detector.label.partition("(")[0], episode.first_alarm
        across, along = episode.error_n[: min(end, first) if first else end, ATTACKED, :2].T
        said, marker = ("ALARM", "X") if first and end >= first else ("no alarm", "o")
        track.plot(across, along + up, color=colour, lw=2.2, label=name)
        track.plot(across[-1], along[-1] + up, marker, color=colour, ms=9)
        ratio = episode.ratio[: episode.onset + end, ATTACKED]
        chart.plot(episode.time[: len(ratio)], ratio, color=colour, label=f"{name}: {said}")
    track.set(xlim=(-10.0, 70.0), ylim=(-30.0, 30.0), yticks=[])
    chart.set(xlim=(-30.0, episodes[0].time[-1]), ylim=(0.0, 3.0))
    for ax in axes:
        ax.legend(fontsize=9, loc="upper left")


def draw_frames(episodes: Sequence[Episode]) -> Iterator[Any]:
    """(H, W, 3) uint8; the last one stands for two seconds."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure: Any = figure_class()(figsize=(9.0, 3.4), dpi=100, layout="constrained")
    canvas: Any = FigureCanvasAgg(figure)
    axes, whole = figure.subplots(1, 2), len(episodes[0].error_n)
    for end in [*range(1, whole, EVERY), *[whole] * round(2 * FPS)]:
        draw_frame(axes, episodes, end)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


if __name__ == "__main__":
    save_animation(draw_frames(play_demo()), Path(__file__).with_suffix(".webp"), FPS)
