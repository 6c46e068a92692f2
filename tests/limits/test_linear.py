"""Responses of a filter and what commands add to its measurements, against the simulator."""

from dataclasses import dataclass

import numpy as np
import pytest

from spoofgym.attacks.commands import FalsePosition
from spoofgym.limits import record, respond, unit_commands
from spoofgym.limits.linear import hat_functions, mechanize_transition, observer
from spoofgym.simulation.simulator import run_serially

from .toy import rates_of, rngs_of, toy_run, unwatched

SHORT = {"warmup_s": 60.0, "live_s": 10.0, "attack_s": 60.0, "time_to_alert_s": 5.0}


def played(setup, actions):
    """(K, m) innovations and (K, 3) positions of a receiver under commands."""
    simulator = observer(setup, 1)
    simulator.start_episodes(rngs_of(setup))
    simulator.run_filter_only(setup.onset)
    seen, place = [], []
    for k in range(setup.steps + setup.hold):
        command = actions[k][None] if k < setup.steps else None
        seen.append(np.array(simulator.predict(command).innovation[0]))
        simulator.update(None)
        axes = setup.C_en[simulator.epochs[0]]
        place.append(simulator.position[0] @ axes)
    return np.array(seen), np.array(place)


@pytest.mark.parametrize(
    ("scenario", "receiver"), [("trolley-consumer", "paper"), ("trolley", "matched")]
)
def test_innovations_and_position_move_as_the_simulator_s(scenario, receiver):
    attack = {"name": "false-position", "control": "rate"}
    setup = unwatched(scenario=scenario, receiver=receiver, attack=attack, timeline=SHORT)
    (run,) = record(setup, rngs_of(setup))
    t = np.linspace(0.0, 1.0, setup.steps)
    rates = 0.3 * np.stack([t, np.sin(4.0 * t)], axis=1)
    both = (played(setup, each / setup.attack.rate_limit_mps) for each in (rates, 0.0 * rates))
    innovation, place = (attacked - clean for attacked, clean in zip(*both, strict=True))
    offsets = unit_commands(setup, run.onset).offsets @ rates.ravel()
    found = respond(run, offsets[:, :, None])
    np.testing.assert_allclose(found.position[:, :, 0], place, atol=5e-4 * np.abs(place).max())
    n = innovation.shape[1] // 2
    for rows, part in ((slice(0, n), 0.01), (slice(n, None), 0.06)):
        size = np.abs(innovation[:, rows]).max()
        np.testing.assert_allclose(
            found.innovation[:, rows, 0], innovation[:, rows], atol=part * size
        )


def test_responses_add_up_and_a_tilt_becomes_a_position_within_one_epoch():
    run, rng = toy_run(epochs=12), np.random.default_rng(1)
    offsets, u = rng.standard_normal((12, 8, 5)), rng.standard_normal(5)
    offsets[:7] = 0.0
    parts, whole = respond(run, offsets), respond(run, (offsets @ u)[:, :, None])
    for part, each in zip(parts, whole, strict=True):
        np.testing.assert_allclose(part @ u, each[:, :, 0], atol=1e-12)
    assert not parts.innovation[:7].any()
    assert parts.innovation[7].any()
    still = respond(run._replace(gain=0.0 * run.gain), offsets)  # only propagates
    np.testing.assert_array_equal(still.innovation, offsets)
    assert not still.position.any()
    tau, g = 0.5, 9.8
    F = np.zeros((3, 3))  # tilt, velocity, position
    F[1, 0], F[2, 1] = g, 1.0
    exact = np.eye(3) + F * tau + F @ F * tau**2 / 2.0
    transition = np.tile(np.eye(3) + F * tau, (40, 1, 1))
    mechanize_transition(transition)
    np.testing.assert_allclose(transition, np.tile(exact, (40, 1, 1)))


BRIEF = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 5.0}
LATE = {"delay_s": 6.0, "alignment_m": None}
ATTACKS = {
    "false position": {"name": "false-position"},
    "per channel": {"name": "per-channel"},
    "incoherent": {"name": "false-position", "coherent": False},
    "captured late": {"name": "false-position", "capture": LATE},
    "meaconer": {"name": "meaconer", "antenna_m": [3.0, 20.0, 0.0]},
}


def setup_of(attack="false-position", **settings):
    return unwatched(attack=attack, timeline=BRIEF, **{"scenario": "zhong2025", **settings})


def at_onset(setup, world=0):
    simulator = setup.copy_with(detector=setup.detector).simulator(1, run_serially)
    simulator.start_episodes([np.random.default_rng(0)], {"world": world})
    simulator.run_filter_only(setup.onset)
    return simulator


def added(setup, actions, world=0):
    """(K, m) what a sequence of actions (decisions, a) adds to the measurements of a receiver."""
    simulator, found = at_onset(setup, world), []
    before = np.zeros((1, actions.shape[1]))
    for k in range(setup.steps + setup.hold):
        command = None
        if k < setup.steps:
            decision, since = divmod(k, setup.repeat)
            action = actions[decision][None]
            command = np.ascontiguousarray(setup.command(before, action, since))
            before = action if since == setup.repeat - 1 else before
        epoch = simulator.predict(command)
        seen = np.tile(np.array(epoch.visible[0]), 2)
        offset = np.r_[simulator.sensors.range_offset[0], simulator.sensors.rate_offset[0]]
        found.append(offset * seen)
        simulator.update(None)
    return np.array(found)


def some_rates(setup, commands, seed=0):
    """(decisions, axes) smooth rates within the limits, forward as one-sided attacks want them."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.0, 1.0, (commands.decisions, commands.axes))
    least = min(commands.change_limit_mps, 0.02 * commands.rate_limit_mps)
    return 0.5 * least * np.cumsum(steps, axis=0)


def assert_same_offsets(commands, found, rates):
    expected = commands.offsets @ rates.ravel() + commands.idle
    n = expected.shape[1] // 2
    for rows in (slice(0, n), slice(n, None)):
        size = np.abs(found[:, rows] - commands.idle[:, rows]).max()
        np.testing.assert_allclose(expected[:, rows], found[:, rows], atol=1e-5 * size + 1e-9)


@pytest.mark.parametrize(("every_s", "between"), [(None, "hold"), (10.0, "linear")])
@pytest.mark.parametrize("attack", ATTACKS.values(), ids=ATTACKS)
def test_offsets_are_what_the_attack_makes_of_its_rates(attack, every_s, between):
    setup = setup_of({**attack, "control": "rate"}, decision_interval_s=every_s, between=between)
    commands = unit_commands(setup, at_onset(setup).onset[0])
    assert commands.change_limit_mps == np.inf
    rates = some_rates(setup, commands)
    found = added(setup, rates / commands.rate_limit_mps)
    assert_same_offsets(commands, found, rates)
    assert np.abs(found).max() > 0.1


@pytest.mark.parametrize("every_s", [None, 10.0])
def test_a_rate_that_comes_by_acceleration_is_reached_at_the_end_of_its_decision(every_s):
    setup = setup_of(decision_interval_s=every_s)
    commands = unit_commands(setup, at_onset(setup).onset[0])
    limit = setup.attack.acceleration_limit_mps2 * (every_s or setup.interval_s)
    assert commands.change_limit_mps == pytest.approx(limit)
    rates = some_rates(setup, commands)
    actions = np.diff(rates, axis=0, prepend=0.0) / commands.change_limit_mps
    assert np.abs(actions).max() <= 1.0
    assert_same_offsets(commands, added(setup, actions), rates)


def test_a_meaconer_moves_the_victim_when_it_is_idle_and_only_the_clock_when_commanded():
    setup = setup_of(ATTACKS["meaconer"])
    commands = unit_commands(setup, at_onset(setup).onset[0])
    assert commands.heading is None
    world, n = setup.world, setup.world.channels
    for k in (0, 30):
        at = at_onset(setup).onset[0] + k + 1
        here, sats = world.position_e[at], world.satellites[at, :, :3]
        there = here + world.C_en[at] @ [3.0, 20.0, 0.0]
        ranges = [np.linalg.norm(sats - place, axis=1) for place in (there, here)]
        away = np.where(world.visible[at], ranges[0] - ranges[1] + np.hypot(3.0, 20.0), 0.0)
        np.testing.assert_allclose(commands.idle[k, :n], away, atol=2e-3)
    seen = np.tile(world.visible[at], 2)
    assert (np.ptp(commands.offsets[:, :n][:, seen[:n]], axis=1) < 1e-9).all()
    assert not np.any(unit_commands(setup_of(), at_onset(setup).onset[0]).idle)


def test_satellites_that_rise_or_set_have_no_offset_out_of_view():
    world = 5
    sky = {"turned_deg": (0.0, 0.0), "constellation_time_s": (0.0, 86_400.0), "worlds": 32}
    long = {"warmup_s": 200.0, "live_s": 20.0, "attack_s": 130.0, "time_to_alert_s": 5.0}
    setup = unwatched(domain=sky, timeline=long)
    simulator = at_onset(setup, world)
    commands = unit_commands(setup, simulator.onset[0])
    after = simulator.onset[0] + 1 + np.arange(len(commands.offsets))
    seen = setup.world.visible[after]
    assert (seen.any(axis=0) & ~seen.all(axis=0)).any()
    hidden = np.tile(~seen, 2)
    assert not np.any(commands.offsets[hidden])
    rates = some_rates(setup, commands)
    actions = np.diff(rates, axis=0, prepend=0.0) / commands.change_limit_mps
    found = added(setup, actions, world)
    expected = commands.offsets @ rates.ravel()
    np.testing.assert_allclose(expected, found, atol=1e-4 * np.abs(found).max())


def test_commands_in_hats_do_what_their_rates_do():
    hats, line = hat_functions(40, 9), np.linspace(1.0, 3.0, 9)
    np.testing.assert_allclose(hats.sum(axis=1), 1.0)
    np.testing.assert_allclose(hats.max(axis=0)[[0, -1]], 1.0)
    np.testing.assert_allclose(hats @ line, np.linspace(1.0, 3.0, 40))
    np.testing.assert_array_equal(hat_functions(9, 9), np.eye(9))
    setup = setup_of()
    commands = unit_commands(setup, at_onset(setup).onset[0])
    np.testing.assert_array_equal(commands.heading, np.eye(2))
    few = unit_commands(setup, at_onset(setup).onset[0], 7)
    assert (few.offsets.shape[2], few.decisions, few.axes) == (14, commands.decisions, 2)
    u = np.random.default_rng(2).standard_normal(14)
    rates = rates_of(few) @ u
    # ranges of 2e7 m are exact to some 4e-9 m
    np.testing.assert_allclose(few.offsets @ u, commands.offsets @ rates.ravel(), atol=1e-6)
    all_of_them = unit_commands(setup, at_onset(setup).onset[0], commands.decisions)
    assert all_of_them.hats is None
    np.testing.assert_array_equal(all_of_them.offsets, commands.offsets)


@dataclass(kw_only=True)
class Squared(FalsePosition):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        super().command(action, epochs, d_range, d_rate, lo, hi)
        d_range[lo:hi] **= 2


def test_an_attack_that_is_not_linear_is_refused():
    setup = setup_of(Squared())
    with pytest.raises(ValueError, match=r"is not linear in its commands: .* at most 2 % is"):
        unit_commands(setup, at_onset(setup).onset[0])
