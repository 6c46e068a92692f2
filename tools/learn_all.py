"""All trainings behind the pages, and their scores, by one command that goes on after a kill.

    python -m tools.learn_all --out runs/all                 # everything
    python -m tools.learn_all --out runs/all --only ppo-T3   # one step, or several
    python -m tools.learn_all --out runs/all --list          # what there is, and what it runs

Steps follow each other, each a command of its own in a folder of its own, which goes on where it
was.  A step that has ended is not run again, unless its command is another one now; `steps.json`
in the folder has the command of each of them, and the seconds that it took.  The last steps write
tables and cards of the pages in docs/ and spoofgym/.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

from agents.folder import error_lines
from spoofgym._files import write_file
from spoofgym._registry import check_choice
from spoofgym.detector_tasks import DETECTOR_TASKS
from spoofgym.tasks import TASKS

MARKS = "steps.json"
Steps = Mapping[str, Sequence[str]]
GAME = (
    *("--iterations", "3", "--runs", "200", "--selection-runs", "64", "--sift-runs", "24"),
    *("--values", "6", "--search-runs", "48", "--generations", "4", "--detectors"),
    "solution-separation",
    *(
        f"{name}:signals=range_rate"
        for name in (
            *("aime", "cumulative-bank", "cusum", "fma", "sequential-chi2", "shewhart"),
            *("snapshot-chi2", "windowed-chi2"),
        )
    ),
    "snapshot-chi2",
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


def steps_of(out: Path) -> dict[str, list[str]]:
    """Arguments of Python for every step, by its name, in their order."""
    recipes = {
        f"ppo-{key}": ["train.ppo_spoofer", "--task", key, *OWN.get(key, "").split()]
        for key in TASKS
    }
    fresh = ("--entropy", "1", "--seeds", "5", "6", "7", "8", "9")
    recipes |= {f"fresh-{key}": ["train.ppo_spoofer", "--task", key, *fresh] for key in FRESH}
    plain = {f"plain-{key}": ["train.plain_ppo", "--task", key] for key in ("T2", "T3", "T5")}
    folders = [*recipes, *plain, "spoofers", "refits", "refits-more"]
    guard = str(out / "guard" / "guard.onnx")
    found = {
        **{name: [*words, "--out", str(out / name)] for name, words in (recipes | plain).items()},
        "spoofers": ["train.spoofers", "--out", str(out / "spoofers")],
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
        "game-hmi": [
            *("train.double_oracle", "--task", "T3", "--out", str(out / "game-hmi"), *GAME),
            *("--payoff", "hmi"),
        ],
        "page": ["tools.learned_page", *(str(out / name) for name in folders)],
        **{
            f"cards-{key}": [
                *("tools.detector_cards", key, "--out", str(out / f"cards-{key}")),
                *("--runs", "200", "--selection-runs", "48"),
            ]
            for key in DETECTOR_TASKS
        },
    }
    return {name: ["-m", *words] for name, words in found.items()}


@dataclass(frozen=True)
class Settings:
    """What is run."""

    out: Path
    """Folder of all results."""
    only: tuple[str, ...] = ()
    """Names of some steps, as `--list` has them; all by default."""
    list: bool = False
    """Print the steps, and run none."""

    def __post_init__(self) -> None:
        """Check the names."""
        for name in self.only:
            check_choice("step", name, [*steps_of(self.out)])


def run(out: Path, steps: Steps, console: Console) -> dict[str, Any]:
    """Run what has not ended yet; seconds and command of every step that has, by its name.

    Raises `subprocess.CalledProcessError` at the first command that fails.
    """
    path = out / MARKS
    done: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.is_file() else {}
    for number, (name, words) in enumerate(steps.items(), 1):
        if name in done and done[name]["command"] == [*words]:
            continue
        console.print(f"{number} of {len(steps)}: {name}", highlight=False)
        began = time.perf_counter()
        subprocess.run([sys.executable, *words], check=True)
        spent_s = round(time.perf_counter() - began, 1)
        done[name] = {"seconds": spent_s, "command": [*words]}
        write_file(path, (json.dumps(done, indent=1) + "\n").encode())
    return done


def main() -> None:
    """Command line."""
    console = Console()
    with error_lines():
        given = tyro.cli(Settings, description=__doc__)
        steps = steps_of(given.out)
        if given.list:
            for name, words in steps.items():
                console.print(f"{name}: python {' '.join(words)}", soft_wrap=True, highlight=False)
            return
        chosen = {name: words for name, words in steps.items() if name in (given.only or steps)}
        done = run(given.out, chosen, console)
        hours = sum(each["seconds"] for each in done.values()) / 3600.0
        console.print(f"{len(done)} of {len(steps)} steps have ended, in {hours:.2f} h of work")


if __name__ == "__main__":
    main()
