"""The floor of the scenarios and the frontier of one world: reference values, closed forms."""

from functools import cache, partial

import numpy as np
import pytest

from spoofgym.limits import compute_frontier, unit_commands
from spoofgym.limits.floor import Analyst, reachable, world_frontier
from spoofgym.limits.linear import record
from spoofgym.simulation import LooselyCoupledSetup

from .toy import best_commands, deflection_of, rngs_of, unwatched

SHORT = {"warmup_s": 30.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 5.0}


@cache
def frontier(scenario, sensors_known):
    return compute_frontier(unwatched(scenario=scenario), sensors_known=sensors_known)


short_setup = partial(unwatched, timeline=SHORT)


@pytest.mark.parametrize(
    ("scenario", "sensors_known", "metres"),
    [
        ("zhong2025", False, 3.25),
        ("zhong2025", True, 1.65),
        ("trolley-tactical", False, 23.6),
        pytest.param("trolley", False, 7.23, marks=pytest.mark.nightly),
        pytest.param("trolley", True, 2.93, marks=pytest.mark.nightly),
        pytest.param("zhong2025-tactical", False, 9.2, marks=pytest.mark.nightly),
    ],
)
def test_frontier_at_a_deflection_of_two(scenario, sensors_known, metres):
    said = frontier(scenario, sensors_known).assumptions[-1]
    assert ("are known" in said, "not known" in said) == (sensors_known, not sensors_known)
    (size,) = frontier(scenario, sensors_known).sizes()
    assert 2.0 * size == pytest.approx(metres, rel=0.03)


@pytest.mark.parametrize(
    ("p_fa", "p_d", "heading", "metres"),
    [(0.01, 0.06, "known", 1.25), (0.01, 0.5, "unknown", 4.6), (0.01, 0.999, "unknown", 9.8)],
)
def test_floor_of_the_flight(p_fa, p_d, heading, metres):
    floor = frontier("zhong2025", False).lower_limit_m(p_fa, p_d, heading=heading)
    assert floor == pytest.approx(metres, rel=0.03)


@pytest.mark.parametrize("scenario", ["zhong2025", "trolley-tactical"])
def test_a_false_position_stays_below_an_attack_on_every_channel(scenario):
    found = frontier(scenario, False)
    apart = found.coasting[0] - found.per_deflection[0]
    assert np.linalg.eigvalsh(apart)[0] > 0.0
    assert found.sizes()[0] < found.sizes(free=True)[0]


def test_a_course_ends_at_the_frontier_and_is_that_of_shorter_attacks():
    found = compute_frontier(short_setup(), times=4)
    np.testing.assert_allclose(found.times_s, [5.0, 10.0, 15.0, 20.0])
    np.testing.assert_allclose(found.course[:, -1], found.per_deflection, rtol=1e-9)
    for e, time in enumerate(found.times_s):
        last = round(2.0 * time) - 1
        expected = found.one.per_deflection(last, hold=10)
        np.testing.assert_allclose(found.course[0, e], expected, rtol=1e-9)
    floors = found.course_m(0.01, 0.5)
    assert floors[-1] == pytest.approx(found.lower_limit_m(0.01, 0.5))
    assert np.all(np.diff(floors) > 0.0)
    shorter = unwatched(timeline={**SHORT, "attack_s": 10.0})
    assert floors[1] == pytest.approx(compute_frontier(shorter).lower_limit_m(0.01, 0.5), rel=0.05)


def test_a_drawn_world_has_a_frontier_of_its_own():
    domain = {"turned_deg": (0.0, 360.0), "constellation_time_s": (0.0, 86_400.0), "worlds": 4}
    found = compute_frontier(short_setup(domain=domain), worlds=3)
    sizes = found.sizes()
    assert len(sizes) == 3
    assert np.ptp(sizes) > 0.0
    low, high = (found.lower_limit_m(0.01, 0.5, quantile=part) for part in (0.0, 1.0))
    assert low == pytest.approx(sizes.min() * high / sizes.max())
    # by default every sky has its run, and the median over them an interval
    found = compute_frontier(short_setup(domain=domain))
    assert len(found.sizes()) == 4
    low, high = found.lower_limit_interval_m(0.01, 0.5)
    assert low <= found.lower_limit_m(0.01, 0.5) <= high
    assert low < high
    ticks = []  # one world is enough where nothing is drawn
    found = compute_frontier(short_setup(), worlds=3, tick=ticks.append)
    assert (len(found.per_deflection), sum(ticks)) == (1, 1.0)


def test_the_frontier_is_largest_where_any_direction_counts():
    found = {
        target: compute_frontier(short_setup(target_heading_deg=target))
        for target in (0.0, 37.0, 90.0, "random", "worst")
    }
    (worst,) = found["worst"].sizes()
    drawn = found["random"].sizes()
    assert worst >= drawn.max() * (1.0 - 1e-12)
    assert drawn.max() == pytest.approx(worst, rel=0.01)
    for target in (0.0, 37.0, 90.0):
        assert drawn.min() * 0.99 <= found[target].sizes()[0] <= worst * (1.0 + 1e-12)


TWO_GRADES = {"imu": ("aviation", "tactical")}


@pytest.mark.parametrize(
    ("setup", "asked", "said"),
    [
        (
            partial(LooselyCoupledSetup, detector="never"),
            {},
            "tightly coupled receivers alone, not for a l",
        ),
        (short_setup, {"worlds": 0}, "`worlds` must be a whole number of at least 1, got 0"),
        (
            partial(short_setup, attack="meaconer"),
            {},
            "no floor is known for 'meaconer': it changes the m",
        ),
        (partial(short_setup, domain=TWO_GRADES), {}, "one grade of inertial sens"),
    ],
)
def test_other_victims_and_wrong_settings_are_refused(setup, asked, said):
    with pytest.raises(ValueError, match=said):
        compute_frontier(setup(), **asked)


EAST, NORTH = np.eye(2)[::-1]
LINE = {"warmup_s": 40.0, "live_s": 10.0, "attack_s": 30.0, "time_to_alert_s": 5.0}
RNG = np.random.default_rng(7)


@cache
def short_frontier(attack="false-position"):
    return compute_frontier(unwatched(attack=attack, timeline=LINE)).one


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
    setup = unwatched(attack=attack, timeline=LINE)
    (victim,) = record(setup, rngs_of(setup))
    (its,) = Analyst(setup).record(rngs_of(setup))
    commands = unit_commands(setup, victim.onset, 20)
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
