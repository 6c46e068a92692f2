"""The tasks of the benchmark: versioned environments, their scores, and the command line."""

import gymnasium as gym
import numpy as np
import pytest

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.report import tasks as task_cards
from spoofgym.bench.runs.play import WarmStart, play_side_by_side
from spoofgym.bench.runs.players import specify_detector
from spoofgym.detectors import make_detector
from spoofgym.envs import core
from spoofgym.tasks import ALARM_PRICE, DETECTOR_TASKS, PAPERS, TASKS, get_task, v2
from tests.command_line import call, read
from tests.nightly import heavy
from tools.pages import part_between
from tools.task_cards import END, PAGE, START, dealt, shown, spread


@pytest.mark.parametrize("key", heavy(TASKS, "S2", "S3", "T2", "T4", "T6"))
def test_a_task_has_a_detector_and_a_campaign(key):
    make_detector(TASKS[key].detector)
    assert Suite(**TASKS[key].suite_kwargs, runs=2).detector_players


@pytest.mark.nightly
def test_the_long_task_is_covered_by_its_detector():
    task = TASKS["T4"]
    env = gym.make(task.env_id)
    env.reset(seed=0)
    setup = env.unwrapped.core.setup
    detector = env.unwrapped.core.engine.simulator.detector
    assert (setup.steps, setup.repeat) == (650, 1)
    assert detector.detector.covers_s >= (setup.steps + setup.hold) * setup.interval_s
    assert setup.live * setup.interval_s >= task.settings["timeline"]["live_s"]


def test_prices_limits_and_settings_of_a_task():
    assert ALARM_PRICE == core.ALARM_PRICE
    suite = Suite(**TASKS["T3"].suite_kwargs, runs=2)
    assert (suite.alert_limit_m, Suite().alert_limit_m) == (20.0, 40.0)
    assert suite.config["alert_limit_m"] in suite.alert_limits_m
    get_task("T5").env_kwargs["domain"]["worlds"] = 1  # a copy
    assert get_task("T5").env_kwargs["domain"]["worlds"] == 32
    with pytest.raises(ValueError, match=r"unknown task 'T7'; valid: S1, .*T6"):
        get_task("T7")


@pytest.mark.parametrize("key", heavy(["S1", "T1", "T3", "T5", "T6"], "S1", "T1", "T5", "T6"))
def test_no_task_is_won_by_full_throttle(key):
    suite = Suite(**TASKS[key].suite_kwargs, runs=2)
    start = WarmStart(suite.setup(suite.detector_players[0]), suite.generators("training", 16))
    push = {"name": "accelerating-ramp", "acceleration_mps2": 0.05}
    (hardest,) = play_side_by_side(start, [push], drop_alarmed=True)
    assert hardest.alarm.any(axis=0).mean() > 0.5


@pytest.mark.parametrize("key", PAPERS)
def test_every_paper_has_an_environment(key):
    env_id, settings = PAPERS[key]
    env = gym.make(env_id, **settings)
    assert env.unwrapped.observation_names
    env.close()


@pytest.mark.parametrize("key", heavy(v2.TASKS, "S2", "S3"))
def test_ages_and_events_are_drawn_and_the_bank_covers_the_attack(key):
    task = TASKS[key]
    setup = Suite(**task.suite_kwargs, runs=2).world.setup
    assert (setup.bounds.youngest, setup.bounds.oldest) == (120, 7200)
    assert setup.combinations.events.front == 0.1
    (bank,) = task.detectors
    assert bank["longest_s"] >= (setup.steps + setup.hold) * setup.interval_s


@pytest.mark.usefixtures("default_rate")  # by which detectors are labelled
@pytest.mark.parametrize("key", [key for key in v2.TASKS if key in task_cards.stored_cards()])
def test_a_card_is_of_its_task_and_detector_and_admits_it(key):
    task, card = TASKS[key], task_cards.stored_cards()[key]
    assert card["detector"] == specify_detector(task.detector).label
    assert card["alert_limit_m"] == task.alert_limit_m
    assert {*task_cards.SCORES} <= {*card["scores_m"]}
    found, floor = card["admission"], card["floor_m"]
    best, figures = found["best_classic"], found["figures"]
    half = {name: each["0.5"]["value"] for name, each in card["protection_m"].items()}
    trivial = next(name for name in half if name.startswith("shewhart"))
    assert half[best] == min(value for name, value in half.items() if name != trivial)
    assert figures["trivial_over_best"]["value"] == pytest.approx(half[trivial] / half[best])
    over = card["alert_limit_m"] / floor["half"]["value"]
    assert figures["limit_over_half"]["value"] == pytest.approx(over)
    assert list(figures) == [*task_cards.FIGURES]
    assert all(each["passes"] for each in figures.values())


def test_skies_are_told_apart_by_the_mean_under_the_worst_attack_of_each():
    sky = np.repeat(np.arange(11), 4)
    first = np.where(np.arange(44) % 2, 0.0, 20.0)  # 10 m on every sky
    second = 2.0 * sky  # 2 m more from sky to sky
    # 10 m up to the sixth sky, then 12 to 20
    assert spread([first, second], sky) == pytest.approx(18.0 / 10.0)
    by_chance = dealt([first, second], sky)
    assert 1.0 < by_chance < spread([second], sky)
    assert dealt([np.full(44, 3.0)], sky) == 1.0


def test_the_command_line_lists_the_tasks_and_the_page_has_the_tables_of_the_cards():
    found = {each["key"]: each for each in read("list", "tasks", "--json")}
    assert [*found] == [*TASKS, *DETECTOR_TASKS]
    for key in (*v2.TASKS, *v2.DETECTOR_TASKS):
        assert (found[key]["card"] is None) == (found[key]["play"] is not None)
    assert read("list", "S1", "--json") == found["S1"]
    one = call("list", "S1").stdout
    assert "stealthy displacement" in one
    assert "S2" not in one
    assert "spoofgym/BenchD2-v2" in call("list", "tasks").stdout
    assert part_between(PAGE.read_text(), START, END) == f"\n{shown()}"
