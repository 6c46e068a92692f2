"""Detectors compared with the negative controls, run by run, at one rate of false alarms.

`never` does not alarm, and `lottery` alarms by chance at the rate that all are asked for.  A
detector against which a spoofer comes farther than against them has done harm, and is marked: its
interval lies above 0.  Detectors at different rates are never compared, and none at its nominal
thresholds is.  A spoofer that reads the detector's statistic obeys that of a lottery, too, which it
could ignore: against such a one `never` alone is a control.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...spoofers.base import sees_statistics
from ..runs.record import MEASURES, Aim, Cell, Protection
from .scores import ALIKE, SHARES, clusters_of, exceeded
from .statistics import (
    NOTHING,
    Estimate,
    FloatArray,
    bootstrap_mean,
    largest_of_share,
    percentiles,
    resamples_of,
)

CONTROLS = ("never", "lottery")  # names of the detectors that chance must not be told from
FREE = "any"  # footing of a detector that never alarms: it has none, and goes with any rate
Footings = Mapping[str, str]


def compare(
    cells: Sequence[Cell],
    protections: Sequence[Protection],
    footings: Footings,
) -> list[dict[str, Any]]:
    """Paired differences, detector less control, over the runs that count for both. Returns a row
    for each score: ``score``, ``spoofer`` or None, ``detector``, ``control``, ``difference_m``,
    ``above`` where its interval lies above 0, ``below`` where it lies below by more than `ALIKE` of
    what the control lets through."""
    found = []
    for control in controls(footings):
        for detector in footings:
            if comparable(footings, detector, control):
                found += _displacements(cells, detector, control)
                found += _protections(protections, detector, control)
    return found


def controls(footings: Footings) -> list[str]:
    return [label for label in footings if name_of(label) in CONTROLS]


def name_of(label: str) -> str:
    return label.partition("(")[0]


def comparable(footings: Footings, detector: str, other: str) -> bool:
    mine, theirs = footings[detector], footings[other]
    if detector == other or "nominal" in (mine, theirs):
        return False
    return mine == theirs or FREE in (mine, theirs)


def _displacements(cells: Sequence[Cell], detector: str, control: str) -> list[dict[str, Any]]:
    by_pair = {(cell.detector, cell.spoofer): cell for cell in cells}
    found = []
    for (label, spoofer), mine in by_pair.items():
        theirs = by_pair.get((control, spoofer))
        if label != detector or spoofer == "none" or theirs is None:
            continue
        obeys = sees_statistics(str(mine.head["knowledge"]["run_time"]))
        if obeys and "lottery" in (name_of(detector), name_of(control)):
            continue
        gap = mine.displacement_m - theirs.displacement_m
        both = mine.counts & theirs.counts
        samples = resamples_of(clusters_of(mine.sky)[both])
        difference = bootstrap_mean(gap[both], samples)
        size = float(theirs.displacement_m[both].mean()) if both.any() else 0.0
        found.append(_row("stealthy displacement", spoofer, detector, control, difference, size))
    return found


def _protections(
    protections: Sequence[Protection], detector: str, control: str
) -> list[dict[str, Any]]:
    by_label = {each.detector: each for each in protections}
    mine, theirs = by_label.get(detector), by_label.get(control)
    if mine is None or theirs is None:
        return []
    found = []
    for share in SHARES:
        aim = Aim(MEASURES[0], share)
        x, y = (each.worst(aim).displacement[aim.measure] for each in (mine, theirs))
        both = mine.counts & theirs.counts
        samples = resamples_of(clusters_of(mine.sky)[both])
        difference = _paired_exceeded(x[both], y[both], samples, share)
        word, size = f"protection {100 * share:g} %", exceeded(y[both], share)
        found.append(_row(word, None, detector, control, difference, size))
    return found


def _paired_exceeded(x: FloatArray, y: FloatArray, samples: FloatArray, share: float) -> Estimate:
    if not len(x):
        return NOTHING
    drawn = [largest_of_share(each, share, samples) for each in (x, y)]
    return percentiles(exceeded(x, share) - exceeded(y, share), drawn[0] - drawn[1])


def _row(
    score: str,
    spoofer: str | None,
    detector: str,
    control: str,
    difference: Estimate,
    size: float,
) -> dict[str, Any]:
    return {
        "score": score,
        "spoofer": spoofer,
        "detector": detector,
        "control": control,
        "difference_m": difference.as_json(),
        "above": bool(difference.low > 0.0),
        "below": bool(difference.high < -ALIKE * size),
    }
