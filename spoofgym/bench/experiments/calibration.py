"""All detectors of a world calibrated: what is missing is made, what is there is replayed."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

from ...calibration.holdouts import check
from ...calibration.thresholds import calibrate, expected_runs
from ...core.progress import ProgressCallback
from ...detectors import Detector
from ...detectors.calibrated import calibrated_parts
from ..runs.players import PlayerSpec
from ..runs.world import World


class _Rate(NamedTuple):
    """Detectors that are asked for at one rate, of one variant."""

    false_alarms_per_hour: float
    rescaled: bool


def _asked(entries: Iterable[PlayerSpec]) -> dict[_Rate, list[Detector]]:
    """Detectors that ask for a rate of the calibrations that are looked up."""
    found: dict[_Rate, list[Detector]] = {}
    for part in (part for entry in entries for part in calibrated_parts(entry.build())):
        rate = part.false_alarms_per_hour
        if part.scale is None and part.calibration is None and rate is not None:
            found.setdefault(_Rate(rate, part.rescaled), []).append(part.detector)
    return found


def missing_runs(world: World, entries: Iterable[PlayerSpec]) -> int:
    """Clean runs that the calibrations of detectors lack."""
    return sum(
        expected_runs(world.setup, detectors, **rate._asdict())
        for rate, detectors in _asked(entries).items()
    )


def calibrate_entries(
    world: World,
    entries: Sequence[PlayerSpec],
    *,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
    optional: Collection[str] = (),
) -> dict[str, str]:
    """Calibrate the detectors that ask for a rate, and replay the first runs of their files.
    `optional`: labels of detectors that may be left out where no factor on their thresholds makes
    the rate; returns why, by their labels."""
    for rate, detectors in _asked(entries).items():
        found = calibrate(
            world.setup,
            detectors,
            **rate._asdict(),
            threads=threads,
            progress=progress,
            strict=False,
        )
        check(world.setup, found, detectors, threads=threads)
    refused = {}
    for entry in entries:
        try:
            world.judge(entry)  # with what is in a file of the user's, too
        except ValueError as error:
            if entry.label not in optional:
                raise
            refused[entry.label] = str(error)
    return refused
