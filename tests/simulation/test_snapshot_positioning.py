"""The snapshot receiver: errors of a clean fix, what spoofing of all and of some does to it."""

import numpy as np
import pytest

from spoofgym.simulation import SnapshotSetup

from .support import setup_of, step, warm

NORTH = [1.0, 0.0, 0.0, 0.0]


def test_clean_fixes_err_as_their_dilution_of_precision_says():
    mine = warm(setup_of("snapshot", detector="never"), 400)
    G = np.concatenate([-mine.lines_of_sight_n()[0], np.ones((12, 1))], axis=1)
    expected = 4.0 * np.sqrt(np.diag(np.linalg.inv(G.T @ G)))[:2]
    np.testing.assert_allclose(mine.error_n().std(axis=0), expected, rtol=0.12)
    assert (np.abs(mine.error_n().mean(axis=0)) < 4.0 * expected / 20.0).all()


def test_spoofing_of_all_moves_the_fix_unseen_and_of_none_not_at_all():
    detector = {"name": "srv-raim", "false_alarm": 0.02}
    every, none, clean = (
        warm(setup_of("snapshot", detector=detector, spoofed=count, heading_deg=60.0), 200)
        for count in (12, 0, 7)
    )
    alarms = 0
    for _ in range(20):
        alarms += step(every, NORTH).sum()
        step(none, NORTH)
        step(clean)
        np.testing.assert_array_equal(none.memory["position_e"], clean.memory["position_e"])
        np.testing.assert_array_equal(none.ratio(), clean.ratio())
    assert abs(alarms - 80) < 4.0 * np.sqrt(80)  # false ones, as promised
    np.testing.assert_allclose(every.error_n().mean(axis=0), [100.0, 0.0], atol=2.5)
    out = np.empty((200, 3))
    clean.motion(1.0, 0.0, out)  # since the onset
    want = [1000.0 * 0.5, 1000.0 * np.sqrt(0.75), 0.0]
    np.testing.assert_allclose(out, [want] * 200, atol=0.1)


def test_exclusion_of_the_few_keeps_the_fix_and_raises_the_alarm():
    errors = {}
    for exclude in (False, True):
        detector = {"name": "traversal-raim", "exclude": exclude}
        mine = warm(setup_of("snapshot", spoofed=[1, 5], detector=detector), 50)
        for _ in range(20):
            alarm = step(mine, [1.0, 1.0, 0.0, 0.0])
        assert alarm.mean() > 0.9
        errors[exclude] = np.median(np.linalg.norm(mine.error_n(), axis=1))
        excluded = mine.observed_weights() == 0.0
        assert excluded[:, [1, 5]].mean() == (pytest.approx(1.0, abs=0.1) if exclude else 0.0)
    assert errors[True] < 6.0 < 12.0 < errors[False]


def test_an_epoch_without_a_fix_coasts():
    mine = warm(setup_of("snapshot"), 3)
    assert not mine.coasting.any()
    before = mine.memory["position_e"].copy()
    mine.advance()
    weights = np.ones((3, 24))
    weights[1, 3:] = 0.0
    mine.update(weights)
    np.testing.assert_array_equal(mine.coasting, [False, True, False])
    np.testing.assert_array_equal((mine.memory["position_e"] == before).all(axis=1), mine.coasting)
    step(mine)
    assert not mine.coasting.any()


def test_geometry_is_where_the_satellites_are_and_who_is_spoofed():
    setup = setup_of("snapshot")
    mine, out = warm(setup, 4), np.empty((4, 48), dtype=np.float32)
    mine.geometry(out)
    value = dict(zip(setup.geometry_names, out[2], strict=True))
    sight = np.array([value[f"sight_{axis}_slot07"] for axis in ("north", "east", "down")])
    assert np.linalg.norm(sight) == pytest.approx(1.0)
    assert sight[2] < -np.sin(np.radians(5.0))
    spoofed = [value[f"spoofed_slot{j:02d}"] for j in range(12)]
    np.testing.assert_array_equal(spoofed, mine.memory["spoofed"][2])
    assert sum(spoofed) == 6


def test_worlds_differ_in_heading_and_satellites():
    domain = {"turned_deg": (0.0, 360.0), "constellation_time_s": (0.0, 4e4), "worlds": 3}
    few = {"satellites": 9, "detector": "never"}
    setup = setup_of("snapshot", domain=domain, **few)
    mine, out = warm(setup, 3, world=[2, 0, 1]), np.empty((3, 3))
    step(mine)
    mine.motion(1.0, 0.0, out)
    turns = np.array([turn for turn, _ in setup.domain.pairs()])[[2, 0, 1]]
    np.testing.assert_allclose(np.degrees(np.arctan2(out[:, 1], out[:, 0])) % 360.0, turns)
    for k, (turn, time) in enumerate(setup.domain.pairs()):
        alone = setup_of("snapshot", heading_deg=turn, time_offset_s=time, **few).sky
        rows = slice(k * setup.epochs_each, (k + 1) * setup.epochs_each)
        np.testing.assert_array_equal(setup.sky.position_e[rows], alone.position_e)
        np.testing.assert_array_equal(
            setup.sky.satellite_position_e[rows], alone.satellite_position_e
        )
    assert (np.linalg.norm(mine.error_n(), axis=1) < 30.0).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"satellites": 30}, "`satellites` must be at most .* got 30"),
        ({"domain": {"constellation_time_s": (3000.0, 12_000.0)}}, r"at most 1[01], .* got 12"),
        ({"spoofed": 13}, r"`spoofed` must be within 0..12, the number of satellites, got 13"),
        ({"spoofed": 2.5}, "`spoofed` must be a whole number of satellites, or a list"),
        ({"spoofed": [1, 1]}, r"slots within 0..11, each once, got \[1, 1\]"),
        ({"rate_limit_mps": [1.0, 2.0]}, "one for each of north, east, down, clock, got"),
        ({"detector": "solution-separation"}, "needs transition, which a snapshot receiver does"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        warm(SnapshotSetup(**settings), 1)
