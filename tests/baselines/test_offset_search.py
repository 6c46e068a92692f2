"""Open-loop attacks by offsets: the linear response, the unseen line, paired ratios."""

import numpy as np
import pytest

from baselines.offset_search import (
    OffsetsBackend,
    OffsetsReplay,
    list_offset_axes,
    unseen_line,
    unseen_ramp,
)
from spoofgym.bench.runs.play import WarmStart, induced_error, play
from spoofgym.bench.runs.world import World
from spoofgym.bench.scores.at_budget import AlarmCurve, ratio_at_budget
from spoofgym.detectors import make_detector
from spoofgym.simulation.setup import seeds_of_runs

TIMELINE = {"warmup_s": 40.0, "live_s": 20.0, "attack_s": 30.0, "time_to_alert_s": 5.0}
SCALES = [2.0, 2.0, 2.0]


@pytest.fixture(scope="module")
def world():
    attack = {"name": "offsets", "basis": "rotated", "channels": "5 of 8", "scales_mps": SCALES}
    return World.of(scenario="zhong2025", timeline=TIMELINE, attack=attack)


@pytest.fixture(scope="module")
def replay(world):
    detector = make_detector({"name": "shewhart", "thresholds": "nominal"})
    seeds = seeds_of_runs(0, "search", world.setup.name, range(3))
    return OffsetsReplay(world.setup, [detector], seeds, threads=1)


def test_curves_displace_on_the_engine_as_the_response_says(world, replay):
    rates = 0.1 * np.random.default_rng(1).normal(size=(len(list_offset_axes(world.setup)), 12))
    rates[:, 0] = 0.0  # from rest, within the attack's limit of acceleration
    curves = np.cumsum(rates, axis=1) / 4.0
    start = WarmStart(world.setup, world.generators(0, "search", 3), threads=1)
    spec = {"name": "action-curves", "curves": (curves / SCALES[0]).tolist()}
    engine = induced_error(world.setup, play(start, spec), play(start, "none"))
    linear = replay.errors(curves.reshape(1, -1), np.arange(3))[:, 0]
    assert engine.max() > 0.2
    assert np.abs(engine - linear).max() < 0.03 * engine.max()


def test_a_search_in_a_space_leaves_the_other_axes_alone(replay):
    backend = OffsetsBackend(replay, 0, "position")
    every = backend.embed(np.ones((1, backend.steps)))[0]
    still = every.reshape(-1, replay.knots).any(axis=1)
    assert still.tolist() == [True] * 3 + [False] * (len(still) - 3)
    assert np.array_equal(backend.restrict(every), np.ones(backend.steps))


def test_three_authentic_satellites_do_not_see_the_ramp_along_their_line(world, replay):
    setup, captured, onset = world.setup, np.arange(5), int(replay.onset[0])
    line = unseen_line(setup, captured, onset)
    assert np.hypot(*line[:2]) == pytest.approx(1.0)
    others = np.flatnonzero(setup.world.visible[onset])[5:]
    sight = setup.world.satellites[onset, others, :3] - setup.world.position_e[onset]
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    assert np.abs(line[3] - sight @ setup.world.C_en[onset] @ line[:3]).max() < 1e-9
    # the shift of the innovations, of a victim that follows it, by that of an east ramp
    ramps = np.zeros((2, len(list_offset_axes(setup)), replay.knots))
    ramps[0] = unseen_ramp(setup, captured, onset, replay.knots).reshape(ramps[0].shape)
    ramps[1, 1] = 1.0
    moved, error = replay.compute_shifts(ramps.reshape(2, -1), np.arange(1), frozenset())
    seen = np.abs(moved["innovation"][-1, :, 0, :8]).max(axis=1) / error[-1, :, 0]
    assert seen[0] < 0.25 * seen[1]


def test_paired_ratios_are_exact_where_one_attack_is_a_multiple_of_the_other():
    rng = np.random.default_rng(2)
    edges, sky = rng.lognormal(size=200), np.arange(200)
    values = np.geomspace(0.05, 5.0, 9)
    moved = values[:, None] * rng.uniform(1.0, 2.0, size=200)
    name, alarmed = "undetected_displacement_m", values[:, None] >= edges

    def curve(factor):
        return AlarmCurve(values, edges, {name: factor * moved}, alarmed, sky, 0.2)

    ratio = ratio_at_budget(curve(2.0), curve(1.0), 0.05)
    assert (ratio.value, ratio.low, ratio.high) == pytest.approx((2.0, 2.0, 2.0))
    other = AlarmCurve(values, edges, {name: moved}, alarmed, sky + 1, 0.2)
    with pytest.raises(ValueError, match="same runs"):
        ratio_at_budget(curve(1.0), other, 0.05)
