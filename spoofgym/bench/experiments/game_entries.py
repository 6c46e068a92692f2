"""Entries of a matrix game in a folder, each in a file of its own by all that it depends on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...core.files import remove_stale_parts, whole_file
from ...core.settings import digest_of, outside_sources
from ...detectors import Detector
from ...detectors.calibrated import factors_of
from ..runs.world import WORLD, World
from ..scores.matrix_game import Played
from .members import Member
from .versions import versions

FORMAT = 1


class KeptEntries:
    """Folder of what the pairs of one world have played on one set of runs. `seeds`: entropy and
    split of the runs."""

    def __init__(self, folder: Path, world: World, runs: int, seeds: tuple[int, str]) -> None:
        self.folder, self.world, self.runs, self.seeds = folder, world, runs, seeds
        folder.mkdir(parents=True, exist_ok=True)
        remove_stale_parts(folder)

    def load(
        self, spoofer: Member, detector: Member, judge: Detector
    ) -> tuple[Played, NDArray[np.int64]] | None:
        """What a pair has played, and the skies of its runs. `judge`: that detector with its
        thresholds in this world; returns none where there is no such entry."""
        file = self.file_of(spoofer, detector, judge)
        if file is None or not file.is_file():
            return None
        with np.load(file) as found:
            return Played(*(found[name] for name in Played._fields)), found["sky"]

    def keep(
        self,
        spoofer: Member,
        detector: Member,
        judge: Detector,
        played: Played,
        sky: NDArray[np.int64],
    ) -> None:
        """Write an entry, whole or not at all; none of an object that can't be described.
        `spoofer`, `detector`, `judge`: as in `load`; `sky`: (R,) sky of each run."""
        file = self.file_of(spoofer, detector, judge)
        if file is not None:
            head = json.dumps([spoofer.as_json(), detector.as_json()])
            with whole_file(file) as part, part.open("wb") as content:
                np.savez(content, **played._asdict(), sky=sky, head=np.array(head))

    def file_of(self, spoofer: Member, detector: Member, judge: Detector) -> Path | None:
        """Where an entry is kept. `spoofer`, `detector`, `judge`: as in `load`; returns by all that
        the entry depends on; None where that can't be written."""
        if spoofer.spec is None or detector.spec is None:
            return None
        factors = factors_of(judge)
        around = outside_sources(*self.world.parts)
        outside = outside_sources(judge, spoofer.spec, detector.spec)
        if None in (*around.values(), *outside.values()):
            return None
        config = self.world.config
        named = {
            "format": FORMAT,
            "world": {
                **{name: config[name] for name in (*WORLD, "env")},
                **{"versions": versions(), "outside": around},
            },
            "settings": config.get("settings"),
            "runs": [self.runs, *self.seeds],
            "spoofer": spoofer.spec,
            "detector": [detector.spec, *factors],
            "sources": outside,
        }
        return self.folder / f"{digest_of(named)}.npz"
