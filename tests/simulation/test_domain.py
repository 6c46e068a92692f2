"""What differs from episode to episode: worlds, begins, sensors, errors, target directions."""

import gymnasium as gym
import numpy as np
import pytest
from scipy.stats import kstest

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.domain import draw
from spoofgym.simulation.engine import Engine
from spoofgym.simulation.simulator import run_serially
from spoofgym.truth.flight import Headings
from spoofgym.truth.manoeuvres import car

ID = "spoofgym/Zhong2025-v0"
SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
ALL = {
    "start_s": (5.0, 40.0),
    "turned_deg": (0.0, 360.0),
    "constellation_time_s": (0.0, 43_200.0),
    "worlds": 3,
    "imu": ("aviation", "tactical"),
    "errors": ("zhong2025", "groves"),
}


def settings(**kwargs):
    return {"timeline": SHORT, "knowledge": "oracle", "action": "full-command", **kwargs}


def test_an_episode_is_played_in_the_circumstances_that_it_has_drawn():
    envs = gym.make_vec(ID, num_envs=12, **settings(domain=ALL, target_heading_deg="random"))
    observation, info = envs.reset(seed=0)
    core = envs.unwrapped.core
    setup, simulator = core.setup, core.engine.simulator
    start = info["time_s"] - 20.0
    assert start.min() >= 5.0
    assert start.max() <= 40.0
    world = simulator.memory["first"] // setup.epochs_each
    assert set(world) == {0, 1, 2}
    # sensors, and what the receiver believes of them
    grades = simulator.memory["combination"] // 2 % 2
    bias = simulator.sensors.constants["accel_bias"]
    assert len({tuple(row) for row in bias[grades == 0]}) == 1
    assert np.abs(bias[grades == 1]).max() > 5.0 * np.abs(bias[grades == 0]).max()
    attitude = simulator.buffers.covariance[:, 0, 0]
    assert attitude[grades == 1].min() > attitude[grades == 0].max()
    # the true motion that is observed is that of the world
    names = envs.unwrapped.observation_names
    own = [names.index(f"target_velocity_{a}") for a in ("north", "east")]
    heading = np.degrees(np.arctan2(observation[:, own[1]], observation[:, own[0]])) % 360.0
    turn = np.array([pair[0] for pair in setup.domain.pairs()])
    spread = (heading - turn[world] + 180.0) % 360.0 - 180.0
    # one flight, at different times, turned as it was drawn
    assert np.ptp(spread[start <= 30.0]) < 60.0
    shown = observation[:, [names.index(f"target_direction_{a}") for a in ("north", "east")]]
    np.testing.assert_allclose(np.hypot(*shown.T), 1.0, atol=1e-6)
    error = simulator.buffers.position_e - setup.world.position_e[simulator.epochs]
    assert np.linalg.norm(error, axis=1).max() < 40.0


def test_a_reset_may_tell_the_circumstances_and_nonsense_loses_nothing():
    kwargs = settings(domain=ALL, target_heading_deg="random")
    envs = gym.make_vec(ID, num_envs=3, **kwargs)
    told = {
        "world": [2, 0, 1],
        "start_s": [5.0, 40.0, 12.5],
        "imu": "tactical",
        "errors": ["groves", "zhong2025", "groves"],
        "target_heading_deg": np.array([0.0, 90.0, 180.0]),
    }
    _, info = envs.reset(seed=1, options={"domain": told})
    simulator = envs.unwrapped.core.engine.simulator
    np.testing.assert_array_equal(info["time_s"], [25.0, 60.0, 32.5])
    np.testing.assert_array_equal(simulator.memory["combination"], [11, 2, 7])
    np.testing.assert_allclose(simulator.heading, np.radians([0.0, 90.0, 180.0]))
    # the next episodes draw again, and are those of an env that was never told anything
    again, _ = envs.reset()
    other = gym.make_vec(ID, num_envs=3, **kwargs)
    other.reset(seed=1)
    np.testing.assert_array_equal(other.reset()[0], again)
    envs, other = (gym.make_vec(ID, num_envs=2, **settings(domain=ALL)) for _ in range(2))
    for each in (envs, other):
        each.reset(seed=2)
    for given, message in (
        ({"word": 1}, "unknown choice of a reset 'word'"),
        ({"world": 3}, "`world` must be whole numbers, 0 to 2, got 3"),
        ({"world": [0, 1, 2]}, "`world` must be one value or 2 of them, got 3"),
        ({"start_s": 41.0}, "`start_s` must be 5 to 40, got 41"),
        ({"start_s": 5.3}, "`start_s` must be a multiple of the interval between epochs, 0.5 s"),
        ({"imu": "toy"}, "unknown imu 'toy'; valid: aviation, tactical"),
        ({"target_heading_deg": 10.0}, "only where it is 'random'"),
    ):
        with pytest.raises(ValueError, match=message):
            envs.reset(options={"domain": given})
    np.testing.assert_array_equal(other.reset()[0], envs.reset()[0])


@pytest.mark.parametrize(
    ("domain", "message"),
    [
        ({"start_s": (5.0, 2.0)}, "`start_s` must be finite, the least first"),
        ({"start_s": (-1.0, 2.0)}, "`start_s` must not begin before 0 s"),
        ({"constellation_time_s": (0.0, 1e12)}, "`constellation_time_s` must be"),
        ({"worlds": 3}, "`worlds` 3 would all be the same"),
        ({"imu": 3}, "`imu` must be a name or a list of names, got 3"),
        ({"start_s": (0.0, 400.0)}, "an episode takes .* from a start at 400 s"),
        ({"turned_deg": 10.0}, "`turned_deg` must be a pair of numbers"),
        ({"imu": ("aviation", "toy")}, "unknown imu grade 'toy'"),
        ({"errors": "none"}, "unknown errors 'none'"),
        ({"age_s": (5.0, 60.0)}, "`age_s` must be at least the 10 s"),
        ({"age_s": (0.0, 60.0)}, "above 0"),
        ({"age_s": (60.0, 30.0)}, "the least first"),
        ({"age_s": (60.0, 400.0)}, r"warm-up 400 s.*but 'zhong2025' lasts 418 s"),
    ],
)
def test_a_wrong_domain_says_what_is_valid(domain, message):
    with pytest.raises(ValueError, match=message):
        TightlyCoupledSetup(timeline=SHORT, domain=domain)


def test_draws_are_uniform_and_by_the_key_alone():
    assert TightlyCoupledSetup(timeline=SHORT).bounds.single  # nothing by default
    setup = TightlyCoupledSetup(timeline=SHORT, domain=ALL, target_heading_deg="random")
    keys = np.random.default_rng(0).integers(2**63, size=(4000, 2)).astype(np.uint64)
    drawn = draw(setup.bounds, keys)
    for array, count in ((drawn.world, 3), (drawn.grade, 2), (drawn.error, 2)):
        share = np.bincount(array, minlength=count) / len(keys)
        np.testing.assert_allclose(share, 1.0 / count, atol=4.0 * 0.5 / np.sqrt(len(keys)))
    assert (drawn.start.min(), drawn.start.max()) == (setup.bounds.first, setup.bounds.last)
    assert abs(np.exp(1j * drawn.heading).mean()) < 4.0 / np.sqrt(len(keys))
    for all_of_them, few in zip(drawn, draw(setup.bounds, keys[100:110]), strict=True):
        np.testing.assert_array_equal(all_of_them[100:110], few)
    # as late as the flight allows
    late = TightlyCoupledSetup(timeline=SHORT, domain={"start_s": (0.0, None)})
    assert late.bounds.last + late.onset + late.steps + late.hold + 2 == late.world.epochs


def test_a_turned_flight_is_the_same_flight_in_another_direction():
    flight = car()
    other = Headings.sample(flight, None, 0.5).fly(np.radians(90.0))
    np.testing.assert_array_equal(other.position_e[0], flight.position_e[0])
    north, east, down = flight.velocity_n.T
    np.testing.assert_allclose(other.velocity_n[0], [-east[0], north[0], down[0]], atol=1e-9)
    there, here = (each.position_e - each.position_e[0] for each in (other, flight))
    apart = np.linalg.norm(there, axis=1) - np.linalg.norm(here, axis=1)
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)
    # over some hundred metres the vertical turns by 1e-4
    np.testing.assert_allclose(other.velocity_n, np.stack([-east, north, down]).T, atol=5e-3)


AGED = {"age_s": (30.0, 120.0), "turned_deg": (0.0, 360.0), "worlds": 2}


def test_ages_are_log_uniform_and_those_of_a_longer_warm_up_in_any_batch():
    setup = TightlyCoupledSetup(timeline=SHORT, domain=AGED)
    keys = np.random.default_rng(1).integers(0, 2**63, (4000, 2), dtype=np.uint64)
    age = draw(setup.bounds, keys).age * setup.interval_s
    assert age.min() < 30.6
    assert age.max() > 119.4
    assert kstest(np.log(age / 30.0) / np.log(4.0), "uniform").pvalue > 1e-3
    # the first part of the warm-up, without detectors, is as long for all
    assert (setup.filter_only, setup.least_live, setup.live) == (20, 40, 220)

    seeds = range(11)
    engine = Engine(len(seeds), setup, threads=1)
    engine.reset([np.random.default_rng(k) for k in seeds])
    whole = engine.simulator
    assert len(np.unique(whole.ages)) > 5
    for k in seeds:
        alone = setup.simulator(1, run_serially)
        alone.warm_up([np.random.default_rng(k)])
        assert alone.ages[0] == whole.ages[k]
        for one, all_ in (
            (alone.position, whole.position),
            (alone.buffers.covariance, whole.buffers.covariance),
            (alone.detector.memory["average"], whole.detector.memory["average"]),
        ):
            assert np.array_equal(one[0], all_[k])
        assert alone.memory["warmup_alarm"][0] == whole.memory["warmup_alarm"][k]
    assert np.array_equal(whole.epochs, whole.onset)
    aged = TightlyCoupledSetup(timeline=SHORT, domain={"age_s": (30.0, 120.0)})
    longer = TightlyCoupledSetup(timeline={**SHORT, "warmup_s": 45.0, "live_s": 35.0})
    found, wanted = aged.simulator(2, run_serially), longer.simulator(2, run_serially)
    found.warm_up([np.random.default_rng(k) for k in range(2)], {"age_s": 45.0})
    wanted.warm_up([np.random.default_rng(k) for k in range(2)])
    assert np.array_equal(found.position, wanted.position)
    for age_s, message in ((20.0, "30 to 120"), (45.2, "multiple of the interval")):
        with pytest.raises(ValueError, match=message):
            found.warm_up([np.random.default_rng(k) for k in range(2)], {"age_s": age_s})
