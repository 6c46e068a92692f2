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
        patch.chdir(tmp_path_factory.mktemp("page"))
        with warnings.catch_warnings():
            if find_spec("ray"):
                # of RLlib itself, whose second algorithm in a process registers once more
                warnings.simplefilter("ignore", DeprecationWarning)
                warnings.filterwarnings("ignore", ".*rllib-multi-agent-env-v0 already in registry")
            yield play_page("rl_libraries.md", patch)


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
