"""One run in detail."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.plots import BLUE, GREEN, GREY, ORANGE, figure_class, save_figure, style
from ...core.registry import whole_number
from ...simulation.engine import Engine
from ...simulation.setup import Setup
from ...simulation.simulator import FrameData
from ...spoofers.base import AXES
from .play import FloatArray, SpooferController, list_attack_epochs, to_local
from .players import PlayerSpec
from .record import undetected_displacement
from .world import World

TITLE_WIDTH = 100  # characters of a line
ATTACKED, TWIN = 0, 1  # columns of the two receivers


def alarm_intervals(alarm: NDArray[np.bool_], time_s: FloatArray) -> list[tuple[float, float]]:
    """Times of the first epoch of every stretch of alarms (K,), and of the first one after it,
    which is infinite where the record ends before."""
    change = np.diff(alarm.astype(np.int8), prepend=0, append=0)
    ends = np.append(time_s, math.inf)[change == -1]
    return list(zip(time_s[change[:-1] == 1].tolist(), ends.tolist(), strict=True))


@dataclass(frozen=True)
class Episode:
    """A run under attack and its clean twin: L epochs of the warm-up, whose times since the onset
    are negative, and K to the end. By epoch, attacked and twin side by side: `time` (L + K,) [s];
    `ratio` (L + K, 2) of statistic to threshold; `alarm` (L + K, 2); `error_n` (K, 2, d) distance
    from the truth, north, east (and down) [m]. Of the attacked one: `displacement` (K, a) of
    `channels` (a,) that is commanded [m], and `frames` (K,). `onset_epoch`: of
    `Setup.epoch_time`."""

    setup: Setup
    detector: PlayerSpec
    spoofer: PlayerSpec
    entropy: int
    run: int
    time: FloatArray
    ratio: FloatArray
    alarm: NDArray[np.bool_]
    error_n: FloatArray
    displacement: FloatArray
    frames: tuple[FrameData, ...]
    channels: tuple[str, ...]
    onset_epoch: int

    @property
    def onset(self) -> int:
        """Epochs before the onset, L."""
        return len(self.time) - len(self.error_n)

    @property
    def induced_error_m(self) -> FloatArray:
        """(K,) horizontal distance from the clean twin [m]."""
        apart = self.error_n[:, ATTACKED] - self.error_n[:, TWIN]
        return np.hypot(apart[:, 0], apart[:, 1])

    @property
    def first_alarm(self) -> int:
        """Epoch of the first alarm after the onset, from 1 on; 0 for none."""
        alarm = self.alarm[self.onset :, ATTACKED]
        return int(alarm.argmax()) + 1 if alarm.any() else 0

    @property
    def intervals(self) -> list[tuple[float, float]]:
        """Stretches of alarms of the attacked receiver, also before the onset [s]."""
        return alarm_intervals(self.alarm[:, ATTACKED], self.time)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Its epochs as columns with units, (L + K, ...); NaN before the onset where only what
        follows is recorded."""

        def fill(values: FloatArray) -> FloatArray:
            return np.concatenate((np.full((self.onset, *values.shape[1:]), np.nan), values))

        found: dict[str, NDArray[Any]] = {"time_s": self.time}
        for side, column in (("", ATTACKED), ("twin_", TWIN)):
            found |= {
                f"{side}ratio": self.ratio[:, column],
                f"{side}alarm": self.alarm[:, column],
                f"{side}error_ned_m": fill(self.error_n[:, column]),
            }
        return {
            **found,
            "induced_error_m": fill(self.induced_error_m),
            "commanded_m": fill(self.displacement),
        }

    def summary(self) -> dict[str, Any]:
        """What came of it, JSON-able."""
        setup = self.setup
        interval, induced, first = setup.interval_s, self.induced_error_m, self.first_alarm
        commanded = induced[: setup.steps]
        alarms = self.alarm[: self.onset, ATTACKED]
        undetected = undetected_displacement(commanded[:, None], [first], setup.hold)[0]
        twin = self.error_n[:, TWIN, :2]
        return {
            "scenario": setup.name,
            "detector": self.detector.spec,
            "spoofer": self.spoofer.spec,
            "attack": setup.attack.label,
            "entropy": self.entropy,
            "run": self.run,
            "warmup_alarm": bool(alarms.any()),
            "alarm": first > 0,
            "delay_s": first * interval if first else None,
            "spoofing_intervals_s": [
                [onset, end if math.isfinite(end) else None] for onset, end in self.intervals
            ],
            "undetected_displacement_m": round(float(undetected), 4),
            "largest_error_m": round(float(commanded.max()), 4),
            "final_error_m": round(float(commanded[-1]), 4),
            "peak_ratio": round(float(self.ratio[self.onset :, ATTACKED].max()), 4),
            "clean_rms_m": round(float(np.sqrt((twin * twin).sum(axis=1).mean())), 4),
        }


def play_episode(
    world: World, detector: PlayerSpec, spoofer: PlayerSpec, run: int = 0, entropy: int = 0
) -> Episode:
    run = whole_number("`run`", run)
    setup = world.build_setup(detector, [spoofer])
    engine = Engine(2, setup, threads=1, twin=True)  # alike: see `keep_company`
    simulator, twin = engine.simulator, engine.twin
    assert twin is not None  # `twin=True` above
    everyone, epochs = np.arange(2), setup.steps + setup.hold
    draw = partial(world.generators, entropy, "evaluation", run + 1, run)
    simulator.switch_on([*draw(), *draw()])
    live = int(simulator.ages[0]) - setup.filter_only
    ratio = np.zeros((live + epochs, 2))
    alarm = np.zeros(ratio.shape, dtype=np.bool_)
    for k in range(live):
        alarm[k], ratio[k] = simulator.live_epochs(1)[0], simulator.ratio()
    twin.copy_rows(everyone, simulator, everyone)
    attacker = SpooferController([spoofer.spec], engine)
    truth = setup.true_position
    apart = np.zeros((epochs, 2, truth.shape[1]))
    displacement = np.zeros((epochs, len(setup.action_names)))
    frames = []
    for k in range(epochs):
        engine.step(attacker.command(k))
        for column, each in ((ATTACKED, simulator), (TWIN, twin)):
            assert each.verdict is not None  # an epoch has been judged
            alarm[live + k, column] = each.verdict.alarm.any()
            ratio[live + k, column] = each.ratio()[0]
            apart[k, column] = (each.position - truth[each.epochs])[0]
        displacement[k] = simulator.commanded_displacement[0]
        frames.append(simulator.frame())
    return Episode(
        setup=setup,
        detector=detector,
        spoofer=spoofer,
        entropy=entropy,
        run=run,
        time=np.arange(1.0 - live, epochs + 1) * setup.interval_s,
        ratio=ratio,
        alarm=alarm,
        error_n=to_local(apart, setup.C_en[list_attack_epochs(setup, simulator.onset)]),
        onset_epoch=int(simulator.onset[0]),
        displacement=displacement,
        frames=tuple(frames),
        channels=tuple(name.rsplit("_", 1)[0] for name in setup.action_names),
    )


def draw_episode(episode: Episode, path: Path) -> Path:
    """Flight, displacement, statistic and error; returns the file, PNG without an ending."""
    figure = figure_class()(figsize=(11.0, 8.2), layout="constrained")
    axes = figure.subplots(2, 2)
    for ax in axes.flat:
        style(ax)
    _draw_flight(axes[0, 0], episode)
    _draw_displacement(axes[0, 1], episode)
    _draw_statistic(axes[1, 0], episode)
    _draw_error(axes[1, 1], episode)
    summary = episode.summary()
    pair = f"{episode.spoofer.label} against {episode.detector.label}"
    title = f"{summary['scenario']}: {pair}, run {episode.run}"
    figure.suptitle(textwrap.fill(title, TITLE_WIDTH, break_on_hyphens=False), fontsize=13)
    return save_figure(figure, path, dpi=130)


def draw_comparison(episodes: Sequence[Episode], path: Path) -> Path:
    """One attack in front of several detectors: position error, and the statistic of each; returns
    the file, PNG without an ending."""
    figure = figure_class()(figsize=(11.0, 4.4), layout="constrained")
    axes = figure.subplots(1, 2)
    for ax in axes:
        style(ax)
        _phases(ax, episodes[0])
    axes[1].axhline(1.0, color="black", lw=1, ls=":")
    top = 1.0
    for episode, colour in zip(episodes, (ORANGE, BLUE, GREEN), strict=False):
        first, alarm = episode.first_alarm, episode.alarm[:, ATTACKED]
        window, ratio = episode.time[episode.onset :], episode.ratio[:, ATTACKED]
        label, top = episode.detector.label, max(top, float(ratio.max()))
        # until the alarm, or to the end
        seen = slice(0, first or None)
        axes[0].plot(
            window, episode.induced_error_m, color=colour, lw=1.2, ls=":" if first else "-"
        )
        axes[0].plot(window[seen], episode.induced_error_m[seen], color=colour, lw=2.2, label=label)
        axes[1].plot(episode.time, ratio, color=colour, lw=1.4, label=label)
        axes[1].plot(episode.time[alarm], ratio[alarm], ".", color=colour, ms=5)
        if first:
            error = episode.induced_error_m[first - 1]
            axes[0].plot(window[first - 1], error, "X", color=colour, ms=10, label="alarm")
    axes[0].set(title="error that the attack causes [m]", xlabel="time since the onset [s]")
    axes[1].set(title="statistic over its threshold", xlabel="time since the onset [s]")
    axes[1].set_ylim(0.0, 1.1 * min(top, 5.0))
    for ax in axes:
        ax.legend(fontsize=9, loc="upper left", framealpha=0.9)
    return save_figure(figure, path, dpi=130)


def _draw_flight(ax: Any, episode: Episode) -> None:
    """True ground track; the part under attack stands out."""
    setup = episode.setup
    world, onset = divmod(episode.onset_epoch, setup.epochs_each)
    flown = setup.true_position[world * setup.epochs_each :][: setup.epochs_each]
    end, first = onset + setup.steps + setup.hold, onset - episode.onset - setup.filter_only
    north, east = ((flown - flown[onset]) @ setup.C_en[episode.onset_epoch]).T[:2] / 1000.0
    ax.plot(east, north, color="#cccccc", lw=2, label="flight")
    ax.plot(east[first : onset + 1], north[first : onset + 1], color=GREY, lw=2, label="warm-up")
    ax.plot(east[onset : end + 1], north[onset : end + 1], color=ORANGE, lw=2.5, label="attack")
    ax.plot(east[first], north[first], "o", color=GREY, ms=5)
    ax.set(title="true flight", xlabel="east of the onset [km]", ylabel="north [km]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.legend(fontsize=9, framealpha=0.9)


def _draw_displacement(ax: Any, episode: Episode) -> None:
    """Estimated less true position of both receivers, and what was commanded."""
    for row, colour, label in ((TWIN, BLUE, "clean twin"), (ATTACKED, ORANGE, "attacked")):
        north, east = episode.error_n[:, row, 0], episode.error_n[:, row, 1]
        ax.plot(east, north, color=colour, lw=1.6, label=label)
        ax.plot(east[-1], north[-1], "o", color=colour, ms=6)
    if set(episode.channels) <= set(AXES):
        moved = dict(zip(episode.channels, episode.displacement.T, strict=True))
        still = np.zeros(len(episode.displacement))
        east, north = moved.get("east", still), moved.get("north", still)
        ax.plot(east, north, color=GREEN, lw=1.4, ls="--", label="commanded")
        ax.plot(east[-1], north[-1], "s", color=GREEN, ms=5)
    ax.plot(0, 0, "+", color="black", ms=10, label="truth")
    if (first := episode.first_alarm) > 0:
        error = episode.error_n[first - 1, ATTACKED]
        ax.plot(error[1], error[0], "X", color="black", ms=9, label="first alarm")
    ax.set(title="estimated less true position", xlabel="east [m]", ylabel="north [m]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.legend(fontsize=9, framealpha=0.9)


def _phases(ax: Any, episode: Episode) -> None:
    setup = episode.setup
    interval = setup.interval_s
    end = setup.steps * interval
    ax.axvline(0.0, color=GREY, lw=1)
    ax.axvspan(end, end + setup.hold * interval, color=GREY, alpha=0.12, lw=0)


def _draw_statistic(ax: Any, episode: Episode) -> None:
    """Statistic over threshold of both receivers."""
    _phases(ax, episode)
    ax.axhline(1.0, color="black", lw=1, ls=":")
    ax.plot(episode.time, episode.ratio[:, TWIN], color=BLUE, lw=1.2, label="clean twin")
    ax.plot(episode.time, episode.ratio[:, ATTACKED], color=ORANGE, lw=1.6, label="attacked")
    for row, colour in ((TWIN, BLUE), (ATTACKED, ORANGE)):
        alarm = episode.alarm[:, row]
        ax.plot(episode.time[alarm], episode.ratio[alarm, row], ".", color=colour, ms=5)
    ax.set(title="largest statistic over its threshold", xlabel="time since the onset [s]")
    top = float(episode.ratio.max())
    if top > 5.0:
        ax.set_yscale("symlog", linthresh=1.0)
    ax.set_ylim(0.0, 1.35 * max(top, 1.0))
    ax.legend(fontsize=9, loc="upper left", framealpha=0.9)


def _draw_error(ax: Any, episode: Episode) -> None:
    _phases(ax, episode)
    summary, window = episode.summary(), episode.time[episode.onset :]
    size = np.linalg.norm(episode.displacement, axis=1)
    if set(episode.channels) <= set(AXES):
        ax.plot(window, size, color=GREEN, lw=1.4, ls="--", label="commanded")
    ax.plot(
        window, episode.induced_error_m, color=ORANGE, lw=1.8, label="distance from the clean twin"
    )
    counted = summary["undetected_displacement_m"]
    ax.axhline(counted, color="black", lw=1, ls=":", label=f"undetected: {counted:.1f} m")
    if summary["delay_s"] is not None:
        ax.axvline(
            summary["delay_s"],
            color="black",
            lw=1.2,
            label=f"first alarm: {summary['delay_s']:g} s",
        )
    ax.set(title="induced error [m]", xlabel="time since the onset [s]")
    ax.set_ylim(0.0, 1.35 * max(float(size.max()), float(episode.induced_error_m.max()), 1e-3))
    ax.legend(fontsize=9, loc="upper left", framealpha=0.9)
