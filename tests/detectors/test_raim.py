"""RAIM, and searches of consistent satellites: against plain ones, and whom each of them tells."""

from functools import cache
from itertools import combinations

import numpy as np
import pytest

from spoofgym.attacks import PerChannel
from spoofgym.detectors import DetectorContext, Raim, SrvRaim, TraversalRaim
from spoofgym.detectors.consistency import fit_thresholds, search_data
from spoofgym.detectors.raim import SEARCH_VECTORS, search_all, search_all_paths, search_vectors
from spoofgym.earth.wgs84 import STILL, dcm_e_from_n, geodetic_to_ecef, range_and_rate
from spoofgym.receiver.snapshot import tabulate
from spoofgym.simulation import Engine, TightlyCoupledSetup

from .support import epoch

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


def geometry(u):
    return np.column_stack([-u, np.ones(len(u))])


def case(seed, n=12, spoofed=3, clean=False):
    rng = np.random.default_rng(seed)
    up, azimuth = rng.uniform(0.17, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    level = np.sqrt(1.0 - up**2)
    u = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), up])
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
    u, y, _ = case(spoofed, spoofed=spoofed)
    assert searched(search_all, u, y) == plain_srv(u, y)


@pytest.mark.parametrize(("n", "spoofed"), [(12, 0), (12, 2), (12, 5), (9, 3), (6, 1), (10, 5)])
def test_traversal_is_the_plain_one(n, spoofed):
    u, y, _ = case(n + spoofed, n=n, spoofed=spoofed)
    assert searched(search_all_paths, u, y) == plain_traversal(u, y)


def test_thresholds_search_vectors_and_axes_are_as_printed_and_residuals_those_of_a_fit():
    table = [7.840, 6.923, 6.456, 6.160, 5.952, 5.795, 5.670, 5.569]
    np.testing.assert_allclose(np.sqrt(LIMIT[5:] / np.arange(1, 9)), table, atol=6e-4)
    assert (LIMIT[:5] == 0.0).all()
    vectors = search_vectors()
    lattice = {tuple(v) for v in (*vectors, *-vectors)}
    assert len(lattice) == 80 == 3**4 - 1
    weight = np.abs(vectors).sum(axis=1)
    assert [set(part) for part in np.split(weight, [12, 24])] == [{1.0, 4.0}, {2.0}, {3.0}]
    # some columns of B and C as printed
    printed = [[0, 1, 0, 1], [1, -1, 1, 0], [1, 0, 1, -1]]
    np.testing.assert_array_equal(vectors[[20, 25, 34]], printed)
    u, y, _ = case(10, clean=True)
    table = np.empty((13, search_data(1, 12).table.shape[2]))
    s2 = tabulate(12, -u, y.copy(), table)
    assert s2 == pytest.approx(squared(geometry(u), y, range(12)), rel=1e-9)
    axes = SrvRaim(frame="ned")._axes(np.array([[6_378_137.0, 0.0, 0.0]]))
    np.testing.assert_allclose(axes[0] @ [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("search", [search_all, search_all_paths])
@pytest.mark.parametrize("wild", [1e5, 1e12])
def test_one_wild_pseudorange_is_told(search, wild):
    u, y, _ = case(5, spoofed=0)
    y[4] += wild
    found, group, _ = searched(search, u, 0.2 * (y - 1e5))
    assert found
    assert group == set(range(12)) - {4}


# --- detectors, in a sky of twelve satellites -----------------------------------------------------

SATELLITES = 12
HERE = geodetic_to_ecef(0.7, 2.0, 100.0)
ELEVATION = np.radians([75, 60, 55, 48, 40, 38, 33, 28, 22, 18, 14, 11])
AZIMUTH = np.radians([20, 250, 130, 60, 310, 190, 95, 225, 345, 160, 275, 35])
NORTH, EAST = np.cos(ELEVATION) * [np.cos(AZIMUTH), np.sin(AZIMUTH)]
LINE_OF_SIGHT = np.column_stack([NORTH, EAST, -np.sin(ELEVATION)]) @ dcm_e_from_n(0.7, 2.0).T
"""(12, 3) in ECEF axes; satellites are 22 000 km away along them, but for the Earth's turn."""
SATELLITE_POSITION = HERE + 2.2e7 * LINE_OF_SIGHT


@cache
def ranges():
    return np.array([range_and_rate(s, STILL, HERE, STILL)[0] for s in SATELLITE_POSITION])


def sky_context(receivers):
    ids = tuple(f"G{j:02d}" for j in range(SATELLITES))
    variance = np.repeat([SIGMA**2, 0.01], SATELLITES)
    return DetectorContext(receivers, SATELLITES, 1.0, variance, ids)


def sky_epoch(offset, visible=None):
    """Epoch of pseudoranges that are off by (B, 12) metres, with a clock of a millisecond."""
    b = len(offset)
    blank = epoch(np.zeros((b, 2 * SATELLITES)), np.eye(2 * SATELLITES), visible)
    return blank._replace(
        pseudorange=np.where(blank.visible, ranges() + 3e5 + offset, 0.0),
        satellite_position=np.tile(SATELLITE_POSITION, (b, 1, 1)),
        predicted_position=np.tile(HERE, (b, 1)),
    )


def spoofed(slots):
    """(1, 12) offsets of satellites that tell of a position, and clock, far from the truth [m]."""
    offset = -LINE_OF_SIGHT @ [400.0, -250.0, 300.0] + 150.0
    return np.where(np.isin(SLOTS, slots), offset, 0.0)[None]


KINDS = pytest.mark.parametrize("kind", [Raim, SrvRaim, TraversalRaim])
SLOTS = np.arange(SATELLITES)


def judged(detector, offset, visible=None, **changes):
    detector.bind(sky_context(len(offset))._replace(**changes))
    return detector.judge(sky_epoch(offset, visible)), detector.memory["group"]


def noise(seed, receivers):
    return SIGMA * np.random.default_rng(seed).standard_normal((receivers, SATELLITES))


def threshold(sd):
    return np.sqrt(fit_thresholds(sd, 1e-5, 12)[12] / 8)


@KINDS
def test_the_statistic_is_that_of_all_in_view(kind):
    offset = noise(0, 4)
    verdict, _ = judged(kind(), offset)
    G = np.column_stack([-LINE_OF_SIGHT, np.ones(SATELLITES)])
    residual = offset.T - G @ np.linalg.lstsq(G, offset.T, rcond=None)[0]
    expected = np.sqrt((residual**2).sum(axis=0) / 8)
    np.testing.assert_allclose(verdict.statistic[:, 0], expected, rtol=1e-4)
    np.testing.assert_allclose(verdict.threshold, threshold(SIGMA))
    # the noise is the receiver's own: the largest, so that no satellite is taken for better than it
    # is, and that of one epoch, not what a filter makes of errors that stay
    mixed = sky_context(4).noise_variance
    mixed[3] = 99.0
    verdict, _ = judged(kind(), offset, noise_variance=mixed)
    np.testing.assert_allclose(verdict.threshold, threshold(np.sqrt(99.0)))
    verdict, _ = judged(kind(), offset, single_epoch_sd=np.full(24, 1.5))
    np.testing.assert_allclose(verdict.threshold, threshold(1.5))


@KINDS
def test_one_wrong_satellite_is_told_and_excluded(kind):
    offset = 0.1 * noise(2, 3)
    offset[:, 7] += [300.0, -3e3, 1e7]
    verdict, group = judged(kind(exclude=True), offset)
    assert verdict.alarm.all()
    np.testing.assert_array_equal(group, np.tile(1 + (SLOTS == 7), (3, 1)))
    np.testing.assert_array_equal(verdict.weights, np.tile(SLOTS != 7, (3, 2)))


@pytest.mark.parametrize("kind", [SrvRaim, TraversalRaim])
@pytest.mark.parametrize("slots", [[3, 9], [0, 2, 4, 6, 8], [0, 1, 3, 5, 7, 8, 9, 10]])
def test_satellites_that_agree_with_each_other_make_a_group(kind, slots):
    verdict, (group,) = judged(kind(sigma_m=SIGMA), spoofed(slots) + 0.2 * noise(3, 1))
    assert verdict.alarm.all()
    assert verdict.weights is None
    taken = np.isin(SLOTS, slots)
    assert len(set(group[taken])) == len(set(group[~taken])) == 1
    assert set(group) == {1, 2}


@pytest.mark.parametrize(
    ("detector", "slots"),
    [
        (Raim(exclude=True), [0, 2, 4, 6, 8]),  # the classical test blames none of several
        (TraversalRaim(exclude=True, largest_group=2), [1, 4, 8]),
    ],
)
def test_who_notices_more_than_it_can_tell_blames_none(detector, slots):
    verdict, group = judged(detector, spoofed(slots) + 0.2 * noise(3, 1))
    assert verdict.alarm.all()
    assert not group.any()
    assert (verdict.weights == 1.0).all()


@KINDS
def test_what_all_have_in_common_is_consistent_and_one_direction_gives_no_verdict(kind):
    verdict, group = judged(kind(exclude=True), spoofed(SLOTS) + 0.2 * noise(4, 1))
    assert not verdict.alarm.any()
    assert (group == 1).all()
    assert (verdict.weights == 1.0).all()
    detector = kind()
    detector.bind(sky_context(1))
    seen = sky_epoch(noise(6, 1))
    same = np.tile(seen.satellite_position[:, :1], (1, SATELLITES, 1))
    verdict = detector.judge(seen._replace(satellite_position=same))
    assert verdict.statistic[0, 0] == 0.0
    assert not verdict.alarm.any()


@KINDS
@pytest.mark.parametrize("count", [0, 4, 5])
def test_fewer_than_five_satellites_give_no_verdict_and_five_cannot_be_told_apart(kind, count):
    offset = noise(5, 2)
    offset[:, 0] += 1e4
    verdict, group = judged(kind(exclude=True), offset, np.tile(count > SLOTS, (2, 1)))
    assert verdict.alarm.all() == (count == 5)
    assert (verdict.statistic > 0.0).all() == (count == 5)
    assert np.isfinite(verdict.threshold).all()
    if count < 5:
        assert (verdict.weights == 1.0).all()
    else:  # any four agree, so that nothing can be left out of five
        assert not group.any()


@KINDS
@pytest.mark.parametrize("wild", [np.nan, -np.inf])
def test_a_pseudorange_that_is_no_number_is_left_out(kind, wild):
    offset, visible = noise(7, 1), SLOTS[None] != 5
    verdict, group = judged(kind(exclude=True), np.where(visible, offset, wild))
    without, _ = judged(kind(), np.where(visible, offset, 0.0), visible)
    assert (verdict.statistic, verdict.threshold) == (without.statistic, without.threshold)
    assert group[0, 5] == 0
    np.testing.assert_array_equal(verdict.weights, np.tile(visible, 2))


def test_more_channels_than_a_mask_has_bits_are_refused():
    many = sky_context(1)._replace(channels=64, noise_variance=np.full(128, 16.0))
    with pytest.raises(ValueError, match=r"at most 63 channels .* got 64"):
        SrvRaim().bind(many)


def test_in_the_loop_of_the_tightly_coupled_receiver():
    phases = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 0.0}
    errors = {}
    for exclude in (False, True):
        attack = PerChannel(control="rate", rate_limit_mps=250.0, channels=("S10",), coherent=False)
        setup = TightlyCoupledSetup(
            detector=SrvRaim(exclude=exclude), attack=attack, timeline=phases
        )
        engine = Engine(2, setup, threads=1)
        engine.reset([np.random.default_rng(i) for i in range(2)])
        assert not engine.warmup_alarm.any()
        slot = engine.setup.world.satellite_ids.index("S10")
        for k in range(20):
            verdict = engine.step(np.full((2, 1), 0.5 * (k == 0)))
            assert verdict.alarm.all()
            group = engine.simulator.detector.memory["group"]
            seen = engine.simulator.epoch.visible
            assert (group[:, slot] == 2).all()
            np.testing.assert_array_equal(group > 0, seen)
        errors[exclude] = np.linalg.norm(engine.simulator.error_n(), axis=1).max()
    assert errors[True] < 10.0 < errors[False]
