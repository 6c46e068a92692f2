"""Double oracle: populations of spoofers and detectors that grow by best responses to mixes.

    python -m train.double_oracle --task T3 --out runs/game

What happens (`mcmahan2003`, `lanctot2017`):

1. The game starts with all detectors that are calibrated in the world of the task, at one rate of
   false alarms, and with the best attack of every scripted family against an even mix of them.
2. In every iteration all pairs play the runs of the split `game`, the matrix is solved, and both
   sides look for a best response to the mix of the other, with the same budget each time: among
   all families and detectors, and what `--ppo-steps` and `--detector-command` let learn.  Nobody
   is ever removed.
3. Both responses are scored against the mixes on the split `evaluation`, which decides nothing:
   that is the exploitability from below.
4. At the end the mix of detectors and the best single one each meet the best response to them, on
   the same fresh runs.  That a single detector solves the game is a valid result.

The folder gets `results.json` and the page `game.md`, and has the pairs in `entries/`.  After a
kill the same command goes on, to the same result.
"""

from __future__ import annotations

import dataclasses
import json
import shlex
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from agents.folder import Part, Records, error_lines, learning_versions, write_json
from agents.game_page import write_page
from spoofgym.bench.experiments.best_response import (
    AttackBudget,
    BestResponse,
    best_detector,
    best_spoofer,
    exploitability,
)
from spoofgym.bench.experiments.calibration import calibrate
from spoofgym.bench.experiments.game import Game
from spoofgym.bench.experiments.suite import list_task_detectors
from spoofgym.bench.runs.players import DETECTOR, SPOOFER, Mixture, PlayerSpec, make_player, mixture
from spoofgym.bench.runs.world import CONTROLS
from spoofgym.bench.scores.matrix_game import PAYOFFS, PayoffMatrix
from spoofgym.bench.search.open_loop import OpenLoopSearch
from spoofgym.core.files import write_file
from spoofgym.core.progress import ProgressBar, show_progress
from spoofgym.core.registry import check_choice, parse_spec, whole_number
from spoofgym.detectors import detector_in_world
from spoofgym.detectors.build import THRESHOLD_KEYS
from spoofgym.detectors.calibrated import STANDARD_RATE
from spoofgym.tasks import ALARM_PRICE, get_task

RESULTS, PAGE = "results.json", "game.md"
RESPONSES = ("none", "learned")
NUM_ENVS, LOG_STD = 32, -1.5
"""Of PPO, which decides as seldom as in `train.ppo_spoofer`; the rest are the defaults of
stable-baselines3, with gamma 1."""
AMPLITUDES = (0.5, 0.7, 1.0)
"""Factors on the commands of a learned policy that are tried."""


@dataclass(frozen=True)
class Arguments:
    """Settings of a game; all but `threads` belong to its identity."""

    out: Path  # Folder of the game.
    task: str = "T3"  # Task whose world and alert limit are taken, T1 to T6.
    iterations: int = 3  # Matrices that are solved; the first one is that of the start.
    detectors: tuple[str, ...] = ()  # As name:key=value or JSON; default: all with a calibration.
    false_alarms_per_hour: float = STANDARD_RATE  # Rate of all detectors.
    payoff: str = "stealth"  # What a run is worth: stealth or hmi.
    limit_m: float = 0.0  # Alert limit in place of the task's; 0 for that.
    runs: int = 200  # Runs of the matrix, and as many fresh ones.
    selection_runs: int = 96  # Runs that decide on best responses.
    sift_runs: int = 32  # How many of them play all candidates.
    values: int = 8  # Values of every family's setting that are tried.
    search_runs: int = 64  # Runs of the search for optimized open-loop attacks; 0 for no search.
    generations: int = 6  # Of that search.
    ppo_steps: int = 0  # Decisions of a PPO best response in every iteration; 0 for none.
    detector_response: str = "none"  # none, or learned by `detector_command`.
    detector_command: str = ""  # Writes a detector to {out}, against the spoofers of {pool}.
    entropy: int = 0  # Seed of everything.
    threads: int = 1  # Threads of the engine.

    def __post_init__(self) -> None:
        get_task(self.task)
        check_choice("payoff", self.payoff, PAYOFFS)
        check_choice("detector_response", self.detector_response, RESPONSES)
        for name, least in (("iterations", 1), ("ppo_steps", 0), ("search_runs", 0)):
            whole_number(f"`{name}`", getattr(self, name), least)
        if (self.detector_response == "learned") != bool(self.detector_command):
            raise ValueError(
                "`detector_command` is needed for `detector_response` 'learned', and for it alone"
            )

    @property
    def config(self) -> dict[str, Any]:
        """All that results depend on, JSON-able."""
        settings = dataclasses.asdict(self)
        return {name: x for name, x in settings.items() if name not in ("out", "threads")}

    @property
    def budget(self) -> AttackBudget:
        blind = None
        if self.search_runs:
            blind = OpenLoopSearch(
                runs=self.search_runs,
                batch=max(self.search_runs // 2, 4),
                knots=12,
                generations=self.generations,
            )
        return AttackBudget(
            runs=self.selection_runs,
            sift_runs=self.sift_runs,
            values=self.values,
            blind=blind,
            further={"ppo_steps": self.ppo_steps} if self.ppo_steps else {},
        )


class DoubleOracle:
    """A game that grows; what has been found is read from its folder."""

    def __init__(self, args: Arguments) -> None:
        self.args, self.budget = args, args.budget
        self.game = Game(
            args.task,
            payoff=args.payoff,
            limit_m=args.limit_m or None,
            runs=args.runs,
            entropy=args.entropy,
            threads=args.threads,
            folder=args.out / "entries",
        )
        self.non_learned, self.left_out = self._list_non_learned()
        self.fresh = self.game.on("evaluation")
        self.spoofers: list[PlayerSpec] = []
        self.detectors: list[PlayerSpec] = []

    def play(self, progress: ProgressBar | None = None) -> dict[str, Any]:
        """Play all iterations that are missing; the results, JSON-able."""
        turns = [f"iteration-{k}" for k in range(self.args.iterations)]
        parts = {"start": Part({}, lambda *_: self._start())}
        for k, turn in enumerate(turns):
            make = lambda before, _, k=k: self._after(before)._iterate(k)  # noqa: E731
            parts[turn] = Part({}, make, ("start", *turns[:k]))
        make = lambda before, _: self._after(before)._final()  # noqa: E731
        parts["final"] = Part({}, make, ("start", *turns[:-1]))
        config = {**self.args.config, "versions": learning_versions()}
        found = Records("double-oracle", config, parts).play(self.args.out, progress)
        return {
            "config": self.args.config,
            "budget": self.budget.as_json(),
            "left_out": found["start"]["left_out"],
            "iterations": [found[turn] for turn in turns],
            "final": found["final"],
        }

    def _after(self, before: dict[str, Any]) -> DoubleOracle:
        """Let all enter that have done so before; the game."""
        self.spoofers, self.detectors = [], []
        for found in before.values():
            self._enter(found.get("entered", found))
        return self

    def _enter(self, found: dict[str, Any]) -> None:
        for side, own in ((SPOOFER, self.spoofers), (DETECTOR, self.detectors)):
            for data in found[f"{side}s"]:
                member = PlayerSpec.from_json(side, data)
                if all(member.spec != each.spec for each in own):
                    own.append(member)

    def _start(self) -> dict[str, Any]:
        """Members at the start: calibrated detectors, and every family's best against all."""
        detectors = self.non_learned
        even = mixture("even mix", detectors, np.ones(len(detectors)))
        found = self._spoofer(even, 0, [])
        spoofers = [
            dataclasses.replace(each, label=f"{name} (start)")
            for name, each in found.by_family.items()
        ]
        return {
            "spoofers": [each.as_json() for each in spoofers],
            "detectors": [each.as_json() for each in detectors],
            "left_out": [*self.left_out, *found.notes],
        }

    def _list_non_learned(self) -> tuple[list[PlayerSpec], list[str]]:
        """Detectors that have a calibration in this world, and why others have none."""
        rate = {"false_alarms_per_hour": self.args.false_alarms_per_hour}
        specs: list[dict[str, Any]] = [parse_spec(text) for text in self.args.detectors]
        if not specs:
            everyone = list_task_detectors(get_task(self.args.task))
            specs = [{**rate, **each} for each in everyone if each not in CONTROLS]
        members, left_out = [], []
        for spec in specs:
            asks = any(key in spec for key in THRESHOLD_KEYS)
            member = make_player(spec if asks else {**rate, **spec}, DETECTOR)
            try:
                self.game.detector(member)
            except ValueError as error:
                if self.args.detectors:
                    raise
                left_out.append(f"{member.label}: {error}")
                continue
            members.append(member)
        if not members:
            raise ValueError(f"no detector can play: {'; '.join(left_out)}")
        return members, left_out

    def _iterate(self, k: int) -> dict[str, Any]:
        """Solve the matrix, and look for both best responses."""
        matrix = self._matrix()
        found, spread = matrix.solve(), matrix.spread()
        spoofers, detectors = matrix.mixes(found)
        answer = self._spoofer(detectors, k + 1, self.spoofers)
        learned = self._train_detector(spoofers, k)
        guard = self._detector(spoofers, k + 1, [*self.detectors, *learned])
        ends = exploitability(self.fresh, spoofers, detectors, answer.member, guard.member)
        entered = {
            "spoofers": [answer.member.as_json()],
            "detectors": [each.as_json() for each in learned],
        }
        return {
            "matrix": matrix.as_json(),
            "pure": found.pure,
            "spread": spread.as_json(),
            "spoofers_mix": spoofers.as_json(),
            "detectors_mix": detectors.as_json(),
            "best_spoofer": answer.as_json(),
            "best_detector": guard.as_json(),
            "exploitability": ends.as_json(),
            "entered": entered,
        }

    def _final(self) -> dict[str, Any]:
        """Hold the last mix of detectors, and the best single one, against their best responses."""
        matrix = self._matrix()
        found = matrix.solve()
        _, detectors = matrix.mixes(found)
        k = int(np.argmin(matrix.values.max(axis=0)))
        seeds = self.detectors[k].decided_on | {matrix.seeds}
        single = mixture(self.detectors[k].label, [self.detectors[k]], [1.0], seeds)
        turn = self.args.iterations + 1
        to_mix = to_single = self._spoofer(detectors, turn, self.spoofers).member
        if detectors.members != single.members:
            to_single = self._spoofer(single, turn, self.spoofers).member
        who = [to_mix, to_single]
        if to_mix.label == to_single.label:
            who[1] = dataclasses.replace(to_single, label=f"{to_single.label}, to the single one")
        fresh = self.fresh.matrix(who, [detectors, single], oracles=True)
        return {
            "pure": found.pure,
            "detectors_mix": detectors.as_json(),
            "pool": detectors.pool(),
            "single": single.label,
            "best_to_mix": to_mix.as_json(),
            "best_to_single": to_single.as_json(),
            "mix": fresh.contrast([[1.0, 0.0], [0.0, 0.0]]).as_json(),
            "alone": fresh.contrast([[0.0, 0.0], [0.0, 1.0]]).as_json(),
            "gain_of_mixing": fresh.contrast([[-1.0, 0.0], [0.0, 1.0]]).as_json(),
        }

    def _matrix(self) -> PayoffMatrix:
        return self.game.matrix(self.spoofers, self.detectors, oracles=True)

    def _spoofer(self, mix: Mixture, turn: int, given: Sequence[PlayerSpec]) -> BestResponse:
        return best_spoofer(
            self.game,
            mix,
            self.budget,
            entropy=self.args.entropy + 1 + turn,
            given=[*given, *self._policies(mix, turn)],
            warm=given,
            label=f"response {turn}",
        )

    def _detector(self, mix: Mixture, turn: int, detectors: Sequence[PlayerSpec]) -> BestResponse:
        return best_detector(
            self.game,
            mix,
            detectors,
            runs=self.args.selection_runs,
            entropy=self.args.entropy + 1 + turn,
        )

    def _policies(self, mix: Mixture, turn: int) -> list[PlayerSpec]:
        """What PPO has learned against a mix, at some amplitudes."""
        if not self.args.ppo_steps:
            return []
        name = "".join(c if c.isalnum() else "-" for c in mix.label)
        file = self.args.out / f"ppo-{turn}-{name}.onnx"
        if not file.with_suffix(".json").is_file() and not self._learn(mix, turn, file):
            print(f"PPO has diverged against {mix.label}, and takes no part in response {turn}")
            return []
        return [
            make_player({"name": str(file), "amplitude": x}, SPOOFER, label=f"PPO {turn}, {x:g}")
            for x in AMPLITUDES
        ]

    def _learn(self, mix: Mixture, turn: int, file: Path) -> bool:
        """Let PPO learn against a mix of detectors, of which every episode meets one, and write an
        ONNX file with its card; whether there is one, since weights may be not finite."""
        from stable_baselines3 import PPO  # and torch, which other games do not need

        from agents.learning import for_learning, learn
        from spoofgym.export import onnx
        from spoofgym.sb3 import SpoofVecEnv
        from spoofgym.spoofers.learned import finite

        args, pool, world = self.args, mix.pool(), get_task(self.args.task)
        length = args.limit_m or world.alert_limit_m
        settings: dict[str, Any] = {
            **world.world_kwargs,
            **({} if length is None else {"length_m": length}),
            "pool": pool["members"],
            "weights": pool["weights"],
            "threads": args.threads,
            "alarm_price": ALARM_PRICE,
        }
        env = SpoofVecEnv(NUM_ENVS, seed=args.entropy + turn, **for_learning(settings))
        n_steps = env.core.episode_steps
        model = PPO(
            "MlpPolicy",
            env,
            n_steps=n_steps,
            batch_size=n_steps * NUM_ENVS // 2,
            gamma=1.0,
            policy_kwargs={"log_std_init": LOG_STD},
            seed=args.entropy + turn,
            device="cpu",
        )
        learn(model, args.ppo_steps)
        sound = finite(model.policy)
        if sound:
            onnx(model, env, file)
        env.close()
        return sound

    def _train_detector(self, mix: Mixture, turn: int) -> list[PlayerSpec]:
        """Detector that a command has learned against a mix, at the rate of all others."""
        if self.args.detector_response == "none":
            return []
        file = self.args.out / f"detector-{turn}.onnx"
        pool = self.args.out / f"spoofers-{turn}.json"
        write_file(pool, json.dumps(mix.pool()).encode())
        if not (file.is_file() and file.with_suffix(".json").is_file()):
            words = shlex.split(self.args.detector_command)
            subprocess.run([word.format(out=file, pool=pool) for word in words], check=True)
        rate = self.args.false_alarms_per_hour
        spec = {"name": str(file), "false_alarms_per_hour": rate}
        judge: Any = detector_in_world(spec)
        calibrate(self.game.setup, [judge.detector], false_alarms_per_hour=rate)
        return [make_player(spec, DETECTOR, label=f"learned {turn}")]


def run(args: Arguments, progress: ProgressBar | None = None) -> dict[str, Any]:
    results = DoubleOracle(args).play(progress)
    write_json(args.out / RESULTS, results)
    write_file(args.out / PAGE, write_page(results).encode())
    return results


@error_lines()
def main() -> None:
    run(tyro.cli(Arguments, description=__doc__), show_progress)


if __name__ == "__main__":
    main()
