"""A small experiment: numbers, their sums, and a group in one pass."""

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from spoofgym.bench.experiments import Cell, Experiment, Interrupted, Result, Store, run_experiment


@dataclass(frozen=True)
class Numbers(Experiment):
    name: ClassVar[str] = "numbers"
    outputs: ClassVar[tuple[str, ...]] = ("report.json",)
    size: int = 3
    seconds: float = 0.0
    kills: str = ""
    """File whose absence lets the cell ``draw-1`` end its process, once."""

    @property
    def config(self):
        return {"size": self.size}

    def cells(self):
        for k in range(self.size):
            yield Cell(f"draw-{k}", {"seed": k}, work=1.0 + k)
            yield Cell(f"Sum of {k}", {"of": k}, after=(f"draw-{k}",))
        for k in range(2):
            yield Cell(f"pass-{k}", {"detector": k}, after=("draw-0",), group="one pass")

    def run(self, cell, results, context):
        time.sleep(self.seconds)
        if cell.key == "draw-1" and self.kills and not os.path.exists(self.kills):
            Path(self.kills).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if cell.key.startswith("draw"):
            rng = np.random.default_rng(cell.identity["seed"])
            arrays = {"normal": rng.normal(size=(5, 3)).T, "count": np.array(3)}
            return Result(arrays, {"key": cell.key, "threads": 1})
        (before,) = results.values()
        context.tick(0.5 * cell.work)
        return Result(record={"sum": before.arrays["normal"].sum(), "key": cell.key})

    def report(self, results):
        return {key: result.record for key, result in results.items()}


def content(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix != ".part"
    }


if __name__ == "__main__":  # folder, seconds a cell, jobs, file of the kill
    folder, seconds, jobs, *kills = sys.argv[1:]
    try:
        run_experiment(Numbers(3, float(seconds), *kills), Store(folder), jobs=int(jobs))
    except (Interrupted, OSError) as error:
        sys.exit(str(error))
