"""The world of a duel: a game where none is given, and what is given otherwise."""

import inspect

import gymnasium as gym
import pytest

from spoofgym import duel_v0
from spoofgym.duel.duel import PACE, make_duel, with_world
from spoofgym.duel.learner import LearnersSide
from spoofgym.duel.opponents import label_opponent
from spoofgym.envs import SpoofEnv
from spoofgym.tasks import DEFAULT_TASK, get_task

from .support import ONE_SKY, SHORT

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
