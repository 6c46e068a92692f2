"""The protection of a detector: the worst attack of the suite, chosen on runs of its own.

1. On a few runs of the split `selection` every member of the suite plays its whole range.  Blind
   optima play around the amplitude that they were found at, and beyond where its ends are best.
2. For each aim, an alert limit or a share of the runs, the best of these and its neighbours play
   all runs of the selection, and the best one there is the winner.
3. The winners play the evaluation runs, which have decided nothing, but for one thing: the worst of
   all winners counts, whatever each was chosen for.  That leans a little to the high side, and no
   figure contradicts another one.

What is kept is how far every winner came in every evaluation run, so that scores and their paired
differences between detectors follow from it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..simulators.setup import Setup
from ..spoofers import SpooferContext
from ..spoofers.scaled import LARGEST, SMALLEST
from .attack_suite import Member, grid_of
from .run import Runs, WarmStart, horizontal, induced, off_truth, play
from .scores import SHARES, counted, exceeded, undetected_displacement, worst_skies
from .searches import Selection, rounded_down

FloatArray = NDArray[np.float64]
Tick = Callable[[float], None]
MEASURES = (
    "undetected_displacement_m",
    "undetected_vertical_m",
    "undetected_total_m",
    "undetected_total_vertical_m",
)
"""Induced and total error, horizontal and vertical; a victim in the plane has no vertical ones."""
NEIGHBOURS = (-0.35, 0.35)
"""Steps of the grid that are tried around the best of its values."""


class Aim(NamedTuple):
    """What an attack is chosen by.

    - `measure`: one of `MEASURES`;
    - `share`: of the runs in which the displacement is to be large; or
    - `limit_m`: alert limit that is to be exceeded often;
    - `skies`: whether only the worst tenth of them counts.
    """

    measure: str
    share: float | None = None
    limit_m: float | None = None
    skies: bool = False

    def reached(self, displacement: FloatArray) -> float:
        """What is exceeded in the share of the runs that count, or how often the limit is."""
        if not len(displacement):
            return 0.0
        if self.share is not None:
            return exceeded(displacement, self.share)
        assert self.limit_m is not None  # one of the two is given
        return float((displacement > self.limit_m).mean())

    def worth(self, displacement: FloatArray) -> float:
        """How good a displacement of the runs that count is, to choose by.

        Of attacks that exceed a limit equally often, that whose weakest such run is the farthest
        above it, as it will most surely do so again; of those that never do, that which comes
        nearest.
        """
        reached = self.reached(displacement)
        if self.limit_m is None or not len(displacement):
            return reached
        above = displacement > self.limit_m
        weakest = float(displacement[above].min() if above.any() else displacement.max())
        return reached + 1e-9 * weakest / (1.0 + weakest)


@dataclass(frozen=True)
class Winner:
    """An attack that is the worst one for some aims.

    - `letter`, `spoofer`, `setting`, `value`, `spec`: which one;
    - `aims`: for what;
    - `displacement` by measure (R,) of the evaluation runs [m].
    """

    letter: str
    spoofer: str
    setting: str
    value: float
    spec: dict[str, Any]
    aims: tuple[Aim, ...]
    displacement: dict[str, FloatArray]


@dataclass(frozen=True)
class Protection:
    """What the suite achieves against one detector.

    - `head`: detector, suite, selection and campaign, JSON-able;
    - `winners`: the worst attacks on the evaluation runs;
    - `counts`, `sky` (R,) which of these runs count, and under which sky;
    - `skies`: the worst tenth; None where there are too few.
    """

    head: dict[str, Any]
    winners: tuple[Winner, ...]
    counts: NDArray[np.bool_]
    sky: NDArray[np.int64]
    skies: NDArray[np.int64] | None

    @property
    def detector(self) -> str:
        """Label of the detector."""
        return str(self.head["detector"])

    def winner(self, aim: Aim) -> Winner | None:
        """Who is the worst for an aim; None where nobody was looked for."""
        return next((each for each in self.winners if aim in each.aims), None)

    def worst(self, aim: Aim) -> Winner:
        """Worst attack on the evaluation runs; of equal ones that which was chosen for the aim."""
        chosen, rows = self.winner(aim), self.rows(aim)
        several = (*([] if chosen is None else [chosen]), *self.winners)
        return max(several, key=lambda each: aim.reached(each.displacement[aim.measure][rows]))

    def rows(self, aim: Aim) -> NDArray[np.bool_]:
        """(R,) which runs an aim is about."""
        if not aim.skies or self.skies is None:
            return self.counts
        return self.counts & np.isin(self.sky, self.skies)

    def to_text(self) -> str:
        """JSON."""
        winners = [
            {
                **{name: getattr(each, name) for name in ("letter", "spoofer", "setting", "value")},
                "spec": each.spec,
                "aims": [aim._asdict() for aim in each.aims],
                "displacement": {name: x.tolist() for name, x in each.displacement.items()},
            }
            for each in self.winners
        ]
        skies = None if self.skies is None else self.skies.tolist()
        runs = {"counts": self.counts.tolist(), "sky": self.sky.tolist(), "skies": skies}
        return json.dumps({**self.head, **runs, "winners": winners}, allow_nan=False) + "\n"

    @classmethod
    def from_text(cls, text: str) -> Protection:
        """Inverse of `to_text`."""
        head = json.loads(text)
        runs = {name: head.pop(name) for name in ("counts", "sky", "skies", "winners")}
        winners = tuple(
            Winner(
                **{
                    **each,
                    "aims": tuple(Aim(**aim) for aim in each["aims"]),
                    "displacement": {k: np.array(x) for k, x in each["displacement"].items()},
                }
            )
            for each in runs["winners"]
        )
        skies = None if runs["skies"] is None else np.array(runs["skies"])
        counts = np.array(runs["counts"], dtype=np.bool_)
        return cls(head, winners, counts, np.array(runs["sky"]), skies)


def measured(setup: Setup, attacked: Runs, twin: Runs) -> dict[str, FloatArray]:
    """Undetected displacement of every run by all measures that a victim has: (R,) each."""
    moved, off = induced(setup, attacked, twin), off_truth(setup, attacked)
    sizes = [horizontal(moved), None, horizontal(off), None]
    if moved.shape[2] == 3:
        sizes[1], sizes[3] = np.abs(moved[..., 2]), np.abs(off[..., 2])
    return {
        name: np.round(
            undetected_displacement(size[: setup.steps], attacked.first_alarm, setup.hold), 6
        )
        for name, size in zip(MEASURES, sizes, strict=True)
        if size is not None
    }


def aims_of(measures: Sequence[str], limits: Sequence[float], skies: bool) -> tuple[Aim, ...]:
    """What is looked for: shares by every measure, and limits and worst skies by the first."""
    first = MEASURES[0]
    found = [Aim(measure, share) for measure in measures for share in SHARES]
    found += [Aim(first, limit_m=float(limit)) for limit in limits]
    return tuple(found + [Aim(first, share, skies=True) for share in SHARES if skies])


Played = dict[tuple[int, float], dict[str, FloatArray]]
"""Displacements by member and value."""


class Search:
    """The search for the worst attacks on a detector, on runs of the selection at the onset."""

    by_skies: ClassVar[bool] = True
    """Whether attacks are looked for that are the worst in the worst skies."""
    neighbours: ClassVar[tuple[float, ...]] = NEIGHBOURS
    """Steps of the grid around the best of its values."""

    def __init__(
        self,
        start: WarmStart,
        clean: Runs,
        members: Sequence[Member],
        context: SpooferContext,
        settings: Selection,
        tick: Tick | None = None,
    ) -> None:
        self.start, self.clean, self.members = start, clean, members
        self.context, self.settings, self.tick = context, settings, tick
        self.counts = counted(start.warmup_alarm, clean.first_alarm)
        self.sky = clean.onset // start.setup.epochs_each
        self.skies: NDArray[np.int64] | None = None

    def winners(self, limits: Sequence[float]) -> dict[tuple[int, float], list[Aim]]:
        """Member and value of the worst attacks, each with its aims."""
        few = min(self.settings.sift_runs, self.start.receivers)
        grids = [self._grid(each) for each in self.members]
        sifted = {(m, v): self._play(m, v, few) for m, grid in enumerate(grids) for v in grid}
        measures = list(next(iter(sifted.values())))
        aims = aims_of(measures, limits, skies=False)
        self._beyond_ends(sifted, grids, aims, few)
        wanted = {self._best(sifted, aim, few) for aim in aims}
        near = {(m, v) for m, value in wanted for v in _around(value, grids[m], self.neighbours)}
        everyone = self.start.receivers
        played = {key: self._play(*key, everyone) for key in sorted(near)}
        if self.by_skies:
            worst = self._best(played, aims[0], everyone)
            moved = played[worst][MEASURES[0]]
            self.skies = worst_skies(moved[self.counts], self.sky[self.counts])
        aims = aims_of(measures, limits, skies=self.skies is not None)
        found: dict[tuple[int, float], list[Aim]] = {}
        for aim in aims:
            found.setdefault(self._best(played, aim, everyone), []).append(aim)
        return found

    def _grid(self, member: Member) -> list[float]:
        """Values of a member's setting."""
        return grid_of(member, self.context, self.settings.values)

    def _beyond_ends(
        self, sifted: Played, grids: list[list[float]], aims: Sequence[Aim], runs: int
    ) -> None:
        """Let found curves go on beyond their range, for as long as its ends are the best of it."""
        while True:
            best = {self._best(sifted, aim, runs) for aim in aims}
            found = {(m, self._next(grids[m], at)) for m, at in best if self._is_found(m)}
            new = sorted((m, value) for m, value in found if value is not None)
            for m, value in new:
                grids[m] = sorted([*grids[m], value])
                sifted[m, value] = self._play(m, value, runs)
            if not new:
                return

    def _is_found(self, member: int) -> bool:
        return self.members[member].letter == "c"

    @staticmethod
    def _next(grid: list[float], at: float) -> float | None:
        """Value beyond an end of a grid, within what an amplitude may be."""
        ratio = grid[1] / grid[0]
        value = at * ratio if at == grid[-1] else at / ratio
        inside = SMALLEST <= value <= LARGEST
        return rounded_down(value) if at in (grid[0], grid[-1]) and inside else None

    def _play(self, member: int, value: float, runs: int) -> dict[str, FloatArray]:
        start = self.start if runs >= self.start.receivers else self.start.first(runs)
        entry, advance = self.members[member].entry, self.tick
        tick = None if advance is None else lambda part: advance(part * runs)
        attacked = play(start, entry.with_value(value), drop_alarmed=True, tick=tick)
        return measured(start.setup, attacked, self.clean.first(runs))

    def _best(self, played: Played, aim: Aim, runs: int) -> tuple[int, float]:
        """Worst attack for an aim; of equal ones the first member with the smaller value."""
        rows = self.counts[:runs]
        if aim.skies and self.skies is not None:
            rows = rows & np.isin(self.sky[:runs], self.skies)
        worth = {key: aim.worth(found[aim.measure][rows]) for key, found in played.items()}
        return max(sorted(worth), key=lambda key: worth[key])


def _around(value: float, grid: list[float], steps: Sequence[float]) -> list[float]:
    """A value and its neighbours, within the grid's range."""
    ratio = grid[1] / grid[0]
    near = [value, *(rounded_down(value * ratio**step) for step in steps)]
    return [each for each in near if grid[0] <= each <= grid[-1]]


def expected_plays(members: int, settings: Selection, runs: int) -> float:
    """Runs of a search and of its winners, roughly."""
    return members * settings.values * settings.sift_runs + 12.0 * settings.runs + 6.0 * runs
