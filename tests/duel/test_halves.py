"""The duel's two halves are the engine's: an agent that repeats a detector gets its runs."""

import numpy as np
import pytest

from spoofgym.envs import SpoofEnv

from .support import PAPERS, SHORT, Late, PerSatellite, aec, as_action, bound, parallel

NO_LIVE = {**SHORT, "live_s": 0.0}
"""Nobody asks an agent in the warm-up, so the detector must not judge there either."""
STRONG = {"name": "false-position", "acceleration_limit_mps2": 1.0}
PUSH = [0.02, 0.6]
"""Without and with an alarm in the world of the papers."""


def reference(detector, push, seed):
    env = SpoofEnv(
        **PAPERS,
        detector=detector,
        timeline=NO_LIVE,
        attack=STRONG,
        alarm_price=0.0,
        action="full-command",
    )
    env.reset(seed=seed)
    displacement, over, info = [], False, {}
    while not over:
        _, _, over, _, info = env.step(np.array([0.0, push]))
        displacement.append(info["displacement_m"])
    return np.array(displacement), info


def played(duel, epoch_of, push, seed):
    agent = bound(PerSatellite(), duel.unwrapped.duel)
    duel.reset(seed=seed)
    displacement, total = [], 0.0
    for name in duel.agent_iter():
        _, reward, over, _, info = duel.last()
        if name == "spoofer_0":
            total += reward
            if "displacement_m" in info:
                displacement.append(info["displacement_m"])
            duel.step(None if over else np.array([0.0, push]))
        else:
            duel.step(None if over else as_action(agent.judge(epoch_of(duel))))
        if over and name == "spoofer_0":
            last = info
    return np.array(displacement), last, total


@pytest.mark.parametrize("push", PUSH)
def test_the_aec_form_with_an_agent_of_ewma_is_the_env_with_ewma(push):
    expected, info = reference(PerSatellite(), push, 4)
    duel = aec(
        **PAPERS,
        timeline=NO_LIVE,
        attack=STRONG,
        attack_probability=1.0,
        threshold=0.5,
        exclusion_s=None,
    )
    own, last, total = played(duel, lambda d: d.unwrapped.duel.core.engine.simulator.epoch, push, 4)
    assert info["detected"] == (push == PUSH[1])
    n = len(expected)
    np.testing.assert_array_equal(own[:n], expected)
    assert len(own) == n + (0 if info["detected"] else duel.unwrapped.duel.setup.hold)
    assert last["undetected_displacement_m"] == info["undetected_displacement_m"]
    assert total == pytest.approx(last["undetected_displacement_m"], rel=1e-12)


@pytest.mark.parametrize("push", PUSH)
def test_the_parallel_form_is_the_env_with_ewma_one_epoch_late(push):
    expected, info = reference(Late(), push, 4)
    duel = parallel(
        **PAPERS,
        timeline=NO_LIVE,
        attack=STRONG,
        attack_probability=1.0,
        threshold=0.5,
        exclusion_s=None,
    )
    core = duel.duel
    agent = bound(PerSatellite(), core)
    duel.reset(seed=4)
    decision, displacement, last = np.r_[-1.0, np.ones(12)], [], {}
    while duel.agents:
        actions = {"detector_0": decision, "spoofer_0": np.array([0.0, push])}
        *_, infos = duel.step(actions)
        # what has been decided on this epoch comes into force in the next one
        epoch = core.core.engine.simulator.epoch
        decision = as_action(agent.judge(epoch))
        last = infos["spoofer_0"]
        displacement.append(last["displacement_m"])
    np.testing.assert_array_equal(displacement[: len(expected)], expected)
    assert last["undetected_displacement_m"] == info["undetected_displacement_m"]
    assert info["detected"] == (push == PUSH[1])


def test_the_two_forms_are_two_games():
    on_time, late = reference(PerSatellite(), 0.6, 4)[0], reference(Late(), 0.6, 4)[0]
    assert len(on_time) < len(late)
