"""What the spoofers of a campaign know, which every table says."""

from __future__ import annotations

from typing import Any

from ..simulators.setup import Setup
from .entries import Entry, build_spoofer
from .shipped import card_behind, transferred


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
