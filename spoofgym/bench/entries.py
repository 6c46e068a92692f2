"""Who plays in a campaign: detectors and spoofers with all their settings and a short name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .._registry import check_choice
from ..detectors import DETECTORS, Detector
from ..spoofers import SPOOFERS, Spoofer, resolve, shipped
from .specs import Spec, label_of, make, slug, spec_of

TUNED = "tuned"
"""Value of a spoofer's setting that is to be searched for."""
DEFAULT_DETECTORS: tuple[Spec, ...] = ({"name": "snapshot-chi2"}, {"name": "ewma"})
DEFAULT_SPOOFERS: tuple[Spec, ...] = (
    {"name": "none"},
    {"name": "step"},
    {"name": "ramp", "rate_mps": TUNED},
    {"name": "accelerating-ramp", "acceleration_mps2": TUNED},
)
"""With them, a campaign plays the shipped spoofers that fit it."""


@dataclass(frozen=True)
class Entry:
    """A detector or a spoofer of a campaign."""

    label: str
    spec: Spec

    @property
    def tuned(self) -> str | None:
        """Setting that is to be searched for."""
        return next((key for key, value in self.spec.items() if value == TUNED), None)

    @property
    def untuned(self) -> Spec:
        """Settings without the one that is to be searched for."""
        return {key: value for key, value in self.spec.items() if key != self.tuned}

    def with_value(self, value: float) -> Spec:
        """Settings with the tuned one at a value."""
        return {**self.spec, str(self.tuned): value}


def build_spoofer(spec: Any) -> Spoofer:
    """Spoofer of a campaign, not bound yet."""
    resolved = resolve(spec)
    name = resolved["name"] if isinstance(resolved, Mapping) and "name" in resolved else resolved
    if isinstance(name, str) and ":" not in name:
        check_choice("spoofer", name, [*SPOOFERS, *shipped()])
    spoofer: Spoofer = make("spoofer", SPOOFERS, Spoofer, resolved)
    return spoofer


def detector_entry(spec: str | Mapping[str, Any] | Detector) -> Entry:
    """Detector of a campaign."""
    detector: Detector = make("detector", DETECTORS, Detector, spec)
    full = spec_of("detector", DETECTORS, detector)
    return Entry(label_of(full, _default("detector", DETECTORS, type(detector))), full)


def spoofer_entry(spec: str | Mapping[str, Any] | Spoofer) -> Entry:
    """Spoofer of a campaign."""
    settings: Any = dict(spec) if isinstance(spec, Mapping) else spec
    tuned = (
        [key for key, value in settings.items() if value == TUNED] if settings is not spec else []
    )
    for key in tuned:
        del settings[key]
    spoofer = build_spoofer(settings)
    for key in tuned:
        if key != spoofer.tunable:
            raise ValueError(
                f"`{key}` of spoofer {settings['name']!r} can't be tuned; tunable: "
                f"{spoofer.tunable or 'nothing'}"
            )
    full = {**spec_of("spoofer", SPOOFERS, spoofer), **dict.fromkeys(tuned, TUNED)}
    if spoofer.label is not None:
        return Entry(spoofer.label, full)
    return Entry(label_of(full, _default("spoofer", SPOOFERS, type(spoofer))), full)


def _default(word: str, kinds: Mapping[str, type[Any]], kind: type[Any]) -> Spec | None:
    """Settings of a kind by default; None where some have none."""
    try:
        return spec_of(word, kinds, kind())
    except TypeError:
        return None


def oracle_labels(entries: tuple[Entry, ...]) -> list[str]:
    """Labels of the detectors that know the attack."""
    made = [(entry, make("detector", DETECTORS, Detector, entry.spec)) for entry in entries]
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
