"""The frontier of one world: closed form, and its end."""

import functools

import numpy as np
import pytest

from spoofgym.limits import WorldFrontier, compute_frontier, unit_commands
from spoofgym.limits.floor import Analyst, reachable, world_frontier
from spoofgym.limits.linear import Commands, record
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.setup import make_generators, seeds_of_runs

from .toy import best_commands, deflection_of, toy_run

EAST, NORTH = np.eye(2)[::-1]
SHORT = {"warmup_s": 40.0, "live_s": 10.0, "attack_s": 30.0, "time_to_alert_s": 5.0}
RNG = np.random.default_rng(7)


@functools.cache
def short_frontier(attack="false-position"):
    return compute_frontier(
        TightlyCoupledSetup(detector="never", attack=attack, timeline=SHORT)
    ).one


@pytest.mark.parametrize("columns", [3, 12])
def test_reachable_is_the_inverse_where_there_is_one(columns):
    rows, n = RNG.standard_normal((40, columns)), RNG.standard_normal((2, columns))
    np.testing.assert_allclose(reachable(rows, n), n @ np.linalg.inv(rows.T @ rows) @ n.T)


def test_commands_that_leave_no_trace_but_move_the_victim_have_no_end():
    rows, n = RNG.standard_normal((40, 6)), RNG.standard_normal((2, 6))
    rows[:, 5] = rows[:, :5] @ [1.0, -2.0, 0.5, 0.0, 1.0]
    assert np.isinf(reachable(rows, n)).all()
    assert np.isinf(reachable(np.zeros((40, 6)), n)).all()


def test_commands_that_leave_no_trace_and_move_nothing_change_nothing():
    rows, n = RNG.standard_normal((40, 6)), RNG.standard_normal((2, 6))
    mix = RNG.standard_normal((6, 9))  # nine commands for six effects
    found = reachable(rows @ mix, n @ mix)
    np.testing.assert_allclose(found, n @ np.linalg.inv(rows.T @ rows) @ n.T, rtol=1e-8)


def toy_frontier(traces):
    """Steps north, east, and of nothing; what the analyst sees of each is multiplied."""
    run = toy_run(epochs=20)
    epochs, m = run.design.shape[:2]
    offsets = np.zeros((epochs, m, 3))
    offsets[:, : m // 2, :2] = -run.design[:, : m // 2, 6:8]
    commands = Commands(offsets, np.zeros((epochs, m)), 3, None, 1.0, 1.0)
    found = world_frontier(commands, run, run, np.zeros((epochs, 3, 3)), epochs - 1)
    return WorldFrontier(
        commands, found.whitened * np.array(traces), found.victim, found.last, found.coasting
    )


def test_a_command_that_nobody_sees_and_that_moves_the_victim_has_no_end():
    found = toy_frontier([1.0, 1.0, 1.0])
    assert np.isfinite(found.per_deflection()).all()
    assert np.isinf(toy_frontier([1.0, 0.0, 1.0]).per_deflection()).all()


def test_the_best_commands_leave_alone_what_does_nothing():
    found = toy_frontier([1.0, 1.0, 1.0])
    u = best_commands(found, EAST, 2.0)
    assert u[2] == 0.0
    assert deflection_of(found, u)[-1] == pytest.approx(2.0)


@pytest.mark.parametrize("direction", [EAST, NORTH, np.array([0.6, -0.8])])
def test_the_best_commands_have_the_deflection_and_come_as_far_as_the_frontier(direction):
    found = short_frontier()
    u = best_commands(found, direction, 1.5)
    far = direction @ found.victim.position[found.last, :2] @ u
    assert far == pytest.approx(1.5 * np.sqrt(direction @ found.per_deflection() @ direction))
    d = deflection_of(found, u)
    assert len(d) == len(found.whitened)
    assert (np.diff(d) >= 0.0).all()
    assert d[-1] == pytest.approx(1.5)
    other = RNG.standard_normal(len(u)) * np.abs(u).max()
    shift = abs(direction @ found.victim.position[found.last, :2] @ other)
    assert shift < far * deflection_of(found, other)[-1] / 1.5


def test_later_epochs_and_a_tested_hold_can_only_help_the_detector():
    found = short_frontier()
    hold = len(found.whitened) - found.last - 1
    sizes = [EAST @ found.per_deflection(hold=each) @ EAST for each in (0, hold // 2, hold)]
    assert sizes[0] > sizes[1] > sizes[2]
    assert sizes[2] == pytest.approx(EAST @ found.per_deflection() @ EAST)
    earlier = EAST @ found.per_deflection(last=found.last // 2, hold=0) @ EAST
    assert earlier < sizes[0]


def test_the_more_an_attack_can_command_the_farther_it_gets():
    one, each = short_frontier(), short_frontier("per-channel")
    sizes = [np.linalg.eigvalsh(M) for M in (one.per_deflection(), each.per_deflection())]
    free = np.linalg.eigvalsh(one.coasting)
    assert (sizes[0] < sizes[1]).all()
    assert (sizes[1] < free * (1.0 + 1e-9)).all()
    assert deflection_of(each, best_commands(each, EAST, 1.0))[-1] == pytest.approx(1.0)


def test_a_meaconer_that_commands_its_delay_alone_moves_no_position():
    # a common delay is the clock's: what is left of it in the position is next to nothing
    setup = TightlyCoupledSetup(detector="never", attack="meaconer", timeline=SHORT)
    seeds = seeds_of_runs(0, "selection", setup.name, [0])
    (victim,) = record(setup, make_generators(seeds))
    (its,) = Analyst(setup).record(make_generators(seeds))
    commands = unit_commands(setup, victim.onset).in_hats(20)
    meaconer = world_frontier(commands, victim, its.linear, its.coasting, setup.steps - 1)
    sizes = [
        np.sqrt(np.linalg.eigvalsh(each.per_deflection())[-1])
        for each in (meaconer, short_frontier())
    ]
    assert sizes[0] < 0.05 * sizes[1]
    # it delays what it repeats without a command, too, which no frontier of commands tells
    with pytest.raises(ValueError, match="when it is commanded nothing"):
        short_frontier("meaconer")


def test_the_frontier_needs_the_analyst_of_the_world():
    setup = TightlyCoupledSetup(detector="never", timeline=SHORT)
    seeds = seeds_of_runs(0, "selection", setup.name, [0])
    (victim,) = record(setup, make_generators(seeds))
    (its,) = Analyst(setup).record(make_generators(seeds_of_runs(0, "selection", setup.name, [0])))
    commands = unit_commands(setup, victim.onset).in_hats(20)
    # by what the victim believes, an attack seems harder to see than it is
    believed = world_frontier(commands, victim, victim, its.coasting, setup.steps - 1)
    real = world_frontier(commands, victim, its.linear, its.coasting, setup.steps - 1)
    believed, real = (np.sqrt(EAST @ each.per_deflection() @ EAST) for each in (believed, real))
    assert believed > 2.0 * real
