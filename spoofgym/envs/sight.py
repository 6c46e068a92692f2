"""What a picture shows of one receiver; all truth, and nothing that an agent gets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Sky(NamedTuple):
    """The satellites over one receiver.

    Attributes
    ----------
    names : tuple of str
        (n,) id of each slot; ``""`` for an empty one.
    azimuth, elevation : ndarray
        (n,) [rad].
    visible : ndarray
        (n,) bool.
    spoofed : ndarray
        (n,) bool, whether the spoofer changes what the satellite tells.
    weight : ndarray
        (n,) weight of the pseudorange in the receiver, 0 where the detector excludes it.
    """

    names: tuple[str, ...]
    azimuth: FloatArray
    elevation: FloatArray
    visible: NDArray[np.bool_]
    spoofed: NDArray[np.bool_]
    weight: FloatArray


class Sight(NamedTuple):
    """One receiver at one instant.

    Attributes
    ----------
    position_ne : ndarray
        (2,) true position from that at the onset, north, east [m].
    error_ne : ndarray
        (2,) estimate minus truth [m].
    displacement_ne : ndarray or None
        (2,) commanded displacement [m]; None where the spoofer commands no position.
    ratio : float
        Largest statistic over its threshold; nan before the detector has judged.
    sky : Sky or None
        None where the receiver is told positions.
    """

    position_ne: FloatArray
    error_ne: FloatArray
    displacement_ne: FloatArray | None
    ratio: float
    sky: Sky | None


class Stage(NamedTuple):
    """What stays the same in a picture for a whole episode.

    Attributes
    ----------
    title : str
        Who plays against whom.
    route_ne : ndarray
        (K, 2) true way from the onset to the end of the time to alert, north, east [m].
    interval_s : float
        Time between epochs.
    steps : int
        Commands of an episode.
    attack_s, hold_s : float
        Length of the command phase and of the time to alert.
    onset_s : float
        Time of the onset since the begin of the run.
    commands_position : bool
        Whether sights have a `displacement_ne`.
    has_sky : bool
        Whether sights have a `sky`.
    """

    title: str
    route_ne: FloatArray
    interval_s: float
    steps: int
    attack_s: float
    hold_s: float
    onset_s: float
    commands_position: bool
    has_sky: bool
