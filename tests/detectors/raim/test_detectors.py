"""The three detectors of consistency: what they have in common, and whom each of them tells."""

import numpy as np
import pytest

from spoofgym.attacks import PerChannel
from spoofgym.detectors import Raim, SrvRaim, TraversalRaim
from spoofgym.detectors.consistency import fit_thresholds
from spoofgym.simulation import Engine, TightlyCoupledSetup

from ..skies import LINE_OF_SIGHT, NOISE, SATELLITES, context, sky_epoch, spoofed_offset

KINDS = pytest.mark.parametrize("kind", [Raim, SrvRaim, TraversalRaim])
SLOTS = np.arange(SATELLITES)
FAR = np.array([400.0, -250.0, 300.0, 150.0])
"""Displacement that changes all ranges by much more than the noise."""


def judged(detector, offset, visible=None, **changes):
    """Verdict on one epoch, and the groups of its satellites."""
    detector.bind(context(len(offset))._replace(**changes))
    return detector.judge(sky_epoch(offset, visible)), detector.memory["group"]


def noise(seed, receivers):
    return NOISE * np.random.default_rng(seed).standard_normal((receivers, SATELLITES))


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
    np.testing.assert_allclose(verdict.threshold, threshold(NOISE))
    # the noise is the receiver's own: the largest, so that no satellite is taken for better than it
    # is, and that of one epoch, not what a filter makes of errors that stay
    mixed = context(4).noise_variance
    mixed[3] = 99.0
    verdict, _ = judged(kind(), offset, noise_variance=mixed)
    np.testing.assert_allclose(verdict.threshold, threshold(np.sqrt(99.0)))
    verdict, _ = judged(kind(), offset, single_epoch_sd=np.full(24, 1.5))
    np.testing.assert_allclose(verdict.threshold, threshold(1.5))


@KINDS
def test_false_alarms_come_as_promised(kind):
    runs, promised = 10_000, 0.05
    verdict, _ = judged(kind(false_alarm=promised), noise(1, runs))
    expected = runs * promised
    assert abs(verdict.alarm.sum() - expected) < 4.0 * np.sqrt(expected * (1 - promised))


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
    verdict, (group,) = judged(kind(sigma_m=NOISE), spoofed_offset(slots, FAR) + 0.2 * noise(3, 1))
    assert verdict.alarm.all()
    assert verdict.weights is None
    spoofed = np.isin(SLOTS, slots)
    assert len(set(group[spoofed])) == len(set(group[~spoofed])) == 1
    assert set(group) == {1, 2}


@pytest.mark.parametrize(
    ("detector", "slots"),
    [
        (Raim(exclude=True), [0, 2, 4, 6, 8]),  # the classical test blames none of several
        (TraversalRaim(exclude=True, largest_group=2), [1, 4, 8]),
    ],
)
def test_who_notices_more_than_it_can_tell_blames_none(detector, slots):
    verdict, group = judged(detector, spoofed_offset(slots, FAR) + 0.2 * noise(3, 1))
    assert verdict.alarm.all()
    assert not group.any()
    assert (verdict.weights == 1.0).all()


@KINDS
def test_what_all_have_in_common_is_consistent(kind):
    verdict, group = judged(kind(exclude=True), spoofed_offset(SLOTS, FAR) + 0.2 * noise(4, 1))
    assert not verdict.alarm.any()
    assert (group == 1).all()
    assert (verdict.weights == 1.0).all()


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
def test_satellites_in_one_direction_give_no_verdict(kind):
    detector = kind()
    detector.bind(context(1))
    epoch = sky_epoch(noise(6, 1))
    same = np.tile(epoch.satellite_position[:, :1], (1, SATELLITES, 1))
    verdict = detector.judge(epoch._replace(satellite_position=same))
    assert verdict.statistic[0, 0] == 0.0
    assert not verdict.alarm.any()


@KINDS
@pytest.mark.parametrize("wild", [np.nan, -np.inf])
def test_a_pseudorange_that_is_no_number_is_left_out(kind, wild):
    offset, visible = noise(7, 1), SLOTS[None] != 5
    verdict, group = judged(kind(exclude=True), np.where(visible, offset, wild))
    without, _ = judged(kind(), np.where(visible, offset, 0.0), visible)
    assert verdict.statistic == without.statistic
    assert verdict.threshold == without.threshold
    assert group[0, 5] == 0
    np.testing.assert_array_equal(verdict.weights, np.tile(visible, 2))


def test_more_channels_than_a_mask_has_bits_are_refused():
    many = context(1)._replace(channels=64, noise_variance=np.full(128, 16.0))
    with pytest.raises(ValueError, match=r"at most 63 channels .* got 64"):
        SrvRaim().bind(many)


def test_frames_are_two_ways_to_search_the_same():
    """Statistics agree; partitions are those of the same search in other axes."""
    offset = spoofed_offset([0, 2, 4, 6, 8], FAR, 50) + noise(10, 50)
    one, mine = judged(SrvRaim(frame="ned"), offset)
    other, theirs = judged(SrvRaim(frame="ecef"), offset)
    np.testing.assert_allclose(one.statistic, other.statistic, rtol=1e-9)
    for group in (mine, theirs):
        sizes = np.sort([(group == 1).sum(axis=1), (group == 2).sum(axis=1)], axis=0)
        assert np.mean((sizes == [[5], [7]]).all(axis=0)) > 0.7
    assert (mine != theirs).any()


@KINDS
def test_in_the_loop_of_the_tightly_coupled_receiver(kind):
    """A step of one pseudorange is told and left out; the clean receiver raises no alarm."""
    phases = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 0.0}
    errors = {}
    for exclude in (False, True):
        attack = PerChannel(control="rate", rate_limit_mps=250.0, channels=("S10",), coherent=False)
        setup = TightlyCoupledSetup(detector=kind(exclude=exclude), attack=attack, timeline=phases)
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
