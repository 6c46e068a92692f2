"""Calibration of a campaign's detectors: what is missing is made, what is there is replayed."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

from ...calibration.clean_runs import Progress
from ...calibration.holdouts import check
from ...calibration.thresholds import calibrate, expected_runs
from ...detectors import Calibrated, Detector, PooledDetector, detector_in_world
from ...detectors.calibrated import resolve
from ..runs.players import Entry
from ..runs.world import Suite


class _Rate(NamedTuple):
    """Detectors that are asked for at one rate, of one variant."""

    false_alarms_per_hour: float
    rescaled: bool


def _asked(suite: Suite) -> dict[_Rate, list[Detector]]:
    """Detectors of a campaign that ask for a rate of the calibrations that are looked up."""
    found: dict[_Rate, list[Detector]] = {}
    for part in (part for entry in suite.detector_entries for part in _parts(entry)):
        rate = part.false_alarms_per_hour
        if part.scale is None and part.calibration is None and rate is not None:
            found.setdefault(_Rate(rate, part.rescaled), []).append(part.detector)
    return found


def _parts(entry: Entry) -> Iterator[Calibrated]:
    judge = detector_in_world(entry.spec)
    parts = judge.judges if isinstance(judge, PooledDetector) else (judge,)
    yield from (part for part in parts if isinstance(part, Calibrated))


def missing_runs(suite: Suite) -> int:
    """Clean runs that the campaign's calibrations lack."""
    return sum(
        expected_runs(
            suite.world,
            detectors,
            false_alarms_per_hour=rate.false_alarms_per_hour,
            rescaled=rate.rescaled,
        )
        for rate, detectors in _asked(suite).items()
    )


def calibrate_suite(
    suite: Suite,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    optional: Collection[str] = (),
) -> dict[str, str]:
    """Calibrate the detectors that ask for a rate, and replay the first runs of their files.
    `optional`: labels of detectors that may be left out where no factor on their thresholds makes
    the rate; returns why, by their labels."""
    for rate, detectors in _asked(suite).items():
        found = calibrate(
            suite.world,
            detectors,
            false_alarms_per_hour=rate.false_alarms_per_hour,
            rescaled=rate.rescaled,
            threads=threads,
            progress=progress,
            strict=False,
        )
        check(suite.world, found, detectors, threads=threads)
    refused = {}
    for entry in suite.detector_entries:
        try:
            for part in _parts(entry):  # those of a file of the user's, too, which this looks up
                resolve(part, suite.world)
        except ValueError as error:
            if entry.label not in optional:
                raise
            refused[entry.label] = str(error)
    return refused
