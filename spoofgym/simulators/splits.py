"""Seeds of runs by what they are for: runs of different splits share no noise."""

from __future__ import annotations

import zlib
from collections.abc import Iterable

import numpy as np

SPLITS = {
    "training": 0,
    "calibration": 1,
    "evaluation": 2,
    "holdout": 4,
    "selection": 5,
    "search": 6,
    "game": 7,
    "dataset-train": 8,
    "dataset-validation": 9,
    "dataset-test": 10,
}
"""First element of the spawn keys; 3 was once another split's."""


def seed_sequences(
    entropy: int, split: str, scenario: str, runs: int, first: int = 0
) -> list[np.random.SeedSequence]:
    """Seeds of the runs of a split; the first ones are the same for any number of runs. `entropy`:
    of the campaign, at least 0; `first`: run to start with."""
    return seeds_of_runs(entropy, split, scenario, range(first, runs))


def seeds_of_runs(
    entropy: int, split: str, scenario: str, runs: Iterable[int]
) -> list[np.random.SeedSequence]:
    key = zlib.crc32(scenario.encode())
    return [np.random.SeedSequence(entropy, spawn_key=(SPLITS[split], key, run)) for run in runs]


def generators_of(seeds: Iterable[np.random.SeedSequence]) -> list[np.random.Generator]:
    return [np.random.Generator(np.random.PCG64(seed)) for seed in seeds]
