"""All trainings behind the pages, and their scores, by one command that goes on after a kill.

    python -m tools.learn_all --out runs/all                 # everything
    python -m tools.learn_all --out runs/all --workers 8     # so many steps at a time
    python -m tools.learn_all --out runs/all --only ppo-T3   # one step, or several
    python -m tools.learn_all --out runs/all --list          # what there is, and what it runs

Each step is a command of its own in a folder of its own, which goes on where it was, and begins
when the steps that it needs have ended.  Several at a time share the processors, and write what
they have to say to `NAME.log` in the folder.  A step that has ended is not run again, unless its
command is another one now; `steps.json` in the folder has the command of each of them, and the
seconds that it took.  Some steps write tables and cards of the pages in docs/ and spoofgym/.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple

import tyro
from rich.console import Console

from agents.folder import error_lines, json_object
from spoofgym.core.files import write_file
from spoofgym.core.registry import check_choice
from spoofgym.simulation.engine import processors
from spoofgym.tasks import DETECTOR_TASKS, TASKS
from train.spoofers import DETECTORS, WORLDS

MARKS = "steps.json"
MOST_WORKERS = 4
"""By default: each of them takes up to two gigabytes."""
GAME = (
    *("--iterations", "3", "--runs", "200", "--selection-runs", "64", "--sift-runs", "24"),
    *("--values", "6", "--search-runs", "48", "--generations", "4", "--ppo-steps", "60000"),
)
"""Settings of the game on docs/game.md."""

OWN = {
    "T4": "--warm-pool 512 --length-m 100 --log-std-init -3 --steps 40000 --stages 4",
    "T6": "--warm-pool 512",
}
"""Settings of the recipe that single tasks have on docs/learned_spoofers.md."""
FRESH = ("T1", "T2", "T3")
"""Tasks with other seeds and other runs on that page, too."""
GUARDS = {"guard": 3, "guard-0": 0, "guard-1": 1, "guard-2": 2, "guard-4": 4}
"""Seeds of the shipped detector, which was best of five on validation runs, and of the others."""


class Step(NamedTuple):
    """Arguments of Python, and names of the steps that have to end before."""

    words: list[str]
    after: tuple[str, ...] = ()


Steps = Mapping[str, Step]


def steps_of(out: Path) -> dict[str, Step]:
    """Every step by its name, in the order in which they would run one by one."""
    recipes = {
        f"ppo-{key}": ["train.ppo_spoofer", "--task", key, *OWN.get(key, "").split()]
        for key in TASKS
    }
    fresh = ("--entropy", "1", "--seeds", "5", "6", "7", "8", "9")
    recipes |= {f"fresh-{key}": ["train.ppo_spoofer", "--task", key, *fresh] for key in FRESH}
    plain = {f"plain-{key}": ["train.plain_ppo", "--task", key] for key in ("T2", "T3")}
    plain |= {
        f"plain-fresh-{key}": ["train.plain_ppo", "--task", key, "--kinds", "plain", *fresh]
        for key in ("T2", "T3")
    }
    sweep = {
        f"spoofers-{world}-{detector}": ["train.spoofers", "--only", world, detector]
        for world in WORLDS
        for detector in DETECTORS
    }
    learners = recipes | plain | sweep
    folders = (*learners, "refits", "refits-more")
    guard = str(out / "guard" / "guard.onnx")
    found = {
        **{
            f"cards-{key}": [
                *("tools.detector_cards", key, "--out", str(out / f"cards-{key}")),
                *("--runs", "200", "--selection-runs", "48"),
            ]
            for key in DETECTOR_TASKS
        },
        **{name: [*words, "--out", str(out / name)] for name, words in learners.items()},
        "refits": ["tools.refits", "--out", str(out / "refits"), "--task", "T1", "T2"],
        "refits-more": [
            *("tools.refits", "--out", str(out / "refits-more"), "--task", "T2"),
            *("--fit-runs", "1024", "--entropies", "1", "2", "3"),
        ],
        "data": [
            *("spoofgym", "dataset", str(out / "data"), "--task", "T3"),
            *("--spoofer", "solution-separation-ppo", "--spoofer", "hidden-pool-ppo"),
        ],
        **{
            name: [
                *("train.detector", "--data", str(out / "data"), "--out", str(out / name)),
                *("--seed", str(seed)),
            ]
            for name, seed in GUARDS.items()
        },
        "threshold": [
            *("spoofgym", "calibrate", "--task", "T3", "--detector", guard, "--runs", "2000"),
            *("--hold-out", "400", "--transfer", "zhong2025", "--transfer", "trolley-tactical"),
        ],
        "feedback": ["tools.feedback_gain", "--out", str(out / "feedback")],
        "feedback-T2": ["tools.feedback_gain", "--task", "T2", "--out", str(out / "feedback")],
        "game": ["train.double_oracle", "--task", "T3", "--out", str(out / "game"), *GAME],
        "game-page": ["tools.game_page", str(out / "game")],
        "page": ["tools.learned_page", *(str(out / name) for name in folders)],
    }
    cards = [f"cards-{key}" for key in DETECTOR_TASKS]
    after: dict[str, tuple[str, ...]] = {
        **dict.fromkeys(GUARDS, ("data",)),
        "threshold": ("guard",),
        "feedback-T2": ("feedback",),  # both write to one folder
        "game-page": ("game",),
        "page": folders,
        **{later: (sooner,) for sooner, later in pairwise(cards)},  # all write to one page
    }
    return {name: Step(["-m", *words], after.get(name, ())) for name, words in found.items()}


@dataclass(frozen=True)
class Settings:
    """What is run."""

    out: Path  # Folder of all results.
    only: tuple[str, ...] = ()  # Names of some steps, as `--list` has them; all by default.
    workers: int = min(MOST_WORKERS, processors())
    """Steps at a time; each has its part of the processors."""
    list: bool = False  # Print the steps, and run none.

    def __post_init__(self) -> None:
        """Check names and number."""
        for name in self.only:
            check_choice("step", name, [*steps_of(self.out)])
        if self.workers < 1:
            raise ValueError(f"`workers` must be at least 1, got {self.workers}")


def run(out: Path, steps: Steps, console: Console, workers: int = 1) -> dict[str, Any]:
    """Run what has not ended yet; seconds and command of every step that has, by its name.  Raises
    `subprocess.CalledProcessError` when a command fails.  Then no other one is begun, and those
    that run go on to their end."""
    path = out / MARKS
    done = json_object(str(path), path.read_text("utf-8") if path.is_file() else "{}")
    order = TopologicalSorter({name: {*step.after} & {*steps} for name, step in steps.items()})
    order.prepare()
    ready: list[str] = []
    running: dict[Future[float], str] = {}
    parts = _parts_of_processors(workers)
    out.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(workers, initializer=_take_part, initargs=(parts,)) as pool:
        while order.is_active():
            ready += order.get_ready()
            while ready and len(running) < workers:
                name, words = ready[0], steps[ready.pop(0)].words
                if name in done and done[name]["command"] == words:
                    order.done(name)
                    ready += order.get_ready()
                else:
                    log = None if workers == 1 else out / f"{name}.log"
                    running[pool.submit(_run_step, name, words, log, console)] = name
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                name = running.pop(future)
                done[name] = {"seconds": future.result(), "command": steps[name].words}
                write_file(path, (json.dumps(done, indent=1) + "\n").encode())
                order.done(name)
    return done


def _take_part(parts: SimpleQueue[set[int]]) -> None:
    """Leave this thread, and what it starts, a part of the processors, where the system can."""
    if sys.platform == "linux":
        os.sched_setaffinity(0, parts.get())


def _parts_of_processors(workers: int) -> SimpleQueue[set[int]]:
    """Processors of every worker, as equal in number as can be; shared where there are too few."""
    parts: SimpleQueue[set[int]] = SimpleQueue()
    if sys.platform == "linux":
        own = sorted(os.sched_getaffinity(0))
        for k in range(workers):
            parts.put({*own[k::workers]} or {own[k % len(own)]})
    return parts


def _run_step(name: str, words: list[str], log: Path | None, console: Console) -> float:
    """Run a command to its end; seconds that it took. `log`: file for what it says, or None."""
    began = time.perf_counter()
    console.print(f"{name} begins" + ("" if log is None else f", see {log}"), highlight=False)
    with ExitStack() as stack:
        file = None if log is None else stack.enter_context(log.open("w", encoding="utf-8"))
        ended = subprocess.run([sys.executable, *words], stdout=file, stderr=file, check=False)
    if ended.returncode != 0:
        console.print(f"{name} has failed; what still runs goes on to its end", highlight=False)
        ended.check_returncode()
    spent_s = round(time.perf_counter() - began, 1)
    console.print(f"{name} has ended after {spent_s / 60.0:.0f} min", highlight=False)
    return spent_s


def main() -> None:
    """Command line."""
    console = Console()
    with error_lines():
        given = tyro.cli(Settings, description=__doc__)
        steps = steps_of(given.out)
        if given.list:
            for name, step in steps.items():
                command = f"{name}: python {' '.join(step.words)}"
                console.print(command, soft_wrap=True, highlight=False)
            return
        chosen = {name: step for name, step in steps.items() if name in (given.only or steps)}
        done = run(given.out, chosen, console, given.workers)
        hours = sum(each["seconds"] for each in done.values()) / 3600.0
        console.print(f"{len(done)} of {len(steps)} steps have ended, in {hours:.2f} h of work")


if __name__ == "__main__":
    main()
