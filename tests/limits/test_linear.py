"""The response of a filter, against the simulator whose clean run it is of."""

import numpy as np
import pytest

from spoofgym.limits import record, respond, unit_commands
from spoofgym.limits.linear import mechanize_transition, observer

from .toy import rngs_of, toy_run, unwatched

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
    ("scenario", "receiver"),
    [("trolley-consumer", "paper"), ("trolley", "matched")],
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
    np.testing.assert_allclose(mechanize_transition((np.eye(3) + F * tau)[None])[0], exact)
