"""Calibrations that a killed process goes on with, and those of all detectors of a world."""

from __future__ import annotations

import copy
import shutil
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial, wraps
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...calibration import holdouts, thresholds
from ...calibration.clean_runs import CHUNK, CleanRuns, Numbers, Player, gather_runs, join_runs
from ...core.devices import SIMULATED, check_device, import_torch
from ...core.progress import ProgressBar, ProgressCallback
from ...core.settings import compute_digest
from ...detectors import Calibrated, Detector
from ...detectors.calibrated import calibrated_parts, describe_identity
from ...detectors.calibration_file import user_folder
from ...simulation.setup import Setup
from ...simulation.simulator import run_serially
from ..runs.players import PlayerSpec
from ..runs.world import World
from .identity import code_identity
from .runner import Context, Experiment, run_experiment
from .store import Cell, Reader, Result, Store

TOGETHER_ON_DEVICE = 16_384
"""Runs of a chunk on a device, one chunk at a time."""
_device = threading.Lock()
TOGETHER = 8  # cells, of the runs that are played side by side, that threads share in one call


@dataclass(frozen=True)
class CleanCells(Experiment):
    """What clean runs come to, a cell for each chunk of them."""

    name: ClassVar[str] = "clean-runs"
    player: Player
    detectors: Sequence[Detector]
    runs: int
    split: str
    in_loop: bool
    now: str

    @property
    def config(self) -> dict[str, Any]:
        """World and detectors; not how many runs, so that more of them go on."""
        player = self.player
        config = {
            "world": player.setup.conditions.digest,
            "detectors": [_identify_detector(each) for each in self.detectors],
            "seeds": [player.entropy, self.split, player.seed_name],
            "in_loop": self.in_loop,
        }
        return config if player.chunk == CHUNK else {**config, "chunk": player.chunk}

    def cells(self) -> Iterator[Cell]:
        chunk = self.player.chunk
        for k, first in enumerate(range(0, self.runs, chunk)):
            last = min(first + chunk, self.runs)
            group = f"{self.now}, part {k // TOGETHER + 1}"
            yield Cell(f"{first}-{last}", {"runs": [first, last]}, float(last - first), group=group)

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        chunks = [range(*map(int, cell.key.split("-"))) for cell in cells]
        how = self.split, self.in_loop, context.tick
        for part in self.player.play_chunks(self.detectors, chunks, *how):
            yield Result(part._asdict())

    def collect_runs(self, results: Reader) -> CleanRuns:
        return join_runs(CleanRuns(**found.arrays) for found in results.values())

    def report(self, results: Reader) -> dict[str, Any]:
        found = self.collect_runs(results)
        return {"runs": len(found.alarmed), "alarms": found.alarmed.sum(axis=0).tolist()}


def _identify_detector(detector: Detector) -> Any:
    if isinstance(detector, Calibrated):
        return [describe_identity(detector.detector), detector.scale, detector.rescale]
    return [describe_identity(detector), getattr(detector, "alarm_scale", 1.0)]


@dataclass
class ResumablePlayer(Player):
    """Keeps the first runs in the user's folder until they are no longer needed, so that a killed
    process goes on from there."""

    folders: list[Path] = field(default_factory=list)

    def play(
        self,
        detectors: Sequence[Detector],
        numbers: Numbers,
        *,
        split: str = "calibration",
        in_loop: bool = False,
        now: str = "clean runs",
    ) -> CleanRuns:
        if not isinstance(numbers, range):  # a few, again
            return super().play(detectors, numbers, split=split, in_loop=in_loop, now=now)
        cells = CleanCells(self, detectors, len(numbers), split, in_loop, now)
        name = compute_digest({**cells.config, "code": code_identity()})
        store = Store(user_folder() / "unfinished" / name)
        self.folders.append(store.path)

        def bar(left: float) -> nullcontext[ProgressCallback]:
            self.progress.advance(len(numbers) - left, now)
            return nullcontext(self.progress)

        return cells.collect_runs(run_experiment(cells, store, progress=bar))

    def forget(self) -> None:
        for folder in self.folders:
            shutil.rmtree(folder)
        self.folders.clear()


def play_on_device(
    setup: Setup,
    detectors: Sequence[Detector],
    in_loop: bool,
    rngs: Sequence[np.random.Generator],
    stopped: threading.Event | None,
    *,
    device: str = "cuda",
) -> CleanRuns:
    """Play clean runs on a device, of one detector after the other, as `Player` does."""
    from ...cuda.pool import Fleet
    from ...cuda.supported import check_receivers

    torch, found = import_torch(), []
    for detector in detectors:
        judged = setup.copy_with(detector=detector, monitors=())
        check_receivers(judged, attacked=False)
        simulator = judged.simulator(len(rngs), run_serially)
        simulator.start_episodes(copy.deepcopy(rngs))
        with _device, torch.no_grad():
            fleet = Fleet(torch, simulator, torch.device("cpu" if SIMULATED else device))
            before = fleet.warm_up(stopped)
            window = fleet.run(setup.steps + setup.hold, stopped)
        found.append((*before, *window))
    columns = [np.stack(each, axis=1) for each in zip(*found, strict=True)]
    return gather_runs(simulator, setup, columns[:2], columns[2:])


def _resumable(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that plays clean runs, going on after a kill; with `device` ``"cuda"`` they are
    played on a GPU, with the same bits."""

    @wraps(function)
    def play(*given: Any, device: str = "cpu", **settings: Any) -> Any:
        check_device(device)
        player: Callable[..., Player] = ResumablePlayer
        if device != "cpu":
            batch = partial(play_on_device, device=device)
            player = partial(player, batch=batch, chunk=TOGETHER_ON_DEVICE)
        return function(*given, **{"player": player, **settings})

    return play


calibrate = _resumable(thresholds.calibrate_detectors)
hold_out = _resumable(holdouts.hold_out)
transfer = _resumable(holdouts.transfer)


def calibrate_players(
    world: World,
    entries: Sequence[PlayerSpec],
    *,
    threads: int | None = None,
    progress: ProgressBar | None = None,
    optional: Collection[str] = (),
) -> dict[str, str]:
    """Calibrate the detectors that request a rate, and replay the first runs of their files.
    `optional`: labels of detectors that may be left out where no factor on their thresholds makes
    the rate; returns why, by their labels."""
    setup = world.setup  # what is wrong with the world is wrong with no detector
    requests: dict[tuple[float, bool], list[Detector]] = {}
    for part in (part for entry in entries for part in calibrated_parts(entry.build())):
        rate = part.false_alarms_per_hour
        if part.scale is None and part.calibration is None and rate is not None:
            requests.setdefault((rate, part.rescaled), []).append(part.detector)
    for (rate, rescaled), detectors in requests.items():
        found = calibrate(
            setup,
            detectors,
            false_alarms_per_hour=rate,
            rescaled=rescaled,
            threads=threads,
            progress=progress,
            strict=False,
        )
        holdouts.check(setup, found, detectors, threads=threads)
    refused = {}
    for entry in entries:
        try:
            world.judge(entry)  # with what is in a file of the user's, too
        except ValueError as error:
            if entry.label not in optional:
                raise
            refused[entry.label] = str(error)
    return refused
