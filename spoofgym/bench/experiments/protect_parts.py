"""Finished parts of the scores of detectors, one file for a detector and a family."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from ...core.files import write_file
from ...core.registry import slug
from ...core.settings import describe, digest_of, outside_sources
from ...detectors import Calibrated, PooledDetector
from ...tasks import AttackFamily, DetectorTask
from ..search.settings import Selection
from .task_worlds import Defence
from .versions import versions


@dataclasses.dataclass(frozen=True)
class Parts:
    """A folder of them, named by all that they depend on; nothing is kept without one."""

    folder: Path | None
    task: DetectorTask
    runs: int
    selection: Selection
    entropy: int

    @cached_property
    def _versions(self) -> dict[str, str]:
        return versions()

    def head(self, family: AttackFamily | None, defence: Defence) -> dict[str, Any]:
        """What a part depends on, JSON-able."""
        judge = defence.judge
        parts = judge.judges if isinstance(judge, PooledDetector) else (judge,)
        scales = [each.scale for each in parts if isinstance(each, Calibrated)]
        return {
            "detector": defence.entry.label,
            "task": self.task.key,
            "family": None if family is None else dataclasses.asdict(family),
            "world": describe(self.task.world_kwargs),
            "alert_limit_m": self.task.alert_limit_m,
            "detector_settings": defence.entry.spec,
            "scales": scales,
            "outside": outside_sources(judge),
            "runs": self.runs,
            "selection": dataclasses.asdict(self.selection),
            "entropy": self.entropy,
            "versions": self._versions,
        }

    def _path(self, family: AttackFamily | None, defence: Defence) -> Path | None:
        """File of a part, named by all that it depends on; None where nothing is kept."""
        head = self.head(family, defence)
        if self.folder is None or None in head["outside"].values():
            return None
        name = "false-alarms" if family is None else family.key
        file = f"{slug(defence.entry.label)}--{name}--{digest_of(head)}.json"
        return self.folder / self.task.key / file

    def kept(self, family: AttackFamily | None, defence: Defence) -> str | None:
        """Text of a finished part, or None."""
        path = self._path(family, defence)
        return path.read_text(encoding="utf-8") if path is not None and path.is_file() else None

    def keep(self, family: AttackFamily | None, defence: Defence, text: str) -> None:
        """Write a finished part down."""
        path = self._path(family, defence)
        if path is not None:
            write_file(path, text.encode())

    def open(self, family: AttackFamily | None, defences: Sequence[Defence]) -> list[Defence]:
        """Detectors whose part is not finished."""
        paths = ((each, self._path(family, each)) for each in defences)
        return [each for each, path in paths if path is None or not path.is_file()]
