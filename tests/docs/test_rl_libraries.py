"""The page on RL libraries: its code runs, with short episodes and few steps."""

import re
import warnings
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest

from .pages import play, text_of

SHORT = 'timeline={"warmup_s": 20.0, "live_s": 10.0, "attack_s": 10.0, "time_to_alert_s": 2.0}'
SMALLER = [
    (r'detector="', f'{SHORT}, detector="'),
    (r"model\.learn\([\d_]+", "model.learn(320"),
    (r"n_steps=300, batch_size=600", "n_steps=10, batch_size=40"),
    (r"n_steps=300,\n    batch_size=2400", "n_steps=20,\n    batch_size=640"),
    (r"warm_pool=256", "warm_pool=16"),
    (r"world = \{", f'world = {{"timeline": {SHORT.removeprefix("timeline=")}, '),
    (r"every=100_000", "fit_runs=80, every=160"),
    (r"(evaluate\(.*)\*\*world\)", r"\1**world, runs=20, fit_runs=80)"),
    (r"range\(350\)", "range(60)"),
    (
        r"STEPS, UPDATES, EPOCHS, CLIP, LAMBDA = 16, 128, 60,",
        r"STEPS, UPDATES, EPOCHS, CLIP, LAMBDA = 16, 30, 2,",
    ),
    (r"range\((50|20)\)(?=:\n    (result|answer))", "range(2)"),
    (  # which is to alarm in some of the short episodes
        r'"snapshot-chi2", (?=knowledge="blind\+reported")',
        '{"name": "snapshot-chi2", "false_alarm": 0.99}, ',
    ),
    (r"num_cpus=2", "num_cpus=2, object_store_memory=200_000_000"),
    (r"learner=4_000, minibatch_size=500", "learner=120, minibatch_size=60"),
    (r'(?<=\{)"knowledge": ', f'"{SHORT.replace("=", chr(34) + ": ")}, "knowledge": '),
]


def play_page(name, patch):
    """With those of the smaller parts that the page has."""
    here = [(old, new) for old, new in SMALLER if re.search(old, text_of(name))]
    return play(name, patch, here)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder := tmp_path_factory.mktemp("page"))
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        with warnings.catch_warnings():
            # of Minari, which wants an author's name, and leaves a folder to the end
            warnings.filterwarnings("ignore", r"`\w+` is set to None\.", UserWarning)
            warnings.filterwarnings("ignore", "Implicitly cleaning up", ResourceWarning)
            if find_spec("ray"):
                # of RLlib itself, whose second algorithm in a process registers once more
                warnings.simplefilter("ignore", DeprecationWarning)
                warnings.filterwarnings("ignore", ".*rllib-multi-agent-env-v0 already in registry")
            played = play_page("rl_libraries.md", patch)
            vars(played).pop("collector", None)  # whose warning is to come while it is ignored
            yield played


@pytest.fixture(scope="module")
def budget(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("budget"))
        yield play_page("learn_with_budget.md", patch)


def test_the_blocks_run_in_their_order(page):
    assert len(page.undetected_m) >= 16


def test_rllib_goes_on_against_the_frozen_side_that_was_found(page):
    pytest.importorskip("ray", reason="ray is not installed: make test-ray")
    found, kept = (x.learner_group.get_weights() for x in (page.both, page.answer))
    sides = {
        side: all(np.array_equal(array, kept[side][name]) for name, array in weights.items())
        for side, weights in found.items()
    }
    assert sides == {"spoofer": False, "detector": True}


def test_a_data_set_of_minari_plays_again_to_the_bit_in_the_recovered_world(page):
    pytest.importorskip("minari", reason="minari is not installed: make test-ray")
    again, ends = page.data.recover_environment(), set()
    assert again.spec.kwargs.keys() == {"timeline", "detector", "knowledge"}
    assert (page.data.total_episodes, page.data.action_space) == (20, again.action_space)
    assert page.data.observation_space == again.observation_space
    metadata = page.data.storage.get_episode_metadata(page.data.episode_indices)
    for episode, about in zip(page.data, metadata, strict=True):
        seen, outcomes, cost = [again.reset(seed=about["seed"])[0]], [], [0.0]
        for action in episode.actions:
            observation, *outcome, info = again.step(action)
            seen.append(observation)
            outcomes.append(tuple(outcome))
            cost.append(info["cost"])
        np.testing.assert_array_equal(episode.observations, seen, strict=True)
        stored = (episode.rewards, episode.terminations, episode.truncations)
        assert list(zip(*stored, strict=True)) == outcomes
        assert episode.infos["cost"].tolist() == cost
        ends.add(sum(cost))
    assert ends == {0.0, 1.0}


def test_the_price_of_the_block_follows_the_budget(budget):
    """Up while more than the budget alarm, down while fewer do, and never below the least price."""
    pytest.importorskip("stable_baselines3")
    paid = []
    logger = SimpleNamespace(record=lambda name, value: None)
    envs = SimpleNamespace(
        set_rewards=lambda terms: paid.extend(x.penalty_m for x in terms if x.name == "alarm")
    )
    rule = budget.AlarmBudget(envs, budget=0.05, least_m=4.0, step_m=100.0)
    rule.init_callback(SimpleNamespace(logger=logger, get_env=lambda: None, num_timesteps=0))
    for costs in ([1.0, 0.0], [0.0, 0.0], [0.0, 0.0]):
        rule.locals = {"infos": [{"cost": x} for x in costs], "dones": np.ones(10)}
        rule.on_rollout_start()
        assert rule.on_step()
        rule.on_rollout_end()
    assert paid == pytest.approx([4.0, 9.0, 4.0, 4.0])
