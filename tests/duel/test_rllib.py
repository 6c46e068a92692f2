"""RLlib: its own check of environments of many agents, and a policy for each side of the duel."""

from importlib.util import find_spec

import numpy as np
import pytest

from .support import QUIET, SHORT, parallel

pytestmark = [
    pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed: make test-ray"),
    # of RLlib itself, whose second algorithm in a process registers once more
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.*rllib-multi-agent-env-v0 already in registry"),
]
VARIANTS = [
    {},
    {"statistic": "channel", "payoff": "weighted", "knowledge": "oracle", "threshold": 0.9},
    {"weighs": False, "attack": {"name": "per-channel", "control": "rate"}},
]
SIDES = ("spoofer", "detector")


def wrapped(**kwargs):
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

    return ParallelPettingZooEnv(parallel(**kwargs))


@pytest.mark.parametrize("kwargs", VARIANTS)
def test_rllibs_pre_check(kwargs):
    from ray.rllib.utils.pre_checks.env import check_multiagent_environments

    check_multiagent_environments(wrapped(**kwargs))


def test_an_episode_ends_for_all_as_rllib_counts():
    env = wrapped()
    env.reset(seed=3)
    ends = []
    while not any(ends):
        actions = {"spoofer_0": np.array([0.0, 1.0]), "detector_0": QUIET}
        _, _, terminated, truncated, _ = env.step(actions)
        assert truncated["__all__"] is False
        ends.append(terminated["__all__"])
    assert len(ends) == (SHORT["attack_s"] + SHORT["time_to_alert_s"]) / 0.5


@pytest.fixture(scope="module")
def cluster():
    """Two processors and little memory; without runners of its own RLlib plays in this process."""
    import ray

    ray.init(num_cpus=2, object_store_memory=200_000_000, include_dashboard=False)
    yield
    ray.shutdown()


def weights_of(algorithm, side):
    state = algorithm.get_module(side).state_dict()
    return {name: array.clone() for name, array in state.items()}


def moved(before, after):
    return any(not np.array_equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize("learning", [SIDES, ("spoofer",)])
def test_the_sides_that_are_to_learn_do_and_no_other(cluster, learning):
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec
    from ray.tune.registry import register_env

    register_env("duel", lambda settings: wrapped(**settings))
    specs = {side: RLModuleSpec() for side in SIDES}
    config = (
        PPOConfig()
        .environment("duel", env_config={"threshold": 0.99})
        .env_runners(num_env_runners=0)
        .multi_agent(
            policies=set(SIDES),
            policy_mapping_fn=lambda agent, episode, **_: agent.removesuffix("_0"),
            policies_to_train=list(learning),
        )
        .rl_module(rl_module_spec=MultiRLModuleSpec(rl_module_specs=specs))
        .training(gamma=1.0, train_batch_size_per_learner=120, minibatch_size=60, num_epochs=1)
        .debugging(seed=1)
    )
    algorithm = config.build_algo()
    before = {side: weights_of(algorithm, side) for side in SIDES}
    for _ in range(2):
        result = algorithm.train()["env_runners"]
    after = {side: weights_of(algorithm, side) for side in SIDES}
    algorithm.stop()
    assert tuple(side for side in SIDES if moved(before[side], after[side])) == learning
    assert result["num_env_steps_sampled_lifetime"] >= 240
    returns = result["module_episode_returns_mean"]
    assert returns["spoofer"] == pytest.approx(-returns["detector"])
