"""What action and end terms may ask of a plant, as they ask a `Setup` and a `Snapshot`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from .actions import AcrossTarget, ActionTerm, AlongTarget
from .ends import EndTerm
from .plant import Plant


class PlantCommands(NamedTuple):
    """Commands of a plant, in the place of an attack.

    Attributes
    ----------
    kind : str
        Of the plant.
    names : tuple of str
        (a,) name of every element.
    """

    kind: str
    names: tuple[str, ...]

    @property
    def control(self) -> str:
        """What an element commands, such as ``rate``."""
        return self.names[0].rsplit("_", 1)[-1]

    def action_names(self, world: object) -> tuple[str, ...]:
        """Name of every element: (a,) names."""
        return self.names


class PlantSetup(NamedTuple):
    """What never changes, in the place of a `Setup`.

    Attributes
    ----------
    attack : PlantCommands
        What is commanded.
    steps : int
        Commands of an episode.
    target_heading_deg : float
        Direction in which displacement counts, clockwise from north.
    world : None
        A plant keeps it to itself.
    repeat : int
        Epochs of a decision.
    """

    attack: PlantCommands
    steps: int
    target_heading_deg: float
    world: None = None
    repeat: int = 1


class PlantSnapshot(NamedTuple):
    """A game over a plant after a step, in the place of a `Snapshot`.

    Attributes
    ----------
    setup : PlantSetup
        What never changes.
    plant : Plant
        The receivers.
    step : ndarray
        (B,) int64 epochs since the attack began.
    """

    setup: PlantSetup
    plant: Plant
    step: NDArray[np.int64]

    @property
    def batch(self) -> NoReturn:
        """There is none: only the tightly coupled receiver has an engine."""
        raise TypeError(
            f"this term looks at the batch of an engine, which the plant {self.plant.kind!r} does "
            "not have; it has `standing.snapshot.plant`"
        )


def setup_of(plant: Plant, target_heading_deg: float) -> PlantSetup:
    """What terms may ask of a plant."""
    return PlantSetup(
        PlantCommands(plant.kind, tuple(plant.action_names)), plant.steps, target_heading_deg
    )


def check_ends(terms: Sequence[EndTerm], plant: Plant) -> None:
    """Raise where an end looks at what only an engine has."""
    for term in terms:
        for kind in getattr(term, "needs", ()):
            raise ValueError(
                f"the end term {term.name!r} needs the {kind.__name__} of a tightly coupled "
                f"filter, which the plant {plant.kind!r} does not have"
            )


def check_aims(terms: Sequence[ActionTerm], plant: Plant) -> None:
    """Raise where an element would not point along the target direction."""
    aimed = [term for term in terms if isinstance(term, AlongTarget | AcrossTarget)]
    stems = [name.rsplit("_", 1)[0] for name in plant.action_names]
    if not aimed or not {"north", "east"} <= set(stems):
        return
    limits = plant.action_limits()
    north, east = (float(limits[stems.index(axis)]) for axis in ("north", "east"))
    if north != east:
        raise ValueError(
            f"{type(aimed[0]).__name__} needs the same limit north and east, got {north:g} and "
            f"{east:g}"
        )
