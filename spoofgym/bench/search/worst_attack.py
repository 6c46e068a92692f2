"""Grid and refinement over an attack suite.

The search for the worst attacks of the suite on a detector, on runs of its own.

1. On a few runs of the split `selection` every member of the suite plays its whole range.  Blind
   optima play around the amplitude that they were found at, and beyond where its ends are best.
   A search with `rounds` then halves the gaps beside the best values.
2. For each aim, an alert limit or a share of the runs, the best of these and its neighbours play
   all runs of the selection, and the best one there is the winner.
3. The winners play the evaluation runs, which have decided nothing, but for one thing: the worst of
   all winners counts, whatever each was chosen for.  That leans a little to the high side, and no
   figure contradicts another one.

The search for the worst attacks of a family on a detector, whose settings it looks for.

What just passes an alert limit unnoticed is a narrow range of settings, and from one value of the
grid to the next a displacement doubles: gaps are halved before anything is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...attacks import make_attack
from ...core.registry import Spec
from ...simulation.setup import Setup
from ...spoofers import SpooferContext
from ...spoofers.scaled import LARGEST, SMALLEST
from ..runs.panel import Panel
from ..runs.play import Runs, WarmStart, horizontal, induced, off_truth, play
from ..runs.players import ATTACK
from ..runs.record import MEASURES, Aim, Winner
from ..scores.scores import SHARES, counted, undetected_displacement, worst_skies
from .attack_suite import SuiteAttack, grid_of
from .settings import Selection, log_spaced, rounded_down

FloatArray = NDArray[np.float64]
Tick = Callable[[float], None]
NEIGHBOURS = (-0.35, 0.35)
"""Steps of the grid that are tried around the best of its values."""
JUST_PAST = 1.005
"""What an amplitude that just passes an alert limit displaces by, in parts of that."""
SILENT = 0.5
"""What runs without an alarm reach at least, in parts of what the farthest one does."""
ALIKE = 0.002
"""Amplitudes that differ by less, in parts, are not both played."""


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


def winner_of(
    member: SuiteAttack, value: float, aims: Sequence[Aim], displacement: dict[str, FloatArray]
) -> Winner:
    """A member at a value as the worst attack, with what it has done in the evaluation runs."""
    return Winner(
        letter=member.letter,
        spoofer=member.player.label,
        setting=str(member.player.tuned),
        value=value,
        spec=member.player.with_value(value),
        aims=tuple(aims),
        displacement=displacement,
    )


Played = dict[tuple[int, float], dict[str, FloatArray]]
"""Displacements by member and value."""


class Search:
    """The search for the worst attacks on a detector, on runs of the selection at the onset."""

    by_skies: ClassVar[bool] = True
    """Whether attacks are looked for that are the worst in the worst skies."""
    neighbours: ClassVar[tuple[float, ...]] = NEIGHBOURS
    """Steps of the grid around the best of its values."""
    rounds: ClassVar[int] = 0
    """How often the gaps beside the best values are halved before that."""

    def __init__(
        self,
        start: WarmStart,
        clean: Runs,
        members: Sequence[SuiteAttack],
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
        """SuiteAttack and value of the worst attacks, each with its aims."""
        few = min(self.settings.sift_runs, self.start.receivers)
        grids = [self._grid(each) for each in self.members]
        sifted = {(m, v): self._play(m, v, few) for m, grid in enumerate(grids) for v in grid}
        measures = list(next(iter(sifted.values())))
        aims = aims_of(measures, limits, skies=False)
        self._beyond_ends(sifted, grids, aims, few)
        for _ in range(self.rounds):
            self._halve_gaps(sifted, aims, few)
        wanted = {self._best(sifted, aim, few) for aim in aims}
        steps = [step * 0.5**self.rounds for step in self.neighbours]
        near = {(m, v) for m, value in wanted for v in _around(value, grids[m], steps)}
        if self.rounds:
            near |= {key for key, _ in self._peaks(sifted, aims, few)}
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

    def _grid(self, member: SuiteAttack) -> list[float]:
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

    def _halve_gaps(self, sifted: Played, aims: Sequence[Aim], runs: int) -> None:
        """Play values beside the best ones, and those that just pass an alert limit. What passes it
        unnoticed may be a range of a few per cent, of which no coarse value is."""
        new = set()
        for (m, at), aim in self._peaks(sifted, aims, runs):
            grid = sorted(value for k, value in sifted if k == m)
            moved = [sifted[m, value][aim.measure][self.counts[:runs]] for value in grid]
            new |= {(m, value) for value in _between(grid, grid.index(at), moved, aim)}
        for key in sorted(new - sifted.keys()):
            sifted[key] = self._play(*key, runs)

    def _peaks(
        self, played: Played, aims: Sequence[Aim], runs: int
    ) -> list[tuple[tuple[int, float], Aim]]:
        """Worst attack for every share, and for a limit that of every member. None for a limit that
        one of them always passes: there is nothing left to look for."""
        found, rows = [], self.counts[:runs]
        for aim in aims:
            best = self._best(played, aim, runs)
            if aim.limit_m is None:
                found.append((best, aim))
            elif aim.reached(played[best][aim.measure][rows]) < 1.0:
                for member in sorted({m for m, _ in played}):
                    own = {key: moved for key, moved in played.items() if key[0] == member}
                    found.append((self._best(own, aim, runs), aim))
        return found

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
        player, advance = self.members[member].player, self.tick
        tick = None if advance is None else lambda part: advance(part * runs)
        attacked = play(start, player.with_value(value), drop_alarmed=True, tick=tick)
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


def _between(grid: list[float], k: int, moved: list[FloatArray], aim: Aim) -> list[float]:
    """Values halfway from one of a grid to both next ones, and what just passes an alert limit. The
    error that a blind attack induces grows in proportion to its amplitude. Of what passes the
    limit, as little as is enough; and the least that does so in any run, and in half of the
    silent."""
    at, low, high = grid[k], grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
    near = [math.sqrt(low * at), math.sqrt(at * high)]
    if aim.limit_m is not None:
        far = [float(each.max(initial=0.0)) for each in moved]
        first = next((j for j, most in enumerate(far) if most > aim.limit_m), None)
        below = int(np.argmax(far)) if first is None else max(first - 1, 0)
        silent = moved[below][moved[below] >= SILENT * far[below]]
        reached = [(grid[below], far[below]), (at, aim.weakest(moved[k]))]
        reached += [(grid[below], float(np.median(silent)))] if len(silent) else []
        near += [value * JUST_PAST * aim.limit_m / most for value, most in reached if most > 0.0]
    inside = [rounded_down(value) for value in near if grid[0] < value < grid[-1]]
    return [value for value in inside if min(abs(value / each - 1.0) for each in grid) > ALIKE]


def expected_plays(members: int, settings: Selection, runs: int, rounds: int = 0) -> float:
    sifted = members * (settings.values + 3 * rounds) * settings.sift_runs
    return sifted + 12.0 * settings.runs + 6.0 * runs


ROUNDS, FINE = 3, (-1.0, -0.5, 0.5, 1.0)
"""How often the gaps beside the best values that sift are halved, and steps of what is left that
all runs play."""
IDLE: Spec = {"name": "profile", "rates_mps": [0.0, 0.0]}
"""A spoofer that commands nothing, and transmits."""


class PlayedFamily:
    """Displacements of a panel's detectors by member, value and number of runs, each played once.
    What one detector's search has played is there for the others."""

    def __init__(self, panel: Panel, members: Sequence[SuiteAttack], tick: Callable[[float], None]):
        self.panel, self.members, self.tick = panel, members, tick
        self._found: dict[tuple[int, float, int], FloatArray] = {}

    def __call__(self, member: int, value: float, runs: int) -> FloatArray:
        """(D, R') [m]."""
        key = member, value, runs
        if key not in self._found:
            player = self.members[member].player
            spec, attack = player.with_value(value), None
            if player.side == ATTACK:
                spec, attack = IDLE, make_attack(spec)
            self._found[key] = self.panel.displacement(spec, runs, attack)
            self.tick(runs)
        return self._found[key]


class FamilySearch(Search):
    """The search for the worst attacks of a family on one detector of a panel."""

    by_skies = False
    neighbours, rounds = FINE, ROUNDS

    def __init__(
        self,
        played: PlayedFamily,
        number: int,
        context: SpooferContext,
        settings: Selection,
        antenna_m: tuple[float, float],
    ) -> None:
        panel = played.panel
        super().__init__(panel.start, panel.clean, played.members, context, settings)
        self.counts, self.sky = panel.counts[:, number], panel.sky
        self._played, self._number, self._antenna_m = played, number, antenna_m

    def _grid(self, member: SuiteAttack) -> list[float]:
        if member.player.side == ATTACK:
            return log_spaced(*self._antenna_m, self.settings.values)
        return super()._grid(member)

    def _play(self, member: int, value: float, runs: int) -> dict[str, FloatArray]:
        return {MEASURES[0]: self._played(member, value, runs)[self._number]}
