"""Worlds of hours: manoeuvres, satellites, memory, and the bits of the whole in pieces."""

import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest

from spoofgym.core import compile as compiling
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.domain import Domain, build_worlds
from spoofgym.simulation.engine import Engine
from spoofgym.truth import flight as flights
from spoofgym.truth.flight import Headings, inverse_kinematics
from spoofgym.truth.manoeuvres import FLIGHTS, LONG_S, car, en_route, terminal
from spoofgym.truth.run import build_world
from spoofgym.truth.satellites import CircularConstellation
from spoofgym.truth.scenario import Scenario
from spoofgym.truth.signal_errors import (
    MAPPINGS,
    OBLIQUITIES,
    causal_mappings,
    compute_mappings,
    stack_obliquities,
)
from spoofgym.truth.skies import look_up

STEP_S = 0.5
INTERVAL = np.array([STEP_S])


@pytest.fixture(scope="module", params=[(en_route, 400.0), (terminal, 75.0)])
def long_flight(request):
    make, quiet_s = request.param
    return make(rate_hz=1.0 / STEP_S), quiet_s


def test_long_flights_turn_or_climb_throughout(long_flight):
    flight, quiet_s = long_flight
    assert flight.duration == LONG_S
    north, east, down = flight.velocity_n.T
    turning = np.abs(np.gradient(np.unwrap(np.arctan2(east, north)), STEP_S)) > np.radians(0.1)
    at = np.flatnonzero(turning | (np.abs(down) > 0.5))
    assert np.diff([0, *at, flight.time.size - 1]).max() * STEP_S < quiet_s
    assert 1000.0 < flight.geodetic[2].min() <= flight.geodetic[2].max() < 11_000.0


def test_the_slots_hold_enough_satellites_for_hours(long_flight):
    """Six of twelve slots at least, and 16 slots lose nothing that is above the mask."""
    trajectory = inverse_kinematics(long_flight[0])
    for offset_s in np.random.default_rng(5).uniform(0.0, 86_400.0, 12):
        sky = CircularConstellation(time_offset_s=offset_s)
        twelve, sixteen, all_ = (
            build_world(trajectory, sky, epoch_interval_s=20.0, channels=channels).visible.sum(1)
            for channels in (12, 16, 32)
        )
        assert twelve.min() >= 6
        np.testing.assert_array_equal(sixteen, all_)


def test_a_flight_has_the_same_bits_in_pieces(monkeypatch):
    whole = car()
    monkeypatch.setattr(flights, "PIECE", 777)
    pieces = car()
    for name in ("position_e", "velocity_e", "C_eb"):
        np.testing.assert_array_equal(getattr(pieces, name), getattr(whole, name))


@pytest.mark.parametrize("turned_deg", [0.0, 360.0])
def test_every_world_of_a_chain_is_the_one_built_alone(turned_deg):
    domain = Domain(
        worlds=4, turns=2, turned_deg=(0.0, turned_deg), constellation_time_s=(0.0, 86_400.0)
    )
    scenario = Scenario(flight="car", imu_rate_hz=20.0)
    chained, count = build_worlds(scenario, domain)
    turns = len({turn for turn, _ in domain.pairs()})
    assert turns == (2 if turned_deg else 1)
    assert chained.run.shape == (8, turns * 1200)
    assert build_worlds(scenario, domain)[0] is chained
    chained = pickle.loads(pickle.dumps(chained))
    assert not chained.at_hand.satellites.any()  # nothing is built before it is drawn
    for w in (2, 3, 1):
        chained.build([w])
        assert chained.at_hand.satellites.reshape(count, -1).any(axis=1)[w]
    assert not chained.at_hand.satellites.reshape(count, -1)[0].any()
    heights, in_view = chained.list_first_elevations(), chained.in_view.reshape(count, -1)
    for w, (turn, time) in enumerate(domain.pairs()):
        flight = Headings.sample(car(), None, 0.5).fly(np.radians(turn))
        sky = CircularConstellation(time_offset_s=time)
        alone = build_world(Headings.sample(flight, 20.0, 0.5).trajectory(0.0), sky)
        part = chained.take(w)
        np.testing.assert_array_equal(heights[w], alone.first_elevation)
        np.testing.assert_array_equal(in_view[w], alone.visible.sum(axis=1))
        turning = chained.at_hand.axes_turning.reshape(count, -1, 3, 3)
        np.testing.assert_array_equal(turning[w], alone.axes_turning)
        for name, array in vars(alone).items():
            if isinstance(array, np.ndarray):
                np.testing.assert_array_equal(getattr(part, name), array, err_msg=name)
        some = np.array([7, 3])
        for each, whole in zip(part.look(some), alone.look(slice(None)), strict=True):
            np.testing.assert_array_equal(each, whole[some])


def test_a_stretch_of_a_world_has_the_bits_of_the_whole():
    """Within a piece, over its edges and those of the world, with neighbours; and late tables."""
    domain = Domain(worlds=2, turns=1, constellation_time_s=(0.0, 86_400.0), world_seed=3)
    scenario = Scenario(flight="approach", imu_rate_hz=20.0)
    skies = [(turn, CircularConstellation(time_offset_s=time)) for turn, time in domain.pairs()]
    whole, some = (scenario.chained_world(skies) for _ in range(2))
    table = "obliquities", (12, OBLIQUITIES), lambda part: stack_obliquities(part.elevation)
    expected, found = whole.tabulate(*table), some.at_hand.tabulate(*table)
    each = whole.epochs // 2
    for low, high in ((511, 511), (each + 100, each + 1100), (0, 3), (2 * each - 3, 2 * each - 1)):
        some.build_epochs(np.array([low]), np.array([high]))
        rows = slice(max(low - 1, 0), high + 2)
        np.testing.assert_array_equal(found[rows], expected[rows])
        for name in ("satellites", "visible", "position_e", "velocity_e", "C_en"):
            parts = (getattr(world, name)[rows] for world in (some.at_hand, whole))
            np.testing.assert_array_equal(*parts, err_msg=name)
    late = some.at_hand.tabulate("late", *table[1:])
    np.testing.assert_array_equal(late, found)
    assert not some.at_hand.satellites[1030:each].any()  # no episode has these


def test_a_flight_is_computed_once_and_again_where_its_file_is_damaged(tmp_path, monkeypatch):
    made, sample = [], Headings.sample
    monkeypatch.setattr(Headings, "sample", lambda *given: made.append(1) or sample(*given))
    monkeypatch.setattr(compiling, "cache_folder", lambda layer: tmp_path)
    scenario = Scenario(flight="car", imu_rate_hz=20.0)
    first = scenario.chained_world([(0.0, CircularConstellation())])
    again = scenario.chained_world([(0.0, CircularConstellation())])
    assert len(made) == 1
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:-5000])
    third = scenario.chained_world([(0.0, CircularConstellation())])
    assert len(made) == 2
    monkeypatch.setitem(FLIGHTS, "car", lambda: car())  # a flight from outside may change unnoticed
    for _ in range(2):
        scenario.chained_world([(0.0, CircularConstellation())])
    assert len(made) == 4
    for world in (again, third):
        for name in ("run", "position_e", "C_eb", "satellites"):
            np.testing.assert_array_equal(getattr(world, name), getattr(first, name))


def test_a_look_at_some_epochs_finds_every_rise_and_set(long_flight):
    trajectory = inverse_kinematics(long_flight[0])
    for offset_s in (0.0, 30_000.0):
        sky = CircularConstellation(time_offset_s=offset_s)
        alone = build_world(trajectory, sky)
        known = look_up(sky, trajectory.time, trajectory.position_e, 12, 10.0)
        np.testing.assert_array_equal(known.visible, alone.visible)
        np.testing.assert_array_equal(known.first_elevation, alone.first_elevation)
        assert known.satellite_ids == alone.satellite_ids


def test_receivers_in_threads_build_the_skies_that_they_draw():
    settings = {"scenario": {"flight": "car", "imu_rate_hz": 20.0}, "detector": "never"}
    domain = {"worlds": 6, "constellation_time_s": (0.0, 86_400.0), "world_seed": 7}
    timeline = {"warmup_s": 4.0, "live_s": 2.0, "attack_s": 4.0, "time_to_alert_s": 1.0}
    setup = TightlyCoupledSetup(**settings, domain=domain, timeline=timeline)
    ended = []

    def fly(world):
        engine = Engine(2, setup, threads=1)
        engine.reset([np.random.default_rng(k) for k in range(2)], given={"world": world})
        ended.append((world, engine.simulator.position.copy()))

    threads = [threading.Thread(target=fly, args=(w,)) for w in (4, 1, 4, 3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    built = setup.world.at_hand.satellites.reshape(6, -1).any(axis=1)
    np.testing.assert_array_equal(built, [False, True, False, True, True, False])
    later, moved = {}, pickle.loads(pickle.dumps(setup))
    for world, _ in ended:
        engine = Engine(2, moved, threads=1)
        engine.reset([np.random.default_rng(k) for k in range(2)], given={"world": world})
        later[world] = engine.simulator.position.copy()
    assert len(ended) == 4
    for world, position in ended:
        np.testing.assert_array_equal(position, later[world])


def test_mappings_of_the_past_are_those_of_the_truth_and_begin_again_with_a_satellite():
    world = Scenario(flight="approach").world()
    table = stack_obliquities(world.elevation)
    true = compute_mappings(table, world.epoch_time, np.arange(world.epochs))
    last, found = np.zeros((1, world.channels, MAPPINGS)), []
    for k in range(world.epochs):
        elevation, _ = world.look(slice(k, k + 1))
        last = causal_mappings(elevation, world.visible[k, None], INTERVAL, last)
        found.append(last[0])
    found, both = np.array(found), world.visible[1:-1] & world.visible[:-2]
    found, true = found[1:-1][both], true[1:-1][both]
    np.testing.assert_array_equal(found[:, [0, 2, 4, 5]], true[:, [0, 2, 4, 5]])
    apart = np.abs(found - true)[:, [1, 3]].max(axis=0)
    assert (apart > 0.0).all()
    assert (apart < 4e-6).all()
    assert (np.abs(true[:, [1, 3]]).max(axis=0) > 30.0 * apart).all()
    first, second = (world.look(slice(k, k + 1))[0] for k in (100, 101))
    seen, none = np.ones((1, world.channels), dtype=bool), np.zeros((1, world.channels, MAPPINGS))
    unseen = seen.copy()
    unseen[0, 2] = False
    before = causal_mappings(first, unseen, INTERVAL, none)
    now = causal_mappings(second, seen, INTERVAL, before)
    assert not before[0, 2].any()
    assert not now[0, 2, [1, 3]].any()
    assert now[0, 3, [1, 3]].all()


@pytest.mark.parametrize(
    ("timeline", "domain", "message"),
    [
        ({"warmup_s": 500.0}, None, "takes 660.5 s .* lasts 600 s: the three take at most 599.5 s"),
        ({}, {"age_s": (60.0, 3600.0)}, "lasts 600 s: .*; `domain` and `timeline` None are those"),
        ({}, {"start_s": (0.0, 300.0)}, "from a start at 300 s .* a start is at most at 239.5 s"),
    ],
)
def test_a_flight_too_short_for_age_and_window_says_what_fits(timeline, domain, message):
    with pytest.raises(ValueError, match=message):
        TightlyCoupledSetup(scenario={"flight": "approach"}, timeline=timeline, domain=domain)


SKIES = """
from spoofgym.simulation import TightlyCoupledSetup
setup = TightlyCoupledSetup(
    scenario={"name": "aviation-actual", "flight": "en-route"}, imu_rate_hz=20.0,
    receiver="matched", domain={"worlds": 32, "turns": TURNS, "turned_deg": (0.0, 360.0),
    "constellation_time_s": (0.0, 86400.0), "start_s": (0.0, None)})
assert setup.world.axes_turning.shape == (32 * 18121, 3, 3)
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(int(status["VmHWM"].split()[0]) * 1024)
"""
"""Prints the most memory of its own [bytes]; `ru_maxrss` counts that of the process before, too."""


@pytest.mark.nightly
@pytest.mark.parametrize(("turns", "most_bytes"), [("8", 1.5e9), ("None", 1.7e9)])
def test_32_skies_of_hours_fit_into_a_process(turns, most_bytes):
    command = [sys.executable, "-c", SKIES.replace("TURNS", turns)]
    done = subprocess.run(command, capture_output=True, check=True, text=True)
    assert int(done.stdout.split()[-1]) < most_bytes
