"""What a detector or a spoofer is: text, settings, a file, a class, an object or a mixture."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...attacks import ATTACKS
from ...core.declared import check_number
from ...core.registry import Spec, build_spec, format_label, inspect_settings, slug
from ...core.settings import describe
from ...detectors import DETECTORS, Calibrated, Detector, detector_in_world
from ...detectors.build import get_default_request, spec_of_judge, split_spec
from ...detectors.isolated import ISOLATED, Isolated
from ...detectors.pool import normalize_weights
from ...envs.spoofer_binding import bound_spoofer, find_card_settings, monitors_for, setup_of_card
from ...policies import SpooferCard, list_shipped, load_card
from ...policies.card import DETECTOR, SPOOFER
from ...simulation.setup import SPLITS, Setup
from ...spoofers import SPOOFERS, Spoofer, make_spoofer
from ...spoofers.base import sees_statistics
from ...spoofers.build import card_behind, spec_of_spoofer
from ...spoofers.learned import ModelPolicy, read_training_env
from ...spoofers.scaled import AMPLITUDE, SMALLEST, Scaled

Seeds = frozenset[tuple[int, str]]  # entropy and split of runs
ATTACK = "attack"
"""A third side: an attack needs no spoofer, and its setting is the distance of an antenna."""
OUT = 1e-6  # probability below which a strategy is taken to be out of a mix
TUNED = "tuned"  # value of a spoofer's setting that is to be searched for
DEFAULT_DETECTORS: tuple[Spec, ...] = ({"name": "snapshot-chi2"}, {"name": "ewma"})
DEFAULT_SPOOFERS: tuple[Spec, ...] = (
    {"name": "none"},
    {"name": "step", AMPLITUDE: TUNED},
    {"name": "ramp", "rate_mps": TUNED},
    {"name": "accelerating-ramp", "acceleration_mps2": TUNED},
    {"name": "open-loop", AMPLITUDE: TUNED},
)
"""With them, a campaign plays the shipped spoofers that fit it."""
FITTED = "fitted"
"""Amplitude that is fitted to the alarm budget on training runs, which are not scored."""


def add_tuned_setting(spec: Any) -> Spec:
    """A spoofer's spec with one setting to be fitted to the alarm budget, where it has none yet:
    that of `DEFAULT_SPOOFERS` for a name alone, and else the amplitude, unless one is given."""
    given: Spec = {"name": spec} if isinstance(spec, str) else dict(spec)
    usual = {each["name"]: each for each in DEFAULT_SPOOFERS}
    if len(given) == 1 and given["name"] in usual:
        return dict(usual[given["name"]])
    if AMPLITUDE in given or TUNED in given.values() or given["name"] == "none":
        return given
    return {**given, AMPLITUDE: TUNED}


@dataclass(frozen=True)
class PlayerSpec:
    """A detector, a spoofer or an attack (`side`) with all its settings.

    - `label`: unique among those that play; `spec`: name and settings, JSON-able; None of an object
      that no text describes, the `thing`;
    - `tuned`: setting that is to be searched for, if any, and its `largest` value, if not the
      usual;
    - `decided_on`: entropy and split of the runs that it was trained, fitted or chosen on.
    """

    label: str
    side: str
    spec: Any
    tuned: str | None = None
    knowledge: str = ""
    decided_on: Seeds = frozenset()
    thing: Any = field(default=None, repr=False, compare=False)
    largest: float | None = None

    @property
    def needs_search(self) -> bool:
        """Whether the spoofer's curve is to be searched for, too: an optimized open-loop attack."""
        spec = self.spec or {"name": ""}
        return bool(spec["name"] == "open-loop" and not spec["rates_mps"])

    @property
    def fixed_spec(self) -> Any:
        """The object, or its settings without the one that is to be searched for."""
        if self.thing is not None:
            return self.thing
        return {key: value for key, value in self.spec.items() if key != self.tuned}

    @property
    def sees_statistics(self) -> bool:
        """Whether the spoofer's commands depend on the detector."""
        return sees_statistics(self.knowledge)

    def with_value(self, value: float) -> Any:
        """What `make_spoofer` takes, with a value of the tuned setting."""
        if self.thing is not None:
            return Scaled(self.thing, value)
        east = [0.0, value, 0.0]
        return {**self.spec, str(self.tuned): east if self.side == ATTACK else value}

    def build(self) -> Any:
        """Detector, or spoofer without its tuned setting; not bound yet."""
        return (detector_in_world if self.side == DETECTOR else make_spoofer)(self.fixed_spec)

    def as_config(self) -> dict[str, Any]:
        return {"label": self.label, "spec": self.spec}

    def as_json(self) -> dict[str, Any]:
        return {
            "label": self.label,
            **({"knowledge": self.knowledge} if self.side == SPOOFER else {}),
            "spec": self.spec,
            "decided_on": sorted([entropy, split] for entropy, split in self.decided_on),
        }

    @classmethod
    def from_json(cls, side: str, data: Mapping[str, Any]) -> PlayerSpec:
        seeds = frozenset((int(entropy), str(split)) for entropy, split in data["decided_on"])
        known = data.get("knowledge", "")
        return cls(data["label"], side, data["spec"], knowledge=known, decided_on=seeds)


@dataclass(frozen=True)
class Mixture:
    """A mixed strategy: one member is drawn for every episode. `decided_on`: as of a `PlayerSpec`,
    the runs of the matrix in which the mix was solved among them."""

    label: str
    members: tuple[PlayerSpec, ...]
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
            raise TypeError(f"{', '.join(nameless)}: an object has no name and settings")
        members, weights = [each.spec for each in self.members], list(self.weights)
        if self.side == DETECTOR:
            return {"name": "pool", "members": members, "weights": weights}
        return {"pool": members, "weights": weights}


Strategy = PlayerSpec | Mixture


def specify_detector(spec: str | Mapping[str, Any] | Detector) -> PlayerSpec:
    """Detector, at the default rate of false alarms where it requests none."""
    detector = detector_in_world(spec)
    full, default = spec_of_judge(detector), get_default_request()
    inner = detector.detector if isinstance(detector, Calibrated) else detector
    if full["name"] == ISOLATED:  # named as what is in it
        own = {key: value for key, value in full.items() if key not in inspect_settings(Isolated)}
        settings, _ = split_spec(full["detector"])
        shown = {**settings, **own, "name": settings["name"]}
        label = format_label(shown, {**dict.fromkeys(settings), **default})
    elif inner.card is None:
        label = _label("detector", DETECTORS, inner, full, default)
    else:
        shown = {key: value for key, value in full.items() if key != "sha256"}
        label = format_label({**shown, "name": inner.label}, default)
    return PlayerSpec(label, DETECTOR, full, decided_on=_collect_seeds(detector))


def _collect_seeds(detector: Detector) -> Seeds:
    """Runs that decided on a detector, or on the members of a pool, as far as a card says."""
    if isinstance(detector, Calibrated):
        return _collect_seeds(detector.detector)
    own = frozenset() if detector.card is None else detector.card.decided_on
    return own.union(*map(_collect_seeds, detector.judges))


def specify_spoofer(spec: str | Mapping[str, Any] | Spoofer) -> PlayerSpec:
    """Spoofer, one setting of which may be `TUNED`; a TypeError where no text describes it."""
    settings: Any = dict(spec) if isinstance(spec, Mapping) else spec
    tuned = (
        [key for key, value in settings.items() if value == TUNED] if spec is not settings else []
    )
    for key in tuned:
        del settings[key]
    spoofer = make_spoofer(settings)
    valid = [name for name in (spoofer.tunable, AMPLITUDE) if name and spoofer.transmits]
    for key in tuned:
        if key not in valid:
            raise ValueError(
                f"`{key}` of spoofer {settings['name']!r} can't be tuned; tunable: "
                f"{', '.join(valid) or 'nothing'}"
            )
    if len(tuned) > 1:
        raise ValueError(f"one setting of a spoofer can be tuned, got {', '.join(tuned)}")
    full = {**spec_of_spoofer(spoofer), **dict.fromkeys(tuned, TUNED)}
    if isinstance(spec, Spoofer):
        _check_pace(spec, full)
    if spoofer.label is None:
        inner = spoofer.spoofer if isinstance(spoofer, Scaled) else spoofer
        label = _label("spoofer", SPOOFERS, inner, full, {AMPLITUDE: TUNED})
    else:
        fixed = full.get(AMPLITUDE, TUNED)
        label = spoofer.label + ("" if fixed == TUNED else f"(amplitude={fixed:g})")
    card = card_behind(spoofer)
    return PlayerSpec(
        label,
        SPOOFER,
        full,
        tuned[0] if tuned else None,
        spoofer.knowledge,
        frozenset() if card is None else card.decided_on,
    )


def _label(word: str, kinds: Mapping[str, type], thing: Any, full: Spec, usual: Spec) -> str:
    """Name, with the settings that are not the class's defaults or the usual ones of all."""
    try:
        known = {**inspect_settings(type(thing)), **build_spec(word, kinds, type(thing)())}
        return format_label(full, {**known, **usual})
    except TypeError:  # a setting has no default
        return format_label(full, None)


def _check_pace(spoofer: Spoofer, spec: Spec) -> None:
    """Raise where an object decides at a pace that the one of its settings would not have."""
    again = make_spoofer(spec)
    for name in ("decision_interval_s", "between"):
        value = getattr(spoofer, name)
        if getattr(again, name) != value:
            raise ValueError(
                f"`{name}` = {value!r} was set on an object of {type(spoofer).__name__}, which has "
                f"no such setting, so that a campaign would lose it: make it an attribute of a "
                "class of your own, or one of its settings"
            )


def specify_policy(
    policy: Any,
    amplitude: float | str | None = None,
    knowledge: str | None = None,
    label: str | None = None,
    largest: float | None = None,
) -> PlayerSpec:
    """Spoofer of any form, and what of it is to be fitted, up to which amplitude."""
    fits = _is_fitted(amplitude, largest)
    if isinstance(policy, str | os.PathLike | Mapping):
        if knowledge is not None or label is not None:
            raise ValueError("`knowledge` and `label` are for models; this spoofer has its own")
        if largest is not None:
            raise ValueError(
                "`largest_amplitude` is for models; this spoofer has a range of its own"
            )
        spec = dict(policy) if isinstance(policy, Mapping) else {"name": os.fspath(policy)}
        if not fits and amplitude is not None:
            spec = {**spec, AMPLITUDE: amplitude}
        return specify_spoofer(add_tuned_setting(spec) if fits else spec)
    spoofer = policy
    if not isinstance(policy, Spoofer):
        known = {
            **read_training_env(policy),
            **({} if knowledge is None else {"knowledge": knowledge}),
        }
        spoofer = ModelPolicy(policy, label=label, **known)
    name = str(spoofer.label or type(spoofer).__name__)
    if isinstance(spoofer, Scaled) and amplitude is not None:
        raise ValueError(
            f"{name} has the amplitude {spoofer.amplitude:g} already: give `amplitude=None`"
        )
    if not fits and amplitude is not None:
        spoofer = Scaled(spoofer, float(amplitude))
    tuned = AMPLITUDE if fits and spoofer.transmits else None
    return PlayerSpec(name, SPOOFER, None, tuned, spoofer.knowledge, thing=spoofer, largest=largest)


def _is_fitted(amplitude: float | str | None, largest: float | None) -> bool:
    """Whether an amplitude is to be fitted; raises where it, or the largest one, is not valid."""
    fits = amplitude == FITTED
    if isinstance(amplitude, str) and not fits:
        raise ValueError(f"`amplitude` must be {FITTED!r}, a number or None, got {amplitude!r}")
    if not fits and amplitude is not None:
        check_number("amplitude", amplitude, above=0.0)
    if largest is None:
        return fits
    check_number("largest_amplitude", largest, above=SMALLEST)
    if not fits:
        raise ValueError(f"`largest_amplitude` is for `amplitude={FITTED!r}`, got {amplitude!r}")
    return fits


def specify_player(given: Any, side: str) -> PlayerSpec:
    """Pure strategy of any form, with all of its settings."""
    if isinstance(given, PlayerSpec):
        return given
    if isinstance(given, Mixture):
        raise ValueError("a mixture can't be a member of a mixture; list its members")
    if side == DETECTOR:
        given = os.fspath(given) if isinstance(given, os.PathLike) else given
        try:
            player = specify_detector(given)
        except TypeError:
            if not isinstance(given, Detector):
                raise
            if given.oracle:
                raise ValueError(
                    f"{type(given).__name__} is given what no receiver can know: leave it out "
                    "of the game"
                ) from None
            name, seeds = type(given).__name__, _collect_seeds(given)
            return PlayerSpec(name, DETECTOR, None, decided_on=seeds, thing=given)
        refuse_oracles((player,))
        return player
    try:
        player = (specify_spoofer if isinstance(given, Spoofer) else specify_policy)(given)
    except TypeError:  # no text describes it
        player = specify_policy(given)
    if player.tuned or player.needs_search:
        raise ValueError(
            f"{player.label}: a strategy of a game has all of its settings; fit "
            f"`{player.tuned or 'rates_mps'}` first, as by spoofgym.evaluate or best_response"
        )
    return player


def make_player(
    given: Any, side: str, *, label: str | None = None, decided_on: Iterable[tuple[int, str]] = ()
) -> PlayerSpec:
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
    PlayerSpec
        Refused by games on these runs.

    Raises
    ------
    ValueError
        When the name, a setting or a split is unknown, or a setting is still to be fitted.
    """
    player = specify_player(given, side)
    seeds = player.decided_on.union((int(entropy), str(split)) for entropy, split in decided_on)
    for _, split in seeds:
        if split not in SPLITS:
            raise ValueError(f"unknown split {split!r}; valid: {', '.join(SPLITS)}")
    return replace(player, label=label or player.label, decided_on=seeds)


def mixture(
    label: str, members: Sequence[PlayerSpec], weights: ArrayLike, decided_on: Seeds = frozenset()
) -> Mixture:
    """Mix of members; those with no probability are left out.

    Parameters
    ----------
    label : str
        Name in tables.
    members : sequence of PlayerSpec
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
    >>> from spoofgym.bench.runs.players import make_player, mixture
    >>> names = ("solution-separation", "cusum", "aime")
    >>> guards = [make_player(name, "detector") for name in names]
    >>> mix = mixture("mine", guards, [3, 1, 0])
    >>> mix.weights, mix.pool()["name"]
    ((0.75, 0.25), 'pool')
    """
    chances = normalize_weights(len(members), np.asarray(weights, dtype=np.float64).tolist())
    chances = np.where(chances < OUT, 0.0, chances)
    parts = [(m, p) for m, p in zip(members, chances.tolist(), strict=True) if p > 0.0]
    seeds = decided_on.union(*(member.decided_on for member, _ in parts))
    total = sum(p for _, p in parts)
    return Mixture(label, tuple(m for m, _ in parts), tuple(p / total for _, p in parts), seeds)


def specify_strategy(given: Any, side: str) -> Strategy:
    """Strategy of any form; a mapping of names or paths to weights is a mixture."""
    if isinstance(given, PlayerSpec | Mixture):
        if given.side != side:
            raise ValueError(f"{given.label} is a {given.side}, and no {side}")
        return given
    if isinstance(given, Mapping) and "name" not in given:
        if not given:
            raise ValueError("a mixture must have at least one member, got none")
        members = [specify_player(each, side) for each in given]
        label = " + ".join(f"{w:g} {m.label}" for m, w in zip(members, given.values(), strict=True))
        return mixture(label, members, list(given.values()))
    return specify_player(given, side)


def oracle_labels(entries: tuple[PlayerSpec, ...]) -> list[str]:
    return [entry.label for entry in entries if entry.build().oracle]


def refuse_oracles(entries: tuple[PlayerSpec, ...]) -> None:
    labels = oracle_labels(entries)
    if labels:
        raise ValueError(
            f"{', '.join(labels)}: an oracle knows the attack's channel, size and onset by its "
            "settings, which no receiver knows, and alarms without an attack, too; it can't be "
            "compared with detectors; to play it all the same: `--allow-oracles`, or "
            "`Suite(allow_oracles=True)`"
        )


def check_labels(entries: tuple[PlayerSpec, ...]) -> None:
    """Raise where two of them would share their files."""
    files = [slug(entry.label) for entry in entries]
    twice = [entry for entry in entries if files.count(slug(entry.label)) > 1]
    if twice:
        labelled = any("label" in entry.spec for entry in twice)
        hint = "; a `label` of its own tells one from the other" if labelled else ""
        names = sorted({entry.label for entry in twice})
        raise ValueError(f"listed twice: {', '.join(names)}{hint}")


def specify_detectors(detectors: Iterable[Any]) -> tuple[PlayerSpec, ...]:
    """Detectors that may be scored together."""
    entries = tuple(map(specify_detector, detectors))
    if not entries:
        raise ValueError("no detector is given")
    check_labels(entries)
    refuse_oracles(entries)
    return entries


def fitting(setup: Setup) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the shipped spoofers of a victim that fit, as a campaign plays them: by their own
    actions and at their own pace. Also why others of it are left out."""
    names, notes = [], []
    for name in list_shipped(SPOOFER):
        if find_card_settings(load_card(name, SpooferCard))[0] is not type(setup):
            continue
        spoofer = make_spoofer(name)
        watched = setup.copy_with(monitors=monitors_for([spoofer], setup))
        try:
            bound_spoofer(spoofer, watched, 1)
            names.append(name)
        except ValueError as error:
            notes.append(f"shipped spoofer {name} is left out: {error}")
    return tuple(names), tuple(notes)


def describe_knowledge(entry: PlayerSpec, setup: Setup, detector: PlayerSpec) -> dict[str, Any]:
    """What a spoofer knows: at ``run_time`` and ``design_time``; the label of the ``detector`` that
    it was made for, None where it was made for none, or has no card that says so; and
    ``transfer``, what is another one here than where it was made."""
    spoofer = entry.build()
    card, made_for, designed = card_behind(spoofer), None, spoofer.designed_on
    differences: list[str] = []
    if card is not None:
        made_for, differences = _compare_training(card, setup, detector)
    elif entry.tuned:
        made_for, designed = detector.label, "detector, receiver and scenario, by tuning"
    return {
        "run_time": spoofer.knowledge,
        "design_time": designed,
        "detector": made_for,
        "transfer": differences,
    }


def _compare_training(
    card: SpooferCard, setup: Setup, detector: PlayerSpec
) -> tuple[str, list[str]]:
    """What a spoofer was made for, and what is another one in a campaign."""
    made = setup_of_card(card)
    label = specify_detector(made.detector).label
    if type(made) is not type(setup):
        return label, ["environment"]
    found = [] if label == detector.label else ["detector"]
    own, here = (build_spec("attack", ATTACKS, each.attack) for each in (made, setup))
    if {**own, "threat": None} != {**here, "threat": None}:  # by name, or by the same options
        found.append("attack")
    return label, found + [
        name
        for name in ("scenario", "receiver", "timeline")
        if describe(getattr(made, name)) != describe(getattr(setup, name))
    ]
