"""Train and score spoofers against many detectors, in one command that goes on after a kill.

    python -m train.spoofers --out runs/spoofers

Every cell, a world, a detector and what the spoofer observes, is one `train.ppo_spoofer` with all
its seeds, in a folder of its own.  What is finished is not trained again, and an interrupted cell
goes on from its last checkpoint.  Beside PPO stand the ramps, the blind optimum and the scripted
feedback of the same runs.  The table says what each of them knows: a spoofer with *statistics* sees
those of the victim's detector (`oracle`), which nobody can in practice, and has columns apart.

By default 6 detectors, 2 worlds, 3 kinds of knowledge and 5 seeds: 180 trainings.  The folder gets
`spoofers.json` and `spoofers.md`, also while it runs; `--only` picks the worlds, detectors or
knowledge of a part, and other parts of the same folder stay in the table.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
import tyro
from rich.console import Console

from agents.folder import error_lines, json_object, open_folder
from agents.spoofer_table import FEEDBACK, KNOWLEDGE, RIVALS, page
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.core.files import write_file
from spoofgym.core.registry import check_choice
from spoofgym.tasks import task_of

from .ppo_spoofer import RESULTS, Arguments, train

DETECTORS = {
    "solution-separation": "solution-separation",
    "aime": "aime:signals=range_rate",
    "sequential-chi2": "sequential-chi2:signals=range_rate",
    "windowed-chi2": "windowed-chi2:signals=range_rate",
    "snapshot-chi2": "snapshot-chi2",
    "ewma": "ewma",
}
"""By short names; all at the default rate of false alarms."""
WORLDS = ("T3", "T5")
"""Worlds, by the tasks that have them."""
TABLE, PAGE, REACHES = "spoofers.json", "spoofers.md", "reaches.json"
MEASURE = "accelerating-ramp"
"""Half of how far it gets is the unit of rewards and prices, unless the alert limit is longer: so
an action of 1 asks at least for its last rate."""


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path  # Folder of all trainings.
    only: tuple[str, ...] = ()
    """Worlds, detectors or knowledge of a part, such as T3 aime blind; all by default."""
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # Seeds of every cell.
    steps: int = 80_000  # Decisions of each training.
    stages: int = 8  # How often each of them is scored.
    fit_runs: int = 256  # Training runs, on which amplitudes are fitted.
    runs: int = 400  # Evaluation runs.
    warm_pool: int | None = 256
    """Receivers that are warmed up once for what is learned from, see train.ppo_spoofer; None for
    warm-ups of their own. At first most episodes end at once by an alarm: warm-ups would take half
    of the time."""
    further: str = "{}"  # Further settings of train.ppo_spoofer for all of them, as JSON.

    def __post_init__(self) -> None:
        """Check the names."""
        for name in self.only:
            check_choice("world, detector or knowledge", name, (*WORLDS, *DETECTORS, *KNOWLEDGE))
        further = json_object("further", self.further)
        valid = sorted({each.name for each in fields(Arguments)} - {"out", "task"})
        for name in further:
            check_choice("further setting", name, valid)

    def cells(self) -> list[tuple[str, str, str]]:
        """World, detector and knowledge of what is to be trained."""

        def chosen(names: Any) -> list[str]:
            return [name for name in names if name in self.only] or list(names)

        worlds, detectors, known = map(chosen, (WORLDS, DETECTORS, KNOWLEDGE))
        return [(w, d, k) for w in worlds for d in detectors for k in known]

    def folder(self, world: str, detector: str, knowledge: str) -> Path:
        """Folder of a cell."""
        return self.out / f"{world}-{detector}-{knowledge.replace('+', '-')}"

    def arguments(self, world: str, detector: str, knowledge: str, reach_m: float) -> Arguments:
        """The training of a cell; `reach_m`: how far an accelerating ramp gets there."""
        blind, limit_m = knowledge == "blind", task_of(world).alert_limit_m
        given: dict[str, Any] = {
            "out": self.folder(world, detector, knowledge),
            "task": world,
            "length_m": max(limit_m or 0.0, round(reach_m / 2.0, 1)),
            "detector": DETECTORS[detector],
            "knowledge": knowledge,
            "rivals": (*RIVALS, FEEDBACK) if blind else ("ramp",),
        }
        own = ("seeds", "steps", "stages", "fit_runs", "runs", "warm_pool")
        further = json_object("further", self.further)
        return Arguments(**{**given, **{name: getattr(self, name) for name in own}, **further})


def play(settings: Settings, console: Console) -> dict[str, Any]:
    """Train what is missing; results of all cells that are finished, JSON-able."""
    for cell in settings.cells():
        console.print(" ".join(cell))
        args = settings.arguments(*cell, reach_of(settings, *cell[:2]))
        if not is_finished(args):
            results = train(args, console)
            write_file(args.out / RESULTS, (json.dumps(results, indent=1) + "\n").encode())
        table = collected(settings)
        write_file(settings.out / TABLE, (json.dumps(table, indent=1) + "\n").encode())
        write_file(settings.out / PAGE, page(table).encode())
    return collected(settings)


def is_finished(args: Arguments) -> bool:
    """Whether a cell has results of all seeds; a ValueError where they are of other settings."""
    path = args.out / RESULTS
    if not path.is_file():
        return False
    open_folder(args.out, args.identity)
    rows = json.loads(path.read_text(encoding="utf-8"))["seeds"]
    return {row["seed"] for row in rows} >= set(args.seeds)


def reach_of(settings: Settings, world: str, detector: str) -> float:
    """How far the accelerating ramp gets on training runs [m]; the folder keeps it."""
    path, key = settings.out / REACHES, f"{world}/{detector}"
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    if key not in known:
        args = settings.arguments(world, detector, "blind", 0.0)
        judge = Evaluator(fit_runs=args.fit_runs, threads=args.threads, **args.world)
        known[key] = round(judge.fit(MEASURE).score, 1)
        write_file(path, (json.dumps(known, indent=1) + "\n").encode())
    return float(known[key])


def collected(settings: Settings) -> dict[str, Any]:
    """Results of every cell whose folder has them."""
    every = [(w, d, k) for w in WORLDS for d in DETECTORS for k in KNOWLEDGE]
    found = {}
    for cell in every:
        path = settings.folder(*cell) / RESULTS
        if path.is_file():
            found["/".join(cell)] = json.loads(path.read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Command line."""
    console = Console()
    with error_lines():
        settings = tyro.cli(Settings, description=__doc__)
        torch.set_num_threads(1)
        table = play(settings, console)
    console.print(page(table), f"written: {settings.out / TABLE}", soft_wrap=True)


if __name__ == "__main__":
    main()
