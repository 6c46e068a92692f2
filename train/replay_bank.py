"""Solution separation under any attack, from clean runs and linear responses alone.

The separations of a passive detector's solutions are linear in the attack, so that a receiver under
a policy costs a small product of matrices per epoch, whatever the detector's own filter costs on
the engine.  A policy sees its own commands, the time, and the detector's statistic over its
threshold; the victim's true error, which the engine shows an oracle, is not recorded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from spoofgym.bench.runs.play import make_bound_spoofer
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.record import MEASURES, undetected_displacement
from spoofgym.bench.runs.world import World
from spoofgym.bench.search.open_loop import share_skies
from spoofgym.limits.floor import check_linear_victim
from spoofgym.limits.linear import get_rate_limits
from spoofgym.limits.response import HATS, LinearBank, Replay
from spoofgym.simulation.setup import Setup, seeds_of_runs
from spoofgym.spoofers.learned import ModelPolicy
from spoofgym.spoofers.scaled import LARGEST, SMALLEST

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]
Policy = Callable[[NDArray[np.float32]], NDArray[Any]]
"""Corrections (B, 1) by what is seen (B, o)."""
AT_ONCE = 64
"""Runs that are recorded together: their filters' matrices are some 10 kB a run and epoch."""
SHARING = 256  # runs that share the starts and ages of their skies; others have their own
JUDGED = 300  # epochs of an attack that a search and a training judge, about
SEEN = (
    *("own_displacement_along_target", "own_rate_along_target"),
    *("time_since_onset", "time_left", "statistic_ratio"),
)
"""What a policy sees, by the names of the environment."""
MOST = np.array([100.0, 100.0, 1.0, 1.0, 10.0])
"""Largest value of each, as of the environment."""


class Bank(NamedTuple):
    """N clean runs of G circumstances (sky, start, age, view) over D decisions of k epochs each;
    the last one has `hold` more, the time to alert.

    - `clean` (N, K, 2 J) whitened separations of J solutions, in units of the threshold's root;
    - `units` (G, K, 2 J, D) their change by 1 m/s of each decision; `moved` (G, K, 2, D) that of
      the position [m]; `group`, `sky` (N,) of the runs;
    - `onset_ratio` (N,) the statistic over its threshold at the last epoch before the onset.
    """

    clean: NDArray[np.float32]
    units: NDArray[np.float32]
    moved: NDArray[np.float32]
    group: NDArray[np.intp]
    sky: NDArray[np.int64]
    onset_ratio: NDArray[np.float32]

    def take(self, rows: NDArray[Any]) -> Self:
        """Some of its runs."""
        each = {name: getattr(self, name)[rows] for name in ("clean", "group", "sky")}
        return self._replace(**each, onset_ratio=self.onset_ratio[rows])

    def thin(self, every: int) -> Self:
        """Only the last of every few epochs."""
        names = "clean", "units", "moved"
        return self._replace(**{name: getattr(self, name)[:, every - 1 :: every] for name in names})


def draw_circumstances(setup: Setup, entropy: int, runs: int) -> dict[str, NDArray[Any]]:
    """World, start and age of runs: one start and age a sky for `SHARING` of them."""
    some = [min(SHARING, runs - first) for first in range(0, runs, SHARING)]
    drawn = [share_skies(setup, 1000 * entropy + k, count) for k, count in enumerate(some)]
    return {name: np.concatenate([each[name] for each in drawn]) for name in drawn[0]}


def record_bank(
    world: World, detector: Mapping[str, Any], split: str, entropy: int, runs: int
) -> Bank:
    """Runs of a split that count, by age, a few circumstances at a time."""
    setup = world.setup
    given = draw_circumstances(setup, entropy, runs)
    kinds = np.stack([given[name] for name in ("age_s", "start_s", "world")])
    circumstance = np.unique(kinds, axis=1, return_inverse=True)[1].ravel()
    order, count = np.argsort(circumstance, kind="stable"), int(circumstance.max()) + 1
    parts, groups = [], 0
    for few in np.array_split(np.arange(count), min(-(-runs // AT_ONCE), count)):
        rows = order[np.isin(circumstance[order], few)]
        seeds = seeds_of_runs(entropy, split, setup.name, rows.tolist())
        own = {name: values[rows] for name, values in given.items()}
        judge = world.judge(specify_detector(dict(detector)))
        replay = Replay(check_linear_victim(setup), [judge], seeds, threads=1, given=own)
        if replay.hats.shape[1] != replay.steps:
            raise ValueError(
                f"at most {HATS} decisions can be learned on replay, got {replay.steps}"
            )
        found = replay.find_bank(0)
        first = np.array([np.flatnonzero(found.group == g)[0] for g in range(len(found.units))])
        shape = len(first), replay.epochs, -1, replay.steps
        clean = found.clean.reshape(len(rows), replay.epochs, -1).astype(np.float32)
        quiet = np.square(clean).reshape(*clean.shape[:2], -1, 2).sum(axis=3).max(axis=(1, 2)) <= 1
        counts = quiet & ~replay.warmup_alarm[0]
        own_bank = Bank(
            clean,
            found.units.reshape(shape),
            replay.respond_positions(first).astype(np.float32),
            found.group + groups,
            replay.sky,
            replay.onset_ratio[0].astype(np.float32),
        ).take(counts)
        parts.append(own_bank)
        groups += len(first)
    return Bank(*(np.concatenate(each) for each in zip(*parts, strict=True)))


class Course(NamedTuple):
    """What an attack with corrections is: of D decisions of `repeat` epochs of `epoch_s`."""

    base: FloatArray  # (D,) actions of the base
    scale: float  # of a correction of 1
    limit_mps: float
    change_mps: float  # of the rate by an action of 1
    repeat: int
    hold: int
    epoch_s: float
    sizes: tuple[float, float]  # displacement [m] and rate [m/s] that are seen as 1
    every: int = 1  # epochs of which the last one is judged

    @classmethod
    def of(cls, setup: Setup, action: Mapping[str, Any]) -> Self:
        """Of a base without corrections; `action`: the residual term."""
        silent = ModelPolicy(lambda seen: np.zeros((len(seen), 1)), action=dict(action))
        bound, observer, _ = make_bound_spoofer(silent, setup, 1)
        seen = np.zeros((1, len(observer.names)), dtype=np.float32)
        limit, change = get_rate_limits(setup)
        steps = setup.steps // setup.repeat
        played = np.array([bound.act(seen)[0, 0] for _ in range(steps)])
        assert bound._base is not None  # as of every residual term
        sizes = 1.0 / observer.command[1], 1.0 / float(observer.per_rate[0])
        epoch = setup.repeat, setup.hold, setup.interval_s
        return cls(played, bound._base.scale, limit, change, *epoch, sizes)

    @property
    def decisions(self) -> int:
        return len(self.base)

    @property
    def judged(self) -> tuple[int, int]:
        """Judged epochs of a decision, and of the time to alert."""
        return self.repeat // self.every, self.hold // self.every

    def thin(self, bank: Bank) -> tuple[Bank, Self]:
        """A bank and a course of which some `JUDGED` epochs are judged."""
        most = max(bank.clean.shape[1] // JUDGED, 1)
        common = math.gcd(self.repeat, self.hold)
        every = max(k for k in range(1, most + 1) if common % k == 0)
        return bank.thin(every), self._replace(every=every)


class Receivers:
    """B receivers under attack, each in its own run of a bank, at its own decision."""

    def __init__(self, bank: Bank, course: Course, count: int) -> None:
        self.bank, self.course = bank, course
        self.row, self.at = np.zeros((2, count), dtype=np.intp)
        self.rate, self.moved, self.action, self.ratio = np.zeros((4, count))
        self.rates = np.zeros((count, course.decisions), dtype=np.float32)
        self.farthest = np.zeros((count, bank.clean.shape[1] + 1), dtype=np.float32)
        self.first_alarm = np.zeros(count, dtype=np.int64)
        self.amplitude = np.ones(count)

    def start(self, which: NDArray[np.intp], rows: NDArray[np.intp]) -> None:
        self.row[which], self.ratio[which] = rows, self.bank.onset_ratio[rows]
        for state in (self.at, self.rate, self.moved, self.action):
            state[which] = 0
        self.rates[which], self.farthest[which], self.first_alarm[which] = 0.0, 0.0, 0

    def observe(self) -> NDArray[np.float32]:
        done = self.at / self.course.decisions
        size = self.course.sizes
        own = np.stack([self.moved / size[0], self.rate / size[1]]) / self.amplitude
        seen = np.stack([*own, done, 1.0 - done, self.ratio], axis=1)
        return np.clip(seen, -MOST, MOST).astype(np.float32)

    def step(self, correction: FloatArray, which: NDArray[np.intp]) -> None:
        """Let some of them decide, and play to the next decision, the last one with the time to
        alert."""
        course, at = self.course, self.at[which]
        planned = np.clip(
            course.base[at] + course.scale * np.clip(correction, -1.0, 1.0), -1.0, 1.0
        )
        action = np.clip(self.amplitude[which] * planned, -1.0, 1.0)
        before = np.where(at > 0, self.rates[which, at - 1], 0.0)
        rate = np.clip(before + course.change_mps * action, -course.limit_mps, course.limit_mps)
        self.rates[which, at] = rate
        self._command(which, (rate - before) / course.change_mps)
        for decision in np.unique(at).tolist():
            mine = which[at == decision]
            for group in np.unique(self.bank.group[self.row[mine]]).tolist():
                self._judge(mine[self.bank.group[self.row[mine]] == group], group, decision)
        self.at[which] += 1

    def _command(self, which: NDArray[np.intp], action: FloatArray) -> None:
        """The commanded rate and displacement, by accelerations linear between decisions."""
        course, before, size = self.course, self.action[which], self.course.change_mps
        count = course.repeat
        part = np.arange(1, count + 1) / count
        each = before[:, None] + part * (action - before)[:, None]  # of change_mps a decision
        rates = self.rate[which, None] + np.cumsum(each, axis=1) * size / count
        last = np.concatenate([self.rate[which, None], rates[:, :-1]], axis=1)
        self.moved[which] += 0.5 * (rates + last).sum(axis=1) * course.epoch_s
        self.rate[which], self.action[which] = rates[:, -1], action

    def _judge(self, which: NDArray[np.intp], group: int, decision: int) -> None:
        course, bank, run = self.course, self.bank, self.row[which]
        each, hold = course.judged
        start, end = decision * each, (decision + 1) * each
        stop = end + (hold if decision + 1 == course.decisions else 0)
        rates = self.rates[which]  # 0 from the next decision on
        flat = rates @ bank.units[group, start:stop].reshape(-1, course.decisions).T
        apart = flat.reshape(len(which), stop - start, -1) + bank.clean[run, start:stop]
        square = np.square(apart)
        ratio = (square[..., 0::2] + square[..., 1::2]).max(axis=2)  # (b, k)
        moved = bank.moved[group, start:end].reshape(-1, course.decisions)
        north, east = np.moveaxis((rates @ moved.T).reshape(len(which), end - start, 2), 2, 0)
        farthest = np.maximum(np.hypot(north, east), self.farthest[which, start, None])
        self.farthest[which, start + 1 : end + 1] = np.maximum.accumulate(farthest, axis=1)
        self.ratio[which] = ratio[:, end - start - 1]
        alarm = ratio > 1.0
        first = np.where(alarm.any(axis=1), start + 1 + alarm.argmax(axis=1), 0)
        self.first_alarm[which] = np.where(self.first_alarm[which], self.first_alarm[which], first)

    def undetected_m(self, which: Any = slice(None)) -> FloatArray:
        """By the rule of the benchmark, of some that have alarmed or come to the end."""
        each, hold = self.course.judged
        error = self.farthest[which, 1 : 1 + self.course.decisions * each]
        return undetected_displacement(error.T, self.first_alarm[which], hold)


class BankBackend:
    """A bank for a search of open-loop attacks, as `ReplayBackend` is. Of long attacks it judges
    one epoch of several: the amplitude of what is found is fitted on all of them."""

    sums = True

    def __init__(self, bank: Bank, course: Course) -> None:
        self.runs, self.steps = len(bank.sky), course.decisions
        self.limits = course.limit_mps, course.change_mps
        few, thinned = course.thin(bank)
        self.moved = few.moved[:, : course.decisions * thinned.judged[0]]
        self.judged = LinearBank(
            few.clean.reshape(*few.clean.shape[:2], -1, 2),
            few.units.reshape(len(few.units), -1, course.decisions),
            bank.group,
        )

    def play(self, curves: FloatArray, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """(P, r) largest ratios of curves (P, D), and (P,) how far they get in the mean [m]."""
        peak = np.zeros((len(curves), len(rows)))
        for at, ratio in self.judged.judge(curves.T, rows):
            peak[:, at] = ratio.max(axis=0)
        groups, count = np.unique(self.judged.group[rows], return_counts=True)
        moved = self.moved[groups] @ curves.T.astype(np.float32)  # (G, K, 2, P)
        reach = np.hypot(moved[:, :, 0], moved[:, :, 1]).max(axis=1)
        return peak, np.average(reach, axis=0, weights=count)


class BankRuns:
    """Runs of a bank that a policy attacks, at any amplitude, for `trace_alarms`."""

    def __init__(self, bank: Bank, course: Course, policy: Policy) -> None:
        self.bank, self.course, self.policy = bank, course, policy
        self.sky, self.span = bank.sky, (SMALLEST, LARGEST)

    def run(self, values: Any, rows: NDArray[np.intp]) -> Receivers:
        """Some runs, each at one value or at its own, to the end."""
        own = Receivers(self.bank, self.course, len(rows))
        everyone = np.arange(len(rows))
        own.start(everyone, rows)
        own.amplitude[:] = values
        for _ in range(self.course.decisions):
            own.step(np.asarray(self.policy(own.observe()), dtype=np.float64)[:, 0], everyone)
        return own

    def play(self, value: float) -> tuple[Mask, dict[str, FloatArray]]:
        played = self.run(value, np.arange(len(self.sky)))
        return played.first_alarm > 0, {MEASURES[0]: played.undetected_m()}

    def sift(self, values: Sequence[float], count: int) -> Mask:
        rows = np.arange(0, len(self.sky), max(len(self.sky) // max(count, 1), 1))
        return np.array([self.run(value, rows).first_alarm > 0 for value in values])

    def alarms(self, values: FloatArray, rows: NDArray[np.intp]) -> Mask:
        return self.run(values, rows).first_alarm > 0


class BankVecEnv(VecEnv):
    """Receivers of a bank for stable-baselines3; an episode is a run of it, drawn, and ends by an
    alarm, which costs `price_m`.  Rewards are metres of undetected displacement.  Of long attacks
    one epoch of several is judged."""

    def __init__(
        self, bank: Bank, course: Course, num_envs: int, price_m: float, seed: int, blind: bool
    ) -> None:
        bank, course = course.thin(bank)
        self.seen = len(SEEN) - blind
        most = MOST[: self.seen].astype(np.float32)
        seen = spaces.Box(-most, most)
        self.price_m, self.render_mode = price_m, None
        super().__init__(num_envs, seen, spaces.Box(-1.0, 1.0, (1,)))
        self.receivers = Receivers(bank, course, num_envs)
        self.rng, self.everyone = np.random.default_rng(seed), np.arange(num_envs)
        self.reached = np.zeros(num_envs)

    def reset(self) -> NDArray[np.float32]:
        self._draw(self.everyone)
        return self.receivers.observe()[:, : self.seen]

    def _draw(self, which: NDArray[np.intp]) -> None:
        self.receivers.start(
            which, self.rng.integers(len(self.receivers.bank.sky), size=len(which))
        )
        self.reached[which] = 0.0

    def step_async(self, actions: NDArray[Any]) -> None:
        self.actions = np.asarray(actions, dtype=np.float64)[:, 0]

    def step_wait(self) -> Any:
        own, course = self.receivers, self.receivers.course
        own.step(self.actions, self.everyone)
        alarmed = own.first_alarm > 0
        now = own.farthest[self.everyone, own.at * course.judged[0]].astype(np.float64)
        if alarmed.any():
            now[alarmed] = own.undetected_m(alarmed)
        reward = now - self.reached - np.where(alarmed, self.price_m, 0.0)
        self.reached[:] = now
        over = alarmed | (own.at == course.decisions)
        seen, infos = own.observe()[:, : self.seen], [{} for _ in self.everyone]
        if over.any():
            for k in np.flatnonzero(over):
                infos[k] = {"terminal_observation": seen[k], "TimeLimit.truncated": False}
            self._draw(np.flatnonzero(over))
            seen = own.observe()[:, : self.seen]
        return seen, reward.astype(np.float32), over, infos

    def close(self) -> None: ...

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        raise NotImplementedError(f"receivers of a bank have no methods: {method_name}")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs
