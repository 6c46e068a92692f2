"""Train and score spoofers against many detectors, in one command that goes on after a kill.

    python -m train.spoofers --out runs/spoofers

Every cell, a world, a detector and what the spoofer observes, is one `train.ppo_spoofer` with all
its seeds, in a folder of its own: by default 180 trainings.  Beside PPO stand the ramps, the blind
optimum and the scripted feedback of the same runs.  The table, `spoofers.json` and `spoofers.md`,
says what each of them knows: a spoofer with *statistics* sees those of the victim's detector
(`oracle`), which nobody can in practice, and has columns apart.  `--only` picks a part; others of
the same folder stay in the table.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import torch
import tyro
from rich.console import Console

from agents.folder import (
    Part,
    Records,
    Ticks,
    error_lines,
    json_object,
    learning_versions,
    write_json,
)
from agents.spoofer_table import FEEDBACK, KNOWLEDGE, RIVALS, page
from spoofgym.bench.experiments import Context, Reader, Store
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.core.files import write_file
from spoofgym.core.progress import ProgressBar, show_progress
from spoofgym.core.registry import check_choice
from spoofgym.tasks import get_task

from .ppo_spoofer import Arguments, train

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
TABLE, PAGE = "spoofers.json", "spoofers.md"
MEASURE = "accelerating-ramp"
"""Half of how far it gets is the unit of rewards and prices, unless the alert limit is longer: so
an action of 1 asks at least for its last rate."""


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path  # Folder of all trainings.
    only: tuple[str, ...] = ()  # Worlds, detectors or knowledge of a part; all by default.
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # Seeds of every cell.
    steps: int = 80_000  # Decisions of each training.
    stages: int = 8  # How often each of them is scored.
    fit_runs: int = 256  # Training runs, on which amplitudes are fitted.
    runs: int = 400  # Evaluation runs.
    warm_pool: int | None = 256  # As in train.ppo_spoofer: at first most episodes end at once.
    further: str = "{}"  # Further settings of train.ppo_spoofer for all of them, as JSON.

    def __post_init__(self) -> None:
        for name in self.only:
            check_choice("world, detector or knowledge", name, (*WORLDS, *DETECTORS, *KNOWLEDGE))
        further = json_object("further", self.further)
        valid = sorted({each.name for each in fields(Arguments)} - {"out", "task"})
        for name in further:
            check_choice("further setting", name, valid)

    def cells(self) -> list[tuple[str, str, str]]:
        """World, detector and knowledge of what is to be trained."""

        def choose(names: Any) -> list[str]:
            return [name for name in names if name in self.only] or list(names)

        worlds, detectors, known = map(choose, (WORLDS, DETECTORS, KNOWLEDGE))
        return [(w, d, k) for w in worlds for d in detectors for k in known]

    def folder(self, world: str, detector: str, knowledge: str) -> Path:
        return self.out / f"{world}-{detector}-{knowledge.replace('+', '-')}"

    def arguments(self, world: str, detector: str, knowledge: str, reach_m: float) -> Arguments:
        """The training of a cell; `reach_m`: how far an accelerating ramp gets there."""
        blind, limit_m = knowledge == "blind", get_task(world).alert_limit_m
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


def build_experiment(settings: Settings) -> Records:
    """A cell for every training with all its seeds, after how far the accelerating ramp gets."""
    parts: dict[str, Part] = {}
    for cell in settings.cells():
        reach, met = f"reach {'/'.join(cell[:2])}", {"detector": DETECTORS[cell[1]]}
        parts[reach] = Part(met, lambda *_, x=cell: measure_reach(settings, *x[:2]))

        def make(before: Any, context: Context, cell: Any = cell, reach: str = reach) -> Any:
            args = settings.arguments(*cell, before[reach])
            return train(args, lambda _: nullcontext(Ticks(context.tick)))

        identity, work = {**met, "seeds": settings.seeds}, len(settings.seeds) * settings.steps
        parts["/".join(cell)] = Part(identity, make, (reach,), work)
    own = ("steps", "stages", "fit_runs", "runs", "warm_pool")
    config = {name: getattr(settings, name) for name in own} | {"versions": learning_versions()}
    further = json_object("further", settings.further)
    return Records("spoofers", {**config, "further": further}, parts)


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train what is missing; results of all cells that are finished, JSON-able."""
    build_experiment(settings).play(settings.out, progress)
    everything, store = build_experiment(replace(settings, only=())), Store(settings.out)
    store.open(everything.name, everything.config)
    found = everything.report(Reader(store, everything.cells()))
    table = {name: x for name, x in found.items() if not name.startswith("reach")}
    write_json(settings.out / TABLE, table)
    write_file(settings.out / PAGE, page(table).encode())
    return table


def measure_reach(settings: Settings, world: str, detector: str) -> float:
    """How far the accelerating ramp gets on training runs [m]."""
    args = settings.arguments(world, detector, "blind", 0.0)
    judge = Evaluator(fit_runs=args.fit_runs, threads=args.threads, **args.world)
    return round(judge.fit(MEASURE).score, 1)


@error_lines()
def main() -> None:
    settings = tyro.cli(Settings, description=__doc__)
    torch.set_num_threads(1)
    table = play(settings, show_progress)
    Console().print(page(table), f"written: {settings.out / TABLE}", soft_wrap=True)


if __name__ == "__main__":
    main()
