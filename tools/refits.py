"""How much a score depends on its training runs and evaluation runs: the same policy, fitted anew.

    python -m tools.refits --out runs/refits                       # what is shipped, in its tasks
    python -m tools.refits --out runs/refits --task T2 --spoofer dash runs/mine.onnx

Every set of runs, by its entropy, has training runs, on which amplitudes are fitted to the alarm
budget, and evaluation runs.  The interval of a score is that of its evaluation runs; how far scores
of several sets lie apart has the fit in it, too.  The folder gets `refits.json`, from which
`tools.learned_page` makes a table; killed, the same command goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from rich.console import Console
from rich.markdown import Markdown

from agents.folder import error_lines
from agents.seeds import keeps_budget, spread, value_of
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.experiments.identity import versions
from spoofgym.bench.report.campaign import markdown_table
from spoofgym.bench.report.table import titled
from spoofgym.bench.runs.players import PlayerSpec, check_labels, fitted, specify_spoofer
from spoofgym.core.files import write_file
from spoofgym.core.registry import parse_spec, whole_number
from spoofgym.core.settings import digest_of
from spoofgym.tasks import task_of

from .transfer import Kept

RESULTS = "refits.json"
RAMP = "ramp"
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


@dataclass(frozen=True)
class Settings:
    """What is scored."""

    out: Path  # Folder of the results.
    task: tuple[str, ...] = tuple(LEARNED)  # Tasks.
    spoofer: tuple[str, ...] = ()
    """Names, files, or name:key=value; by default an accelerating ramp and what is shipped for the
    task. A ramp is always among them."""
    entropies: tuple[int, ...] = (1, 2, 3, 4, 5)  # Seeds of the sets; tables of the tasks have 0.
    fit_runs: int = 256  # Training runs of a set.
    runs: int = 400  # Evaluation runs of a set.
    threads: int | None = None  # Of the engine.
    json: bool = False  # Print the results as JSON, and nothing else.

    def __post_init__(self) -> None:
        """Check the names."""
        for name in self.task:
            task_of(name)
            if not self.spoofer and name not in LEARNED:
                raise ValueError(f"no learned spoofer is shipped for {name}: give `spoofer`")
        if not self.entropies or len(set(self.entropies)) < len(self.entropies):
            raise ValueError(f"`entropies` must be different numbers, got {self.entropies}")
        whole_number("`runs`", self.runs, 1)

    def whom(self, task: str) -> list[PlayerSpec]:
        """Spoofers of a task, the ramp first."""
        given = self.spoofer or ("accelerating-ramp", LEARNED[task])
        names = [RAMP, *(name for name in given if name != RAMP)]
        entries = tuple(specify_spoofer(fitted(parse_spec(name))) for name in names)
        check_labels(entries)
        return list(entries)

    @property
    def sizes(self) -> dict[str, int]:
        """Of every set of runs."""
        return {"runs": self.runs, "fit_runs": self.fit_runs}


def scored(judge: Evaluator, whom: Sequence[PlayerSpec]) -> list[dict[str, Any]]:
    """Scores on one set of runs, with ratios to the first one, JSON-able."""
    scores = [judge.score(entry.spec) for entry in whom]
    ramp = scores[0]
    return [
        {**score.as_dict(), "of_ramp": score.ratio_to(ramp, oracles=True).as_json()}
        for score in scores
    ]


def play(settings: Settings, console: Console) -> dict[str, Any]:
    """Score what is missing; results by task and training runs, for each spoofer a list of sets."""
    kept, made = Kept(settings.out), versions()
    results: dict[str, Any] = {}
    for task in settings.task:
        whom, sizes, sets = settings.whom(task), settings.sizes, []
        specs = [entry.spec for entry in whom]
        for entropy in settings.entropies:
            judge = Evaluator(task, entropy=entropy, threads=settings.threads, **sizes)
            points = [each._asdict() for each in judge.world.points(judge.detector)]
            digest = digest_of([made, judge.world.config, points, sizes, entropy, specs])
            with console.status(f"{task}, entropy {entropy}"):
                sets.append(kept(digest, partial(scored, judge, whom)))
        results[f"{task}/{settings.fit_runs}"] = {
            "task": task,
            **sizes,
            "versions": made,
            "entropies": list(settings.entropies),
            "spoofers": {each[0]["spoofer"]: list(each) for each in zip(*sets, strict=True)},
        }
        write_file(settings.out / RESULTS, (json.dumps(results, indent=1) + "\n").encode())
    return results


def table(results: Mapping[str, Any]) -> str:
    """A line for each spoofer of each task and number of training runs."""
    rows = [
        (
            *(
                found["task"],
                str(found["fit_runs"]),
                titled(f"`{name.removesuffix('(tuned)')}`", scores[0]["knowledge"]),
            ),
            *(str(len(scores)), *_cells(scores)),
        )
        for found in results.values()
        for name, scores in found["spoofers"].items()
    ]
    return "\n".join(markdown_table(HEAD, rows)) + "\n"


def _cells(scores: Sequence[Mapping[str, Any]]) -> tuple[str, str, str]:
    """Scores of one spoofer, their ratios to the ramp, and how many are over the budget."""
    ratios = [score["of_ramp"]["value"] for score in scores]
    times = "-"  # where the ramp gets nowhere
    if None not in ratios:
        times = f"{median(ratios):.2f} [{min(ratios):.2f}, {max(ratios):.2f}]"
    over = sum(not keeps_budget(score) for score in scores)
    return (
        spread([value_of(score) for score in scores]),
        times,
        str(over) if over else "",
    )


def main() -> None:
    """Command line."""
    with error_lines():
        settings = tyro.cli(Settings, description=__doc__)
        console = Console(quiet=settings.json)
        results = play(settings, console)
    if settings.json:
        print(json.dumps(results, indent=1, allow_nan=False))
    console.print(Markdown(table(results)))


if __name__ == "__main__":
    main()
