"""Spoofers that come with the package: learned ones, and optimised profiles.

For every one there is a card, NAME.json; a learned one also has its policy, NAME.onnx.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...core.registry import check_choice
from ..card import Card

ZOO_FOLDER = Path(__file__).parent


def shipped() -> tuple[str, ...]:
    """Names of the shipped spoofers.

    Returns
    -------
    tuple of str
        Sorted.
    """
    return tuple(sorted(path.stem for path in ZOO_FOLDER.glob("*.json")))


def card_of(name: str) -> Card:
    """Card of a shipped spoofer; a ValueError lists the valid names.

    Parameters
    ----------
    name : str
        Its name.

    Returns
    -------
    Card
        As it was written.
    """
    check_choice("shipped spoofer", name, shipped())
    return Card.load(ZOO_FOLDER / f"{name}.json")


def spec_of_shipped(name: str) -> dict[str, Any]:
    """Registered name and settings of a shipped spoofer."""
    card = card_of(name)
    if card.file is None:
        return {"name": card.kind, **card.settings, "label": name}
    return {"name": card.kind, "file": name, "sha256": card.file.sha256}
