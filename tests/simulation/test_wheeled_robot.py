"""The wheeled robot: jumps and their rejection, interruptions, starts on the course."""

import numpy as np
import pytest

from spoofgym.simulation import WheeledRobotSetup

from .support import setup_of, step, warm


def test_a_command_moves_the_fix_at_its_rate_and_none_holds_it():
    setup = setup_of("robot", rate_limit_mps=0.4)
    attacked, clean = warm(setup, 2), warm(setup_of("robot"), 2)
    moved = []
    for k in range(6):
        step(attacked, [1.0, -0.5] if k < 3 else None)
        step(clean)
        moved.append(attacked.memory["fix"] - clean.memory["fix"])
    expected = np.arange(1.0, 7.0)[:, None, None] * [0.4, -0.2]
    np.testing.assert_allclose(moved, np.tile(expected, (1, 2, 1)), atol=1e-12)
    out = np.empty((2, 4))
    clean.motion(0.1, 1.0, out)  # since the onset
    travelled = setup.true_position[26] - setup.true_position[20]
    np.testing.assert_allclose(out[:, :2], [0.1 * travelled] * 2)
    np.testing.assert_allclose(np.hypot(*out[:, 2:].T), 0.5)


def test_a_jump_takes_one_fix_with_a_high_limit_and_is_rejected_by_default():
    attacked, clean = warm(setup_of("robot", rate_limit_mps=100.0), 20), warm(setup_of("robot"), 20)
    assert not step(attacked, 0.2).all()  # pending
    alarms = [step(attacked, 0.0) for _ in range(10)]
    for _ in range(11):
        step(clean)
    assert np.all(alarms)
    np.testing.assert_allclose(attacked.commanded_displacement, 20.0)
    assert np.abs(attacked.error_n() - clean.error_n()).max() < 3.0
    np.testing.assert_array_equal(attacked.observed_weights()[:, 0] == 0.0, attacked.ratio() > 1.0)


def test_alarms_before_the_onset_are_reported():
    jumpy = {"name": "acna", "variant": "literal", "jump_window": 1, "jump_threshold_m": 0.01}
    mine = warm(setup_of("robot", detector=jumpy), 3)
    generators = [np.random.default_rng(row) for row in range(3)]
    assert mine.warm_up(generators).all()
    line = {"warmup_s": 20.0, "live_s": 0.0, "attack_s": 40.0, "time_to_alert_s": 5.0}
    deaf = warm(setup_of("robot", detector=jumpy, timeline=line), 3)
    assert not deaf.warm_up(generators).any()


def test_an_interruption_has_no_fix_and_no_alarm():
    setup = setup_of("robot", interruptions_s=[[25.0, 40.0]], domain={"start_s": (0.0, 30.0)})
    mine = warm(setup, 3, start_s=[0.0, 10.0, 30.0])
    for k in range(30):
        alarm = step(mine)
        missing = 25.0 <= 21.0 + k < 40.0
        np.testing.assert_array_equal(np.isnan(mine.memory["fix"]).all(axis=1), missing)
        np.testing.assert_array_equal(mine.coasting, missing)
        np.testing.assert_array_equal(mine.memory["interrupted"], k - 3 if missing else 0.0)
        assert np.isfinite(mine.error_n()).all()
        assert not (missing and alarm.any())


def test_a_start_may_be_anywhere_on_the_course():
    setup = setup_of("robot", domain={"start_s": (2.0, None)})
    lap = 2.0 * (13.4 + 6.1) - (8.0 - 2.0 * np.pi) * 0.3
    assert (setup.bounds.first, setup.bounds.last) == (2, np.floor(2.0 + lap / 0.5))
    drawn = warm(setup, 40)
    starts = setup.true_position[drawn.memory["first"]]
    assert (np.ptp(starts, axis=0) > 5.0).all()
    assert np.linalg.norm(drawn.error_n(), axis=1).max() < 6.0
    same = warm(setup_of("robot"), 1)
    given = warm(setup_of("robot", domain={"start_s": (0.0, 50.0)}), 1, start_s=0.0)
    np.testing.assert_array_equal(same.error_n(), given.error_n())


def test_what_fits_no_robot_is_refused():
    for settings, message in (
        ({"interval_s": 10.0}, "`interval_s` must be 1 to 64 times the sample interval"),
        ({"loop": {"speed": 1.0}}, "`loop` has no setting 'speed'; valid: length_m, "),
        ({"interruptions_s": [[5.0, 4.0]]}, r"must be pairs .* got \[\[5.0, 4.0\]\]"),
        ({"detector": "ewma"}, "Ewma measures satellites, but the receiver measures position"),
    ):
        with pytest.raises(ValueError, match=message):
            warm(WheeledRobotSetup(**settings), 1)
