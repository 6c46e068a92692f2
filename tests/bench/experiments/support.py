"""A small experiment: numbers, their sums, and a group in one pass."""

from __future__ import annotations

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from spoofgym.bench.experiments import Cell, Experiment, Result, Store, run_experiment


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
            return Result(arrays, {"key": cell.key, "threads": 1}, {"a.onnx": bytes(range(9))})
        (before,) = results.values()
        context.tick(0.5 * cell.work)
        return Result(record={"sum": before.arrays["normal"].sum(), "key": cell.key})

    def run_group(self, cells, results, context):
        context.cache["calls"] = context.cache.get("calls", 0) + 1
        return super().run_group(cells, results, context)

    def report(self, results):
        return {key: result.record for key, result in results.items()}


def content(folder: Path) -> dict[str, bytes]:
    """All files but temporary ones."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix != ".part"
    }


def expected(folder: Path, **settings) -> dict[str, bytes]:
    """What a run that nothing interrupts leaves."""
    run_experiment(Numbers(**settings), Store(folder))
    return content(folder)


if __name__ == "__main__":  # folder, seconds a cell, jobs, file of the kill
    from spoofgym.bench.experiments import Interrupted

    try:
        run_experiment(
            Numbers(seconds=float(sys.argv[2]), kills=sys.argv[4] if sys.argv[4:] else ""),
            Store(sys.argv[1]),
            jobs=int(sys.argv[3]),
        )
    except (Interrupted, OSError) as error:
        sys.exit(str(error))
