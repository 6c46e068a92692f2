r"""What the worst attack exceeds in a share of the runs, with an interval that includes the choice.

The figure is the largest over all attacks that played the evaluation runs.  A setting of an attack
has a few values that were played, and the figure often is the whole displacement at one of them:
with this value alone the interval would have no width.  So the bootstrap (`efron1979`) looks for
the worst attack again in every draw, and the interval reaches

- from the lower end of what the played attacks exceed
- to the upper end of what these and settings between two played values of one attack exceed.

A part t of the way (in the logarithm) from one value to the next, the share of alarms and the
displacements are between theirs, too.  With the displacements D and D' at the two, and those of the
farthest runs M and M',

.. math:: P_t(D > d) = (1 - t) P(D (M' / M)^t > d) + t P(D' (M / M')^{1 - t} > d)

The figure itself is that of an attack that was played.  Few runs have no upper end: where all of
them lie below the quantile with a chance of over 2.5 %, (1 - share)^R', as with less than 72 runs
for a share of 5 %.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise

import numpy as np

from ..runs.record import Aim, Mask, Protection, Winner
from .statistics import (
    NOTHING,
    Estimate,
    FloatArray,
    bound_above,
    largest_of_share,
    map_samples,
    percentiles,
)

PARTS = np.arange(1, 8) / 8.0  # of the way between two values of a setting
Between = tuple[FloatArray, FloatArray, float]
"""Displacements (R') at two values of a setting, scaled to a part of the way, and that part."""


def estimate_exceeded(aim: Aim, *parts: tuple[Protection, FloatArray]) -> Estimate:
    """What the worst of one or more groups of attacks exceeds in the share of an aim [m], with its
    95 % interval, whose upper end is NaN where the runs are too few for one. `parts`: each group
    with (S, R') bootstrap samples of the runs that the aim is about."""
    drawn = [_draw_group(found, aim, each) for found, each in parts if found.rows(aim).any()]
    if not drawn:
        return NOTHING
    assert aim.share is not None  # as chosen by the caller
    value, least, most, runs = zip(*drawn, strict=True)
    low, high = (np.max(each, axis=0) for each in (least, most))
    worst = max(value)
    ends = percentiles(worst, low).low, percentiles(worst, np.maximum(high, worst)).high
    return bound_above(Estimate(worst, *ends), aim.share, min(runs))


def _draw_group(
    found: Protection, aim: Aim, samples: FloatArray
) -> tuple[float, FloatArray, FloatArray, int]:
    """What the worst attack exceeds in a share of the runs [m], the same (S,) of the bootstrap
    samples, of attacks that were played and of settings between, too, and the number of runs."""
    rows, value = found.rows(aim), found.score_worst(aim)
    drawn = draw_exceeded(found, aim, rows, samples)
    most = np.maximum(drawn, value)
    for between in _list_between(found.winners, aim, rows, value):
        np.maximum(most, _draw_between(between, aim, samples, value), out=most)
    return value, drawn, most, int(rows.sum())


def draw_exceeded(found: Protection, aim: Aim, rows: Mask, samples: FloatArray) -> FloatArray:
    """(S,) what the worst attack of each bootstrap sample exceeds [m]. `samples` (S, R') of the
    `rows` (R,), of which there is at least one."""
    moved = [each.displacement[aim.measure][rows] for each in found.winners]
    moved.sort(key=aim.score_displacement, reverse=True)
    most = _draw(moved[0], aim, samples)
    for each in moved[1:]:
        if each.max() > most.min():  # of the others none can be the worst
            np.maximum(most, _draw(each, aim, samples), out=most)
    return most


def _draw(displacement: FloatArray, aim: Aim, samples: FloatArray) -> FloatArray:
    assert aim.share is not None  # as chosen by the caller
    return largest_of_share(displacement, aim.share, samples)


def _draw_between(between: Between, aim: Aim, samples: FloatArray, least: float) -> FloatArray:
    """(S,) what is exceeded there, and `least` where that is more."""
    near, far, part = between
    x, y = near > least, far > least
    moved = np.concatenate([near[x], far[y], [least]])

    def find(some: FloatArray) -> FloatArray:
        weights = [(1.0 - part) * some[:, x], part * some[:, y]]
        rest = some.sum(axis=1) - sum(each.sum(axis=1) for each in weights)
        return _draw(moved, aim, np.column_stack([*weights, rest]))

    return map_samples(find, samples)


def _list_between(
    winners: Sequence[Winner], aim: Aim, rows: Mask, least: float
) -> Iterator[Between]:
    """Of all values of a setting that are next to each other, the larger of which gets farther than
    `least`."""
    order = sorted(winners, key=lambda each: (_name_attack(each), each.value))
    for _, several in groupby(order, key=_name_attack):
        for pair in pairwise(several):
            near, far = (each.displacement[aim.measure][rows] for each in pair)
            if near.any() and far.max() > least:
                ratio = float(far.max() / near.max())
                yield from ((near * ratio**t, far * ratio ** (t - 1.0), t) for t in PARTS)


def _name_attack(winner: Winner) -> str:
    """Equal for the values of one attack's setting."""
    return json.dumps({**winner.spec, winner.setting: None}, sort_keys=True)
