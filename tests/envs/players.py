"""One way to play every form of an environment: transitions of its receivers, one by one."""

from __future__ import annotations

import importlib.util
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.detectors import Detector, DetectorContext, Verdict
from spoofgym.envs.factory import DEFAULT_ID
from spoofgym.receiver.epoch import Epoch
from spoofgym.tasks import DEFAULT_TASK, TASKS

from ..duel.support import GAME, ONE_SKY
from .support import ID, SMALL, VICTIMS

IDS = sorted(name for name in gym.registry if name.startswith("spoofgym/"))
MODES = ("next_step", "same_step", "disabled")
VICTIM_IDS = tuple(f"spoofgym/{kind}-v0" for kind in VICTIMS)
SMALL_IDS = tuple(f"spoofgym/{kind}-v0" for kind in SMALL)
DUELS = {"AEC duel": "env", "parallel duel": "parallel_env"}
COUNT = 3
SHORT = {"warmup_s": 8.0, "live_s": 5.0, "attack_s": 10.0, "time_to_alert_s": 2.0}
FEW_WORLDS = {"start_s": [0.0, 30.0], "turned_deg": [0.0, 360.0], "worlds": 2}
PLANT = {"warmup_s": 10, "live_s": 10, "attack_s": 24, "time_to_alert_s": 5}
DRAWN = {"timeline": SHORT, "scenario": "trolley", "domain": FEW_WORLDS}
AGED = {**DRAWN, "decision_interval_s": 2.0, "domain": {**FEW_WORLDS, "age_s": [8.0, 16.0]}}
SETTINGS: dict[str, dict[str, Any]] = {
    **{f"spoofgym/BenchD{k}-v1": DRAWN for k in range(1, 5)},
    **{f"spoofgym/Bench{side}{k}-v2": AGED for side in "SD" for k in range(1, 4)},
    "spoofgym/DetectorView-v0": {**GAME, "timeline": SHORT, "domain": ONE_SKY},
    "spoofgym/SpooferView-v0": {**GAME, "timeline": SHORT, "domain": ONE_SKY},
    "spoofgym/TightlyCoupled-v0": AGED,
    "spoofgym/BenchT4-v1": {
        "timeline": {**SHORT, "warmup_s": 10.0, "attack_s": 60.0},
        "scenario": "trolley-tactical",
    },
    "spoofgym/BenchT5-v1": {"timeline": SHORT, "domain": FEW_WORLDS},
    "spoofgym/Offsets-v0": {
        **{"timeline": SHORT, "decision_interval_s": 1.0, "detector": "ewma"},
        **{"scenario": "zhong2025", "receiver": "paper", "domain": None},
    },
    "spoofgym/LooselyCoupled-v0": {
        "timeline": {"warmup_s": 1.0, "live_s": 1.0, "attack_s": 2.4, "time_to_alert_s": 0.5},
        "detector": {"name": "windowed-chi2", "window": 8},
    },
    "spoofgym/Snapshot-v0": {"timeline": PLANT},
    "spoofgym/WheeledRobot-v0": {"timeline": PLANT},
}


class Sooner(Detector):
    """Alarms when the first measurement has been large for a time that differs by receiver."""

    paper = "groves2013"
    measures = "any"
    needs = frozenset({"pseudorange"})

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self.memory.declare("total", np.zeros(context.receivers))

    def judge(self, epoch: Epoch) -> Verdict:
        measured = epoch.pseudorange if epoch.visible.shape[1] else epoch.innovation
        self.memory["total"] = self.memory["total"] + np.abs(measured[:, 0] * 1e3) % 1.0
        statistic = self.memory["total"][:, None].copy()
        threshold = np.full_like(statistic, 16.0)
        return Verdict(statistic, threshold, statistic > threshold)


NOMINAL: dict[str, dict[str, Any]] = {}
"""Whom the spoofer of a task meets, for episodes of lengths that nothing is calibrated for."""
for task in TASKS.values():
    met = [{k: x for k, x in spec.items() if not k.endswith("hour")} for spec in task.detectors]
    plain = [{**spec, "thresholds": "nominal"} for k, spec in enumerate(met) if spec not in met[:k]]
    NOMINAL[task.env_id] = {"pool": plain} if task.pooled else {"detector": plain[0]}
NOMINAL[DEFAULT_ID] = NOMINAL[TASKS[DEFAULT_TASK].env_id]


def short(name: str, **settings: Any) -> dict[str, Any]:
    return {**SETTINGS.get(name, {"timeline": SHORT}), **NOMINAL.get(name, {}), **settings}


def early(name: str, **settings: Any) -> dict[str, Any]:
    """The same with episodes that end early, and at different times, where there is no pool."""
    pooled = "View" in name or "pool" in gym.spec(name).kwargs
    return short(name, **({} if pooled else {"detector": Sooner()}), **settings)


def forms_of(name: str) -> tuple[str, ...]:
    """Forms of an id; the adapter of stable-baselines3 has the tightly coupled receiver alone."""
    adapter = gym.spec(name).entry_point == gym.spec(ID).entry_point
    return ("single", *MODES, *(("SB3",) if adapter else ()))


def make(name: str, form: str, count: int = COUNT, **settings: Any) -> Any:
    if form == "single":
        return gym.make(name, **settings)
    if form in MODES:
        return gym.make_vec(name, num_envs=count, autoreset_mode=form, **settings)
    if form == "SB3":
        pytest.importorskip("stable_baselines3")
        from spoofgym.sb3 import SpoofVecEnv

        return SpoofVecEnv(count, env_id=name, infos="all", torch_threads=None, **settings)
    if importlib.util.find_spec("pettingzoo") is None:
        pytest.skip("the duel needs pettingzoo")
    return getattr(duel_v0, DUELS[form])(**settings)


def action_of(receiver: int, step: int, shape: tuple[int, ...], push: float = 0.2) -> np.ndarray:
    """An action that depends on the receiver and the number of its step alone."""
    return (push * np.sin(step + receiver + np.arange(shape[0]))).astype(np.float32)


class Player:
    """An environment, and what its receivers have gone through: starts and steps, one by one.

    A start holds `seen` and `info`; a step also `reward`, `terminated` and `truncated`, and the
    last one of an episode is what was handed out as final.
    """

    def __init__(self, env: Any, form: str, first: int = 0, push: float = 0.2) -> None:
        self.env, self.form, self.first, self.push = env, form, first, push
        self.count = getattr(env, "num_envs", 1)
        self.rows: list[list[dict[str, Any]]] = [[] for _ in range(self.count)]
        self.told = [0] * self.count
        self.steps = np.zeros(self.count, dtype=int)
        self.due, self.over = np.zeros_like(self.steps), np.zeros(self.count, dtype=bool)
        self.advance = {"single": self._single, "SB3": self._adapted}.get(form, self._vector)

    def begin(self, seed: int) -> Player:
        self.rows, self.told = [[] for _ in range(self.count)], [0] * self.count
        self.steps[:], self.due[:], self.over[:] = 0, 0, False
        if self.form == "single":
            self._start(0, *self.env.reset(seed=seed))
        elif self.form in MODES:
            observation, info = self.env.reset(seed=seed)
            for i in range(self.count):
                self._start(i, observation[i], of_row(info, i))
        else:
            self.env.seed(seed)
            for i, observation in enumerate(self.env.reset()):
                self._start(i, observation, None)
        return self

    def go(self, steps: int) -> list[list[dict[str, Any]]]:
        """Run so many steps of every receiver; these, and what has started before and between."""
        self.due += steps
        while (self.steps < self.due).any():
            self.advance()
        found = []
        for i, row in enumerate(self.rows):
            left, end = steps, self.told[i]
            while left:
                left -= "reward" in row[end]
                end += 1
            found.append(row[self.told[i] : end])
            self.told[i] = end
        return found

    def _start(self, i: int, seen: Any, info: Any) -> None:
        self.rows[i].append({"seen": np.array(seen), "info": info})

    def _step(self, i: int, seen: Any, reward: Any, ends: tuple[Any, Any], info: Any) -> None:
        row = {"seen": np.array(seen), "reward": reward, "terminated": bool(ends[0])}
        self.rows[i].append({**row, "truncated": bool(ends[1]), "info": info})
        self.steps[i] += 1

    def _actions(self, shape: tuple[int, ...]) -> np.ndarray:
        each = enumerate(self.steps, self.first)
        return np.stack([action_of(i, k, shape, self.push) for i, k in each])

    def _single(self) -> None:
        env = self.env
        seen, reward, *ends, info = env.step(self._actions(env.action_space.shape)[0])
        self._step(0, seen, reward, (ends[0], ends[1]), info)
        if any(ends):
            self._start(0, *env.reset())

    def _vector(self) -> None:
        envs, before = self.env, self.over.copy()
        seen, reward, terminated, truncated, info = envs.step(
            self._actions(envs.single_action_space.shape)
        )
        self.over = terminated | truncated
        final = self.over if self.form == "same_step" else np.zeros(self.count, dtype=bool)
        for i in range(self.count):
            if self.form == "next_step" and before[i]:
                assert (reward[i], terminated[i], truncated[i]) == (0.0, False, False)
                self._start(i, seen[i], of_row(info, i))
                continue
            last, told = (info["final_obs"], info["final_info"]) if final[i] else (seen, info)
            ends = terminated[i], truncated[i]
            self._step(i, last[i], reward[i].item(), ends, of_row(told, i))
            if final[i]:
                self._start(i, seen[i], of_row(info, i))
        if self.form == "disabled" and self.over.any():
            seen, info = envs.reset(options={"reset_mask": self.over})
            for i in np.flatnonzero(self.over):
                self._start(i, seen[i], of_row(info, i))
            self.over[:] = False

    def _adapted(self) -> None:
        seen, reward, over, infos = self.env.step(self._actions(self.env.action_space.shape))
        for i, info in enumerate(infos):
            last = info.pop("terminal_observation") if over[i] else seen[i]
            truncated = info.pop("TimeLimit.truncated", False)
            assert ("episode" in info) == over[i]
            info.pop("episode", None)
            self._step(i, last, reward[i].item(), (over[i] and not truncated, truncated), info)
            if over[i]:
                self._start(i, seen[i], None)


def of_row(info: dict[str, Any], i: int) -> dict[str, Any]:
    """What a vector environment tells of one receiver, by its masks."""
    names = [n for n in info if not n.startswith("_") and n not in ("final_obs", "final_info")]
    return {name: info[name][i] for name in names if info[f"_{name}"][i]}


def assert_same(one: Any, other: Any, where: str = "") -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key, value in one.items():
            assert_same(value, other[key], f"{where} {key}")
    elif isinstance(one, list | tuple) or (isinstance(one, np.ndarray) and one.dtype == object):
        for k, (mine, theirs) in enumerate(zip(one, other, strict=True)):
            assert_same(mine, theirs, f"{where} {k}")
    else:
        np.testing.assert_array_equal(one, other, err_msg=where)
