"""Searches of consistent satellites, against plain ones."""

from itertools import combinations

import numpy as np
import pytest

from spoofgym.detectors import SrvRaim
from spoofgym.detectors.consistency import fit_thresholds, search_data
from spoofgym.detectors.raim import SEARCH_VECTORS, search_all, search_all_paths, search_vectors
from spoofgym.receiver.snapshot import tabulate

SIGMA = 4.0
LIMIT = fit_thresholds(SIGMA, 0.05, 12)


def searched(search, u, y):
    """By lines of sight (n, 3) and offsets (n,): whether a partition is found, the satellites of
    its first group, and how many positionings that took."""
    n = len(y)
    data = search_data(1, n)
    data.slots[0], data.lines[0], data.offsets[0] = np.arange(n), -u, y
    tabulate(n, data.lines[0], data.offsets[0], data.table[0])
    settings = SEARCH_VECTORS if search is search_all else 6
    search(data, fit_thresholds(SIGMA, 0.05, n), settings)
    group = np.flatnonzero((data.mask[0] >> np.arange(n)) & 1)
    found = bool(data.solved[0])
    return found, set(group) if found else set(), int(data.positionings[0])


def sky(rng, n):
    up, azimuth = rng.uniform(0.17, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    level = np.sqrt(1.0 - up**2)
    return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), up])


def geometry(u):
    return np.column_stack([-u, np.ones(len(u))])


def case(seed, n=12, spoofed=3, clean=False):
    """Lines of sight, offsets and who is spoofed."""
    rng = np.random.default_rng(seed)
    u = sky(rng, n)
    slots = rng.permutation(n)[:spoofed]
    y = (0.0 if clean else SIGMA) * rng.standard_normal(n) + 1e5
    y[slots] += geometry(u)[slots] @ (400.0 * rng.standard_normal(4))
    return u, y, np.isin(np.arange(n), slots)


def squared(G, y, rows):
    rows = list(rows)
    return np.sum((y[rows] - G[rows] @ np.linalg.lstsq(G[rows], y[rows], rcond=None)[0]) ** 2)


def plain_traversal(u, y):
    G, n, fits = geometry(u), len(y), 0
    for size in range(min(6, n // 2, n - 5) + 1):
        for left in combinations(range(n), size):
            if 2 * size == n and 0 not in left:
                continue
            kept = [i for i in range(n) if i not in left]
            fits += 1 + (size >= 5)
            if squared(G, y, kept) < LIMIT[len(kept)] and (
                size < 5 or squared(G, y, left) < LIMIT[size]
            ):
                return True, set(kept), fits
    return False, set(), fits


def plain_srv(u, y):
    G = geometry(u)
    residual, fits = y - G @ np.linalg.lstsq(G, y, rcond=None)[0], 1
    for v in search_vectors():
        order = list(np.argsort(-residual * (G @ v), kind="stable"))
        for side in (order[:5], order[-5:]):
            first, grown = list(side), True
            fits += 1
            if not squared(G, y, first) < LIMIT[5]:
                continue
            while grown:
                grown = False
                for j in [j for j in order if j not in first]:
                    fits += 1
                    if squared(G, y, [*first, j]) < LIMIT[len(first) + 1]:
                        first.append(j)
                        grown = True
            second = [j for j in order if j not in first]
            fits += len(second) >= 5
            if len(second) < 5 or squared(G, y, second) < LIMIT[len(second)]:
                return True, set(first), fits
    return False, set(), fits


@pytest.mark.parametrize("spoofed", range(7))
def test_srv_search_is_the_plain_one(spoofed):
    for seed in range(3):
        u, y, _ = case(seed, spoofed=spoofed)
        assert searched(search_all, u, y) == plain_srv(u, y)


@pytest.mark.parametrize(("n", "spoofed"), [(12, 0), (12, 2), (12, 5), (9, 3), (6, 1), (10, 5)])
def test_traversal_is_the_plain_one(n, spoofed):
    u, y, _ = case(n + spoofed, n=n, spoofed=spoofed)
    assert searched(search_all_paths, u, y) == plain_traversal(u, y)


def test_thresholds_are_those_of_the_notes():
    table = [7.840, 6.923, 6.456, 6.160, 5.952, 5.795, 5.670, 5.569]
    np.testing.assert_allclose(np.sqrt(LIMIT[5:] / np.arange(1, 9)), table, atol=6e-4)
    assert (LIMIT[:5] == 0.0).all()


def test_search_vectors_are_half_of_a_lattice_in_three_sets():
    vectors = search_vectors()
    lattice = {tuple(v) for v in (*vectors, *-vectors)}
    assert len(lattice) == 80 == 3**4 - 1
    weight = np.abs(vectors).sum(axis=1)
    assert [set(part) for part in np.split(weight, [12, 24])] == [{1.0, 4.0}, {2.0}, {3.0}]
    # some columns of B and C as printed
    printed = [[0, 1, 0, 1], [1, -1, 1, 0], [1, 0, 1, -1]]
    np.testing.assert_array_equal(vectors[[20, 25, 34]], printed)


@pytest.mark.parametrize("search", [search_all, search_all_paths])
@pytest.mark.parametrize("wild", [1e5, 1e12])
def test_one_wild_pseudorange_is_told(search, wild):
    u, y, _ = case(5, spoofed=0)
    y[4] += wild
    found, group, _ = searched(search, u, 0.2 * (y - 1e5))
    assert found
    assert group == set(range(12)) - {4}


def test_more_than_32_satellites_have_their_bits():
    u, y, spoofed = case(7, n=40, spoofed=10, clean=True)
    found, group, _ = searched(search_all, u, y)
    assert found
    assert group in (set(np.flatnonzero(spoofed)), set(np.flatnonzero(~spoofed)))


def test_the_squared_residual_is_that_of_a_fit():
    u, y, _ = case(10, clean=True)
    table = np.empty((13, search_data(1, 12).table.shape[2]))
    s2 = tabulate(12, -u, y.copy(), table)
    assert s2 == pytest.approx(squared(geometry(u), y, range(12)), rel=1e-9)


def test_axes_of_the_local_frame():
    axes = SrvRaim(frame="ned")._axes(np.array([[6_378_137.0, 0.0, 0.0]]))
    np.testing.assert_allclose(axes[0] @ [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], atol=1e-12)
