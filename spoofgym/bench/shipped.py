"""Shipped spoofers in a campaign: which of them fit it, and what each of them was made for."""

from __future__ import annotations

from typing import Any

from ..attacks import ATTACKS
from ..envs.spoofer_binding import bound_spoofer, monitors_for, setup_of_card
from ..simulators.setup import Setup
from ..spoofers import Spoofer
from ..spoofers.card import Card
from ..spoofers.scaled import split_amplitude
from ..spoofers.zoo import card_of, shipped
from .entries import Entry, build_spoofer, detector_entry, spec_of_spoofer
from .specs import describe, spec_of


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
