"""A paper as an experiment: a cell a part, so that a killed run goes on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.bench.experiments.runner import Context, Experiment, run_experiment
from spoofgym.bench.experiments.store import Cell, Reader, Result, Store
from spoofgym.core.progress import ProgressBar

from .frame import Part, Row, Settings
from .paper import count_runs, list_parts, list_rows, load_paper, rows_record
from .sources import digest_of_modules

Data = dict[str, dict[str, Any]]
"""What each part returned, by its name."""


class PartError(RuntimeError):
    """A part has failed."""


class PaperRun(Experiment):
    """Parts of a paper, and the folder in which their results are kept."""

    name = "paper"

    def __init__(self, key: str, settings: Settings, out: Path) -> None:
        self.key, self.settings = key, settings
        self.parts = {part.name: part for part in list_parts(load_paper(key), settings)}
        modules = {part.function.__module__ for part in self.parts.values()}
        self._sources = digest_of_modules(modules)
        extent = "quick" if settings.quick else "full"
        self.store = Store(out / key / f"{extent}-seed{settings.seed}")

    @property
    def config(self) -> Mapping[str, Any]:
        """Which paper, how, and the code of its parts; that of the library the store adds."""
        quick, seed = self.settings.quick, self.settings.seed
        return {"paper": self.key, "quick": quick, "seed": seed, "sources": self._sources}

    def cells(self) -> Iterable[Cell]:
        """One a part."""
        return [
            Cell(part.name, {"settings": part.settings}, part.weight)
            for part in self.parts.values()
        ]

    def run(self, cell: Cell, results: Reader, context: Context) -> Result:
        """What a part returns, arrays apart."""
        part: Part = self.parts[cell.key]
        try:
            found = part.function(**part.settings)
        except Exception as error:
            raise PartError(f"part {part.name!r} of {self.key} has failed: {error}") from error
        arrays = {name: value for name, value in found.items() if isinstance(value, np.ndarray)}
        record = {name: value for name, value in found.items() if name not in arrays}
        return Result(arrays, record, deflated=True)

    def play(
        self, jobs: int = 1, progress: ProgressBar | None = None, *, overwrite: bool = False
    ) -> Data:
        """Run what is left, or all of it, and read everything."""
        if overwrite:
            self.store.open(self.name, self.config, overwrite=True)
        return self._data(run_experiment(self, self.store, jobs=jobs, progress=progress))

    def load_data(self) -> Data:
        """Read everything; a ValueError where something has not been run."""
        self.store.open(self.name, self.config)
        results = Reader(self.store, self.cells())
        if missing := results.missing:
            raise ValueError(f"part {missing[0]!r} of {self.key} is not in {self.store.path}")
        return self._data(results)

    @staticmethod
    def _data(results: Reader) -> Data:
        return {name: {**found.record, **found.arrays} for name, found in results.items()}

    def rows(self, data: Data) -> list[Row]:
        """Figures of the paper beside ours, checked."""
        return list_rows(load_paper(self.key), data, self.settings)

    def report(self, results: Reader) -> dict[str, Any]:
        """The run as JSON: ``paper``, ``runs``, ``seed``, and what `rows_record` gives."""
        return self.record(self._data(results))

    def record(self, data: Data) -> dict[str, Any]:
        """The same from what was read."""
        return {
            "paper": self.key,
            "runs": count_runs([*self.parts.values()], data),
            "seed": self.settings.seed,
            **rows_record(self.rows(data)),
        }

    def draw(self, data: Data, folder: Path) -> list[Path]:
        """The paper's figures, drawn from our runs."""
        import matplotlib

        matplotlib.use("Agg")
        folder.mkdir(parents=True, exist_ok=True)
        return load_paper(self.key).figures(data, folder)
