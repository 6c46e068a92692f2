"""The folder of a campaign: every finished part is a file of its own, complete or absent.

A part says which campaign it is of, and is not taken for one of another.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...core.files import remove_stale_parts, write_file
from ...core.registry import slug
from ...core.settings import differences
from ..runs.players import TUNED
from ..runs.record import Cell, Protection
from ..search.amplitude import TuningResult
from .suite import Suite
from .versions import campaign_digest

CONFIG, TABLE, SUMMARY, PICTURE = "config.json", "results.md", "summary.json", "campaign.png"
CELLS, TUNINGS, PROTECTIONS, LIMITS = "cells", "tuning", "protection", "limits"
FOLDERS = (CELLS, TUNINGS, PROTECTIONS, LIMITS)
OWN = (*FOLDERS, TABLE, SUMMARY, PICTURE, CONFIG)
"""In the order in which they are removed: what says whose results they are comes last."""


class ResultsFolder:
    """Results of one campaign.

    Parameters
    ----------
    path : path-like
        The folder.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._campaign: str | None = None

    def open(self, suite: Suite, *, overwrite: bool = False) -> None:
        """Begin a campaign, or go on with it."""
        if self.path.exists() and not self.path.is_dir():
            raise ValueError(f"{self.path} is not a folder; choose another one with --out")
        for folder in (self.path, *(self.path / name for name in FOLDERS)):
            remove_stale_parts(folder)
        config = self.path / CONFIG
        leftover = [item for item in self._content() if not item.name.endswith(".part")]
        if not config.is_file():
            if leftover:
                raise ValueError(
                    f"{self.path} is not empty and holds no {CONFIG} of a campaign "
                    f"({', '.join(sorted(item.name for item in leftover)[:5])}); choose another "
                    "folder with --out"
                )
        elif overwrite:
            self.config()  # which raises where it is no campaign's
            self._clear()
        text = json.dumps(suite.config, indent=1, allow_nan=False)
        try:
            write_file(config, text.encode(), exclusive=True)
        except FileExistsError:  # to be gone on with, or of one that has begun in this moment
            found = self.config()
            if campaign_digest(found) != suite.digest:
                changed = ", ".join(name for name, _, _ in differences(found, suite.config))
                raise ValueError(
                    f"{self.path} holds the results of another campaign (different: {changed}); "
                    "choose another folder with --out, or --overwrite to replace them"
                ) from None
        self._campaign = suite.digest

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
        """Whether a cell is finished, of this campaign."""
        there = self._cell_path(detector, spoofer).is_file()
        return there and self.cell(detector, spoofer) is not None

    def put_cell(self, cell: Cell) -> None:
        """Write a finished cell."""
        text = "\n".join(cell.to_lines()) + "\n"
        self._own_config()
        write_file(self._cell_path(cell.detector, cell.spoofer), text.encode())

    def cell(self, detector: str, spoofer: str) -> Cell:
        """Read a finished cell of this campaign."""
        path = self._cell_path(detector, spoofer)
        try:
            cell = Cell.from_lines(path.read_text(encoding="utf-8").splitlines())
        except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
            raise ValueError(f"{path} is damaged ({error}); delete it and run again") from error
        head = {**cell.head, "runs": cell.runs}
        self._check(path, head, detector=detector, spoofer=spoofer)
        return cell

    def put_tuning(self, result: TuningResult) -> None:
        """Write a finished search."""
        config = self._own_config()
        head = {"entropy": config["entropy"], "campaign": campaign_digest(config)}
        text = json.dumps({**head, **result.as_dict()}, indent=1, allow_nan=False) + "\n"
        write_file(self._tuning_path(result.detector, result.spoofer), text.encode())

    def tuning(self, detector: str, spoofer: str) -> TuningResult | None:
        """Read a finished search of this campaign; None where there is none."""
        path = self._tuning_path(detector, spoofer)
        if not path.is_file():
            return None
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            head = {key: found.pop(key) for key in ("entropy", "campaign")}
            result = TuningResult.from_dict(found)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{path} is damaged ({error}); delete it and run again") from error
        head |= {"detector": result.detector, "spoofer": result.spoofer}
        self._check(path, head, detector=detector, spoofer=spoofer)
        return result

    def _protection_path(self, detector: str) -> Path:
        return self.path / PROTECTIONS / f"{slug(detector)}.json"

    def put_protection(self, found: Protection) -> None:
        """Write what the attack suite has achieved against a detector."""
        self._own_config()
        write_file(self._protection_path(found.detector), found.to_text().encode())

    def protection(self, detector: str) -> Protection | None:
        """Read what the attack suite has achieved; None where it has not been played."""
        path = self._protection_path(detector)
        if not path.is_file():
            return None
        try:
            found = Protection.from_text(path.read_text(encoding="utf-8"))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{path} is damaged ({error}); delete it and run again") from error
        self._check(path, found.head, detector=detector)
        return found

    def _limits_path(self, detector: str | None) -> Path:
        return self.path / LIMITS / ("floor.json" if detector is None else f"{slug(detector)}.json")

    def put_limits(self, detector: str | None, found: dict[str, Any]) -> None:
        """Write the zero-alarm bounds of a detector, or the floor of the world for None."""
        config = self._own_config()
        campaign = campaign_digest(config)
        head = {"detector": detector, "entropy": config["entropy"], "campaign": campaign}
        text = json.dumps({**head, "limits": found}, indent=1, allow_nan=False) + "\n"
        write_file(self._limits_path(detector), text.encode())

    def limits(self, detector: str | None) -> dict[str, Any] | None:
        """Read them; None where they have not been computed."""
        path = self._limits_path(detector)
        if not path.is_file():
            return None
        try:
            head = json.loads(path.read_text(encoding="utf-8"))
            found: dict[str, Any] = head.pop("limits")
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{path} is damaged ({error}); delete it and run again") from error
        self._check(path, head)
        return found

    def put_text(self, name: str, text: str) -> Path:
        """Write a report."""
        write_file(self.path / name, text.encode())
        return self.path / name

    def _own_config(self) -> dict[str, Any]:
        """Configuration of the campaign that was opened here, as long as the folder is its."""
        config = self.config()
        if self._campaign not in (None, campaign_digest(config)):
            raise ValueError(
                f"{self.path} has been taken by another campaign meanwhile; choose another folder "
                "with --out"
            )
        return config

    def _check(self, path: Path, head: Mapping[str, Any], **named: str) -> None:
        """Raise where the head of a part is not what the campaign of the folder asks for."""
        config = self.config()
        asked = {**named, "entropy": config["entropy"], "campaign": campaign_digest(config)}
        if "runs" in head:
            asked["runs"] = config["runs"]
            for kind, label in named.items():
                specs = {entry["label"]: entry["spec"] for entry in config[f"{kind}s"]}
                asked[f"{kind}_settings"] = specs.get(label)
        found = [
            f"{name} is {there!r} and not {wanted!r}"
            for name, there, wanted in differences({key: head.get(key) for key in asked}, asked)
            if wanted != TUNED and not (name.endswith("rates_mps") and not wanted)
        ]
        if found:
            raise ValueError(
                f"{path} is of another campaign than its folder: {'; '.join(found)}; delete it and "
                "run again"
            )
