"""The filter that knows the world: white innovations, and the frontier on runs of the simulator."""

import copy

import numpy as np
import pytest

from spoofgym.limits import Analyst, Commands, compute_frontier, floor
from spoofgym.limits.floor import world_frontier
from spoofgym.limits.linear import observer

from ..nightly import heavy
from .toy import best_commands, rates_of, rngs_of, unwatched

LINE = {"warmup_s": 60.0, "live_s": 10.0, "attack_s": 60.0, "time_to_alert_s": 2.0}
DRAWN = {"turn_on": "drawn"}
SCENARIOS = ["zhong2025", "trolley"]
WANDERING = {"name": "trolley-tactical", "imu_rate_hz": 20.0, "in_run": "wandering"}
EAST = np.array([0.0, 1.0])


def whitened(epoch):
    factor = np.linalg.cholesky(epoch.innovation_cov)
    return np.linalg.solve(factor, epoch.innovation[:, :, None])[:, :, 0]


def every_channel(run):
    """Commands that are offsets of every visible measurement at every epoch, one by one."""
    epochs, m = run.design.shape[:2]
    seen = np.tile(run.visible, 2)
    offsets = np.zeros((epochs, m, int(seen.sum())))
    for column, (k, i) in enumerate(np.argwhere(seen)):
        offsets[k, i, column] = 1.0
    return Commands(offsets, np.zeros((epochs, m)), 1, None, 1.0, 1.0)


@pytest.mark.parametrize(
    ("scenario", "hold_s", "sensors_known"),
    [
        ("trolley", 2.0, False),
        (WANDERING, 0.0, True),
        pytest.param("zhong2025", 0.0, True, marks=pytest.mark.nightly),
    ],
)
def test_where_every_channel_is_free_the_frontier_is_the_spread_of_a_coasting_twin(
    scenario, hold_s, sensors_known, monkeypatch
):
    line = {**LINE, "attack_s": 8.0, "time_to_alert_s": hold_s}
    setup = unwatched(scenario=scenario, timeline=line)

    def found():
        (its,) = Analyst(setup, sensors_known=sensors_known).record(rngs_of(setup, 1))
        run, last = its.linear, setup.steps - 1
        frontier = world_frontier(every_channel(run), run, run, its.coasting, last)
        return frontier.per_deflection(), its.coasting[last, :2, :2]

    # the receiver mechanizes to second order, which its filter leaves out
    really, coasting = found()
    assert np.abs(really - coasting).max() < 0.01 * np.trace(coasting)
    # in a world that is the filter's own they are the same to all digits
    monkeypatch.setattr(floor, "as_it_happens", lambda run, world: run)
    np.testing.assert_allclose(*found(), rtol=1e-6)


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_twin_without_measurements_drifts_as_the_closed_form_says(scenario):
    runs = 96
    setup = unwatched(scenario=scenario, domain=DRAWN)
    analyst = Analyst(setup)
    coasting = analyst.record(rngs_of(setup, 1))[0].coasting[setup.steps - 1]
    fed = analyst.start_simulator(rngs_of(setup, runs))
    fed.run_filter_only(setup.onset)
    starved = copy.deepcopy(fed)
    nothing = np.zeros((runs, 2 * setup.world.channels))
    for _ in range(setup.steps):
        fed.advance()
        fed.update(None)
        seen = np.tile(starved.advance().visible, 2)
        starved.update(np.where(seen, nothing, 1.0))
    axes = setup.C_en[fed.epochs]
    apart = np.einsum("bij,bi->bj", axes, starved.position - fed.position)[:, :2]
    slack = 0.05 + 3.0 / np.sqrt(2.0 * (runs - 1))
    expected = np.sqrt(np.diag(coasting)[:2])
    np.testing.assert_allclose(apart.std(axis=0, ddof=1), expected, rtol=slack)
    assert (np.abs(apart.mean(axis=0)) < 4.0 * expected / np.sqrt(runs)).all()


@pytest.mark.parametrize(
    ("scenario", "runs", "line"),
    [
        ("trolley", 40, LINE),
        *(pytest.param(each, 100, None, marks=pytest.mark.nightly) for each in SCENARIOS),
    ],
)
def test_innovations_are_white_on_runs_that_are_not_linear(scenario, runs, line):
    setup = unwatched(scenario=scenario, domain=DRAWN, timeline=line)
    simulator = Analyst(setup).start_simulator(rngs_of(setup, runs))
    simulator.run_filter_only(setup.onset)
    seen, count = [], 0
    for _ in range(setup.steps + setup.hold):
        epoch = simulator.advance()
        seen.append(whitened(epoch))
        count += 2 * int(epoch.visible.sum())
        simulator.update(None)
    y = np.array(seen)
    assert count > 4000 * runs or line
    assert (y * y).sum() / count == pytest.approx(1.0, abs=0.01)
    assert abs((y[1:] * y[:-1]).sum() / (y[1:] != 0.0).sum()) < 0.01


def attacked(simulator, actions):
    """(K, R, m) whitened innovations and (K, R, 3) positions of receivers under commands."""
    setup = simulator.setup
    simulator.run_filter_only(setup.onset)
    seen, moved = [], []
    for k in range(setup.steps + setup.hold):
        command = None
        if k < setup.steps:
            command = np.repeat(actions[k // setup.repeat][None], simulator.receivers, axis=0)
        seen.append(whitened(simulator.predict(command)))
        simulator.update(None)
        moved.append(simulator.position.copy())
    return np.array(seen), np.array(moved)


def test_best_commands_shift_the_statistic_by_d_and_the_victim_to_the_frontier():
    runs, d = 8, 2.0
    rate = {"name": "false-position", "control": "rate"}
    setup = unwatched(domain=DRAWN, attack=rate, timeline=LINE)
    found = compute_frontier(setup).one
    u = best_commands(found, EAST, d)
    actions = rates_of(found.commands) @ u / setup.attack.rate_limit_mps
    shift = found.whitened @ u
    assert np.linalg.norm(shift) == pytest.approx(d)
    statistics, places = [], []
    for each in (actions, np.zeros_like(actions)):
        y, _ = attacked(Analyst(setup).start_simulator(rngs_of(setup, runs)), each)
        statistics.append(np.einsum("km,krm->r", shift / d, y))
        victim = observer(setup, runs)
        victim.start_episodes(rngs_of(setup, runs))
        places.append(attacked(victim, each)[1][found.last])
    np.testing.assert_allclose((statistics[0] - statistics[1]).mean(), d, rtol=0.01)
    axes = setup.C_en[victim.onset + setup.steps]
    moved = np.einsum("bij,bi->bj", axes, places[0] - places[1])[:, 1]
    size = float(EAST @ found.victim.position[found.last, :2] @ u)
    assert size == pytest.approx(d * np.sqrt(EAST @ found.per_deflection() @ EAST))
    np.testing.assert_allclose(moved.mean(), size, rtol=0.01)
    assert moved.std() < 0.01 * size


@pytest.mark.parametrize(
    "scenario", heavy(["trolley-tactical", "aviation-actual"], "aviation-actual")
)
def test_a_shift_of_the_analyst_is_that_of_its_filter_on_the_simulator(scenario):
    setup = unwatched(
        scenario={"name": scenario, "events": None},
        attack={"name": "false-position", "control": "rate"},
        timeline=LINE,
    )
    found, d = compute_frontier(setup).one, 2.0
    u = best_commands(found, EAST, d)
    actions = rates_of(found.commands) @ u / setup.attack.rate_limit_mps
    both = (
        attacked(Analyst(setup).start_simulator(rngs_of(setup, 1)), each)[0][:, 0]
        for each in (actions, 0.0 * actions)
    )
    seen = np.subtract(*both)
    np.testing.assert_allclose(np.linalg.norm(seen), d, rtol=0.1)
    assert np.linalg.norm(seen - found.whitened @ u) < 0.25 * d
