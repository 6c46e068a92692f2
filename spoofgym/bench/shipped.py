"""Shipped spoofers in a campaign: which of them fit it, and what each of them was made for."""

from __future__ import annotations

from collections.abc import Callable

from ..attacks import ATTACKS
from ..envs.attach import setup_of_card
from ..envs.setup import Setup
from ..spoofers import SPOOFERS, Spoofer, SpooferContext
from ..spoofers.card import Card
from ..spoofers.zoo import card_of, shipped
from .entries import Entry, build_spoofer, detector_entry
from .specs import describe, spec_of


def fitting(context_of: Callable[[str], SpooferContext]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Shipped spoofers whose actions and observations mean in a campaign what they meant.

    Parameters
    ----------
    context_of : callable
        What a spoofer is told in the campaign, by its knowledge at run time.

    Returns
    -------
    names : tuple of str
        Those that fit.
    notes : tuple of str
        One line for each of the others: what differs.
    """
    names, notes = [], []
    for name in shipped():
        card = card_of(name)
        differences = card.differences(context_of(card.knowledge.run_time))
        if differences:
            notes.append(f"shipped spoofer {name} is left out: {'; '.join(differences)}")
        else:
            names.append(name)
    return tuple(names), tuple(notes)


def card_behind(spoofer: Spoofer) -> Card | None:
    """Card of a spoofer.

    Parameters
    ----------
    spoofer : Spoofer
        With a card of its own, as learned ones have; or with the settings of a shipped one.

    Returns
    -------
    Card or None
        None where there is none.
    """
    card = getattr(spoofer, "card", None)
    if isinstance(card, Card):
        return card
    settings = spec_of("spoofer", SPOOFERS, spoofer)
    for name in shipped():
        if spoofer.label == name and settings == spec_of("spoofer", SPOOFERS, build_spoofer(name)):
            return card_of(name)
    return None


def transferred(card: Card, setup: Setup, detector: Entry) -> tuple[str, list[str]]:
    """What a spoofer was made for, and what is another one in a campaign.

    Parameters
    ----------
    card : Card
        Of the spoofer.
    setup : Setup
        Of the campaign.
    detector : Entry
        Which the spoofer plays against.

    Returns
    -------
    label : str
        Of the detector that it was optimised against, as campaigns have it.
    differences : list of str
        Among ``detector``, ``attack``, ``scenario``, ``receiver`` and ``timeline``.
    """
    made = setup_of_card(card)
    label = detector_entry(made.detector).label
    found = [] if label == detector.label else ["detector"]
    if spec_of("attack", ATTACKS, made.attack) != spec_of("attack", ATTACKS, setup.attack):
        found.append("attack")
    return label, found + [
        name
        for name in ("scenario", "receiver", "timeline")
        if describe(getattr(made, name)) != describe(getattr(setup, name))
    ]
