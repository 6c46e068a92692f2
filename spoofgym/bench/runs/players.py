"""Specs of detectors, spoofers and mixes, their labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...attacks import ATTACKS
from ...core.registry import Spec, label_of, make, slug, spec_of
from ...core.settings import describe
from ...detectors import DETECTORS, Calibrated, Detector, LearnedDetector, detector_in_world
from ...detectors.build import asked_by_default, spec_of_judge
from ...envs.spoofer_binding import bound_spoofer, monitors_for, setup_of_card
from ...simulation.setup import Setup
from ...spoofers import SPOOFERS, Spoofer, resolve
from ...spoofers.card import Card
from ...spoofers.scaled import AMPLITUDE, Scaled, split_amplitude, with_amplitude
from ...spoofers.zoo import card_of, shipped

TUNED = "tuned"
"""Value of a spoofer's setting that is to be searched for."""
DEFAULT_DETECTORS: tuple[Spec, ...] = ({"name": "snapshot-chi2"}, {"name": "ewma"})
DEFAULT_SPOOFERS: tuple[Spec, ...] = (
    {"name": "none"},
    {"name": "step", AMPLITUDE: TUNED},
    {"name": "ramp", "rate_mps": TUNED},
    {"name": "accelerating-ramp", "acceleration_mps2": TUNED},
    {"name": "blind-optimum", AMPLITUDE: TUNED},
)
"""With them, a campaign plays the shipped spoofers that fit it."""


def fitted(spec: Any) -> Spec:
    """A spoofer's spec with one setting to be fitted to the alarm budget, where it has none yet.
    That is the usual one of `DEFAULT_SPOOFERS` for a name without settings, and else the amplitude
    of its commands; an amplitude that is given stays."""
    given: Spec = {"name": spec} if isinstance(spec, str) else dict(spec)
    usual = {each["name"]: each for each in DEFAULT_SPOOFERS}
    if len(given) == 1 and given["name"] in usual:
        return dict(usual[given["name"]])
    if AMPLITUDE in given or TUNED in given.values() or given["name"] == "none":
        return given
    return {**given, AMPLITUDE: TUNED}


@dataclass(frozen=True)
class Entry:
    """A detector or a spoofer of a campaign."""

    label: str
    spec: Spec

    @property
    def tuned(self) -> str | None:
        return next((key for key, value in self.spec.items() if value == TUNED), None)

    @property
    def largest(self) -> float | None:
        """Largest value that is tried of that setting; None for the spoofer's own range."""
        return None

    @property
    def searched(self) -> bool:
        """Whether the spoofer's curve is to be searched for, too: a blind optimum."""
        return self.spec["name"] == "blind-optimum" and not self.spec["rates_mps"]

    @property
    def untuned(self) -> Spec:
        """Settings without the one that is to be searched for."""
        return {key: value for key, value in self.spec.items() if key != self.tuned}

    def with_value(self, value: float) -> Spec:
        return {**self.spec, str(self.tuned): value}


def build_spoofer(spec: Any) -> Spoofer:
    plain, amplitude = split_amplitude(spec)
    resolved = resolve(plain)
    spoofer: Spoofer = make("spoofer", SPOOFERS, Spoofer, resolved, shipped())
    return with_amplitude(spoofer, amplitude)


def spec_of_spoofer(spoofer: Spoofer) -> Spec:
    if isinstance(spoofer, Scaled):
        return {**spec_of_spoofer(spoofer.spoofer), AMPLITUDE: spoofer.amplitude}
    return spec_of("spoofer", SPOOFERS, spoofer)


def detector_entry(spec: str | Mapping[str, Any] | Detector) -> Entry:
    """Detector of a campaign, at the default rate of false alarms where it asks for nothing."""
    detector = detector_in_world(spec)
    full = spec_of_judge(detector)
    inner = detector.detector if isinstance(detector, Calibrated) else detector
    if isinstance(inner, LearnedDetector):
        shown = {key: value for key, value in full.items() if key != "sha256"}
        return Entry(label_of({**shown, "name": inner.label}, asked_by_default()), full)
    default = _default("detector", DETECTORS, type(inner))
    if default is not None:
        default |= asked_by_default()
    return Entry(label_of(full, default), full)


def spoofer_entry(spec: str | Mapping[str, Any] | Spoofer) -> Entry:
    settings: Any = dict(spec) if isinstance(spec, Mapping) else spec
    tuned = (
        [key for key, value in settings.items() if value == TUNED] if settings is not spec else []
    )
    for key in tuned:
        del settings[key]
    spoofer = build_spoofer(settings)
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
    if spoofer.label is not None:
        fixed = full.get(AMPLITUDE, TUNED)
        word = "" if fixed == TUNED else f"(amplitude={fixed:g})"
        return Entry(f"{spoofer.label}{word}", full)
    inner = spoofer.spoofer if isinstance(spoofer, Scaled) else spoofer
    default = _default("spoofer", SPOOFERS, type(inner))
    if default is not None:
        default |= {AMPLITUDE: TUNED}
    return Entry(label_of(full, default), full)


def _check_pace(spoofer: Spoofer, spec: Spec) -> None:
    """Raise where an object decides at a pace that the one of its settings would not have."""
    again = build_spoofer(spec)
    for name in ("decision_interval_s", "between"):
        value = getattr(spoofer, name)
        if getattr(again, name) != value:
            raise ValueError(
                f"`{name}` = {value!r} was set on an object of {type(spoofer).__name__}, which has "
                f"no such setting, so that a campaign would lose it: make it an attribute of a "
                "class of your own, or one of its settings"
            )


def _default(word: str, kinds: Mapping[str, type[Any]], kind: type[Any]) -> Spec | None:
    """Settings of a kind by default; None where some have none."""
    try:
        return spec_of(word, kinds, kind())
    except TypeError:
        return None


def oracle_labels(entries: tuple[Entry, ...]) -> list[str]:
    """Labels of the detectors that know the attack."""
    made = [(entry, detector_in_world(entry.spec)) for entry in entries]
    return [entry.label for entry, detector in made if detector.oracle]


def refuse_oracles(entries: tuple[Entry, ...]) -> None:
    """Raise where a detector knows the attack."""
    labels = oracle_labels(entries)
    if labels:
        raise ValueError(
            f"{', '.join(labels)}: an oracle knows the attack's channel, size and onset by its "
            "settings, which no receiver knows, and alarms without an attack, too; it can't be "
            "compared with detectors; to play it all the same: `--allow-oracles`, or "
            "`Suite(allow_oracles=True)`"
        )


def check_labels(entries: tuple[Entry, ...]) -> None:
    """Raise where two entries would share their files."""
    files = [slug(entry.label) for entry in entries]
    twice = [entry for entry in entries if files.count(slug(entry.label)) > 1]
    if twice:
        labelled = any("label" in entry.spec for entry in twice)
        hint = "; a `label` of its own tells one from the other" if labelled else ""
        names = sorted({entry.label for entry in twice})
        raise ValueError(f"listed twice: {', '.join(names)}{hint}")


def fitting(env: str, setup: Setup) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Shipped spoofers of an environment whose actions and observations mean what they meant. Each
    is asked as a campaign plays it, by its own actions and at its own pace. Returns their names,
    and why others of it are left out."""
    names, notes = [], []
    for name in shipped():
        if card_of(name).env_id != env:
            continue
        differences = _unlike_card(name, setup)
        if differences:
            notes.append(f"shipped spoofer {name} is left out: {'; '.join(differences)}")
        else:
            names.append(name)
    return tuple(names), tuple(notes)


def _unlike_card(name: str, setup: Setup) -> list[str]:
    """What is another one for a shipped spoofer in a world than on its card."""
    spoofer = build_spoofer(name)
    watched = setup.altered(monitors=monitors_for([spoofer], setup))
    try:
        context, _, _ = bound_spoofer(spoofer, watched, 1)
    except ValueError as error:
        return [str(error)]
    return card_of(name).differences(context)


def card_behind(spoofer: Spoofer) -> Card | None:
    card = getattr(spoofer, "card", None)
    if isinstance(card, Card):
        return card
    settings, _ = split_amplitude(spec_of_spoofer(spoofer))
    for name in shipped():
        if spoofer.label == name and settings == spec_of_spoofer(build_spoofer(name)):
            return card_of(name)
    return None


def _attack_of(setup: Setup) -> dict[str, Any]:
    """What an attack does; a threat by name does what the same options do."""
    spec = spec_of("attack", ATTACKS, setup.attack)
    return {key: value for key, value in spec.items() if key != "threat"}


def transferred(card: Card, setup: Setup, detector: Entry) -> tuple[str, list[str]]:
    """What a spoofer was made for, and what is another one in a campaign."""
    made = setup_of_card(card)
    label = detector_entry(made.detector).label
    if type(made) is not type(setup):
        return label, ["environment"]
    found = [] if label == detector.label else ["detector"]
    if _attack_of(made) != _attack_of(setup):
        found.append("attack")
    return label, found + [
        name
        for name in ("scenario", "receiver", "timeline")
        if describe(getattr(made, name)) != describe(getattr(setup, name))
    ]


def knowledge_of(entry: Entry, setup: Setup, detector: Entry) -> dict[str, Any]:
    """What a spoofer knows: while it attacks, and when it was designed. Returns ``run_time``;
    ``design_time``; ``detector``, the label of the one that it was made for, None where it was made
    for none, or has no card that says so; ``transfer``, what is another one here than where it was
    made."""
    spoofer = build_spoofer(entry.untuned)
    known: dict[str, Any] = {
        "run_time": spoofer.knowledge,
        "design_time": spoofer.designed_on,
        "detector": None,
        "transfer": [],
    }
    card = card_behind(spoofer)
    if entry.tuned and card is None:
        designed = "detector, receiver and scenario, by tuning"
        return {**known, "design_time": designed, "detector": detector.label}
    if card is None:
        return known
    made_for, differences = transferred(card, setup, detector)
    return {**known, "detector": made_for, "transfer": differences}
