"""Ship a learned spoofer with the package, scored on evaluation runs.

    python -m tools.ship_spoofer runs/ppo-T3/ppo-T3.onnx --name solution-separation-ppo --task T3

The policy and its card go to the zoo under a name, with the score on the card.  The amplitude is
the one in the file: it was fitted on training runs, and nothing is chosen here.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from agents.folder import error_lines
from agents.seeds import copy_policy, on_card
from spoofgym.bench.experiments.evaluate import RUNS, Evaluator
from spoofgym.cli.app import progress
from spoofgym.policies.zoo import ZOO_FOLDER


def ship(policy: Path, name: str, judge: Evaluator, folder: Path = ZOO_FOLDER) -> Path:
    """Copy a policy into the zoo, with its score; refused where it is over the budget."""
    score = judge.score(str(policy), amplitude=None)
    if not score.within_budget:
        raise ValueError(f"{policy} is not shipped: {score}")
    target = folder / f"{name}.onnx"
    copy_policy(policy, target, scores=[on_card(score, judge)])
    print(score)
    return target


@error_lines()
def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("policy", type=Path, help="an .onnx file with its card")
    parser.add_argument("--name", required=True, help="of the shipped spoofer")
    parser.add_argument("--task", required=True, help="whose detector it has learned against")
    parser.add_argument("--runs", type=int, default=RUNS, help="evaluation runs")
    parser.add_argument("--seed", type=int, default=1, help="of these runs; trainings have 0")
    given = parser.parse_args(arguments)
    with progress(3.0 * given.runs) as bar:
        judge = Evaluator(given.task, runs=given.runs, entropy=given.seed, progress=bar)
        ship(given.policy, given.name, judge)


if __name__ == "__main__":
    main(sys.argv[1:])
