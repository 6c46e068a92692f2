"""Shipped spoofers in a campaign: which of them fit it, and what each of them was made for."""

from __future__ import annotations

from collections.abc import Callable

from ..attacks import ATTACKS
from ..envs.spoofer_binding import setup_of_card
from ..simulators.setup import Setup
from ..spoofers import Spoofer, SpooferContext
from ..spoofers.card import Card
from ..spoofers.scaled import split_amplitude
from ..spoofers.zoo import card_of, shipped
from .entries import Entry, build_spoofer, detector_entry, spec_of_spoofer
from .specs import describe, spec_of


def fitting(
    env: str, context_of: Callable[[str], SpooferContext]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Shipped spoofers of an environment whose actions and observations mean what they meant.

    Returns their names, and why others of it are left out.
    """
    names, notes = [], []
    for name in shipped():
        card = card_of(name)
        if card.env_id != env:
            continue
        differences = card.differences(context_of(card.knowledge.run_time))
        if differences:
            notes.append(f"shipped spoofer {name} is left out: {'; '.join(differences)}")
        else:
            names.append(name)
    return tuple(names), tuple(notes)


def card_behind(spoofer: Spoofer) -> Card | None:
    """Card of a spoofer."""
    card = getattr(spoofer, "card", None)
    if isinstance(card, Card):
        return card
    settings, _ = split_amplitude(spec_of_spoofer(spoofer))
    for name in shipped():
        if spoofer.label == name and settings == spec_of_spoofer(build_spoofer(name)):
            return card_of(name)
    return None


def transferred(card: Card, setup: Setup, detector: Entry) -> tuple[str, list[str]]:
    """What a spoofer was made for, and what is another one in a campaign."""
    made = setup_of_card(card)
    label = detector_entry(made.detector).label
    if type(made) is not type(setup):
        return label, ["environment"]
    found = [] if label == detector.label else ["detector"]
    if spec_of("attack", ATTACKS, made.attack) != spec_of("attack", ATTACKS, setup.attack):
        found.append("attack")
    return label, found + [
        name
        for name in ("scenario", "receiver", "timeline")
        if describe(getattr(made, name)) != describe(getattr(setup, name))
    ]
