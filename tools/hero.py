"""The animation of the README: one slow pull, which one detector misses and another one catches.

python -m tools.hero             # draws docs/attack.webp, from the attack of `spoofgym demo`
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from spoofgym.bench.experiments.suite import RATE, Suite
from spoofgym.bench.runs.episode import ATTACKED, Episode, play_episode
from spoofgym.cli.demo import DETECTORS, RATE_MPS, SCENARIO
from spoofgym.cli.suites import calibrate_suite
from spoofgym.core.plots import BLUE, ORANGE, figure_class, style
from spoofgym.envs.factory import choose_env_id
from spoofgym.envs.rendering import save_animation
from tools.pages import DOCS

DRAWN, EVERY, FPS, REACH_M = DOCS / "attack.webp", 4, 15.0, 70.0
COLOURS = (ORANGE, BLUE)


def play_demo() -> list[Episode]:
    """The runs of `spoofgym demo`, one for each detector, pulled north, across the flight."""
    detectors = [{"name": name, "false_alarms_per_hour": RATE} for name in DETECTORS]
    ramp = {"name": "ramp", "rate_mps": RATE_MPS, "heading_deg": 0.0}
    env = choose_env_id(["scenario"])
    suite = Suite(env=env, scenario=SCENARIO, detectors=detectors, spoofers=[ramp])
    suite = calibrate_suite(suite, None, None)
    player = suite.spoofer_players[-1]
    return [play_episode(suite.world, each, player) for each in suite.detector_players]


def draw_frame(axes: Sequence[Any], episodes: Sequence[Episode], end: int) -> None:
    """Map of the false positions and the statistics, up to an epoch after the onset."""
    track, chart = axes
    for ax in axes:
        ax.clear()
        style(ax)
    track.plot(0.0, 0.0, "k^", ms=11)
    track.annotate("true position", (0.0, 0.0), (6, -14), textcoords="offset points", fontsize=9)
    chart.axhline(1.0, color="black", lw=1, ls=":")
    for episode, colour, up in zip(episodes, COLOURS, (6.0, -12.0), strict=True):
        name, first = episode.detector.label.partition("(")[0], episode.first_alarm
        across, along = episode.error_n[:, ATTACKED, :2].T
        last = min(end, first) if first else end
        track.plot(across[:last], along[:last] + up, color=colour, lw=2.2, label=name)
        alarmed = bool(first) and end >= first
        marker = "X" if alarmed else "o"
        track.plot(across[last - 1], along[last - 1] + up, marker, color=colour, ms=9)
        ratio = episode.ratio[: episode.onset + end, ATTACKED]
        said = "ALARM" if alarmed else "no alarm"
        chart.plot(episode.time[: len(ratio)], ratio, color=colour, lw=1.6, label=f"{name}: {said}")
    track.set(xlim=(-10, REACH_M), ylim=(-30, 30), yticks=[])
    track.set_xlabel("position error across the flight [m]")
    track.set_title("where the receiver believes to be", fontsize=11)
    chart.set(xlim=(-30.0, episodes[0].time[-1]), ylim=(0.0, 3.0))
    chart.set_xlabel("time since the attack began [s]")
    chart.set_title("detector's statistic over its threshold", fontsize=11)
    track.legend(fontsize=9, loc="upper left")
    chart.legend(fontsize=9, loc="upper left")


def draw_frames(episodes: Sequence[Episode]) -> Iterator[Any]:
    """(H, W, 3) uint8; the last one stands for two seconds."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure: Any = figure_class()(figsize=(9.0, 3.4), dpi=100, layout="constrained")
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2)
    whole = len(episodes[0].error_n)
    ends = [*range(1, whole, EVERY), *[whole] * round(2 * FPS)]
    for end in ends:
        draw_frame(axes, episodes, end)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


if __name__ == "__main__":
    played = play_demo()
    save_animation(draw_frames(played), DRAWN, FPS)
    print([(each.detector.label, each.summary()["final_error_m"]) for each in played])
