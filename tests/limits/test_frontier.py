"""The frontier of one world: closed form, and its end."""

import functools

import numpy as np
import pytest

from spoofgym.limits import compute_frontier, unit_commands
from spoofgym.limits.floor import Analyst, reachable, world_frontier
from spoofgym.limits.linear import record

from .toy import best_commands, deflection_of, rngs_of, unwatched

EAST, NORTH = np.eye(2)[::-1]
SHORT = {"warmup_s": 40.0, "live_s": 10.0, "attack_s": 30.0, "time_to_alert_s": 5.0}
RNG = np.random.default_rng(7)


@functools.cache
def short_frontier(attack="false-position"):
    return compute_frontier(unwatched(attack=attack, timeline=SHORT)).one


@pytest.mark.parametrize("columns", [3, 12])
def test_reachable_is_the_inverse_where_there_is_one(columns):
    rows, n = RNG.standard_normal((40, columns)), RNG.standard_normal((2, columns))
    np.testing.assert_allclose(reachable(rows, n), n @ np.linalg.inv(rows.T @ rows) @ n.T)


def test_commands_that_leave_no_trace_have_no_end_unless_they_move_nothing():
    rows, n = RNG.standard_normal((40, 6)), RNG.standard_normal((2, 6))
    mix = RNG.standard_normal((6, 9))  # nine commands for six effects
    found = reachable(rows @ mix, n @ mix)
    np.testing.assert_allclose(found, n @ np.linalg.inv(rows.T @ rows) @ n.T, rtol=1e-8)
    rows[:, 5] = rows[:, :5] @ [1.0, -2.0, 0.5, 0.0, 1.0]
    assert np.isinf(reachable(rows, n)).all()
    assert np.isinf(reachable(np.zeros((40, 6)), n)).all()


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


def worlds_of(attack):
    """How far commands come by the analyst of the world, and by what the victim believes."""
    setup = unwatched(attack=attack, timeline=SHORT)
    (victim,) = record(setup, rngs_of(setup))
    (its,) = Analyst(setup).record(rngs_of(setup))
    commands = unit_commands(setup, victim.onset).in_hats(20)
    return [
        world_frontier(commands, victim, run, its.coasting, setup.steps - 1).per_deflection()
        for run in (its.linear, victim)
    ]


def test_a_meaconer_moves_no_position_and_an_attack_is_easier_to_see_than_is_believed():
    # a common delay is the clock's: what is left of it in the position is next to nothing
    meaconer, _ = worlds_of("meaconer")
    sizes = [np.linalg.eigvalsh(M)[-1] for M in (meaconer, short_frontier().per_deflection())]
    assert np.sqrt(sizes[0]) < 0.05 * np.sqrt(sizes[1])
    # it delays what it repeats without a command, too, which no frontier of commands tells
    with pytest.raises(ValueError, match="when it is commanded nothing"):
        short_frontier("meaconer")
    real, believed = (np.sqrt(EAST @ each @ EAST) for each in worlds_of("false-position"))
    assert believed > 2.0 * real
