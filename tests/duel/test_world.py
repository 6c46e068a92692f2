"""The world of a duel: a game where none is given, and what is given otherwise."""

import inspect

import gymnasium as gym
import pytest

from spoofgym import duel_v0
from spoofgym.duel.duel import make_duel, with_world
from spoofgym.duel.learner import LearnersSide
from spoofgym.envs import SpoofEnv
from spoofgym.tasks import task_of

from .support import SHORT

GAME, PAPERS = task_of("T3").world_kwargs, "zhong2025"
PAPER = {"scenario": PAPERS}


def duels(**given):
    """Setups of all forms of the duel."""
    own = {"timeline": SHORT, **given}
    return [
        make_duel(1, **own).setup,
        duel_v0.SpooferView(**own).core.setup,
        duel_v0.DetectorView(**own).core.duel.setup,
        gym.make("spoofgym/SpooferView-v0", **own).unwrapped.core.setup,
    ]


def test_without_a_world_all_forms_are_played_in_that_of_t3():
    expected = SpoofEnv(**GAME, timeline=SHORT).core.setup.world_settings()
    papers = SpoofEnv(timeline=SHORT).core.setup.world_settings()
    assert expected["scenario"] != papers["scenario"]
    for setup in duels():
        assert setup.world_settings() == expected


def test_with_a_scenario_nothing_of_it_is_left():
    papers = SpoofEnv(timeline=SHORT).core.setup.world_settings()
    for setup in duels(scenario=PAPERS):
        assert setup.world_settings() == papers


def test_no_scenario_is_as_if_it_were_not_given():
    assert with_world({"scenario": None}) == GAME
    assert side_of(pool=["ewma"], scenario=None) == GAME
    named = side_of(env_id="spoofgym/TightlyCoupled-v0", pool=["ewma"], scenario=None)
    assert named == {"scenario": PAPERS}


def test_parts_of_it_can_be_set():
    for setup in duels(receiver="paper", domain=None):
        same = SpoofEnv(scenario="trolley", receiver="paper", timeline=SHORT)
        assert setup.world_settings() == same.core.setup.world_settings()


def test_its_signature_shows_it():
    shown = inspect.signature(duel_v0.env).parameters
    assert {name: shown[name].default for name in GAME} == GAME


def side_of(env_id=None, task=None, side="spoofer", pool=None, **settings):
    return LearnersSide.of(env_id, task, side, pool, None, settings).settings


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({}, {}),
        ({"pool": ["ewma"]}, GAME),
        ({"side": "detector"}, GAME),
        ({"env_id": "spoofgym/DetectorView-v0"}, GAME),
        ({"env_id": "spoofgym/TightlyCoupled-v0", "pool": ["ewma"]}, {"scenario": PAPERS}),
        ({"pool": ["ewma"], "scenario": "trolley"}, {"scenario": "trolley"}),
    ],
)
def test_a_learner_has_it_where_it_names_no_world(asked, expected):
    assert side_of(**asked) == expected


def test_a_task_keeps_its_world():
    for task in ("T1", "T2"):
        found = side_of(task=task, side="detector")
        assert found == task_of(task).world_kwargs


@pytest.mark.parametrize("task", ["T3", "T6"])
def test_the_detectors_side_of_a_task_is_its_world_without_the_spoofers_reward(task):
    side = LearnersSide.of(None, task, "detector", None, None, {"timeline": SHORT})
    assert side.pool == "ramp"
    core = side.core(1, 1, False, "test")
    expected = SpoofEnv(**task_of(task).world_kwargs, timeline=SHORT, detector="never")
    assert core.duel.setup.world_settings() == expected.core.setup.world_settings()


def test_an_id_of_a_spoofer_gives_no_pool_to_the_detectors_side():
    name, entry = "spoofgym/Against-v0", gym.spec("spoofgym/SpooferView-v0").entry_point
    gym.register(name, entry_point=entry, kwargs={"pool": ["ewma", "never"], "weights": [1, 2]})
    try:
        side = LearnersSide.of(name, None, "detector", None, None, {})
        assert (side.pool, side.weights) == ("ramp", None)
    finally:
        del gym.registry[name]


def test_settings_are_not_changed():
    given = {"receiver": "paper"}
    assert with_world(given) == {**GAME, "receiver": "paper"}
    assert given == {"receiver": "paper"}


@pytest.mark.parametrize(
    ("given", "met"),
    [({}, "solution-separation"), ({"scenario": None}, "solution-separation"), (PAPER, "ewma")],
)
def test_a_spoofer_meets_the_best_detector_of_the_game_by_default(given, met):
    own = {"timeline": SHORT, **given}
    assert duel_v0.SpooferView(**own)._side.labels == (met,)
    assert duel_v0.SpooferVectorView(2, **own).opponents == [met, met]
    side = LearnersSide.of("spoofgym/SpooferView-v0", None, "spoofer", None, None, given)
    assert side.pool == met


@pytest.mark.parametrize(
    ("view", "pool"), [("DetectorView", ["ramp", "none"]), ("SpooferView", ["ewma", "never"])]
)
def test_weights_of_a_named_view_hold_on_both_sides(view, pool):
    name, entry = f"spoofgym/Weighted{view}-v0", gym.spec(f"spoofgym/{view}-v0").entry_point
    gym.register(name, entry_point=entry, kwargs={"pool": pool, "weights": [3, 1]})
    try:
        found = LearnersSide.of(name, None, "spoofer", None, None, {})
        assert (found.pool, found.weights) == (pool, [3, 1])
        assert LearnersSide.of(name, None, "spoofer", None, [1, 1], {}).weights == [1, 1]
    finally:
        del gym.registry[name]
