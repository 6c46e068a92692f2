"""Members of a game of spoofers against detectors, and mixtures of them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...detectors import Calibrated, Detector, LearnedDetector, detector_in_world
from ...detectors.pool import PooledDetector, checked_weights
from ...simulation.setup import SPLITS
from ...spoofers import OnnxPolicy, Scaled, Spoofer, card_of, make_spoofer, shipped
from ...spoofers.base import sees_statistics
from ..runs.players import (
    build_spoofer,
    detector_entry,
    refuse_oracles,
    spec_of_spoofer,
    spoofer_entry,
)
from .evaluate import LiveEntry, entry_of

Seeds = frozenset[tuple[int, str]]
"""Entropy and split of runs."""
SPOOFER, DETECTOR = "spoofer", "detector"
OUT = 1e-6
"""Probability below which a strategy is taken to be out of a mix."""


@dataclass(frozen=True)
class Member:
    """A pure strategy: a spoofer or a detector with all its settings.

    - `label`: unique in a game; `side`: ``"spoofer"`` or ``"detector"``;
    - `spec`: name and settings, JSON-able; None of an object that no text describes, which is
      `thing`;
    - `knowledge`: what a spoofer observes while it attacks; "" of a detector;
    - `decided_on`: entropy and split of the runs that it was trained, fitted or chosen on.
    """

    label: str
    side: str
    spec: Any
    knowledge: str = ""
    decided_on: Seeds = frozenset()
    thing: Any = field(default=None, repr=False, compare=False)

    @property
    def given(self) -> Any:
        return self.spec if self.thing is None else self.thing

    @property
    def sees_statistics(self) -> bool:
        """Whether the spoofer's commands depend on the detector."""
        return sees_statistics(self.knowledge)

    def as_json(self) -> dict[str, Any]:
        return {
            "label": self.label,
            **({"knowledge": self.knowledge} if self.side == SPOOFER else {}),
            "spec": self.spec,
            "decided_on": sorted([entropy, split] for entropy, split in self.decided_on),
        }

    @classmethod
    def from_json(cls, side: str, data: Mapping[str, Any]) -> Member:
        """Inverse of `as_json`."""
        seeds = frozenset((int(entropy), str(split)) for entropy, split in data["decided_on"])
        return cls(data["label"], side, data["spec"], data.get("knowledge", ""), seeds)


@dataclass(frozen=True)
class Mixture:
    """A mixed strategy: one member is drawn for every episode.

    - `weights`: probabilities; `decided_on`: as of a `Member`, the runs of the matrix in which the
      mix was solved among them.
    """

    label: str
    members: tuple[Member, ...]
    weights: tuple[float, ...]
    decided_on: Seeds = frozenset()

    @property
    def side(self) -> str:
        return self.members[0].side

    @property
    def knowledge(self) -> str:
        return ", ".join(dict.fromkeys(each.knowledge for each in self.members))

    def as_json(self) -> dict[str, Any]:
        each = [member.as_json() for member in self.members]
        return {"label": self.label, "weights": list(self.weights), "members": each}

    def pool(self) -> dict[str, Any]:
        """Mix for an environment, JSON-able. Returns a ``pool``: of detectors as `make_detector`
        takes it, of spoofers ``pool`` and ``weights`` as `DetectorView` takes them."""
        nameless = [each.label for each in self.members if each.spec is None]
        if nameless:
            raise TypeError(f"{', '.join(nameless)}: an object, which no text describes")
        members, weights = [each.spec for each in self.members], list(self.weights)
        if self.side == DETECTOR:
            return {"name": "pool", "members": members, "weights": weights}
        return {"pool": members, "weights": weights}


Strategy = Member | Mixture


def mixture(
    label: str, members: Sequence[Member], weights: ArrayLike, decided_on: Seeds = frozenset()
) -> Mixture:
    """Mix of members; those with no probability are left out.

    Parameters
    ----------
    label : str
        Name in tables.
    members : sequence of Member
        Pure strategies of one side.
    weights : array_like
        Their probabilities, or numbers in proportion to them.
    decided_on : frozenset of (int, str)
        Entropy and split of the runs that decided on the weights; those of the members are added.

    Returns
    -------
    Mixture
        Refused by games on these runs.

    Raises
    ------
    ValueError
        When the weights do not fit.

    Examples
    --------
    >>> from spoofgym.bench.experiments.members import member_of, mixture
    >>> guards = [member_of(name, "detector") for name in ("solution-separation", "cusum", "aime")]
    >>> mix = mixture("mine", guards, [3, 1, 0])
    >>> mix.weights, mix.pool()["name"]
    ((0.75, 0.25), 'pool')
    """
    chances = checked_weights(len(members), np.asarray(weights, dtype=np.float64).tolist())
    chances = np.where(chances < OUT, 0.0, chances)
    kept = [(m, p) for m, p in zip(members, chances.tolist(), strict=True) if p > 0.0]
    seeds = decided_on.union(*(member.decided_on for member, _ in kept))
    total = sum(p for _, p in kept)
    return Mixture(label, tuple(m for m, _ in kept), tuple(p / total for _, p in kept), seeds)


def strategy_of(given: Any, side: str) -> Strategy:
    """Strategy of any form: `Member` or `Mixture`, name, settings, path, object, or a mix. A mix is
    a mapping of names or paths to weights."""
    if isinstance(given, Member | Mixture):
        if given.side != side:
            raise ValueError(f"{given.label} is a {given.side}, and no {side}")
        return given
    if isinstance(given, Mapping) and "name" not in given:
        if not given:
            raise ValueError("a mixture must have at least one member, got none")
        members = [_member_of(each, side) for each in given]
        label = " + ".join(f"{w:g} {m.label}" for m, w in zip(members, given.values(), strict=True))
        return mixture(label, members, list(given.values()))
    return _member_of(given, side)


def member_of(
    given: Any,
    side: str,
    *,
    label: str | None = None,
    decided_on: Iterable[tuple[int, str]] = (),
) -> Member:
    """Pure strategy of a spoofer or a detector, with what it was decided on.

    Parameters
    ----------
    given : str, path, mapping or object
        A spoofer as `spoofgym.evaluate` takes one, a detector as `make_detector` does, or an
        ``.onnx`` file.
    side : {"spoofer", "detector"}
        Which of them it is.
    label : str, optional
        Name in tables.
    decided_on : iterable of (int, str)
        Entropy and split of the runs that it was trained, fitted or chosen on, besides those that
        its card names.

    Returns
    -------
    Member
        Refused by games on these runs.

    Raises
    ------
    ValueError
        When the name, a setting or a split is unknown, or a setting is still to be fitted.
    """
    seeds = frozenset((int(entropy), str(split)) for entropy, split in decided_on)
    made = _member_of(given, side)
    seeds |= made.decided_on
    for _, split in seeds:
        if split not in SPLITS:
            raise ValueError(f"unknown split {split!r}; valid: {', '.join(SPLITS)}")
    return Member(label or made.label, side, made.spec, made.knowledge, seeds, made.thing)


def _member_of(given: Any, side: str) -> Member:
    if isinstance(given, Mixture):
        raise ValueError("a mixture can't be a member of a mixture; list its members")
    if isinstance(given, Member):
        return given
    if side == SPOOFER:
        return _spoofer(given)
    return _detector(os.fspath(given) if isinstance(given, os.PathLike) else given)


def _spoofer(given: Any) -> Member:
    try:
        entry = spoofer_entry(given) if isinstance(given, Spoofer) else entry_of(given, None, None)
    except TypeError:  # no text describes it
        entry = entry_of(given, None, None)
    if isinstance(entry, LiveEntry):
        return Member(entry.label, SPOOFER, None, entry.spoofer.knowledge, thing=entry.spoofer)
    if entry.tuned or entry.searched:
        raise ValueError(
            f"{entry.label}: a strategy of a game has all of its settings; fit "
            f"`{entry.tuned or 'rates_mps'}` first, as by spoofgym.evaluate or best_response"
        )
    spoofer = build_spoofer(entry.spec)
    seeds = _seeds_of_spoofer(spoofer)
    return Member(entry.label, SPOOFER, entry.spec, spoofer.knowledge, seeds)


def _detector(given: Any) -> Member:
    try:
        entry = detector_entry(given)
    except TypeError:
        if not isinstance(given, Detector):
            raise
        if given.oracle:
            raise ValueError(
                f"{type(given).__name__} is given what no receiver can know: no member of a game"
            ) from None
        seeds = _seeds_of_detector(given)
        return Member(type(given).__name__, DETECTOR, None, decided_on=seeds, thing=given)
    refuse_oracles((entry,))
    seeds = _seeds_of_detector(detector_in_world(entry.spec))
    return Member(entry.label, DETECTOR, entry.spec, decided_on=seeds)


def _seeds_of_spoofer(spoofer: Spoofer) -> Seeds:
    """Runs that decided on a spoofer, as far as its card says."""
    inner = spoofer.spoofer if isinstance(spoofer, Scaled) else spoofer
    if isinstance(inner, OnnxPolicy):
        return inner.card.decided_on
    name = inner.label  # of a shipped profile, which is no more than its settings
    if name not in shipped() or spec_of_spoofer(inner) != spec_of_spoofer(make_spoofer(name)):
        return frozenset()
    return card_of(name).decided_on


def _seeds_of_detector(detector: Detector) -> Seeds:
    """Runs that decided on a detector, as far as its card says, or those of a pool's members."""
    if isinstance(detector, Calibrated):
        return _seeds_of_detector(detector.detector)
    if isinstance(detector, PooledDetector):
        return frozenset[tuple[int, str]]().union(*map(_seeds_of_detector, detector.judges))
    return detector.card.decided_on if isinstance(detector, LearnedDetector) else frozenset()
