"""What a tree of spoofgym does, recorded to the last bit: the child process of `tools.frozen`.

It runs with ``PYTHONPATH`` at the tree to be probed, reads one JSON request per line and answers
with one JSON line.  Only the public surface is used, and what is imported goes through the name
map, so that the same file probes trees of different insides; what is not there is an error.

A record has a column for every leaf of what a step returns.  The path of a column is a tuple of
keys, such as ``("info", "final_info", "cost")``; what a reset returns is under ``"reset"``.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

SEED = 20261121
STEPS, MILD_STEPS = 400, 325
BATCHES = (1, 3, 17)
MODES = ("next_step", "same_step", "disabled")
MAIN = "spoofgym/Zhong2025-v0"
SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 40.0, "time_to_alert_s": 2.0}
WORLDS = {"start_s": [0.0, 30.0], "turned_deg": [0.0, 360.0], "worlds": 2}
VARIANTS: dict[str, dict[str, Any]] = {
    "twin": {"twin": True},
    "watch": {"watch": ["snapshot-chi2", {"name": "cusum"}], "end_at_alarm": False},
    "domain": {"domain": WORLDS, "target_heading_deg": "random"},
    "oracle": {"knowledge": "oracle", "detector": {"name": "ewma", "false_alarm": 0.05}},
    "worst": {"target_heading_deg": "worst", "twin": True},
    "interval": {"decision_interval_s": 1.0, "between": "linear"},
    "tracking-1m": {"attack": "tracking-1m", "receiver": "matched", "scenario": "groves"},
    "meaconer": {"attack": "meaconer", "detector": {"name": "cusum"}},
}
"""Settings of the main id that change what is simulated, in short episodes."""
DRAWN = {
    **{"start_s": [0.0, None], "turned_deg": [0.0, 360.0], "constellation_time_s": [0.0, 86_400.0]},
    **{"worlds": 32, "turn_on": "drawn"},
}
GAME = {"scenario": "trolley", "receiver": "matched", "domain": DRAWN, "timeline": SHORT}
DUELS: dict[str, dict[str, Any]] = {
    "": {},
    "+weighted": {"payoff": "weighted", "threshold": 0.7, **GAME},
    "+channel": {"statistic": "channel", **GAME, "threshold": 0.9},
    "+interval": {"decision_interval_s": 1.0, "between": "linear", **GAME},
    "+domain": {**GAME, "domain": WORLDS, "target_heading_deg": "random"},
}
TURNS = {"spoofer_0": 0, "detector_0": 2}
"""As which receiver of a batch an agent of the duel acts."""
NO_SB3 = ("DetectorView", "SpooferView", "LooselyCoupled", "Snapshot", "WheeledRobot")
"""Ids that stable-baselines3's adapter does not make."""
IMPORTS = {
    "sb3": "spoofgym.sb3:SpoofVecEnv",
    "aec": "spoofgym.duel_v0:env",
    "parallel": "spoofgym.duel_v0:parallel_env",
    "register": "spoofgym:__name__",
    "evaluate": "spoofgym:evaluate",
    "default_rate": "spoofgym.detectors.calibrated:DEFAULT_RATE",
    "own_calibrations": "spoofgym.detectors.calibration:FOLDER_VARIABLE",
}
"""What is imported or patched, by use; the name map may give other places in the new tree, and
other options of commands."""
TIMES = "--scenario zhong2025 --warmup-s 20 --live-s 10 --attack-s 20 --time-to-alert-s 5"
BENCH = (
    f"spoofgym bench --json --training-seeds 16 --budget 0.25 --selection-seeds 0 {TIMES} "
    "--set domain={} --nominal --detector ewma --spoofer none --spoofer ramp:rate_mps=tuned "
    "--out results"
)
COMMANDS = {
    ("list", ""): "spoofgym list --json",
    ("bench", ""): f"{BENCH} --seeds 20 --detector snapshot-chi2 --spoofer step:size_m=30",
    ("bench", "killed"): f"{BENCH} --seeds 8",
    ("bench", "shipped"): (
        "spoofgym bench --json --seeds 4 --training-seeds 16 --budget 0.25 --selection-seeds 0 "
        "--scenario zhong2025 --set domain={} --detector ewma --spoofer none "
        "--spoofer ramp:rate_mps=0.2 --out results"
    ),
    ("run", ""): (
        f"spoofgym run --json --no-picture {TIMES} --spoofer step "
        "--detector snapshot-chi2:thresholds=nominal"
    ),
    ("run", "shipped"): (
        "spoofgym run --json --no-picture --scenario zhong2025 --spoofer ewma-ppo --detector ewma"
    ),
    ("calibrate", ""): (
        f"spoofgym calibrate --json {TIMES} --false-alarms-per-hour 20 --detector snapshot-chi2 "
        "--detector cusum --runs 40 --hold-out 40 --transfer groves --check"
    ),
    ("dataset", ""): (
        f"spoofgym dataset data --json {TIMES} --train 3 --validation 2 --test 2 "
        "--term innovation --term in-view"
    ),
    ("limits", ""): (
        f"spoofgym limits --json {TIMES} --set domain={{}} --nominal --detector snapshot-chi2 "
        "--detector raim --spoofer ramp"
    ),
    ("game", ""): (
        "spoofgym game --json --task T3 --detector snapshot-chi2 --detector ewma --spoofer none "
        "--spoofer ramp:rate_mps=0.2 --runs 4 --out results"
    ),
    ("paper", ""): "baselines.papers wu2024 --quick --json --out results",
}
"""Command lines that print JSON, by id and form; they run where users have calibrated nothing."""
CELLS = (".jsonl", ".npz")
"""Suffixes of the files of finished cells."""
PUBLISHED = {"name": "snapshot-chi2", "thresholds": "nominal"}
CALLS: dict[tuple[str, str], tuple[str, dict[str, Any]]] = {
    ("evaluate", ""): (
        "ramp",
        {"detector": PUBLISHED, "timeline": SHORT, "runs": 6, "fit_runs": 64},
    ),
    ("evaluate", "shipped"): ("solution-separation-ppo", {"task": "T3", "runs": 4, "fit_runs": 59}),
}
"""Functions of the package, by id and form: what they are asked about, and how."""
SHIPPED = (MAIN, "spoofgym/BenchT3-v1")
"""Ids that are played with the thresholds that users have, too; else they are as published."""
Array = np.ndarray[Any, Any]
Path_ = tuple[str, ...]


class Case(NamedTuple):
    """One thing that is played."""

    id: str
    form: str
    batch: int | None = None

    @property
    def name(self) -> str:
        """As ``--only`` takes it."""
        parts = (self.id.removeprefix("spoofgym/"), self.form, self.batch)
        return "/".join(str(part) for part in parts if part not in (None, ""))

    @property
    def base(self) -> str:
        """Id without the name of a variant."""
        return self.id.partition("+")[0]


def list_cases(ids: list[str]) -> list[Case]:
    """Every case of a tree with these ids."""
    made = []
    for name in ids:
        made += [Case(name, "single")]
        made += [Case(name, mode, b) for mode in MODES for b in BATCHES]
        if not name.removeprefix("spoofgym/").startswith(NO_SB3):
            made += [Case(name, "sb3", b) for b in BATCHES]
    for name in VARIANTS:
        made += [Case(f"{MAIN}+{name}", form) for form in ("single",)]
        made += [Case(f"{MAIN}+{name}", form, 3) for form in ("same_step", "sb3")]
    made += [Case(f"duel_v0{name}", form) for name in DUELS for form in ("parallel", "aec")]
    made += [Case(name, "shipped") for name in SHIPPED]
    return [*made, *(Case(*each) for each in (*COMMANDS, *CALLS))]


# --- records ---------------------------------------------------------------------------------


class Record:
    """Columns of values over steps; -1 is what comes before the first step."""

    def __init__(self) -> None:
        self.steps: dict[Path_, list[int]] = {}
        self.values: dict[Path_, list[Array]] = {}
        self.types: dict[Path_, set[str]] = {}
        self.names: dict[str, list[str]] = {}
        self.ends = 0

    def add(self, step: int, path: Path_, value: Any) -> None:
        """Keep a value, or the leaves of a mapping or a list of other things than numbers."""
        if is_dataclass(value):
            value = {each.name: getattr(value, each.name) for each in fields(value)}
        if isinstance(value, Mapping):
            for key, part in value.items():
                self.add(step, (*path, str(key)), part)
        elif isinstance(value, list | tuple) or _holds_objects(value):
            for label, part in _label_elements(value):
                self.add(step, (*path, label), part)
        else:
            array = np.array(str(value) if value is None else value)
            kind = type(value).__name__
            if array.dtype == object:
                raise TypeError(f"{path} is {value!r}, which has no bits to compare")
            # a column has one type and one shape; another makes another column
            other = path in self.values and (
                self.values[path][0].shape != array.shape
                or self.values[path][0].dtype.kind != array.dtype.kind
            )
            path = (*path[:-1], f"{path[-1]} {array.dtype.kind}{array.shape}") if other else path
            self.steps.setdefault(path, []).append(step)
            self.values.setdefault(path, []).append(array)
            self.types.setdefault(path, set()).add(kind)

    def save(self, file: Path) -> None:
        """Write all columns into one ``.npz``, complete or not at all."""
        columns = [
            {"path": path, "steps": self.steps[path], "types": sorted(self.types[path])}
            for path in self.values
        ]
        about = {"columns": columns, "names": self.names, "ends": self.ends}
        part = file.with_suffix(f".{os.getpid()}.npz")
        arrays = {f"c{i}": np.array(self.values[path]) for i, path in enumerate(self.values)}
        np.savez_compressed(part, about=np.array(json.dumps(about)), **arrays)
        part.replace(file)


def _holds_objects(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype == object


def _label_elements(values: Any) -> Iterator[tuple[str, Any]]:
    """Elements with their place, or with their own names where all of them have one."""
    named = all(isinstance(value, Mapping) and "name" in value for value in values)
    for i, value in enumerate(values):
        if value is not None or not _holds_objects(values):
            yield f"[{value['name'] if named else i}]", value


# --- play ------------------------------------------------------------------------------------


def place(name: str) -> tuple[Any, str]:
    """Module and attribute of a ``module:attribute``; an error where it is not there."""
    module, _, attribute = name.partition(":")
    owner = importlib.import_module(module)
    if not hasattr(owner, attribute):
        raise AttributeError(f"there is no {name}: say in [imports] of the name map where it is")
    return owner, attribute


class Player:
    """Actions of one case, and its record."""

    def __init__(self, case: Case, imports: Mapping[str, str]) -> None:
        self.case, self.imports = case, {**IMPORTS, **imports}
        self.record = Record()
        self.rng = np.random.default_rng(SEED)

    def load(self, use: str) -> Any:
        """Something of the package, by its use."""
        return getattr(*place(self.imports[use]))

    def action(self, step: int, shape: tuple[int, ...], turn: int = 0) -> Array:
        """Receivers take turns: a whole mild episode then a hard push, random, pushes in between.

        So episodes last until their time is over, or are ended by an alarm.
        """
        rows = np.arange(shape[0])[:, None] if len(shape) > 1 else np.array(turn)
        ramp, push = np.zeros(shape), np.ones(shape)
        ramp[..., 1 % shape[-1]] = 0.02
        push[..., 0] = step % 20 == 0  # a detector's statistic: an alarm at every step takes long
        first = ramp if step < MILD_STEPS else push
        third = push if step // 40 % 2 else ramp
        chosen = np.choose(rows % 3, [first, self.rng.uniform(-1.0, 1.0, shape), third])
        return chosen.astype(np.float32)

    def describe(self, env: Any, observation: Any, action: Any) -> None:
        """Spaces, and the names of their elements."""
        for name, space in (("observation", observation), ("action", action)):
            for bound in ("low", "high"):
                self.record.add(-1, ("space", name, bound), getattr(space, bound))
            names = getattr(env, f"{name}_names", None)
            if names is not None:
                self.record.names[name] = list(names)

    def keep(self, step: int, *result: Any) -> None:
        """What a step returned."""
        keys = ("observation", "reward", "terminated", "truncated", "info")
        for key, value in zip(keys, result, strict=True):
            self.record.add(step, (key,), value)

    def keep_reset(self, step: int, observation: Any, info: Any) -> None:
        """What a reset returned."""
        self.record.add(step, ("reset", "observation"), observation)
        self.record.add(step, ("reset", "info"), info)

    def settings(self) -> dict[str, Any]:
        """Of a variant."""
        _, _, variant = self.case.id.partition("+")
        return {"timeline": SHORT, **VARIANTS[variant]} if variant else {}

    def play(self) -> Record:
        """Play the case."""
        plays: dict[str, Callable[[], None]] = {
            "single": self.single,
            "sb3": self.sb3,
            "parallel": self.parallel,
            "aec": self.aec,
            **dict.fromkeys(MODES, self.vector),
        }
        self.load("register")
        key = self.case.id, self.case.form
        usual = key in COMMANDS or key in CALLS or key[1] == "shipped"
        set_thresholds(self.imports, usual=usual)
        if key in COMMANDS:
            self.command(COMMANDS[key])
        elif key in CALLS:
            what, settings = CALLS[key]
            self.record.add(-1, ("score",), self.load(key[0])(what, **settings))
        else:
            plays.get(key[1], self.single)()
        return self.record

    def single(self) -> None:
        """Play the single environment."""
        import gymnasium as gym

        env = gym.make(self.case.base, disable_env_checker=True, **self.settings()).unwrapped
        self.describe(env, env.observation_space, env.action_space)
        self.keep_reset(-1, *env.reset(seed=SEED))
        for step in range(STEPS):
            result = env.step(self.action(step, env.action_space.shape or ()))
            self.keep(step, *result)
            if result[2] or result[3]:
                self.record.ends += 1
                self.keep_reset(step, *env.reset())
        env.close()

    def vector(self) -> None:
        """Play the vector environment."""
        import gymnasium as gym

        mode = self.case.form
        given = {"autoreset_mode": mode, **self.settings()}
        env = gym.make_vec(self.case.base, num_envs=self.case.batch or 1, **given).unwrapped
        self.describe(env, env.single_observation_space, env.single_action_space)
        self.keep_reset(-1, *env.reset(seed=SEED))
        for step in range(STEPS):
            result = env.step(self.action(step, env.action_space.shape or ()))
            self.keep(step, *result)
            over = result[2] | result[3]
            self.record.ends += int(over.sum())
            if mode == "disabled" and over.any():
                self.keep_reset(step, *env.reset(options={"reset_mask": over.copy()}))
        env.close()

    def sb3(self) -> None:
        """Play stable-baselines3's vector environment."""
        import gymnasium as gym

        given = {**(gym.spec(self.case.base).kwargs or {}), **self.settings()}
        if "pool" in given:
            given["detector"] = {"name": "pool", "members": given.pop("pool")}
        env = self.load("sb3")(self.case.batch, seed=SEED, infos="all", **given)
        self.describe(env, env.observation_space, env.action_space)
        self.record.add(-1, ("reset", "observation"), env.reset())
        shape = (env.num_envs, *env.action_space.shape)
        for step in range(STEPS):
            observation, reward, done, infos = env.step(self.action(step, shape))
            self.keep(step, observation, reward, done, False, {})
            for row, info in enumerate(infos):
                stamped = dict(info)
                if "episode" in stamped:  # its time is that of the clock
                    stamped["episode"] = {k: v for k, v in info["episode"].items() if k != "t"}
                self.record.add(step, ("info", f"[{row}]"), stamped)
            self.record.ends += int(done.sum())
        env.close()

    def parallel(self) -> None:
        """Play the duel's parallel form."""
        env = self.load("parallel")(**DUELS[self.case.id.removeprefix("duel_v0")])
        self._describe_duel(env)
        self.keep_reset(-1, *env.reset(seed=SEED))
        for step in range(STEPS):
            actions = {
                agent: self.action(step, env.action_space(agent).shape, TURNS[agent])
                for agent in env.agents
            }
            self.keep(step, *env.step(actions))
            if not env.agents:
                self.record.ends += 1
                self.keep_reset(step, *env.reset())
        env.close()

    def aec(self) -> None:
        """Play the duel's form with turns."""
        env = self.load("aec")(**DUELS[self.case.id.removeprefix("duel_v0")])
        self._describe_duel(env)
        env.reset(seed=SEED)
        for turn in range(2 * STEPS):
            agent, result = env.agent_selection, env.last()
            for key, value in zip(
                ("observation", "reward", "terminated", "truncated", "info"), result, strict=True
            ):
                self.record.add(turn // 2, (key, agent), value)
            over = result[2] or result[3]
            shape = env.action_space(agent).shape
            env.step(None if over else self.action(turn // 2, shape, TURNS[agent]))
            if not env.agents:
                self.record.ends += 1
                env.reset()
        env.close()

    def _describe_duel(self, env: Any) -> None:
        for agent in env.possible_agents:
            spaces = {
                "observation": env.observation_space(agent),
                "action": env.action_space(agent),
            }
            for name, space in spaces.items():
                for bound in ("low", "high"):
                    self.record.add(-1, ("space", agent, name, bound), getattr(space, bound))

    def command(self, line: str) -> None:
        """Run a command line, which prints JSON; of a data set, keep what its files hold."""
        with tempfile.TemporaryDirectory() as folder:
            printed = self.finish(self.start(line, Path(folder, "whole")))
            if self.case.form == "killed":
                again = Path(folder, "again")
                self.kill(self.start(line, again), again / "results")
                resumed = self.finish(self.start(line, again))
                if resumed != printed:
                    raise RuntimeError("killed and resumed, it prints another JSON than at once")
            self.record.add(-1, ("json",), json.loads(printed.replace(folder, "")))
            if self.case.id == "dataset":
                for i, file in enumerate(sorted(Path(folder).rglob("*.npz"))):
                    with np.load(file) as members:
                        names = [n for n in members if n != "digest" and not n.endswith(".json")]
                        arrays = {name: members[name] for name in names}
                        self.record.add(-1, ("npz", f"[{i}]"), arrays)

    def start(self, line: str, folder: Path) -> subprocess.Popen[str]:
        """Start a command in a folder, without calibrations of the user's own."""
        folder.mkdir(exist_ok=True)
        return subprocess.Popen(
            [sys.executable, "-m", *(self.imports.get(word, word) for word in line.split())],
            cwd=folder,
            env={**os.environ, self.load("own_calibrations"): str(folder / "own")},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def finish(self, child: subprocess.Popen[str]) -> str:
        """What a command prints."""
        printed, told = child.communicate()
        if child.returncode:
            raise RuntimeError(f"{self.case.name} exits with {child.returncode}: {told}")
        return printed

    def kill(self, child: subprocess.Popen[str], results: Path) -> None:
        """Kill a command as soon as a finished cell is there."""
        while child.poll() is None and not any(file.suffix in CELLS for file in results.rglob("*")):
            time.sleep(0.002)
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
        _, told = child.communicate()
        if child.returncode != -signal.SIGKILL:
            raise RuntimeError(f"{self.case.name} ended before it was killed: {told}")


# --- speed -----------------------------------------------------------------------------------


class Speed(NamedTuple):
    """What is timed: steps of one kind, without their resets unless they are `whole` episodes.

    `batch` None is the single environment.  Times of one thread are of the processor, those of
    several are of the clock.
    """

    kind: str
    batch: int | None
    threads: int = 1
    steps: int = 140
    episodes: int = 1

    @property
    def whole(self) -> bool:
        """Whether resets with their warm-up count, as in training."""
        return self.kind == "episodes"

    @property
    def clock(self) -> str:
        """Time that counts."""
        return "cpu" if self.threads == 1 else "wall"


SPEEDS = {
    "engine 1": Speed("engine", None, episodes=10),
    "engine 64": Speed("engine", 64, episodes=2),
    "engine 256": Speed("engine", 256),
    "engine 1024": Speed("engine", 1024, steps=60),
    "engine 256, 2 threads": Speed("engine", 256, threads=2),
    "single env": Speed("env", None, episodes=10),
    "vector env 64": Speed("env", 64, episodes=2),
    "vector env 256": Speed("env", 256),
    "episodes 256, 2 threads": Speed("episodes", 256, threads=2, steps=302),
}
SPEED_SETTINGS: dict[str, Any] = {
    "action": "full-command",  # the same work whatever the default is
    "scenario": {"name": "zhong2025", "epoch_interval_s": 1.0},
    "detector": "ewma",
    "end_at_alarm": False,
}
SOON = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 170.0}
"""Where resets do not count, they are short; 20 steps pass before the time is taken."""


class Stopwatch:
    """Seconds a step of environments that are made once."""

    def __init__(self) -> None:
        self._envs: dict[Speed, Any] = {}

    def _env(self, speed: Speed) -> Any:
        if speed not in self._envs:
            import gymnasium as gym

            given = {**SPEED_SETTINGS} if speed.whole else {**SPEED_SETTINGS, "timeline": SOON}
            if speed.batch is None:
                made: Any = gym.make(MAIN, disable_env_checker=True, **given)
            else:
                given |= {"threads": speed.threads, "prefetch": speed.whole}
                made = gym.make_vec(MAIN, num_envs=speed.batch, **given)
            self._envs[speed] = made.unwrapped
            if speed.whole:  # its episodes follow one another from round to round
                made.reset(seed=SEED)
        return self._envs[speed]

    def round(self, what: str) -> dict[str, float]:
        """Seconds a step over one round, by both clocks."""
        speed = SPEEDS[what]
        env = self._env(speed)
        action = np.zeros(env.action_space.shape, dtype=np.float32)
        step: Callable[[], Any] = lambda: env.step(action)  # noqa: E731
        if speed.kind == "engine":
            engine = env.core.engine
            command = np.zeros((speed.batch or 1, len(env.core.setup.action_names)))
            step = lambda: engine.step(command)  # noqa: E731
        wall = cpu = 0.0
        for episode in range(speed.episodes):
            if not speed.whole:
                env.reset(seed=SEED + episode)
                for _ in range(20):
                    step()
            start = time.perf_counter(), time.process_time()
            for _ in range(speed.steps):
                step()
            wall += time.perf_counter() - start[0]
            cpu += time.process_time() - start[1]
        count = speed.steps * speed.episodes
        return {"wall": wall / count, "cpu": cpu / count}


# --- requests --------------------------------------------------------------------------------


def answer(request: dict[str, Any], stopwatch: Stopwatch) -> dict[str, Any]:
    """Answer to one request."""
    imports = {**IMPORTS, **request["imports"]}
    if request["do"] == "cases":
        import gymnasium as gym

        package, _ = place(imports["register"])
        ids = sorted(name for name in gym.registry if name.startswith("spoofgym/"))
        return {"cases": list_cases(ids), "package": package.__file__}
    if request["do"] == "run":
        start = time.perf_counter()
        record = Player(Case(*request["case"]), imports).play()
        record.save(Path(request["out"]))
        return {"ends": record.ends, "seconds": time.perf_counter() - start}
    set_thresholds(imports, usual=False)
    return stopwatch.round(request["what"])


USUAL: dict[str, Any] = {}
"""What has been replaced, by its place."""


def set_thresholds(imports: Mapping[str, str], *, usual: bool) -> None:
    """Let detectors without a word on their thresholds have those as published, or the usual ones.

    The usual ones are those that are shipped, as the folder of the user's own is an empty one.
    """
    where = imports["default_rate"]
    owner, attribute = place(where)
    rate = USUAL.setdefault(where, getattr(owner, attribute))
    setattr(owner, attribute, rate if usual else None)
    os.environ[getattr(*place(imports["own_calibrations"]))] = str(Path.cwd() / "own")


def main() -> None:
    """Answer requests until there are no more."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the package prints is no answer
    warnings.simplefilter("ignore")
    stopwatch = Stopwatch()
    for line in sys.stdin:
        try:
            reply = answer(json.loads(line), stopwatch)
        except Exception as error:
            reply = {
                "error": f"{type(error).__name__}: {error}",
                "traceback": traceback.format_exc(),
            }
        replies.write(json.dumps(reply) + "\n")
        replies.flush()


if __name__ == "__main__":
    main()
