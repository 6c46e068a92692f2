"""The robot's plant: the same bits in any batch, and zero commands are the clean run."""

import json
import pickle

import numpy as np
import pytest

from spoofgym.detectors import Acna, Never
from spoofgym.envs.robot_plant import RobotPlant

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 40.0, "time_to_alert_s": 5.0}
KNOWLEDGE = ("blind", "tracking", "oracle")


def generators(count, first=0):
    return [np.random.default_rng(first + i) for i in range(count)]


def begun(receivers, first=0, **settings):
    plant = RobotPlant(receivers, **{"timeline": SHORT, **settings})
    plant.begin(generators(receivers, first))
    return plant


def commanded(receivers, steps, seed=0):
    """Commands of the first receivers of a large batch: each has its own, whatever the batch."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, 40, 2))[:, :receivers].copy()


def states(plant):
    return {name: array.copy() for name, array in (plant.memory | plant.detector.memory).items()}


@pytest.mark.parametrize("detector", ["acna", {"name": "acna", "variant": "literal"}, "rio"])
@pytest.mark.parametrize("receivers", [1, 7])
def test_a_receiver_is_the_same_in_any_batch(receivers, detector):
    few, many = begun(receivers, detector=detector), begun(40, detector=detector)
    for mine, theirs in zip(commanded(receivers, 40), commanded(40, 40), strict=True):
        np.testing.assert_array_equal(few.advance(mine), many.advance(theirs)[:receivers])
        for name, array in states(few).items():
            np.testing.assert_array_equal(array, states(many)[name][:receivers], err_msg=name)
    assert not np.array_equal(states(many)["position"][0], states(many)["position"][1])


@pytest.mark.parametrize("action", [np.zeros((3, 2)), None])
def test_zero_command_is_the_clean_run(action):
    plant, still = begun(3), begun(3, rate_limit_mps=500.0)
    for _ in range(45):
        plant.advance(action)
        still.advance(None)
        np.testing.assert_array_equal(plant.error_ne(), still.error_ne())
        np.testing.assert_array_equal(plant.memory["fix"], still.memory["fix"])


def test_an_action_moves_the_fix_at_its_rate_and_none_holds_it():
    plant, clean = begun(2, rate_limit_mps=0.4), begun(2)
    moved = []
    for k in range(6):
        plant.advance(np.tile([1.0, -0.5], (2, 1)) if k < 3 else None)
        clean.advance(None)
        moved.append(plant.memory["fix"] - clean.memory["fix"])
    expected = np.arange(1.0, 7.0)[:, None, None] * [0.4, -0.2]
    np.testing.assert_allclose(moved, np.tile(expected, (1, 2, 1)), atol=1e-12)


def test_a_jump_takes_one_fix_with_a_high_limit_and_is_rejected_by_default():
    plant, clean = begun(20, rate_limit_mps=100.0), begun(20)
    assert not plant.advance(np.full((20, 2), 0.2)).all()  # pending
    alarms = [plant.advance(np.zeros((20, 2))) for _ in range(10)]
    for _ in range(11):
        clean.advance(None)
    assert np.all(alarms)
    np.testing.assert_allclose(plant.memory["offset"], 20.0)
    assert np.abs(plant.error_ne() - clean.error_ne()).max() < 3.0


def test_without_a_detector_the_estimate_follows():
    plant, clean = begun(5, detector="never", rate_limit_mps=100.0), begun(5, detector=Never())
    plant.advance(np.full((5, 2), 0.2))
    clean.advance(None)
    for _ in range(35):
        plant.advance(np.zeros((5, 2)))
        clean.advance(None)
    np.testing.assert_allclose(plant.error_ne() - clean.error_ne(), 20.0, atol=0.1)


def test_rows_move_between_batches():
    plant, other = begun(4), begun(4, first=10)
    for action in commanded(4, 5):
        plant.advance(action)
        other.advance(action[::-1].copy())
    twin = plant.spawn(6)
    twin.begin(generators(6, 20))
    twin.copy_rows(np.array([5, 0]), plant, np.array([1, 3]))
    twin.copy_rows(np.array([2]), other, np.array([0]))
    command = np.linspace(-1.0, 1.0, 12).reshape(6, 2)
    for source, rows, to in ((plant, [1, 3], [5, 0]), (other, [0], [2])):
        action = np.zeros((4, 2))
        action[rows] = command[to]
        source.advance(action)
    twin.advance(command)
    for source, rows, to in ((plant, [1, 3], [5, 0]), (other, [0], [2])):
        for name, array in states(source).items():
            np.testing.assert_array_equal(array[rows], states(twin)[name][to], err_msg=name)


def test_an_episode_depends_on_its_generator_alone():
    rngs = generators(2)
    plant = RobotPlant(2, timeline=SHORT)
    plant.begin(rngs)
    first = plant.memory["fix"].copy()
    for action in commanded(2, 7):
        plant.advance(action)
    plant.begin(rngs)
    assert not np.array_equal(plant.memory["fix"], first)
    fresh = generators(2)
    other = RobotPlant(2, timeline=SHORT)
    other.begin(fresh)
    other.begin(fresh)
    np.testing.assert_array_equal(plant.memory["fix"], other.memory["fix"])
    assert not plant.memory["offset"].any()


@pytest.mark.parametrize("knowledge", KNOWLEDGE)
def test_observations_have_names_and_finite_bounds(knowledge):
    plant = begun(5)
    names, low, high = plant.observation(knowledge)
    assert len(set(names)) == len(names) == len(low) == len(high)
    assert (np.isfinite(low) & np.isfinite(high) & (low < high)).all()
    for less in KNOWLEDGE[: KNOWLEDGE.index(knowledge)]:
        assert names[: len(plant.observation(less)[0])] == plant.observation(less)[0]
    out = np.full((5, len(names)), np.nan, dtype=np.float32)
    for action in commanded(5, plant.steps):
        plant.advance(action)
        plant.observe(knowledge, out)
        assert np.isfinite(out).all()
        assert ((out >= low - 1e-6) & (out <= high + 1e-6)).all()


def test_observations_say_what_is_so():
    plant = begun(3, rate_limit_mps=2.0)
    for _ in range(10):
        plant.advance(np.full((3, 2), 0.5))
    names, _, _ = plant.observation("oracle")
    out = np.empty((3, len(names)), dtype=np.float32)
    plant.observe("oracle", out)
    seen = dict(zip(names, out.T, strict=True))
    np.testing.assert_allclose(seen["own_displacement_north"], 1.0)
    np.testing.assert_allclose(seen["own_rate_east"], 0.5)
    np.testing.assert_allclose(seen["time_since_onset"], 0.25)
    np.testing.assert_allclose(seen["time_left"], 0.75)
    truth = plant.true_position_ne
    np.testing.assert_allclose(
        seen["target_position_east"], (truth[30] - truth[20])[1] / 10.0, 1e-5
    )
    speed = np.hypot(seen["target_velocity_north"], seen["target_velocity_east"])
    np.testing.assert_allclose(speed, 0.5, 1e-5)
    np.testing.assert_allclose(seen["estimate_error_north"], plant.error_ne()[:, 0] / 10.0, 1e-5)
    np.testing.assert_array_equal(seen["weight"] == 0.0, seen["statistic_ratio"] > 1.0)
    with pytest.raises(ValueError, match=r"unknown knowledge 'oracel'.*did you mean 'oracle'"):
        plant.observation("oracel")


def test_alarms_before_the_onset_are_told():
    quiet = {**SHORT, "live_s": 0.0}
    jumpy = {"name": "acna", "variant": "literal", "jump_window": 1, "jump_threshold_m": 0.01}
    assert RobotPlant(3, detector=jumpy, timeline=SHORT).begin(generators(3)).all()
    assert not RobotPlant(3, detector=jumpy, timeline=quiet).begin(generators(3)).any()


def test_an_interruption_has_no_fix_and_no_alarm():
    plant = begun(8, interruptions_s=[[25.0, 40.0]])
    for k in range(30):
        alarm = plant.advance(None)
        missing = 25.0 <= plant.time_s()[0] < 40.0
        assert np.isnan(plant.memory["fix"]).any() == missing
        assert plant.memory["interrupted"][0] == (k - 3 if missing else 0.0)
        assert np.isfinite(plant.error_ne()).all()
        assert not (missing and alarm.any())


def test_settings_are_json_and_a_plant_is_pickled():
    settings = {
        "detector": {"name": "acna", "variant": "literal"},
        "timeline": SHORT,
        "loop": {"speed_mps": 1.0},
        "odometer": {"hard_iron_deg": 2.0},
        "fix_errors": {"white_sd_m": 0.4},
        "receiver": {"gain": 0.3},
        "interruptions_s": [[30.0, 35.0]],
    }
    plant = RobotPlant(2, **json.loads(json.dumps(settings)))
    plant.begin(generators(2))
    twin = pickle.loads(pickle.dumps(plant))
    for action in commanded(2, 10):
        np.testing.assert_array_equal(plant.advance(action), twin.advance(action))
    np.testing.assert_array_equal(plant.error_ne(), twin.error_ne())


def test_an_episode_has_an_end():
    plant = begun(1)
    for _ in range(plant.epochs - 1 - plant.onset):
        plant.advance(None)
    assert plant.epochs - 1 > plant.onset + plant.steps + plant.hold
    with pytest.raises(RuntimeError, match=r"has 65 epochs, and receivers \[0\] are past its end"):
        plant.advance(None)


class Antenna(Acna):
    """Needs what a robot does not have."""

    needs = frozenset({"gnss_position", "cn0_dbhz"})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rate_limit_mps": 0.0}, "`rate_limit_mps` must be finite and > 0, got 0"),
        ({"interval_s": 0.25}, "`interval_s` must be 1 to 64 times the sample interval"),
        ({"interval_s": 10.0}, "`interval_s` must be 1 to 64 times the sample interval"),
        ({"loop": {"speed": 1.0}}, "`loop` has no setting 'speed'; valid: length_m, "),
        ({"receiver": {"gain": 2.0}}, "`gain` must lie between 0 and 1"),
        ({"timeline": {"attack_s": -1.0}}, "`attack_s` must be finite and >= 0, got -1"),
        ({"interruptions_s": [[5.0, 4.0]]}, "must be pairs .* got \\[\\[5.0, 4.0\\]\\]"),
        ({"interruptions_s": [5.0]}, "must be pairs .* got \\[5.0\\]"),
        ({"timeline": {"attack_s": 1e9}}, "an episode must have at most 100000 epochs"),
        ({"detector": "ewma"}, "Ewma measures satellites, but the receiver measures position"),
        ({"detector": Antenna()}, "Antenna needs cn0_dbhz, which a wheeled robot does not have"),
        ({"receivers": 0}, "`receivers` must be at least 1, got 0"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(ValueError, match=message):
        RobotPlant(**{"receivers": 2, **settings})
