"""Policies and profiles that come with the package, of both sides.

For each there is a card, NAME.json; a learned one also has its network, NAME.onnx.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TypeVar, overload

from ...core.reading import read_json
from ...core.registry import check_choice
from ..card import SIDES, Card

ZOO_FOLDER = Path(__file__).parent


def list_shipped(side: str | None = None) -> tuple[str, ...]:
    """Names of the shipped policies and profiles.

    Parameters
    ----------
    side : {"spoofer", "detector"}, optional
        Which ones; all by default.

    Returns
    -------
    tuple of str
        Sorted.
    """
    sides = _sides(ZOO_FOLDER, ZOO_FOLDER.stat().st_mtime_ns)
    return tuple(name for name, of in sides.items() if side in (None, of))


CardT = TypeVar("CardT", bound=Card)


@overload
def load_card(name: str) -> Card:  # noqa: D418
    """Card of either side."""


@overload
def load_card(name: str, kind: type[CardT]) -> CardT:  # noqa: D418
    """Card of one side."""


def load_card(name: str, kind: type[Card] = Card) -> Card:
    """Card of a shipped policy or profile; a ValueError lists the valid names.

    Parameters
    ----------
    name : str
        Its name.
    kind : type, optional
        `SpooferCard` or `DetectorCard`, where it has to be one of this side.

    Returns
    -------
    SpooferCard or DetectorCard
        As it was written.
    """
    side = kind.own_side
    check_choice(f"shipped {side or 'spoofer or detector'}", name, list_shipped(side))
    return kind.load(ZOO_FOLDER / f"{name}.json")


def resolve_path(file: str, side: str | None = None) -> Path:
    """Path of the network of a shipped policy, by its name; of anything else as it is."""
    return ZOO_FOLDER / f"{file}.onnx" if file in list_shipped(side) else Path(file)


@lru_cache(maxsize=4)  # called whenever a spoofer or a detector is made by its name
def _sides(folder: Path, changed: int) -> dict[str, str]:
    """Sides by name, sorted; `changed`: when a file of the folder came or went."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        fields = read_json(path)
        found[path.stem] = fields.get("side") or SIDES[fields["kind"]]
    return found
