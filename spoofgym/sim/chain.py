"""Several worlds one after the other, so that a single index gives the world and the time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .world import World


def chain_worlds(worlds: Sequence[World]) -> World:
    """World in which the epochs of some worlds follow one another. World w of K epochs each has the
    epochs ``w K`` to ``(w + 1) K - 1``. Times start again with each; nothing may cross from one to
    the next."""
    first = worlds[0]
    if len(worlds) == 1:
        return first
    for world in worlds:
        if world.channels != first.channels or not (
            np.array_equal(world.epoch_time, first.epoch_time)
            and np.array_equal(world.imu_time, first.imu_time)
        ):
            raise ValueError("worlds in a chain must have the same times and the same slots")
    same = all(world.satellite_ids == first.satellite_ids for world in worlds)
    samples = first.run.shape[1]
    ends = [world.epoch_end + w * samples for w, world in enumerate(worlds)]
    ids = first.satellite_ids if same else tuple(f"slot{s:02d}" for s in range(first.channels))

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(world, name) for world in worlds])

    return replace(
        first,
        satellite_ids=ids,
        run=np.ascontiguousarray(np.concatenate([world.run for world in worlds], axis=1)),
        epoch_time=joined("epoch_time"),
        epoch_end=np.concatenate(ends),
        satellites=joined("satellites"),
        visible=joined("visible"),
        elevation=joined("elevation"),
        azimuth=joined("azimuth"),
        position_e=joined("position_e"),
        velocity_e=joined("velocity_e"),
        C_eb=joined("C_eb"),
        C_en=joined("C_en"),
    )
