"""Double oracle: populations of spoofers and detectors that grow by best responses to mixes.

    python -m train.double_oracle --task T3 --out runs/game

What happens (`mcmahan2003`, `lanctot2017`):

1. The game starts with all detectors that are calibrated in the world of the task, at one rate of
   false alarms, and with the best attack of every scripted family against an even mix of them:
   ramps, accelerating ramps, profiles, dashes, feedback and blind optima.  Nobody is ever removed.
2. In every iteration all pairs play the runs of the split `game`, the matrix is solved, and both
   sides look for a best response to the mix of the other: a spoofer among all families, blind
   optima and, with `--ppo-steps`, a policy that PPO of stable-baselines3 learns; a detector among
   those that are there and, with `--detector-response learned`, one that `--detector-command`
   makes, calibrated to the same rate before it enters.
3. Both responses are scored against the mixes on the split `evaluation`, which decides nothing:
   that is the exploitability from below.  From above it is known where all detectors of the mix
   have a zero-alarm bound.  The budget of the search is the same in all iterations.
4. At the end the mix of detectors and the best single one each meet the best response to them, on
   the same fresh runs.  That a single detector solves the game is a valid result.

The folder holds `config.json`, `entries/` with a file for every pair, a file for every iteration,
`results.json` and the page `game.md`.  After a kill the same command goes on, to the same result.
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
from rich.console import Console

from agents.folder import error_lines, open_folder
from agents.game_page import page_of
from spoofgym.bench.experiments.best_response import (
    AttackBudget,
    Response,
    best_detector,
    best_spoofer,
    exploitability,
)
from spoofgym.bench.experiments.game import Game
from spoofgym.bench.experiments.suite import everyone_in, in_order
from spoofgym.bench.runs.players import (
    DETECTOR,
    SPOOFER,
    Mixture,
    PlayerSpec,
    member_of,
    mixture,
)
from spoofgym.bench.runs.world import CONTROLS
from spoofgym.bench.scores.matrix_game import PAYOFFS, PayoffMatrix
from spoofgym.bench.search.open_loop import BlindSearch
from spoofgym.calibration.thresholds import calibrate
from spoofgym.core.files import write_file
from spoofgym.core.registry import check_choice, parse_spec, whole_number
from spoofgym.detectors import detector_in_world
from spoofgym.detectors.build import ASKED
from spoofgym.detectors.calibrated import STANDARD_RATE
from spoofgym.tasks import task_of

RESULTS, PAGE = "results.json", "game.md"
RESPONSES = ("none", "learned")
AMPLITUDES = (0.5, 0.7, 1.0)
"""Factors on the commands of a learned policy that are tried."""


@dataclass(frozen=True)
class Arguments:
    """Settings of a game; all but `threads` belong to its identity."""

    out: Path  # Folder of the game.
    task: str = "T3"  # Task whose world and alert limit are taken, T1 to T6.
    iterations: int = 3  # Matrices that are solved; the first one is that of the start.
    detectors: tuple[str, ...] = ()
    """Detectors as name:key=value or JSON; by default all that are calibrated in this world."""
    false_alarms_per_hour: float = STANDARD_RATE  # Rate of all detectors.
    payoff: str = "stealth"  # What a run is worth: stealth or hmi.
    limit_m: float = 0.0  # Alert limit in place of the task's; 0 for that.
    runs: int = 200  # Runs of the matrix, and as many fresh ones.
    selection_runs: int = 96  # Runs that decide on best responses.
    sift_runs: int = 32  # How many of them play all candidates.
    values: int = 8  # Values of every family's setting that are tried.
    search_runs: int = 64  # Runs of the search for blind optima; 0 for no search.
    generations: int = 6  # Of that search.
    ppo_steps: int = 0  # Decisions of a PPO best response in every iteration; 0 for none.
    detector_response: str = "none"  # none, or learned by `detector_command`.
    detector_command: str = ""
    """Command that writes a detector to {out}, against the spoofers of the JSON file {pool}."""
    entropy: int = 0  # Seed of everything.
    threads: int = 1  # Threads of the engine.

    def __post_init__(self) -> None:
        """Check them."""
        task_of(self.task)
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
        """Of every best response."""
        blind = None
        if self.search_runs:
            blind = BlindSearch(
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


class Shown:
    """Prints what is being done, but for single attacks."""

    def __init__(self, console: Console) -> None:
        self.console, self.last = console, ""

    def advance(self, amount: float, now: str) -> None:
        """Print what has begun."""
        if amount == 0.0 and now != self.last and " against " not in now:
            self.console.print(f"  {now}", style="dim", highlight=False)
            self.last = now


class DoubleOracle:
    """A game that grows; what has been found is read from its folder."""

    def __init__(self, args: Arguments, console: Console) -> None:
        self.args, self.console, self.budget = args, console, args.budget
        settings: dict[str, Any] = {
            "payoff": args.payoff,
            "limit_m": args.limit_m or None,
            "runs": args.runs,
            "entropy": args.entropy,
            "threads": args.threads,
            "progress": Shown(console),
        }
        self.game = Game(args.task, **settings)  # without a folder it writes nothing
        self.classics, self.left_out = self._classics()
        open_folder(args.out, args.config)
        self.game = Game(args.task, folder=args.out / "entries", **settings)
        self.fresh = self.game.on("evaluation")
        self.spoofers: list[PlayerSpec] = []
        self.detectors: list[PlayerSpec] = []

    def play(self) -> dict[str, Any]:
        """Play all iterations that are missing; the results, JSON-able."""
        begun = self._kept("start", self._start)
        self._enter(begun)
        iterations = []
        for k in range(self.args.iterations):
            self.console.print(f"iteration {k}: {len(self.spoofers)} x {len(self.detectors)}")
            found = self._kept(f"iteration-{k}", lambda k=k: self._iterate(k))
            iterations.append(found)
            if k + 1 < self.args.iterations:
                self._enter(found["entered"])
        self.console.print("final mix against the best single detector")
        final = self._kept("final", self._final)
        return {
            "config": self.args.config,
            "budget": self.budget.as_json(),
            "left_out": begun["left_out"],
            "iterations": iterations,
            "final": final,
        }

    def _kept(self, name: str, work: Any) -> Any:
        """What a step has found, now or before a kill."""
        file = self.args.out / f"{name}.json"
        if not file.is_file():
            write_file(file, (json.dumps(work(), indent=1, allow_nan=False) + "\n").encode())
        return json.loads(file.read_text(encoding="utf-8"))

    def _enter(self, found: dict[str, Any]) -> None:
        """Add members that are not there yet."""
        for side, own in ((SPOOFER, self.spoofers), (DETECTOR, self.detectors)):
            for data in found[f"{side}s"]:
                member = PlayerSpec.from_json(side, data)
                if all(member.spec != each.spec for each in own):
                    own.append(member)

    def _start(self) -> dict[str, Any]:
        """Members at the start: calibrated detectors, and every family's best against all."""
        detectors = self.classics
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

    def _classics(self) -> tuple[list[PlayerSpec], list[str]]:
        """Detectors that have a calibration in this world, and why others have none."""
        rate = {"false_alarms_per_hour": self.args.false_alarms_per_hour}
        specs: list[dict[str, Any]] = [parse_spec(text) for text in self.args.detectors]
        if not specs:
            everyone = in_order(everyone_in(self.game.setup, rescaled=True))
            specs = [{**rate, **each} for each in everyone if each not in CONTROLS]
        members, left_out = [], []
        for spec in specs:
            asks = any(key in spec for key in ASKED)
            member = member_of(spec if asks else {**rate, **spec}, DETECTOR)
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
        learned = self._learned(spoofers, k)
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

    def _spoofer(self, mix: Mixture, turn: int, given: Sequence[PlayerSpec]) -> Response:
        return best_spoofer(
            self.game,
            mix,
            self.budget,
            entropy=self.args.entropy + 1 + turn,
            given=[*given, *self._policies(mix, turn)],
            warm=given,
            label=f"response {turn}",
        )

    def _detector(self, mix: Mixture, turn: int, detectors: Sequence[PlayerSpec]) -> Response:
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
        from agents.policy_response import learn_against  # torch, which other games do not need

        name = "".join(c if c.isalnum() else "-" for c in mix.label)
        file = self.args.out / f"ppo-{turn}-{name}.onnx"
        args = self.args
        if not file.with_suffix(".json").is_file() and not learn_against(
            mix, args.task, args.limit_m, args.ppo_steps, file, args.entropy + turn, args.threads
        ):
            print(f"PPO has diverged against {mix.label}, and takes no part in response {turn}")
            return []
        return [
            member_of({"name": str(file), "amplitude": x}, SPOOFER, label=f"PPO {turn}, {x:g}")
            for x in AMPLITUDES
        ]

    def _learned(self, mix: Mixture, turn: int) -> list[PlayerSpec]:
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
        return [member_of(spec, DETECTOR, label=f"learned {turn}")]


def run(args: Arguments, console: Console) -> dict[str, Any]:
    """Play a game, and write its results and its page."""
    results = DoubleOracle(args, console).play()
    text = json.dumps(results, indent=1, allow_nan=False) + "\n"
    write_file(args.out / RESULTS, text.encode())
    write_file(args.out / PAGE, page_of(results).encode())
    return results


def main() -> None:
    """Command line."""
    with error_lines():
        run(tyro.cli(Arguments, description=__doc__), Console())


if __name__ == "__main__":
    main()
