"""The folder of a campaign: every finished part is a file of its own, complete or absent."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

from .cells import Cell
from .specs import digest_of, slug
from .suite import Suite
from .tune import TuningResult

CONFIG, TABLE, SUMMARY, PICTURE = "config.json", "results.md", "summary.json", "campaign.png"
CELLS, TUNINGS = "cells", "tuning"
OWN = (CONFIG, TABLE, SUMMARY, PICTURE, CELLS, TUNINGS)


class ResultsFolder:
    """Results of one campaign.

    Parameters
    ----------
    path : path-like
        The folder.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)

    def open(self, suite: Suite, *, overwrite: bool = False) -> None:
        """Begin a campaign, or go on with it."""
        if self.path.exists() and not self.path.is_dir():
            raise ValueError(f"{self.path} is not a folder; choose another one with --out")
        config = self.path / CONFIG
        leftover = [item for item in self._content() if not item.name.endswith(".part")]
        if not config.is_file():
            if leftover:
                raise ValueError(
                    f"{self.path} is not empty and holds no {CONFIG} of a campaign "
                    f"({', '.join(sorted(item.name for item in leftover)[:5])}); choose another "
                    "folder with --out"
                )
        elif digest_of(self.config()) != suite.digest:
            if not overwrite:
                changed = ", ".join(differences(self.config(), suite.config))
                raise ValueError(
                    f"{self.path} holds the results of another campaign (different: {changed}); "
                    "choose another folder with --out, or --overwrite to replace them"
                )
            self._clear()
        elif overwrite:
            self._clear()
        self._write(config, json.dumps(suite.config, indent=1, allow_nan=False))

    def _content(self) -> list[Path]:
        return list(self.path.iterdir()) if self.path.is_dir() else []

    def _clear(self) -> None:
        """Remove what a campaign writes, and nothing else."""
        for name in OWN:
            item = self.path / name
            if item.is_dir():
                shutil.rmtree(item)
            else:
                item.unlink(missing_ok=True)

    def config(self) -> dict[str, Any]:
        """Configuration that is written there."""
        config = self.path / CONFIG
        if not config.is_file():
            raise ValueError(f"{self.path} holds no results of a campaign: there is no {CONFIG}")
        try:
            found = json.loads(config.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"{config} is not JSON: {error}") from error
        if not isinstance(found, dict) or "detectors" not in found:
            raise ValueError(f"{config} is not the configuration of a campaign")
        return found

    def _cell_path(self, detector: str, spoofer: str) -> Path:
        return self.path / CELLS / f"{slug(detector)}--{slug(spoofer)}.jsonl"

    def _tuning_path(self, detector: str, spoofer: str) -> Path:
        return self.path / TUNINGS / f"{slug(detector)}--{slug(spoofer)}.json"

    def has_cell(self, detector: str, spoofer: str) -> bool:
        """Whether a cell is finished."""
        return self._cell_path(detector, spoofer).is_file()

    def put_cell(self, cell: Cell) -> None:
        """Write a finished cell."""
        text = "\n".join(cell.to_lines()) + "\n"
        self._write(self._cell_path(cell.detector, cell.spoofer), text)

    def cell(self, detector: str, spoofer: str) -> Cell:
        """Read a finished cell."""
        path = self._cell_path(detector, spoofer)
        try:
            return Cell.from_lines(path.read_text(encoding="utf-8").splitlines())
        except (ValueError, KeyError, IndexError) as error:
            raise ValueError(f"{path} is damaged ({error}); delete it and run again") from error

    def put_tuning(self, result: TuningResult) -> None:
        """Write a finished search."""
        text = json.dumps(result.as_dict(), indent=1, allow_nan=False) + "\n"
        self._write(self._tuning_path(result.detector, result.spoofer), text)

    def tuning(self, detector: str, spoofer: str) -> TuningResult | None:
        """Read a finished search."""
        path = self._tuning_path(detector, spoofer)
        if not path.is_file():
            return None
        return TuningResult.from_dict(json.loads(path.read_text(encoding="utf-8")))

    def put_text(self, name: str, text: str) -> Path:
        """Write a report."""
        self._write(self.path / name, text)
        return self.path / name

    @staticmethod
    def _write(path: Path, text: str) -> None:
        """Write a file as a whole: to a temporary one that is renamed."""
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        with part.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)


def differences(mine: Any, yours: Any, where: str = "") -> list[str]:
    """Settings that differ between two configurations."""
    if isinstance(mine, dict) and isinstance(yours, dict):
        names = [*mine, *(key for key in yours if key not in mine)]
        found = []
        for name in names:
            inside = f"{where}.{name}" if where else str(name)
            found += differences(mine.get(name), yours.get(name), inside)
        return found
    return [] if mine == yours else [where]
