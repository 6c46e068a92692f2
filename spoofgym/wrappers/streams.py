"""Recorded epochs, played through the wrappers of an environment in place of the environment.

A detector that only looks changes nothing, so that runs can be recorded first, and judged later. A
wrapper gets the epochs one by one, each in a step of its own, and no word of the truth: neither
when an attack begins, which is some time after the first epoch, nor what it does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from ..envs import attach
from ..envs.core import SpoofCore
from ..envs.env import CoreVectorEnv
from ..envs.factory import composable
from ..receiver.epoch import Epoch
from ..spoofers import Spoofer, make_spoofer
from ..spoofers.base import sees_statistics
from ..spoofers.build import SpooferSpec

FloatArray = NDArray[np.float64]
BLOCK = 16  # runs that are recorded together
STREAM = 0xE7  # key of the seeds, apart from those of the benchmark


class Stream(NamedTuple):
    """Epochs of one run: `settling` of the filter-only warm-up, then those that are judged, of
    which the first `before` come before the onset."""

    settling: tuple[Epoch, ...]
    epochs: tuple[Epoch, ...]
    before: int


class Recorder:
    """Records runs of the world of a wrapped environment; `hold` and `interval_s` are its own."""

    def __init__(self, env: Any, entropy: int = 0, threads: int | None = None) -> None:
        inner = composable(env)
        core: SpoofCore = inner.core
        setup, self.entropy = core.setup, entropy
        if core.settings["epoch"] is False:
            raise ValueError(
                "the information has no epochs: make the environment with epoch=True, or put an "
                "`EpochInfo` below the wrappers"
            )
        if setup.detector.calibrates or setup.detector.judges:
            raise ValueError(
                f"{type(setup.detector).__name__} is in the loop, and the scored detector is "
                "outside: make the environment with detector='never'. `spoofgym.audit` scores a "
                "detector in the loop"
            )
        if not setup.live:
            raise ValueError("a drawn onset needs a monitored start: give the timeline a `live_s`")
        same: dict[str, Any] = {"prefetch": False, "watch": (), "twin": False, "warm_pool": None}
        settings = {**core.settings, **same, "end": ("at-window-end",), "threads": threads}
        self.core = SpoofCore(BLOCK, setup, **settings)
        self._cores = {self.core.settings["knowledge"]: self.core}
        self.hold, self.interval_s = setup.hold, setup.interval_s
        self._drawn = setup.youngest < setup.onset  # else the first epochs are left out

    def attach(self, spoofer: SpooferSpec) -> tuple[SpoofCore, Spoofer]:
        """Receivers in which a spoofer observes what it knows, and the spoofer, ready for them; a
        ValueError where it does not fit. There are no statistics of a detector to see."""
        made, core = make_spoofer(spoofer), self.core
        if not sees_statistics(made.knowledge):
            if made.knowledge not in self._cores:
                self._cores[made.knowledge] = core.copy_with(knowledge=made.knowledge)
            core = self._cores[made.knowledge]
        return core, attach(made, CoreVectorEnv(core, "disabled"), transfer=True)

    def record_clean(self, split: int, runs: range) -> list[Stream]:
        """Runs without an attack."""
        starts = self._begin(self.core, split, runs)
        simulator, setup = self.core.engine.simulator, self.core.setup
        simulator.live_epochs(setup.steps + setup.hold)
        return self._cut(split, runs, starts, self.core.reset_info()["epochs"])

    def record_attack(
        self, spoofer: SpooferSpec, split: int, runs: range
    ) -> tuple[list[Stream], FloatArray]:
        """The same runs under an attack, and the displacement at its epochs, (steps, runs) [m]."""
        (core, player), moved = self.attach(spoofer), list[FloatArray]()
        starts, observation = self._begin(core, split, runs), core.observe()
        rest = np.frompyfunc(lambda row: (), 1, 1)(np.arange(BLOCK))
        core.listeners[:] = [lambda core, state, verdict: moved.append(state.displacement.copy())]
        for _ in range(core.episode_steps):
            result, observation = core.step(np.asarray(player.act(observation), dtype=np.float64))
            rest = rest + result.extra["epochs"]
        core.listeners.clear()
        return self._cut(split, runs, starts, rest), np.array(moved)[:, : len(runs)]

    def _begin(self, core: SpoofCore, split: int, runs: range) -> dict[str, NDArray[Any]]:
        numbers = [*runs, *range(runs.stop, runs.start + BLOCK)]
        core.reset([np.random.default_rng(self._seed(split, run)) for run in numbers])
        return core.reset_info()

    def _seed(self, split: int, run: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.entropy, spawn_key=(STREAM, split, run))

    def _cut(
        self, split: int, runs: range, starts: dict[str, NDArray[Any]], rest: NDArray[Any]
    ) -> list[Stream]:
        """Streams that begin at a drawn moment of the monitored start, and count time from it."""
        found = []
        for row, run in enumerate(runs):
            start, settling = (
                starts["epochs"][row],
                starts.get("settling_epochs", [()] * BLOCK)[row],
            )
            draw = np.random.default_rng([self.entropy, STREAM, split, run])
            first = 0 if self._drawn else int(draw.integers(len(start) // 2 + 1))
            zero = start[first].time
            parts = (*settling, *start[:first]) if settling else (), (*start[first:], *rest[row])
            settled, judged = (
                tuple(e._replace(time=e.time - zero) for e in part) for part in parts
            )
            found.append(Stream(settled, judged, len(start) - first))
        return found


class Feed:
    """Streams of some receivers, side by side, an epoch a step; none after the last one."""

    def __init__(self) -> None:
        self.streams: Sequence[Stream] = ()
        self.at = 0

    def begin(self) -> dict[str, list[Any]]:
        self.at = 0
        settling = [each.settling for each in self.streams]
        more = {"settling_epochs": settling} if any(settling) else {}
        return {"epochs": self._next(), **more}

    def advance(self) -> dict[str, list[Any]]:
        self.at += 1
        return {"epochs": self._next()}

    def _next(self) -> list[Any]:
        return [tuple(map(_copy, each.epochs[self.at : self.at + 1])) for each in self.streams]

    @property
    def over(self) -> NDArray[np.bool_]:
        return np.array([self.at + 1 >= len(each.epochs) for each in self.streams])


def _copy(epoch: Epoch) -> Epoch:
    """The same in arrays of its own, which a wrapper may keep, or write to."""
    return Epoch(*(None if array is None else array.copy() for array in epoch))  # type: ignore[arg-type]


class StreamEnv(gym.Env[Any, Any]):
    """Stands in for an environment; what it observes is drawn, and means nothing."""

    def __init__(self, inner: Any) -> None:
        self.observation_space, self.action_space = inner.observation_space, inner.action_space
        self.metadata, self.feed, self.observed = inner.metadata, Feed(), np.zeros(0)

    def _observe(self) -> Any:
        self.observed = self.observation_space.sample()
        return self.observed.copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        return self._observe(), {name: each[0] for name, each in self.feed.begin().items()}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        info = {name: each[0] for name, each in self.feed.advance().items()}
        return self._observe(), 0.0, bool(self.feed.over[0]), False, info


class StreamVectorEnv(VectorEnv[Any, Any, Any]):
    """The same for a vector environment."""

    def __init__(self, inner: Any) -> None:
        for name in ("observation_space", "action_space"):
            setattr(self, name, getattr(inner, name))
            setattr(self, f"single_{name}", getattr(inner, f"single_{name}"))
        self.num_envs, self.feed = inner.num_envs, Feed()
        self.metadata = {**inner.metadata, "autoreset_mode": AutoresetMode.DISABLED}

    def end_episodes(self, mask: NDArray[np.bool_]) -> None:
        """Nothing: all streams are played to their ends."""

    def _observe(self) -> Any:
        self.observed = self.observation_space.sample()
        return self.observed.copy()

    def _infos(self, lists: dict[str, list[Any]]) -> dict[str, Any]:
        info: dict[str, Any] = {}
        for name, each in lists.items():
            info[name] = np.empty(self.num_envs, dtype=np.object_)
            info[name][:] = each
            info[f"_{name}"] = np.ones(self.num_envs, dtype=np.bool_)
        return info

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        return self._observe(), self._infos(self.feed.begin())

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        info, over = self._infos(self.feed.advance()), self.feed.over
        return self._observe(), np.zeros(self.num_envs), over, np.zeros_like(over), info


@contextmanager
def replaced_bottom(env: Any) -> Iterator[StreamEnv | StreamVectorEnv]:
    """Let the wrappers of an environment be around streams for a while."""
    above, inner = env, env.unwrapped
    if above is inner:
        raise ValueError("there is no wrapper to try around the environment")
    while above.env is not inner:
        above = above.env
    vector = isinstance(inner, VectorEnv)
    bottom = StreamVectorEnv(inner) if vector else StreamEnv(inner)
    bottom.observation_space.seed(0)
    above.env = bottom
    try:
        yield bottom
    finally:
        above.env = inner


class Reading(NamedTuple):
    """What a wrapper sets at one epoch, for (R,) streams: `alarm`, None without any, and `ratio` of
    statistic to threshold, None without them."""

    alarm: NDArray[np.bool_] | None
    ratio: FloatArray | None


def read_info(info: Mapping[str, Any], receivers: int | None) -> Reading:
    """Alarm and ratio in the information of a wrapper, of (B,) receivers or a single environment;
    a ValueError that says what is wrong with them."""
    found: dict[str, Any] = {name: info[name] for name in READ if name in info}
    for name, value in found.items():
        array, kinds = np.asarray(value), "b" if name == "alarm" else "fiu"
        if array.shape != (() if receivers is None else (receivers,)):
            many = "one value" if receivers is None else f"shape ({receivers},)"
            raise ValueError(f"info[{name!r}] must have {many}, got {value!r}")
        if array.dtype.kind not in kinds:
            word = "boolean" if name == "alarm" else "a number"
            raise ValueError(f"info[{name!r}] must be {word}, got {value!r}")
        if name != "alarm" and not np.isfinite(array).all():
            raise ValueError(f"info[{name!r}] must be finite, got {value!r}")
        found[name] = array.reshape(-1)
    if ("statistic" in found) != ("threshold" in found):
        raise ValueError("a wrapper sets both info['statistic'] and info['threshold'], or neither")
    if "threshold" in found and not (found["threshold"] > 0.0).all():
        raise ValueError(f"info['threshold'] must be above 0, got {info['threshold']!r}")
    ratio = found["statistic"] / found["threshold"] if "statistic" in found else None
    return Reading(found.get("alarm"), ratio)


READ = ("alarm", "statistic", "threshold")
Look = Callable[[int, Reading], bool]


def play_streams(env: Any, bottom: Any, streams: Sequence[Stream], look: Look) -> None:
    """Play streams through the wrappers, as many as there are receivers; `look` is called at every
    epoch, with its number from 0 on, and says whether to go on."""
    bottom.feed.streams = streams
    receivers = bottom.num_envs if isinstance(bottom, StreamVectorEnv) else None
    idle = np.zeros(bottom.action_space.shape, dtype=np.float32)
    info = env.reset()[1]
    for number in range(max(len(each.epochs) for each in streams)):
        if number:
            info = env.step(idle)[4]
        if not look(number, read_info(info, receivers)):
            return
