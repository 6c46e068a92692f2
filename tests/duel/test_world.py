"""The world of a duel: the default one, a given one, and what a reset is told of it."""

import inspect

import gymnasium as gym
import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.duel.duel import PACE, make_duel, with_world
from spoofgym.duel.learner import LearnersSide
from spoofgym.duel.opponents import label_opponent
from spoofgym.envs import SpoofEnv
from spoofgym.tasks import DEFAULT_TASK, get_task

from .support import BRIEF, ONE_SKY, SHORT, aec, parallel

TASK = get_task(DEFAULT_TASK)
GAME, PAPERS = TASK.world_kwargs, "zhong2025"
UNPACED = {key: x for key, x in GAME.items() if key not in PACE}
REFERENCE = {key: x for key, x in TASK.detector.items() if key != "false_alarms_per_hour"}
SMALL = {"timeline": {**SHORT, "attack_s": 20.0}, "domain": ONE_SKY}  # whole decisions
NAMED = "spoofgym/Zhong2025-v0"


@pytest.mark.parametrize(
    ("given", "same", "met"),
    [
        ({}, GAME, REFERENCE),
        ({"scenario": PAPERS}, {}, "ewma"),
        (
            {"receiver": "paper", "domain": None},
            {**GAME, "receiver": "paper", "domain": None},
            REFERENCE,
        ),
    ],
)
def test_all_forms_are_played_in_the_world_that_is_given_or_in_the_default_one(given, same, met):
    own = {**SMALL, **given}
    expected = SpoofEnv(**{**same, **own}).core.setup.world_settings()
    for setup in (
        make_duel(1, **own).setup,
        duel_v0.SpooferView(**own).core.setup,
        duel_v0.DetectorView(**own).core.duel.setup,
        gym.make("spoofgym/SpooferView-v0", **own).unwrapped.core.setup,
    ):
        assert setup.world_settings() == expected
    assert duel_v0.SpooferVectorView(2, **own).opponents == [label_opponent(met)] * 2
    assert side_of("spoofgym/SpooferView-v0", **given).pool == met


def side_of(env_id=None, task=None, side="spoofer", pool=None, weights=None, **settings):
    return LearnersSide.of(env_id, task, side, pool, weights, settings)


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({}, TASK.env_kwargs),
        ({"pool": ["ewma"]}, GAME),
        ({"pool": ["ewma"], "scenario": None}, GAME),
        ({"side": "detector"}, UNPACED),
        ({"env_id": "spoofgym/DetectorView-v0"}, UNPACED),
        ({"env_id": NAMED, "pool": ["ewma"]}, {"scenario": PAPERS}),
        ({"env_id": NAMED, "pool": ["ewma"], "scenario": None}, {"scenario": PAPERS}),
        ({"pool": ["ewma"], "scenario": "trolley"}, {"scenario": "trolley"}),
        ({"task": "T1", "side": "detector"}, get_task("T1").world_kwargs),
    ],
)
def test_a_learner_has_it_where_it_names_no_world(asked, expected):
    assert side_of(**asked).settings == expected


def test_its_signature_shows_it_and_settings_are_not_changed():
    shown = inspect.signature(duel_v0.env).parameters
    assert {name: shown[name].default for name in GAME} == GAME
    given = {"receiver": "paper"}
    assert with_world(given) == {**GAME, "receiver": "paper"}
    assert given == {"receiver": "paper"}
    assert with_world({"scenario": None}) == GAME
    # the detectors' side of a task is its world without the spoofer's reward
    side = side_of(task="T6", side="detector", timeline=SHORT)
    assert side.pool == "ramp"
    expected = SpoofEnv(**get_task("T6").world_kwargs, timeline=SHORT, detector="never")
    found = side.core(1, 1, False, "test").duel.setup
    assert found.world_settings() == expected.core.setup.world_settings()


@pytest.mark.parametrize(
    ("view", "pool", "of_detector"),
    [
        ("DetectorView", ["ramp", "none"], (["ramp", "none"], [3, 1])),
        ("SpooferView", ["ewma", "never"], ("ramp", None)),
    ],
)
def test_pool_and_weights_of_a_named_view_are_those_of_its_own_side(view, pool, of_detector):
    name, entry = f"spoofgym/Weighted{view}-v0", gym.spec(f"spoofgym/{view}-v0").entry_point
    gym.register(name, entry_point=entry, kwargs={"pool": pool, "weights": [3, 1]})
    try:
        found = side_of(name)
        assert (found.pool, found.weights) == (pool, [3, 1])
        assert side_of(name, weights=[1, 1]).weights == [1, 1]
        found = side_of(name, side="detector")
        assert (found.pool, found.weights) == of_detector
    finally:
        del gym.registry[name]


DRAWN = {
    **BRIEF,
    "domain": {"start_s": (0.0, 30.0), "turned_deg": (0.0, 360.0), "worlds": 2},
    "target_heading_deg": "random",
}
TOLD = {"start_s": 12.0, "world": 1, "target_heading_deg": 45.0}
RAMP = {"name": "ramp", "heading_deg": "target"}
SINGLE = {
    "aec": lambda: aec(**DRAWN),
    "parallel": lambda: parallel(**DRAWN),
    "spoofer": lambda: duel_v0.SpooferView("never", action="full-command", **DRAWN),
    "detector": lambda: duel_v0.DetectorView(RAMP, **DRAWN),
}
VECTOR = {
    "spoofers": lambda **more: duel_v0.SpooferVectorView(3, "never", **DRAWN, **more),
    "detectors": lambda **more: duel_v0.DetectorVectorView(3, RAMP, **DRAWN, **more),
}


def batch_of(env):
    inner = env.unwrapped
    duel = inner.duel if hasattr(inner, "duel") else getattr(inner.core, "duel", None)
    return (inner.core if duel is None else duel.core).engine.simulator


def circumstances(env):
    """World, time from its begin to the onset, and heading of every receiver."""
    batch = batch_of(env)
    world, epochs = np.divmod(batch.onset, batch.setup.epochs_each)
    return world, epochs * batch.setup.interval_s, np.degrees(batch.heading)


def check_told(env, rows=slice(None)):
    world, begun, heading = circumstances(env)
    assert (set(world[rows]), set(begun[rows])) == ({1}, {12.0 + SHORT["warmup_s"]})
    np.testing.assert_allclose(heading[rows], 45.0)


@pytest.mark.parametrize("name", SINGLE)
def test_a_single_receiver(name):
    env = SINGLE[name]()
    env.reset(seed=3, options={"domain": TOLD})
    check_told(env)
    env.reset(seed=3)
    drawn = circumstances(env)
    env.reset(seed=3, options={"domain": {"world": 1 - drawn[0][0]}})
    world, *others = circumstances(env)
    assert world[0] == 1 - drawn[0][0]
    for told, was in zip(others, drawn[1:], strict=True):  # the rest is drawn as ever
        np.testing.assert_array_equal(told, was)


@pytest.mark.parametrize("name", ["aec", "parallel", "detector"])
def test_what_is_wrong_leaves_the_episode_alone(name):
    env = SINGLE[name]()
    env.reset(seed=1)
    before = batch_of(env).epochs.copy()
    for given, message in (
        ({"options": {"domain": {"wurld": 1}}}, "wurld"),
        ({"options": {"domain": {"start_s": 40.0}}}, "`start_s` must be"),
        ({"options": {"domain": 3}}, "`domain` of a reset must be"),
        ({"seed": -1}, "a seed must be a whole number of at least 0, got -1"),
    ):
        with pytest.raises((ValueError, TypeError), match=message):
            env.reset(**given)
        np.testing.assert_array_equal(batch_of(env).epochs, before)


@pytest.mark.parametrize("name", VECTOR)
def test_a_batch(name):
    envs = VECTOR[name](autoreset_mode="disabled")
    envs.reset(seed=3, options={"domain": {**TOLD, "world": [1, 0, 1]}})
    world, begun, _ = circumstances(envs)
    assert (world.tolist(), set(begun)) == ([1, 0, 1], {32.0})
    envs.reset(seed=3)
    before = circumstances(envs)
    mask = np.array([True, False, True])
    envs.reset(seed=3, options={"domain": TOLD, "reset_mask": mask})
    check_told(envs, mask)
    for now, was in zip(circumstances(envs), before, strict=True):
        assert now[1] == was[1]


def test_both_forms_and_the_views_begin_alike():
    told = {"seed": 8, "options": {"domain": TOLD}}
    observations, _ = SINGLE["parallel"]().reset(**told)
    attack, guard = observations["spoofer_0"], observations["detector_0"]
    aec_form = SINGLE["aec"]()
    aec_form.reset(**told)
    view = duel_v0.DetectorView(RAMP, decision_delay=1, **DRAWN)
    for mine, expected in (
        (aec_form.observe("detector_0"), guard),
        (aec_form.observe("spoofer_0"), attack),
        (SINGLE["spoofer"]().reset(**told)[0], attack),
        (view.reset(**told)[0], guard),
    ):
        np.testing.assert_array_equal(mine, expected)
