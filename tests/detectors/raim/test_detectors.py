"""The three detectors of consistency: what they have in common, and whom each of them tells."""

import numpy as np
import pytest

from spoofgym.attacks import PerChannel
from spoofgym.detectors import Raim, SrvRaim, TraversalRaim
from spoofgym.detectors.consistency import fit_thresholds
from spoofgym.simulation import Engine, TightlyCoupledSetup

from ..skies import LINE_OF_SIGHT, NOISE, SATELLITES, context, sky_epoch, spoofed_offset

KINDS = [Raim, SrvRaim, TraversalRaim]
SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 0.0}
FAR = np.array([400.0, -250.0, 300.0, 150.0])
"""Displacement that changes all ranges by much more than the noise."""


def judged(detector, offset, visible=None):
    detector.bind(context(len(offset)))
    return detector.judge(sky_epoch(offset, visible))


def noise(seed, receivers):
    return NOISE * np.random.default_rng(seed).standard_normal((receivers, SATELLITES))


@pytest.mark.parametrize("kind", KINDS)
def test_the_statistic_is_that_of_all_in_view(kind):
    offset = noise(0, 4)
    verdict = judged(kind(), offset)
    G = np.column_stack([-LINE_OF_SIGHT, np.ones(SATELLITES)])
    for b in range(4):
        residual = offset[b] - G @ np.linalg.lstsq(G, offset[b], rcond=None)[0]
        expected = np.sqrt(residual @ residual / 8)
        assert verdict.statistic[b, 0] == pytest.approx(expected, rel=1e-4)
    np.testing.assert_allclose(verdict.threshold, np.sqrt(fit_thresholds(NOISE, 1e-5, 12)[12] / 8))


@pytest.mark.parametrize("kind", KINDS)
def test_false_alarms_come_as_promised(kind):
    runs, promised = 20_000, 0.05
    verdict = judged(kind(false_alarm=promised), noise(1, runs))
    expected = runs * promised
    assert abs(verdict.alarm.sum() - expected) < 4.0 * np.sqrt(expected * (1 - promised))


@pytest.mark.parametrize("kind", KINDS)
def test_one_wrong_satellite_is_told_and_excluded(kind):
    offset = 0.1 * noise(2, 3)
    offset[:, 7] += [300.0, -3e3, 1e7]
    detector = kind(exclude=True)
    verdict = judged(detector, offset)
    assert verdict.alarm.all()
    expected = np.ones((3, SATELLITES))
    expected[:, 7] = 2.0
    np.testing.assert_array_equal(detector.memory["group"], expected)
    np.testing.assert_array_equal(verdict.weights, np.tile(expected == 1.0, (1, 2)))


@pytest.mark.parametrize("kind", [SrvRaim, TraversalRaim])
@pytest.mark.parametrize("slots", [[3, 9], [0, 2, 4, 6, 8], [0, 1, 3, 5, 7, 8, 9, 10]])
def test_satellites_that_agree_with_each_other_make_a_group(kind, slots):
    detector = kind(sigma_m=NOISE)
    verdict = judged(detector, spoofed_offset(slots, FAR) + 0.2 * noise(3, 1))
    assert verdict.alarm.all()
    assert verdict.weights is None
    group = detector.memory["group"][0]
    spoofed = np.isin(np.arange(SATELLITES), slots)
    assert len(set(group[spoofed])) == len(set(group[~spoofed])) == 1
    assert set(group) == {1, 2}


def test_the_classical_test_notices_several_but_blames_none():
    detector = Raim(exclude=True)
    verdict = judged(detector, spoofed_offset([0, 2, 4, 6, 8], FAR) + 0.2 * noise(3, 1))
    assert verdict.alarm.all()
    assert not detector.memory["group"].any()
    assert (verdict.weights == 1.0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_what_all_have_in_common_is_consistent_and_five_cannot_be_told_apart(kind):
    detector = kind(exclude=True)
    verdict = judged(detector, spoofed_offset(range(SATELLITES), FAR) + 0.2 * noise(4, 1))
    assert not verdict.alarm.any()
    assert (detector.memory["group"] == 1).all()
    assert (verdict.weights == 1.0).all()
    # any four agree, so that nothing can be left out of five
    offset = np.zeros((1, SATELLITES))
    offset[0, 0] = 1e4
    assert judged(kind(), offset, np.arange(SATELLITES)[None] < 5).alarm.all()
    detector = kind()
    judged(detector, offset, np.arange(SATELLITES)[None] < 5)
    assert not detector.memory["group"].any()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [0, 4, 5])
def test_fewer_than_five_satellites_give_no_verdict(kind, count):
    visible = np.tile(np.arange(SATELLITES) < count, (2, 1))
    offset = noise(5, 2)
    offset[:, 0] += 1e4
    verdict = judged(kind(exclude=True), offset, visible)
    assert verdict.alarm.all() == (count == 5)
    assert (verdict.statistic > 0.0).all() == (count == 5)
    assert np.isfinite(verdict.threshold).all()
    if count < 5:
        assert (verdict.weights == 1.0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_satellites_in_one_direction_give_no_verdict(kind):
    detector = kind()
    detector.bind(context(1))
    epoch = sky_epoch(noise(6, 1))
    same = np.tile(epoch.satellite_position[:, :1], (1, SATELLITES, 1))
    verdict = detector.judge(epoch._replace(satellite_position=same))
    assert verdict.statistic[0, 0] == 0.0
    assert not verdict.alarm.any()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("wild", [np.nan, -np.inf])
def test_a_pseudorange_that_is_no_number_is_left_out(kind, wild):
    offset = noise(7, 1)
    offset[0, 5] = wild
    detector = kind(exclude=True)
    verdict = judged(detector, offset)
    visible = np.arange(SATELLITES) != 5
    without = judged(kind(), np.where(visible, offset, 0.0), visible[None])
    assert verdict.statistic == without.statistic
    assert verdict.threshold == without.threshold
    assert detector.memory["group"][0, 5] == 0
    np.testing.assert_array_equal(verdict.weights[0], np.tile(visible, 2))


@pytest.mark.parametrize("kind", KINDS)
def test_the_noise_is_the_receivers_own_or_a_setting(kind):
    detector = kind()
    detector.bind(context(1, noise=7.0))
    assert detector.judge(sky_epoch(noise(8, 1))).threshold[0, 0] == pytest.approx(
        np.sqrt(fit_thresholds(7.0, 1e-5, 12)[12] / 8)
    )
    mixed = context(1)
    mixed.noise_variance[3] = 99.0
    detector.bind(mixed)  # the largest, so that no satellite is taken for better than it is
    assert detector.judge(sky_epoch(noise(8, 1))).threshold[0, 0] == pytest.approx(
        np.sqrt(fit_thresholds(np.sqrt(99.0), 1e-5, 12)[12] / 8)
    )
    # that of one epoch, not what a filter makes of errors that stay
    detector.bind(context(1, noise=40.0)._replace(single_epoch_sd=np.full(24, 1.5)))
    assert detector.judge(sky_epoch(noise(8, 1))).threshold[0, 0] == pytest.approx(
        np.sqrt(fit_thresholds(1.5, 1e-5, 12)[12] / 8)
    )


@pytest.mark.parametrize("kind", KINDS)
def test_more_channels_than_a_mask_has_bits_are_refused(kind):
    many = context(1)._replace(channels=64, noise_variance=np.full(128, 16.0))
    with pytest.raises(ValueError, match=r"at most 63 channels .* got 64"):
        kind().bind(many)


def test_a_limit_of_the_left_out_group_is_kept():
    offset = spoofed_offset([1, 4, 8], FAR) + 0.2 * noise(9, 1)
    detector = TraversalRaim(largest_group=2)
    assert judged(detector, offset).alarm.all()
    assert not detector.memory["group"].any()


def test_frames_are_two_ways_to_search_the_same():
    """Statistics agree; partitions are those of the same search in other axes."""
    offset = spoofed_offset([0, 2, 4, 6, 8], FAR, 50) + noise(10, 50)
    ned, ecef = SrvRaim(frame="ned"), SrvRaim(frame="ecef")
    one, other = judged(ned, offset), judged(ecef, offset)
    np.testing.assert_allclose(one.statistic, other.statistic, rtol=1e-9)
    groups = ned.memory["group"], ecef.memory["group"]
    split = [np.sort([(g == 1).sum(1), (g == 2).sum(1)], axis=0) for g in groups]
    assert all(np.mean((s == [[5], [7]]).all(axis=0)) > 0.7 for s in split)
    assert (groups[0] != groups[1]).any()


@pytest.mark.parametrize("kind", KINDS)
def test_in_the_loop_of_the_tightly_coupled_receiver(kind):
    """A step of one pseudorange is told and left out; the clean receiver raises no alarm."""
    errors = {}
    for exclude in (False, True):
        attack = PerChannel(control="rate", rate_limit_mps=250.0, channels=("S10",), coherent=False)
        setup = TightlyCoupledSetup(detector=kind(exclude=exclude), attack=attack, timeline=SHORT)
        engine = Engine(2, setup, threads=1)
        engine.reset([np.random.default_rng(i) for i in range(2)])
        assert not engine.warmup_alarm.any()
        slot = engine.setup.world.satellite_ids.index("S10")
        for k in range(20):
            verdict = engine.step(np.full((2, 1), 0.5 * (k == 0)))
            assert verdict.alarm.all()
            group = engine.simulator.detector.memory["group"]
            seen = engine.simulator.epoch.visible
            np.testing.assert_array_equal(group[:, slot], 2)
            assert (group[seen] > 0).all()
            assert not group[~seen].any()
        errors[exclude] = np.linalg.norm(engine.simulator.error_n(), axis=1).max()
    assert errors[True] < 10.0 < errors[False]
