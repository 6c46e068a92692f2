"""How much a score depends on its training runs and evaluation runs: the same policy, fitted anew.

    python -m tools.refits --out runs/refits                       # what is shipped, in its tasks
    python -m tools.refits --out runs/refits --task T2 --spoofer dash runs/mine.onnx

Every set has training runs, on which amplitudes are fitted to the alarm budget, and evaluation
runs.  The interval of a score is that of its evaluation runs; how far scores of several sets lie
apart has the fit in it, too.  `tools.learned_page` makes a table of `refits.json`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from statistics import median
from typing import Any

from rich.console import Console
from rich.markdown import Markdown

from agents.folder import Part, Records, describe_identity, error_lines, write_json
from agents.seeds import format_range, get_displacement, keeps_budget
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.experiments.identity import code_identity
from spoofgym.bench.report.campaign import format_spoofer
from spoofgym.bench.report.table import Table
from spoofgym.bench.runs.players import add_tuned_setting, check_labels, specify_spoofer
from spoofgym.core.progress import ProgressBar, show_progress
from spoofgym.core.registry import parse_spec
from spoofgym.tasks import get_task

from .scored import get_sizes, make_parser

RESULTS = "refits.json"
LEARNED = {
    "T1": "snapshot-chi2-ppo",
    "T2": "ewma-ppo",
    "T3": "solution-separation-ppo",
    "T5": "solution-separation-quiet-ppo",
    "T6": "hidden-pool-ppo",
}
"""The learned spoofer that is shipped for a task."""
HEAD = (
    *("task", "training runs", "spoofer", "sets of runs"),
    *("stealthy displacement, median and range [m]", "times the ramp, median and range"),
    "over the budget",
)


def options(arguments: list[str]) -> argparse.Namespace:
    parser = make_parser(__doc__, "runs/refits", fit_runs=256)
    parser.add_argument("--task", nargs="+", default=[*LEARNED])
    parser.add_argument("--spoofer", nargs="+", default=[], help="by default what is shipped")
    parser.add_argument("--entropies", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    given = parser.parse_args(arguments)
    for name in given.task:
        get_task(name)
        if not given.spoofer and name not in LEARNED:
            raise ValueError(f"no learned spoofer is shipped for {name}: give `spoofer`")
    if len(set(given.entropies)) < len(given.entropies):
        raise ValueError(f"`entropies` must be different numbers, got {given.entropies}")
    return given


def list_specs(task: str, given: Sequence[str]) -> list[Any]:
    names = given or ("accelerating-ramp", LEARNED[task])
    names = ["ramp", *(name for name in names if name != "ramp")]
    entries = tuple(specify_spoofer(add_tuned_setting(parse_spec(name))) for name in names)
    check_labels(entries)
    return [entry.spec for entry in entries]


def score_specs(judge: Evaluator, specs: Sequence[Any]) -> list[dict[str, Any]]:
    """Scores on one set of runs, with ratios to the first one, JSON-able."""
    scores = [judge.score(spec) for spec in specs]
    return [
        {**score.as_dict(), "of_ramp": score.ratio_to(scores[0], oracles=True).as_json()}
        for score in scores
    ]


def play(given: argparse.Namespace, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Score what is missing; results by task and training runs, for each spoofer a list of sets."""
    parts: dict[str, Part] = {}
    for task, entropy in product(given.task, given.entropies):
        judge = partial(Evaluator, task, **get_sizes(given, entropy))
        specs = list_specs(task, given.spoofer)
        make = lambda *_, judge=judge, specs=specs: score_specs(judge(), specs)  # noqa: E731
        parts[f"{task} {entropy}"] = Part(describe_identity(judge(), *specs), make)
    found = Records("refits", {}, parts).play(given.out, progress)
    results = {}
    for task in given.task:
        sets = [found[f"{task} {entropy}"] for entropy in given.entropies]
        results[f"{task}/{given.fit_runs}"] = {
            "task": task,
            "runs": given.runs,
            "fit_runs": given.fit_runs,
            "versions": code_identity(),
            "entropies": given.entropies,
            "spoofers": {each[0]["spoofer"]: list(each) for each in zip(*sets, strict=True)},
        }
    write_json(given.out / RESULTS, results)
    return results


def table(results: Mapping[str, Any]) -> str:
    rows = [
        (
            *(found["task"], str(found["fit_runs"])),
            format_spoofer(f"`{name.removesuffix('(tuned)')}`", scores[0]["knowledge"]),
            *(str(len(scores)), *_cells(scores)),
        )
        for found in results.values()
        for name, scores in found["spoofers"].items()
    ]
    return Table.of_texts(*HEAD).markdown(rows) + "\n"


def _cells(scores: Sequence[Mapping[str, Any]]) -> tuple[str, str, str]:
    ratios = [score["of_ramp"]["value"] for score in scores]
    times = "-"  # where the ramp gets nowhere
    if None not in ratios:
        times = f"{median(ratios):.2f} [{min(ratios):.2f}, {max(ratios):.2f}]"
    over = sum(not keeps_budget(score) for score in scores)
    return format_range([get_displacement(score) for score in scores]), times, str(over or "")


@error_lines()
def main(arguments: list[str]) -> None:
    given = options(arguments)
    results = play(given, show_progress)
    if given.json:
        print(json.dumps(results, indent=1, allow_nan=False))
    else:
        Console().print(Markdown(table(results)))


if __name__ == "__main__":
    main(sys.argv[1:])
