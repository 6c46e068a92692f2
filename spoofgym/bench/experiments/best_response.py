r"""Best responses to a mix within a stated budget, and how far a pair of mixes can be exploited.

The best response of a spoofer to a mix of detectors is looked for among the attack suite, blind
optima that are searched for against this mix, and given policies: each family plays its whole
range on a few runs of the split `selection`, and the best of them play all of these.  A detector's
is the best of given ones.  What is chosen is then scored on runs that have decided nothing.

That is one end of the exploitability, from below: another search may find more.  The other, from
above, is the zero-alarm bound of every detector, weighted by the mix, where each of them has one.
It bounds the mean displacement E, and with the alert limit L both payoffs: a mean of
:math:`\min(d, L) / L` is at most :math:`\min(E / L, 1)`, by Jensen's inequality, and so is
:math:`P(d > L)`, by Markov's.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...core.declared import setting, settings_record
from ...core.settings import compute_digest
from ...envs.context import spoofer_context
from ...limits.bounds import draw_worlds, zero_alarm_bounds
from ...limits.response import Replay
from ...policies.card import DETECTOR, SPOOFER
from ...simulation.setup import seeds_of_runs
from ...simulation.tight import TightlyCoupledSetup
from ...spoofers.scaled import AMPLITUDE, split_amplitude
from ..runs.players import TUNED, Mixture, PlayerSpec, make_player, specify_spoofer
from ..scores.statistics import Estimate, FloatArray
from ..search.attack_suite import SuiteAttack, build_grid, list_fitting_attacks
from ..search.backends import MixedBackend, ReplayBackend, find_obstacle
from ..search.bounds import WORLDS
from ..search.open_loop import SPLIT as SEARCH
from ..search.open_loop import OpenLoopOptimizer, OpenLoopSearch
from .game import Game

SELECTION = "selection"
SHARES = (0.05, 0.5)
"""Shares of alarms for which open-loop attacks are searched for; amplitudes are tried later."""
SIGNIFICANT = 1e-3  # weight in a mix from which on a detector takes part in that search


@settings_record(frozen=True, kw_only=True)
class AttackBudget:
    """What a best response may cost, the same for every mix that it is held against."""

    runs: int = setting(default=96, least=1, help="Runs of the selection.")
    sift_runs: int = setting(default=32, least=1, help="Runs on which all candidates are tried.")
    values: int = setting(default=8, least=2, help="Log-spaced values of every family's setting.")
    kept: int = setting(default=6, least=1, help="Candidates that are tried on all of the runs.")
    blind: OpenLoopSearch | None = setting(
        default_factory=lambda: OpenLoopSearch(runs=64, batch=32, knots=12, generations=6),
        help="Search for optimized open-loop attacks; None for none.",
    )
    oracles: bool = setting(
        default=True,
        help="Whether feedback, which observes the detector's statistics, is among the candidates.",
    )
    further: Mapping[str, Any] = setting(
        default_factory=dict,
        hash=False,
        help="What else is spent on every mix, JSON-able, by candidates that learn, such as "
        '``{"ppo_steps": 30_000}``; part of the digest, and nothing else.',
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "further", dict(self.further))

    def as_json(self) -> dict[str, Any]:
        """JSON-able, with a digest."""
        settings = dataclasses.asdict(self)
        if not self.further:
            del settings["further"]
        return {**settings, "digest": compute_digest(settings)}


class BestResponse(NamedTuple):
    """A best response that was found: the player, with what decided on it; its payoff on the runs
    of the selection; the `best` payoff of every family on the first of these, and its player; and
    `notes` on what the search left out."""

    member: PlayerSpec
    value: float
    best: dict[str, float]
    by_family: dict[str, PlayerSpec]
    notes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        by_family = {name: each.as_json() for name, each in self.by_family.items()}
        found = {"member": self.member.as_json(), "by_family": by_family}
        return {"value": self.value, "best": self.best, **found, "notes": list(self.notes)}


def best_spoofer(
    game: Game,
    mix: Mixture,
    budget: AttackBudget,
    *,
    entropy: int,
    given: Sequence[PlayerSpec] = (),
    warm: Sequence[PlayerSpec] = (),
    label: str | None = None,
) -> BestResponse:
    """Look for the spoofer that gets most against a mix of detectors.

    Parameters
    ----------
    game : Game
        World and payoff; its runs are not played.
    mix : Mixture
        Of detectors.
    budget : AttackBudget
        How much is tried.
    entropy : int
        Seed of the runs that decide; no member of the mix may have been chosen on them.
    given : sequence of PlayerSpec
        Further spoofers, which are tried as they are, and keep their names.
    warm : sequence of PlayerSpec
        Curves from which the search for open-loop attacks may start, besides plain shapes.
    label : str, optional
        Name of what is found, which its family follows.

    Returns
    -------
    Response
        Its member was decided on the splits `selection` and `search` of that seed, a given one,
        too.
    """
    seeds = frozenset([(entropy, SELECTION), (entropy, SEARCH)])
    context = spoofer_context(game.setup)
    attacks = [
        each
        for each in list_fitting_attacks(game.setup, context)
        if budget.oracles or not each.player.sees_statistics
    ]
    curves, notes = ([], ()) if budget.blind is None else _curves(game, mix, budget, warm, entropy)
    for rates in curves:
        rounded = [float(f"{rate:.6g}") for rate in rates]
        spec = {"name": "open-loop", "rates_mps": rounded, AMPLITUDE: TUNED}
        attacks.append(SuiteAttack("c", specify_spoofer(spec)))
    known = {each.label for each in given}
    tried = [
        (each.label, dataclasses.replace(each, decided_on=each.decided_on | seeds))
        for each in given
    ]
    for number, attack in enumerate(attacks):
        player = attack.player
        family = player.label.removesuffix("(tuned)").replace("tuned,", "")
        for value in build_grid(attack, context, budget.values):
            name = f"{family} {number}, {player.tuned} {value:g}"
            spec = player.with_value(value)
            tried.append((family, make_player(spec, SPOOFER, label=name, decided_on=seeds)))
    few, all_runs = (game.on(SELECTION, n, entropy) for n in (budget.sift_runs, budget.runs))
    sifted = _against(few, [player for _, player in tried], mix)
    order = np.argsort(-sifted, kind="stable")
    finalists = [tried[k] for k in order[: budget.kept]]
    found = _against(all_runs, [player for _, player in finalists], mix)
    best: dict[str, float] = {}
    by_family: dict[str, PlayerSpec] = {}
    for k in order:
        family, player = tried[k]
        best.setdefault(family, float(sifted[k]))
        by_family.setdefault(family, player)
    family, winner = finalists[int(np.argmax(found))]
    if winner.label not in known:
        name = family if label is None else f"{label}: {family}"
        winner = dataclasses.replace(winner, label=name)
    return BestResponse(winner, float(found.max()), best, by_family, notes)


def best_detector(
    game: Game, mix: Mixture, detectors: Sequence[PlayerSpec], *, runs: int, entropy: int
) -> BestResponse:
    """Detector, of given ones, against which a mix of spoofers gets least.

    Parameters
    ----------
    game, mix : optional
        As in `best_spoofer`; the mix is of spoofers.
    detectors : sequence of PlayerSpec
        Detectors to choose from.
    runs, entropy : int
        Runs of the selection, and their seed.

    Returns
    -------
    Response
        One of them, as it was; nothing but its name has been decided on these runs.
    """
    values = game.on(SELECTION, runs, entropy).matrix([mix], detectors, oracles=True).values[0]
    k = int(np.nanargmin(values))
    best = {each.label: float(x) for each, x in zip(detectors, values, strict=True)}
    by_family = {each.label: each for each in detectors}
    return BestResponse(detectors[k], float(values[k]), best, by_family)


def _against(game: Game, spoofers: Sequence[PlayerSpec], mix: Mixture) -> FloatArray:
    """Payoffs (S,) of candidates against a mix, to choose by: they may have been chosen here."""
    open_ = [dataclasses.replace(each, decided_on=frozenset()) for each in spoofers]
    return game.matrix(open_, [mix], oracles=True).values[:, 0]


def _curves(
    game: Game, mix: Mixture, budget: AttackBudget, warm: Sequence[PlayerSpec], entropy: int
) -> tuple[list[FloatArray], tuple[str, ...]]:
    """Open-loop attacks against a mix, by response replay; and the members that are left out."""
    assert budget.blind is not None  # as the caller has seen
    setup, notes = game.setup, []
    if not isinstance(setup, TightlyCoupledSetup):
        return [], (f"no optimized open-loop attack: {setup.whose} has no linear response",)
    members, weights = [], []
    for member, weight in zip(mix.members, mix.weights, strict=True):
        if why := find_obstacle(setup, game.detector(member), "it"):
            notes.append(
                f"the search for optimized open-loop attacks is without {member.label}: {why}"
            )
        elif weight >= SIGNIFICANT:
            members.append(game.detector(member))
            weights.append(weight)
    if not members:
        return [], tuple(notes)
    seeds = seeds_of_runs(entropy, SEARCH, setup.name, range(budget.blind.runs))
    replay = Replay(setup, members, seeds, threads=game.threads)
    backend = MixedBackend([ReplayBackend(replay, k) for k in range(len(members))], weights)
    starts = {each.label: curve for each in warm if (curve := _get_curve_rates(each)) is not None}
    curves = []
    for share in SHARES:
        game.progress.advance(0.0, f"optimized open-loop attack, {100 * share:g} % alarms")
        curves.append(OpenLoopOptimizer(backend, share, budget.blind).search(starts).rates_mps)
    return curves, tuple(notes)


def _get_curve_rates(member: PlayerSpec) -> FloatArray | None:
    """Rates at knots of a curve along one line; None of any other spoofer."""
    spec, amplitude = split_amplitude(member.spec)
    rates = spec.get("rates_mps") if isinstance(spec, dict) else None
    if not rates or spec.get("cross_rates_mps"):
        return None
    return np.array(rates) * (1.0 if amplitude is None else amplitude)


class DeviationGain(NamedTuple):
    """What one side gains by leaving a pair of mixes: `below`, by the response `member` on fresh
    runs, negative where the own mix is better; `above`, by any, None where no bound is known, and
    `why`."""

    below: Estimate
    member: str
    above: float | None
    why: str

    def as_json(self) -> dict[str, Any]:
        return {**self._asdict(), "below": self.below.as_json()}


class Exploitability(NamedTuple):
    """How far a pair of mixes can be exploited: its payoff on fresh runs, the gains of either side,
    and `below`, both together: 0 in an equilibrium, and at least 0 in truth."""

    value: Estimate
    spoofer: DeviationGain
    detector: DeviationGain
    below: Estimate

    def as_json(self) -> dict[str, Any]:
        return {name: getattr(self, name).as_json() for name in self._fields}


def exploitability(
    game: Game, spoofers: Mixture, detectors: Mixture, answer: PlayerSpec, guard: PlayerSpec
) -> Exploitability:
    """Score responses to a pair of mixes on fresh runs.

    Parameters
    ----------
    game : Game
        On runs that have decided on no member, which is checked.
    spoofers, detectors : Mixture
        The pair.
    answer : PlayerSpec
        Response to the detectors, as of `best_spoofer`.
    guard : PlayerSpec
        Response to the spoofers, as of `best_detector`.

    Returns
    -------
    Exploitability
        Paired, since all of it is played on the same runs.
    """
    matrix = game.matrix([spoofers, answer], [detectors, guard], oracles=True)
    value = matrix.contrast([[1.0, 0.0], [0.0, 0.0]])
    limit, why = upper_end(game, detectors)
    return Exploitability(
        value,
        DeviationGain(
            matrix.contrast([[-1.0, 0.0], [1.0, 0.0]]),
            answer.label,
            None if limit is None else limit - value.value,
            why,
        ),
        DeviationGain(
            matrix.contrast([[1.0, -1.0], [0.0, 0.0]]),
            guard.label,
            None,
            "no bound is known of what every detector allows a mix of spoofers",
        ),
        matrix.contrast([[0.0, -1.0], [1.0, 0.0]]),
    )


def upper_end(game: Game, mix: Mixture) -> tuple[float | None, str]:
    """Payoff that no spoofer exceeds against a mix of detectors. Returns `bound`, None where a
    member has no bound; and `why`, bounds by member, or which is missing and why."""
    setup = game.setup
    if mix.side != DETECTOR:
        raise ValueError(f"only a mix of detectors has bounds, got one of {mix.side}s")
    if not isinstance(setup, TightlyCoupledSetup):
        return None, f"no bound is known for {setup.whose}"
    cases, total, words = draw_worlds(setup, WORLDS, game.seeds[0]), 0.0, []
    for member, weight in zip(mix.members, mix.weights, strict=True):
        game.progress.advance(0.0, f"zero-alarm bound of {member.label}")
        if not game.is_passive(member):
            return None, f"{member.label} has no bound: it takes weight off measurements"
        found = zero_alarm_bounds(setup, game.detector(member), cases)
        bound = found.free_m if found.restricted_m is None else found.restricted_m
        if bound is None:
            return None, f"{member.label} has no bound: {found.why}"
        total += weight * min(bound / game.payoff.limit_m, 1.0)
        words.append(f"{member.label} {bound:.3g} m" if math.isfinite(bound) else member.label)
    why = f"zero-alarm bounds of attacks along one heading: {', '.join(words)}"
    if total >= 1.0 - 1e-9:
        why += f"; none is below the limit of {game.payoff.limit_m:g} m, so that they say nothing"
    return total, why
