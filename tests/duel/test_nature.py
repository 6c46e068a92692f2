"""Nature's choice: fair, hidden from the detector, and clean episodes are clean and pay nothing."""

import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.detectors.pool import NATURE, OPPONENT, draw_members, normalize_weights, uniforms
from spoofgym.duel.duel import with_world
from spoofgym.envs import SpoofEnv

from .support import ALARM, BRIEF, QUIET, aec, parallel

PUSH = np.array([0.4, 1.0])


def run(env, seed, push=PUSH, decision=QUIET):
    observations, infos = env.reset(seed=seed)
    trace = [(observations, dict.fromkeys(env.agents, 0.0), infos)]
    while env.agents:
        observations, rewards, *_, infos = env.step({"spoofer_0": push, "detector_0": decision})
        trace.append((observations, rewards, infos))
    return trace


def test_half_of_the_episodes_are_attacked():
    keys = np.random.default_rng(0).integers(0, 2**64, size=(4000, 2), dtype=np.uint64)
    nature = uniforms(keys, NATURE)
    assert abs((nature < 0.5).mean() - 0.5) < 3.0 * 0.5 / np.sqrt(4000)
    # the opponent tells nothing of it
    assert abs(np.corrcoef(nature, uniforms(keys, OPPONENT))[0, 1]) < 3.0 / np.sqrt(4000)
    share = (
        draw_members(keys, normalize_weights(3, [1.0, 0.0, 3.0]))[:, None] == np.arange(3)
    ).mean(axis=0)
    np.testing.assert_allclose(share, [0.25, 0.0, 0.75], atol=0.03)


def test_a_clean_episode_is_the_clean_run_and_pays_nothing_but_for_false_alarms():
    env = parallel(threshold=1.0)
    found = {seed: run(env, seed)[0][2]["spoofer_0"]["attacked"] for seed in range(8)}
    assert {True, False} == set(found.values())
    seed = next(seed for seed, hit in found.items() if not hit)
    reference = SpoofEnv(detector="never", action="full-command", **with_world(BRIEF))
    reference.reset(seed=seed)
    expected = [reference.step(np.zeros(2))[4]["displacement_m"] for _ in range(30)]
    trace = run(env, seed)
    own = [step[2]["spoofer_0"]["displacement_m"] for step in trace[1:]]
    np.testing.assert_array_equal(own[:30], expected)
    for _, rewards, _ in trace:
        assert rewards == {"spoofer_0": 0.0, "detector_0": 0.0}
    assert trace[-1][2]["spoofer_0"]["undetected_displacement_m"] == 0.0
    payoff = {"name": "weighted", "false_alarm": 7.0, "error_per_m": 0.0}
    env = parallel(attack_probability=0.0, payoff=payoff, threshold=0.5)
    _, (_, rewards, _) = run(env, 2, decision=ALARM)
    assert rewards == {"spoofer_0": 0.0, "detector_0": -7.0}


def test_the_detector_is_not_told_of_an_attack_and_observes_no_truth():
    """Until the measurements differ, attacked and clean episodes look alike to the detector."""
    env, clean = parallel(attack_probability=1.0), parallel(attack_probability=0.0)
    ours, theirs = run(env, 5, push=np.zeros(2)), run(clean, 5, push=np.zeros(2))
    assert len(ours) == len(theirs)
    for (mine, _, told), (other, _, also) in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(mine["detector_0"], other["detector_0"])
        assert told["detector_0"] == also["detector_0"]
        assert "attacked" not in told["detector_0"]
    # and a learner at the end alone
    view = duel_v0.DetectorView("none", **BRIEF, attack_probability=1.0, threshold=1.0)
    _, info = view.reset(seed=3)
    over = False
    while not over:
        assert not info.get("attacked")
        *_, over, _, info = view.step(QUIET)
    assert info["attacked"]
    # its observation is the same when the sensors' true errors are deleted after a measurement
    env = aec(attack_probability=1.0)
    env.reset(seed=3)
    env.step(PUSH)
    duel = env.unwrapped.duel
    assert np.isfinite(duel.observe_detector()).all()
    agent, batch, seen = duel.agent, duel.core.engine.simulator, []
    assert {*agent.memory} == {"observation", "average", "elapsed", "excluded_s"}
    for _ in range(2):
        agent.reset()
        agent.look(batch.epoch)
        seen.append(agent.memory["observation"].copy())
        batch.sensors.fields.data[:] = np.nan
    np.testing.assert_array_equal(*seen)


@pytest.mark.parametrize(("payoff", "late"), [("neyman-pearson", 0.0), ("weighted", 0.05)])
def test_the_return_is_the_undetected_displacement(payoff, late):
    trace = run(parallel(attack_probability=1.0, payoff=payoff, threshold=1.0), 2)
    paid = sum(rewards["spoofer_0"] for _, rewards, _ in trace)
    assert paid == -sum(rewards["detector_0"] for _, rewards, _ in trace)
    induced = trace[-1][2]["spoofer_0"]["undetected_displacement_m"]
    assert induced > 1.0
    assert paid == pytest.approx(induced + late * (len(trace) - 1), rel=1e-9)
