"""SRV-RAIM and traversal RAIM on noisy cases: tables 5 to 8, and the time of a call."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofgym.core.compile import njit
from spoofgym.detectors import raim
from spoofgym.detectors.consistency import SearchData, fit_thresholds, search_data
from spoofgym.receiver.snapshot import tabulate

from .draws import displacements, offsets, subsets
from .geometry import SATELLITES, sky

FloatArray = NDArray[np.float64]

NOISE_M = 4.0
CONFIDENCE = 0.95
METHODS = ("srv", "traversal")
LIMIT = fit_thresholds(NOISE_M, 1.0 - CONFIDENCE, SATELLITES)


@njit
def tabulate_cases(lines: FloatArray, offsets: FloatArray, data: SearchData) -> None:
    """Prepare the search of many sets of pseudoranges, `offsets` (C, n) y [m], of one geometry that
    isn't singular, `lines` (n, 3) g."""
    for c in range(offsets.shape[0]):
        data.lines[c], data.offsets[c] = lines, offsets[c]
        tabulate(offsets.shape[1], lines, data.offsets[c], data.table[c])


def _srv(data: SearchData) -> None:
    raim.search_all(data, LIMIT, raim.SEARCH_VECTORS)


def _traversal(data: SearchData) -> None:
    raim.search_all_paths(data, LIMIT, raim.LARGEST_GROUP)


SEARCHES: dict[str, Callable[[SearchData], None]] = {"srv": _srv, "traversal": _traversal}


def score(
    method: str, lines: FloatArray, y: FloatArray, spoofed: NDArray[np.bool_]
) -> tuple[float, float, float, float, float]:
    """Rates of one method. `method`: ``srv``, ``traversal``: which search; `lines`: (n, 3) rows of
    the geometry without the clock's column; `y`: (C, n) pseudoranges minus predicted ranges [m];
    `spoofed`: (C, n) bool. Returns `success`, `false`, `fail` both groups right in either order; a
    partition, but another one; no partition; `time_us` mean time of a call, of the processor
    [us]."""
    cases, n = y.shape
    data = search_data(cases, n)
    begin = time.thread_time()
    tabulate_cases(lines, y, data)
    SEARCHES[method](data)
    taken = time.thread_time() - begin
    found, mask, fits = data.solved, data.mask, data.positionings
    right = spoofed @ (1 << np.arange(n))
    success = found & ((mask == right) | (mask == (1 << n) - 1 - right))
    return (
        float(success.mean()),
        float((found & ~success).mean()),
        float((~found).mean()),
        float(fits[found].mean()),
        taken / cases * 1e6,
    )


def run_partitions(number: int, draws: int, seed: int) -> dict[str, Any]:
    """Tables 5 to 8 in one sky.  `draws`: least number of cases for each number of spoofed
    satellites.  Returns (11, 5) success, false, fail, positionings and time [us] by method, number
    of cases."""
    lines, rng = sky(number), np.random.default_rng([seed, number, 5])
    result: dict[str, Any] = {}
    scores: dict[str, list[tuple[float, ...]]] = {method: [] for method in METHODS}
    cases = 0
    for method in METHODS:
        score(method, lines, np.zeros((1, SATELLITES)), np.ones((1, SATELLITES), dtype=np.bool_))
    for count in range(1, SATELLITES):
        spoofed = subsets(SATELLITES, count, draws)
        y = offsets(lines, spoofed, displacements(rng, lines, spoofed))
        y += NOISE_M * rng.standard_normal(y.shape)
        cases += len(y)
        for method in METHODS:
            scores[method].append(score(method, lines, y, spoofed))
    result = {method: np.array(scores[method]) for method in METHODS}
    return {**result, "cases": cases}
