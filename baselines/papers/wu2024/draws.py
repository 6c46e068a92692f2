"""Cases of table 1: which satellites are spoofed, and where to."""

from __future__ import annotations

from itertools import combinations
from math import ceil, comb

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LENGTH_M = (100.0, 4000.0)
LEAST_M = 100.0
"""How far the range of a spoofed satellite is changed at least."""


def subsets(satellites: int, spoofed: int, draws: int) -> NDArray[np.bool_]:
    """All subsets of one size, each as often as it takes. Returns (C, n) bool, C at least
    `draws`."""
    chosen = np.array(list(combinations(range(satellites), spoofed)))
    masks = np.zeros((len(chosen), satellites), dtype=np.bool_)
    np.put_along_axis(masks, chosen, True, axis=1)
    return np.tile(masks, (ceil(draws / comb(satellites, spoofed)), 1))


def displacements(
    rng: np.random.Generator, lines: FloatArray, spoofed: NDArray[np.bool_]
) -> FloatArray:
    """Counterfeit minus true position and clock of every case.  The direction is uniform in four
    dimensions, clock included, the length uniform; both are drawn again until every spoofed
    satellite's range is changed by more than 100 m.  What it would change of the authentic ones
    does not matter. `lines`: (n, 3) rows of the geometry without the clock's column; `spoofed`: (C,
    n) bool. Returns (C, 4) [m]."""
    G = np.column_stack([lines, np.ones(len(lines))])
    out = np.empty((len(spoofed), 4))
    left = np.arange(len(spoofed))
    while left.size:
        direction = rng.standard_normal((left.size, 4))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        drawn = direction * rng.uniform(*LENGTH_M, left.size)[:, None]
        far = (np.abs(drawn @ G.T) > LEAST_M) | ~spoofed[left]
        accepted = far.all(axis=1)
        out[left[accepted]] = drawn[accepted]
        left = left[~accepted]
    return out


def offsets(lines: FloatArray, spoofed: NDArray[np.bool_], displacement: FloatArray) -> FloatArray:
    """Noise-free changes of the pseudoranges.  `lines`: (n, 3) rows of the geometry without the
    clock's column; `spoofed`: (C, n) bool; `displacement`: (C, 4) [m].  Returns (C, n) [m], 0 for
    authentic satellites."""
    changed = displacement[:, :3] @ lines.T + displacement[:, 3:]
    return np.where(spoofed, changed, 0.0)
