"""All trainings behind the pages, and their scores, by one command that goes on after a kill.

    python -m tools.learn_all --out runs/all          # everything
    python -m tools.learn_all --out runs/all --list   # what there is, and what it runs

Each step is a command in a folder of its own, which goes on where it was, and begins when the steps
that it needs have ended; what it has to say is in `NAME.log`.  A step that has ended is not run
again, unless its command is another one now; where one fails, the others end, too.  `steps.json`
has commands and seconds.  Some steps write tables and cards of the pages in docs/ and spoofgym/.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import subprocess
import sys
import time
from collections.abc import Mapping
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

from agents.folder import Part, Records, error_lines, write_json
from spoofgym.bench.experiments import Context
from spoofgym.core.progress import ProgressBar, show_progress
from spoofgym.core.registry import check_choice
from spoofgym.simulation.engine import processors
from spoofgym.tasks import DETECTOR_TASKS, TASKS

MARKS = "steps.json"
MOST_WORKERS = 4
"""By default: each of them takes up to two gigabytes."""
GAME = (
    "--iterations 3 --runs 200 --selection-runs 64 --sift-runs 24 --values 6 --search-runs 48 "
    "--generations 4 --ppo-steps 60000"
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
"""Seeds of the detector that was best of five on validation runs, and of the others."""

AGED = "ramp", "accelerating-ramp", "profile", "dash", "open-loop"
"""Families of attacks of drawn ages that the window guard learns from; none sees a statistic."""


class Step(NamedTuple):
    """Arguments of Python, and names of the steps that have to end before."""

    words: list[str]
    after: tuple[str, ...] = ()


def list_steps(out: Path) -> dict[str, Step]:
    """Every step by its name, in the order in which they would run one by one."""
    from train.spoofers import DETECTORS, WORLDS  # torch, which workers do not need

    fresh, plain = "--entropy 1 --seeds 5 6 7 8 9", ("T2", "T3")
    learners = {
        **{f"ppo-{key}": f"train.ppo_spoofer --task {key} {OWN.get(key, '')}" for key in TASKS},
        **{f"fresh-{key}": f"train.ppo_spoofer --task {key} {fresh}" for key in FRESH},
        **{f"plain-{key}": f"train.plain_ppo --task {key}" for key in plain},
        **{
            f"plain-fresh-{key}": f"train.plain_ppo --task {key} --kinds plain {fresh}"
            for key in plain
        },
        **{
            f"spoofers-{world}-{detector}": f"train.spoofers --only {world} {detector}"
            for world, detector in product(WORLDS, DETECTORS)
        },
    }
    folders = (*learners, "refits", "refits-more")
    cards = [f"cards-{key}" for key in DETECTOR_TASKS]
    found = {
        **{
            f"cards-{key}": f"tools.detector_cards {key} --out OUT/cards-{key} --runs 200 "
            "--selection-runs 48"
            for key in DETECTOR_TASKS
        },
        **{name: f"{words} --out OUT/{name}" for name, words in learners.items()},
        "refits": "tools.refits --out OUT/refits --task T1 T2",
        "refits-more": "tools.refits --out OUT/refits-more --task T2 --fit-runs 1024 "
        "--entropies 1 2 3",
        "data": "spoofgym dataset OUT/data --task T3 --spoofer solution-separation-ppo "
        "--spoofer hidden-pool-ppo",
        **{
            name: f"train.detector --data OUT/data --out OUT/{name} --seed {seed}"
            for name, seed in GUARDS.items()
        },
        "threshold": "spoofgym calibrate --task T3 --detector OUT/guard/guard.onnx --runs 2000 "
        "--hold-out 400 --transfer zhong2025 --transfer trolley-tactical",
        "window-data": "spoofgym dataset OUT/window-data --task S1 --detector never "
        "--train 512 --validation 192 --test 128 --term filter-shift "
        + " ".join(f"--family {name}" for name in AGED),
        "window-guard": "train.detector --data OUT/window-data --out OUT/window-guard "
        "--network window --past-s 320 --passes 20 --keep-last --projections 16",
        "window-threshold": "spoofgym calibrate --task S1 "
        "--detector OUT/window-guard/window-guard.onnx --runs 1000",
        "window-scores": "tools.against_reference OUT/window-guard/window-guard.onnx "
        "--out OUT/window-scores --runs 24 --selection-runs 12 --clean-runs 40 --entropy 771 "
        "--page",
        "suite": "train.suite_ppo --out OUT/suite",
        "replay": "train.replay_ppo --out OUT/replay --ship",
        "feedback": "tools.feedback_gain --out OUT/feedback",
        "feedback-T2": "tools.feedback_gain --task T2 --out OUT/feedback",
        "game": f"train.double_oracle --task T3 --out OUT/game {GAME}",
        "game-page": "tools.game_page OUT/game",
        "page": " ".join(["tools.learned_page", *(f"OUT/{name}" for name in folders)]),
    }
    after: dict[str, tuple[str, ...]] = {
        **dict.fromkeys(GUARDS, ("data",)),
        "threshold": ("guard",),
        "window-guard": ("window-data",),
        "window-threshold": ("window-guard",),
        "window-scores": ("window-threshold",),
        "feedback-T2": ("feedback",),  # both write to one folder
        "game-page": ("game",),
        "page": folders,
        **{later: (sooner,) for sooner, later in pairwise(cards)},  # all write to one page
    }
    words = {
        name: ["-m", *(word.replace("OUT", str(out)) for word in text.split())]
        for name, text in found.items()
    }
    return {name: Step(words[name], after.get(name, ())) for name in found}


def run(
    out: Path, steps: Mapping[str, Step], workers: int = 1, progress: ProgressBar | None = None
) -> dict[str, Any]:
    """Run what has not ended yet; seconds and command of every step, by its name."""
    parts = {}
    for name, step in steps.items():
        make = partial(_run_step, step.words, out / f"{name}.log", workers)
        after = tuple(each for each in step.after if each in steps)
        parts[name] = Part({"command": step.words}, make, after)
    done = Records("learn-all", {}, parts).play(out, progress, jobs=workers)
    write_json(out / MARKS, done)
    return done


def _run_step(words: list[str], log: Path, workers: int, _: Any, context: Context) -> Any:
    """Run a command to its end, on a part of the processors where there are several workers."""
    if sys.platform == "linux" and workers > 1 and "processors" not in context.cache:
        own = context.cache["processors"] = sorted(os.sched_getaffinity(0))
        k = int(re.split(r"\D", multiprocessing.current_process().name)[-1]) % workers
        os.sched_setaffinity(0, own[k::workers] or own)
    began = time.perf_counter()
    with log.open("w", encoding="utf-8") as file:
        subprocess.run([sys.executable, *words], stdout=file, stderr=file, check=True)
    return {"seconds": round(time.perf_counter() - began, 1), "command": words}


@error_lines()
def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of all results")
    parser.add_argument("--only", nargs="+", default=(), help="names of some steps")
    most = min(MOST_WORKERS, processors())
    parser.add_argument("--workers", type=int, default=most, help="steps at a time")
    parser.add_argument("--list", action="store_true", help="print the steps, and run none")
    given = parser.parse_args(arguments)
    steps = list_steps(given.out)
    for name in given.only:
        check_choice("step", name, steps)
    chosen = {name: step for name, step in steps.items() if name in (given.only or steps)}
    if given.list:
        for name, step in chosen.items():
            print(f"{name}: python {' '.join(step.words)}")
        return
    done = run(given.out, chosen, given.workers, show_progress)
    hours = sum(each["seconds"] for each in done.values()) / 3600.0
    print(f"{len(done)} of {len(steps)} steps have ended, in {hours:.2f} h of work")


if __name__ == "__main__":
    main(sys.argv[1:])
