"""The attack suite, a fixed, versioned list of attacks that every detector is scored against, and
the search for the worst of them, or of a family, on runs of its own.

What no member of the suite achieves, another attack may.  Every member has one setting that is
searched for, the same as in a campaign.  The open-loop attacks (letter c) that a campaign has found
against the detector play with them, where that is among its spoofers.  A member whose spoofer is
not registered is left out, which changes the digest.

The search:

1. On a few runs of the split `selection` every member of the suite plays its whole range.  Blind
   optima play around the amplitude that they were found at, and beyond where its ends are best.
   A search with `rounds` then halves the gaps beside the best values: what just passes an alert
   limit unnoticed is a narrow range of settings, and from one value of the grid to the next a
   displacement doubles.
2. For each aim, an alert limit or a share of the runs, the best of these and its neighbours play
   all runs of the selection, and the best one there is the winner.
3. The winners play the evaluation runs, which have decided nothing, but for one thing: the worst of
   all winners counts, whatever each was chosen for.  That leans a little to the high side, and no
   figure contradicts another one.  The next values of the setting play with the winners for a share
   of the runs, so that the interval of the figure is not that of one value (`scores.exceeded`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...attacks import make_attack
from ...core.declared import setting, settings_record
from ...core.registry import Spec
from ...core.settings import compute_digest
from ...simulation.setup import Setup
from ...spoofers import SPOOFERS, SpooferContext, make_spoofer
from ...spoofers.scaled import AMPLITUDE, LARGEST, SMALLEST
from ..runs.panel import Panel, PanelAttack, Search
from ..runs.play import FloatArray, Runs, make_bound_spoofer
from ..runs.players import ATTACK, TUNED, PlayerSpec, specify_spoofer
from ..runs.record import MEASURES, Aim, Winner, measure_displacement
from ..scores.scores import SHARES, worst_skies
from ..scores.statistics import build_log_grid, rounded_down

NAME, VERSION = "spoofgym-scripted", 2
"""Of the suite; another list of members, or another grid, is another version."""
FAMILIES = {
    "a": "ramps and accelerating ramps",
    "b": "profiles",
    "c": "optimized open-loop attacks, found against each detector",
    "t": "those that were found against others in the same world",
    "e": "feedback (oracle)",
    "h": "dashes",
}
"""What the letters of the members mean."""
CURVES = "ct"
"""Letters of those that have an amplitude at which they were found."""
ORACLES = "e"
"""Letters of those that see the detector's statistics, which is impossible in practice."""
KNOTS = 13
SHAPES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "smooth-entry": lambda t: np.where(t < 0.5, t * t * (12.0 - 16.0 * t), 1.0),
    "quadratic": lambda t: t * t,
    "late": lambda t: t**4,
}
"""Rates of the profiles over the attack window, both in parts of the largest."""
STEEPEST = 0.25
"""Largest rate of a profile with amplitude 1, of what the acceleration allows in a whole window."""
AMPLITUDE_RANGE = (0.5, 2.0)
"""Amplitudes of an open-loop attack that are tried first, in parts of that of its search."""
LAST_PARTS = (0.15, 0.4)  # parts of the attack window in which a dash takes place


@settings_record(frozen=True, kw_only=True)
class Selection:
    """How the worst attack of the suite is looked for."""

    runs: int = setting(default=192, least=1, help="Number of runs, from the split `selection`.")
    sift_runs: int = setting(default=48, least=1, help="Runs on which the whole suite is tried.")
    values: int = setting(default=10, least=2, help="Log-spaced values of every member's setting.")


@dataclass(frozen=True)
class SuiteAttack:
    """One attack of the suite."""

    letter: str
    player: PlayerSpec


def list_suite_attacks(context: SpooferContext) -> tuple[SuiteAttack, ...]:
    """All attacks, by an attack's limits and the length of its window."""
    found = [
        ("a", {"name": "ramp", "rate_mps": TUNED}),
        ("a", {"name": "accelerating-ramp", "acceleration_mps2": TUNED}),
        *(("b", _profile(name, context)) for name in SHAPES),
        ("e", {"name": "feedback", AMPLITUDE: TUNED}),
        *(("h", _dash(part, context)) for part in LAST_PARTS),
    ]
    return tuple(
        SuiteAttack(letter, specify_spoofer(spec))
        for letter, spec in found
        if spec["name"] in SPOOFERS
    )


def list_fitting_attacks(setup: Setup, context: SpooferContext) -> tuple[SuiteAttack, ...]:
    """Those that this attack can be commanded by: feedback needs its victim's statistics."""
    found = []
    for member in list_suite_attacks(context):
        try:
            make_bound_spoofer(member.player.with_value(1e-3), setup, 1)
        except ValueError:
            if member.letter not in ORACLES:  # of the others each must fit
                raise
            continue
        found.append(member)
    return tuple(found)


def suite_digest(members: Sequence[SuiteAttack]) -> str:
    specs = [[member.letter, member.player.spec] for member in members]
    return compute_digest({"name": NAME, "version": VERSION, "members": specs})


def build_grid(member: SuiteAttack, context: SpooferContext, values: int) -> list[float]:
    """Log-spaced values of a member's setting over its whole range. Of an open-loop attack around
    the amplitude that it was found at."""
    if member.letter in CURVES:
        return build_log_grid(*AMPLITUDE_RANGE, values)
    kind = type(make_spoofer(member.player.with_value(1.0)))
    return build_log_grid(*kind.tuning_range(context), values)


def _profile(name: str, context: SpooferContext) -> Spec:
    """A curve of the rate by its shape."""
    most = context.largest_rate[1]
    if context.control == "acceleration":
        window_s = context.steps * context.interval_s
        most = min(most, STEEPEST * context.acceleration_limit_mps2 * window_s)
    rates = most * SHAPES[name](np.linspace(0.0, 1.0, KNOTS))
    return {
        "name": "profile",
        "rates_mps": [float(f"{rate:.6g}") for rate in rates],
        "label": f"profile-{name}",
        AMPLITUDE: TUNED,
    }


def _dash(part: float, context: SpooferContext) -> dict[str, Any]:
    last_s = part * context.steps * context.interval_s
    return {"name": "dash", "rate_mps": TUNED, "last_s": float(f"{last_s:.4g}")}


NEIGHBOURS = (-0.35, 0.35)  # steps of the grid that are tried around the best of its values
BESIDE = 2, 3  # tried values below and above a winner that play with it
JUST_PAST = 1.005
"""What an amplitude that just passes an alert limit displaces by, in parts of that."""
SILENT = 0.5  # what runs without an alarm reach at least, in parts of what the farthest one does
AT_ONCE = 8  # worst attacks whose runs are held together
ALIKE = 0.002  # amplitudes that differ by less, in parts, are not both played
ROUNDS, FINE = 3, (-1.0, -0.5, 0.5, 1.0)
"""Of a family: how often those gaps are halved, and steps of what is left that all runs play."""
IDLE: Spec = {"name": "profile", "rates_mps": [0.0, 0.0]}
"""A spoofer that commands nothing, and transmits."""


def list_aims(measures: Sequence[str], limits: Sequence[float], skies: bool) -> tuple[Aim, ...]:
    """What is looked for: shares by every measure, and limits and worst skies by the first."""
    first = MEASURES[0]
    found = [Aim(measure, share) for measure in measures for share in SHARES]
    found += [Aim(first, limit_m=float(limit)) for limit in limits]
    return tuple(found + [Aim(first, share, skies=True) for share in SHARES if skies])


Played = dict[tuple[int, float], dict[str, FloatArray]]  # displacements by member and value
AttackAims = dict[tuple[int, float], list[Aim]]
"""Aims by member and value of the attack that is the worst one for them."""


class WorstAttacks:
    """The search for the worst attacks on one of a panel's detectors."""

    measures: ClassVar[tuple[str, ...]] = MEASURES
    by_skies: ClassVar[bool] = True
    """Whether attacks are looked for that are the worst in the worst skies."""
    neighbours: ClassVar[tuple[float, ...]] = NEIGHBOURS
    """Steps of the grid around the best of its values."""
    rounds: ClassVar[int] = 0  # how often the gaps beside the best values are halved before that
    beside: ClassVar[tuple[int, int]] = BESIDE
    """Tried values below and above the winners for a share that play the evaluation runs, too."""

    def __init__(
        self, panel: Panel, number: int, members: Sequence[SuiteAttack], settings: Selection
    ) -> None:
        self.panel, self.number = panel, number
        self.attacks, self.settings = members, settings
        self.context = panel.context
        self.counts, self.sky = panel.counts[:, number], panel.sky
        self.skies: NDArray[np.int64] | None = None

    def winners(self, limits: Sequence[float]) -> Search[AttackAims]:
        """Member and value of the worst attacks, each with its aims."""
        few, all_runs = min(self.settings.sift_runs, self.panel.runs), self.panel.runs
        grids = [self._grid(each) for each in self.attacks]
        sifted = yield from self._play(((m, v) for m, grid in enumerate(grids) for v in grid), few)
        measures = list(next(iter(sifted.values())))
        aims = list_aims(measures, limits, skies=False)
        yield from self._beyond_ends(sifted, grids, aims, few)
        for _ in range(self.rounds):
            yield from self._halve_gaps(sifted, aims, few)
        wanted = {self._best(sifted, aim, few) for aim in aims}
        steps = [step * 0.5**self.rounds for step in self.neighbours]
        near = {(m, v) for m, value in wanted for v in _around(value, grids[m], steps)}
        if self.rounds:
            near |= {key for key, _ in self._peaks(sifted, aims, few)}
        played = yield from self._play(sorted(near), all_runs)
        if self.by_skies:
            moved = played[self._best(played, aims[0], all_runs)][MEASURES[0]]
            self.skies = worst_skies(moved[self.counts], self.sky[self.counts])
        aims = list_aims(measures, limits, skies=self.skies is not None)
        found: AttackAims = {}
        for aim in aims:
            found.setdefault(self._best(played, aim, all_runs), []).append(aim)
        for key in self._list_beside(found, sifted.keys() | played.keys()):
            found.setdefault(key, [])
        return found

    def _list_beside(
        self, found: AttackAims, tried: Iterable[tuple[int, float]]
    ) -> list[tuple[int, float]]:
        """Tried values beside the winners for a share of the runs."""
        near, (below, above) = [], self.beside
        for key, aims in found.items():
            if any(aim.share is not None and aim.measure == MEASURES[0] for aim in aims):
                own = sorted(each for each in tried if each[0] == key[0])
                k = own.index(key)
                near += own[max(k - below, 0) : k + above + 1]
        return near

    def _play(self, keys: Iterable[tuple[int, float]], runs: int) -> Search[Played]:
        """Displacements of the first runs, by member and value."""
        keys = list(keys)
        played = yield [self.attack(*key, runs) for key in keys]
        return {key: self.measure(self.panel, x) for key, x in zip(keys, played, strict=True)}

    def attack(self, member: int, value: float, runs: int) -> PanelAttack:
        entry = self.attacks[member].player
        spec = entry.with_value(value)
        if entry.side == ATTACK:
            return PanelAttack(IDLE, runs, make_attack(spec))
        return PanelAttack(spec, runs)

    def measure(self, panel: Panel, attacked: Runs) -> dict[str, FloatArray]:
        """Undetected displacement of the first runs of a panel by the measures: (R',) each."""
        twin = panel.clean[self.number].first(len(attacked.peak))
        return measure_displacement(panel.setup, attacked, twin, self.measures)

    def winner(
        self, key: tuple[int, float], aims: Sequence[Aim], displacement: dict[str, FloatArray]
    ) -> Winner:
        """A member at a value as the worst attack, with what it has done in the evaluation runs."""
        member, value = self.attacks[key[0]], key[1]
        return Winner(
            letter=member.letter,
            spoofer=member.player.label,
            setting=str(member.player.tuned),
            value=value,
            spec=member.player.with_value(value),
            aims=tuple(aims),
            displacement=displacement,
        )

    def _grid(self, member: SuiteAttack) -> list[float]:
        return build_grid(member, self.context, self.settings.values)

    def _beyond_ends(
        self, sifted: Played, grids: list[list[float]], aims: Sequence[Aim], runs: int
    ) -> Search[None]:
        """Let found curves go on beyond their range, for as long as its ends are the best of it."""
        while True:
            best = {self._best(sifted, aim, runs) for aim in aims}
            curves = ((m, at) for m, at in best if self.attacks[m].letter in CURVES)
            found = {(m, self._next(grids[m], at)) for m, at in curves}
            new = sorted((m, value) for m, value in found if value is not None)
            if not new:
                return
            for m, value in new:
                grids[m] = sorted([*grids[m], value])
            sifted |= yield from self._play(new, runs)

    def _halve_gaps(self, sifted: Played, aims: Sequence[Aim], runs: int) -> Search[None]:
        """Play values beside the best ones, and those that just pass an alert limit. What passes it
        unnoticed may be a range of a few per cent, of which no coarse value is."""
        new = set()
        for (m, at), aim in self._peaks(sifted, aims, runs):
            grid = sorted(value for k, value in sifted if k == m)
            moved = [sifted[m, value][aim.measure][self.counts[:runs]] for value in grid]
            new |= {(m, value) for value in _between(grid, grid.index(at), moved, aim)}
        sifted |= yield from self._play(sorted(new - sifted.keys()), runs)

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
            elif aim.score_displacement(played[best][aim.measure][rows]) < 1.0:
                for member in sorted({m for m, _ in played}):
                    own = {key: moved for key, moved in played.items() if key[0] == member}
                    found.append((self._best(own, aim, runs), aim))
        return found

    @staticmethod
    def _next(grid: list[float], at: float) -> float | None:
        """Value beyond an end of a grid, within what an amplitude may be."""
        ratio = grid[1] / grid[0]
        value = at * ratio if at == grid[-1] else at / ratio
        inside = SMALLEST <= value <= LARGEST
        return rounded_down(value) if at in (grid[0], grid[-1]) and inside else None

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
    """Values halfway from one of a grid to both next ones, and what just passes an alert limit: an
    error grows with the amplitude. Of what passes it as little as is enough; and the least that
    does so in any run, and in half of the silent."""
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


class FamilyAttacks(WorstAttacks):
    """The search for the worst attacks of a family. `antenna_m`: range of a meaconer's antenna."""

    measures, by_skies = MEASURES[:1], False
    neighbours, rounds, beside = FINE, ROUNDS, (0, 0)

    def __init__(self, *panel: Any, antenna_m: tuple[float, float]) -> None:
        super().__init__(*panel)
        self._antenna_m = antenna_m

    def _grid(self, member: SuiteAttack) -> list[float]:
        if member.player.side == ATTACK:
            return build_log_grid(*self._antenna_m, self.settings.values)
        return super()._grid(member)


def play_winners(
    panel: Panel, found: Sequence[tuple[WorstAttacks, AttackAims]], tick: Callable[[float], None]
) -> list[tuple[Winner, ...]]:
    """Let the worst attacks on detectors play all runs of a panel."""
    attacks = [
        (search.attack(*key, panel.runs), search, key) for search, aims in found for key in aims
    ]
    attacks.sort(key=lambda each: each[0].key)  # equal ones are played together
    moved: dict[tuple[int, tuple[int, float]], dict[str, FloatArray]] = {}
    for first in range(0, len(attacks), AT_ONCE):
        some = attacks[first : first + AT_ONCE]
        played = panel.play([(attack, search.number) for attack, search, _ in some], tick=tick)
        for (_, search, key), runs in zip(some, played, strict=True):
            moved[search.number, key] = search.measure(panel, runs)
    return [
        tuple(search.winner(key, sought, moved[search.number, key]) for key, sought in aims.items())
        for search, aims in found
    ]
