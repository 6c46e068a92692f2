"""The snapshot receiver as a plant."""

import numpy as np
import pytest

from spoofgym.envs.snapshot_plant import SnapshotPlant

SHORT = {"warmup_s": 5.0, "live_s": 3.0, "attack_s": 20.0, "time_to_alert_s": 4.0}
NORTH = np.array([1.0, 0.0, 0.0, 0.0])
EXCLUDING = {"name": "traversal-raim", "exclude": True}


def rngs(receivers, first=0):
    return [np.random.default_rng(first + i) for i in range(receivers)]


def plant(receivers, **settings):
    return SnapshotPlant(receivers, **{"timeline": SHORT, **settings})


def play(p, action=NORTH, epochs=15):
    """Errors, alarms and observations of all epochs."""
    out = []
    for k in range(epochs):
        given = None if action is None else np.tile(action * np.cos(k), (p.receivers, 1))
        alarm = p.advance(given)
        seen = np.empty((p.receivers, len(p.observation("oracle")[0])), dtype=np.float32)
        p.observe("oracle", seen)
        out.append(np.column_stack([p.error_ne(), p.time_s(), alarm, seen]))
    return np.array(out)


@pytest.mark.parametrize("detector", ["srv-raim", EXCLUDING, "snapshot-chi2", "ewma"])
@pytest.mark.parametrize(("receivers", "row"), [(7, 3), (64, 37)])
def test_a_receiver_is_the_same_in_any_batch(detector, receivers, row):
    many, one = plant(receivers, detector=detector), plant(1, detector=detector)
    warm = many.begin(rngs(receivers)), one.begin(rngs(1, first=row))
    assert warm[0][row] == warm[1][0]
    np.testing.assert_array_equal(play(many)[:, row], play(one)[:, 0])
    for name, array in one.memory.items():
        np.testing.assert_array_equal(many.memory[name][row], array[0], err_msg=name)


@pytest.mark.parametrize("detector", ["srv-raim", EXCLUDING])
def test_zero_command_is_the_clean_run(detector):
    clean, idle = plant(5, detector=detector, spoofed=0), plant(5, detector=detector, spoofed=7)
    clean.begin(rngs(5))
    idle.begin(rngs(5))
    for k in range(20):
        clean.advance(np.tile(NORTH, (5, 1)))
        idle.advance(np.zeros((5, 4)) if k else None)
        np.testing.assert_array_equal(clean.memory["position_e"], idle.memory["position_e"])
        np.testing.assert_array_equal(clean.memory["statistic"], idle.memory["statistic"])


def test_rows_can_be_moved_to_another_batch():
    source, target = plant(3, detector=EXCLUDING), plant(2, detector=EXCLUDING)
    source.begin(rngs(3))
    target.begin(rngs(2, first=50))
    play(source, epochs=4)
    target.copy_rows(np.array([1]), source, np.array([2]))
    np.testing.assert_array_equal(play(target)[:, 1], play(source)[:, 2])


def test_a_spawned_batch_is_one_of_its_own():
    parent = plant(2)
    child = parent.spawn(3)
    assert child.sky is parent.sky
    assert child.detector is not parent.detector
    parent.begin(rngs(2))
    child.begin(rngs(3))
    before = parent.memory["position_e"].copy()
    play(child, epochs=2)
    np.testing.assert_array_equal(parent.memory["position_e"], before)
    again = plant(3)
    again.begin(rngs(3))
    play(again, epochs=2)
    np.testing.assert_array_equal(again.memory["position_e"], child.memory["position_e"])


def test_episodes_of_a_receiver_differ_and_can_be_had_again():
    p, other = plant(1), plant(1)
    rng = np.random.default_rng(4)
    p.begin([rng])
    first = p.memory["keys"].copy()
    p.begin([rng])
    assert (p.memory["keys"] != first).all()
    rng = np.random.default_rng(4)
    other.begin([rng])
    other.begin([rng])
    np.testing.assert_array_equal(p.memory["keys"], other.memory["keys"])
    np.testing.assert_array_equal(p.memory["spoofed"], other.memory["spoofed"])


def test_clean_fixes_err_as_their_dilution_of_precision_says():
    p = plant(400, detector="never")
    p.begin(rngs(400))
    G = np.concatenate([-p._line_of_sight_n()[0], np.ones((12, 1))], axis=1)
    expected = 4.0 * np.sqrt(np.diag(np.linalg.inv(G.T @ G)))[:2]
    np.testing.assert_allclose(p.error_ne().std(axis=0), expected, rtol=0.12)
    assert (np.abs(p.error_ne().mean(axis=0)) < 4.0 * expected / 20.0).all()


def test_spoofing_of_all_moves_the_fix_unseen():
    p = plant(50, spoofed=12)
    p.begin(rngs(50))
    alarm = np.zeros(50, dtype=np.bool_)
    for _ in range(20):
        alarm |= p.advance(np.tile(NORTH, (50, 1)))
    assert not alarm.any()
    np.testing.assert_allclose(p.error_ne().mean(axis=0), [100.0, 0.0], atol=2.5)


def test_exclusion_of_the_few_keeps_the_fix_and_the_alarm_tells_of_it():
    errors = {}
    for exclude in (False, True):
        p = plant(50, spoofed=[1, 5], detector={"name": "traversal-raim", "exclude": exclude})
        assert not p.begin(rngs(50)).any()
        for _ in range(20):
            alarm = p.advance(np.tile([1.0, 1.0, 0.0, 0.0], (50, 1)))
        assert alarm.mean() > 0.9
        errors[exclude] = np.median(np.linalg.norm(p.error_ne(), axis=1))
    assert errors[True] < 6.0 < 12.0 < errors[False]


def test_a_held_command_goes_on():
    p = plant(2)
    p.begin(rngs(2))
    p.advance(np.tile([0.5, 2.0, 0.0, -0.2], (2, 1)))  # 2 is more than the limit
    p.advance(None)
    np.testing.assert_allclose(p.memory["displacement"][0], [5.0, 10.0, 0.0, -2.0])


@pytest.mark.parametrize("knowledge", ["blind", "tracking", "oracle"])
def test_observations_have_names_and_finite_bounds(knowledge):
    p = plant(3)
    p.begin(rngs(3))
    play(p, epochs=5)
    names, low, high = p.observation(knowledge)
    assert len(names) == len(set(names)) == len(low) == len(high)
    assert np.isfinite([low, high]).all()
    out = np.full((3, len(names)), np.nan, dtype=np.float32)
    p.observe(knowledge, out)
    assert (out >= low - 1e-6).all()
    assert (out <= high + 1e-6).all()
    value = dict(zip(names, out[0], strict=True))
    assert value["own_displacement_north"] == pytest.approx(
        p.memory["displacement"][0, 0] / 100.0, rel=1e-5
    )
    assert value["time_since_onset"] == pytest.approx(5 / 20)
    if knowledge != "blind":
        assert value["target_motion_north"] == pytest.approx(5 * 50.0 / 10_000.0, rel=1e-4)
        assert sum(value[f"satellite_{j}_spoofed"] for j in range(12)) == 6
    if knowledge == "oracle":
        assert value["error_north"] == pytest.approx(p.error_ne()[0, 0] / 100.0, rel=1e-5)


def test_an_episode_ends():
    p = plant(1)
    p.begin(rngs(1))
    for _ in range(p.steps + p.hold):
        p.advance(None)
    assert p.time_s()[0] == 29.0
    p.advance(None)  # one to spare, beside receivers that go on
    with pytest.raises(RuntimeError, match="the episode is over"):
        p.advance(None)


def test_false_alarms_come_as_promised():
    p = plant(500, detector={"name": "srv-raim", "false_alarm": 0.02}, timeline={**SHORT})
    p.begin(rngs(500))
    alarms = sum(int(p.advance(None).sum()) for _ in range(20))
    assert abs(alarms - 200) < 4.0 * np.sqrt(200)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"receivers": 0}, "`receivers` must be at least 1, got 0"),
        ({"satellites": 3}, "`satellites` must be a whole number >= 4, got 3"),
        ({"satellites": 6.5}, "`satellites` must be a whole number >= 4, got 6.5"),
        ({"satellites": 30}, "`satellites` must be at most .* got 30"),
        ({"spoofed": 13}, r"`spoofed` must be within 0..12, the number of satellites, got 13"),
        ({"spoofed": 2.5}, "`spoofed` must be a whole number of satellites, or a list"),
        ({"spoofed": [1, 1]}, r"slots within 0..11, each once, got \[1, 1\]"),
        ({"spoofed": [12]}, r"slots within 0..11, each once, got \[12\]"),
        ({"noise_m": 0.0}, "`noise_m` must be finite and > 0, got 0.0"),
        ({"interval_s": -1.0}, "`interval_s` must be finite and > 0, got -1.0"),
        ({"rate_limit_mps": [1.0, 2.0]}, "one for each of north, east, down, clock, got"),
        ({"rate_limit_mps": 0.0}, "`rate_limit_mps` must be finite and > 0"),
        ({"speed_mps": np.nan}, "`speed_mps` must be finite, got nan"),
        ({"timeline": {"warmup": 1.0}}, "`timeline` has no setting 'warmup'; valid: warmup_s"),
        ({"timeline": {"attack_s": 1e9}}, "at most 100000 epochs; 1e[+]09 s at intervals of 1 s"),
        ({"detector": "srv-rain"}, "unknown detector 'srv-rain'"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        plant(**{"receivers": 1, **settings})


def test_a_detector_with_needs_is_refused():
    from spoofgym.detectors import Never

    class Odometer(Never):
        needs = frozenset({"auxiliary_position"})

    with pytest.raises(ValueError, match="Odometer needs auxiliary_position"):
        plant(1, detector=Odometer())
