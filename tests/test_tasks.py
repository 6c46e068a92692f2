"""The tasks of the benchmark: versioned environments, their scores, and the command line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import gymnasium as gym
import pytest
from typer.testing import CliRunner

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.bench.run import WarmStart, play
from spoofgym.bench.suite import Suite
from spoofgym.bench.task_scores import stored_scores, task_scores
from spoofgym.cli import app
from spoofgym.detectors import make_detector
from spoofgym.tasks import PAPERS, TASKS, normalised, task_of

RUNNER = CliRunner()


@pytest.mark.parametrize("key", TASKS)
def test_a_task_is_an_environment_whose_spec_survives_json(key):
    spec = gym.spec(TASKS[key].env_id)
    again = gym.envs.registration.EnvSpec.from_json(spec.to_json())
    told = json.loads(json.dumps(TASKS[key].env_kwargs))
    assert json.loads(json.dumps(again.kwargs)) == told
    make_detector(TASKS[key].detector)
    assert Suite(**TASKS[key].suite_kwargs, runs=2).detector_entries


@pytest.mark.parametrize("key", ["T1", "T2", "T3", "T6"])
def test_a_task_can_be_played(key):
    short = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
    env = gym.make(TASKS[key].env_id, timeline=short)
    env.reset(seed=0)
    _, reward, _, _, _ = env.step(env.action_space.sample() * 0.0)
    assert abs(reward) < 5.0
    env.close()


def test_the_long_task_has_a_decision_every_ten_seconds():
    setup = gym.make(TASKS["T4"].env_id).unwrapped.core.setup
    assert (setup.steps, setup.repeat) == (3600, 20)
    assert setup.receiver.tuning == "matched"


def test_the_alert_limit_of_a_task_stands_in_its_table():
    suite = Suite(**TASKS["T4"].suite_kwargs, runs=2)
    assert (suite.alert_limit_m, Suite().alert_limit_m) == (556.0, 40.0)
    assert suite.config["alert_limit_m"] in suite.alert_limits_m


@pytest.mark.parametrize("key", ["T1", "T2", "T3", "T5", "T6"])
def test_no_task_is_won_by_full_throttle(key):
    """What pushes as hard as the attack allows is caught, in most runs of every task."""
    suite = Suite(**TASKS[key].suite_kwargs, runs=2)
    start = WarmStart(suite.setup(suite.detector_entries[0]), suite.generators("training", 16))
    hardest = play(
        start, {"name": "accelerating-ramp", "acceleration_mps2": 0.05}, drop_alarmed=True
    )
    assert hardest.alarm.any(axis=0).mean() > 0.5


def test_a_copy_of_the_settings_is_handed_out():
    task_of("T5").env_kwargs["domain"]["worlds"] = 1
    assert task_of("T5").env_kwargs["domain"]["worlds"] == 16
    with pytest.raises(ValueError, match=r"unknown task 'T7'; valid: T1, .*T6"):
        task_of("T7")


@pytest.mark.parametrize("key", PAPERS)
def test_every_paper_has_an_environment(key):
    env_id, settings = PAPERS[key]
    env = gym.make(env_id, **settings)
    assert env.unwrapped.observation_names
    env.close()


def test_scores_are_normalised_between_ramp_and_profile():
    assert normalised(15.0, 10.0, 20.0) == 0.5
    with pytest.raises(ValueError, match="the profile must get farther than the ramp"):
        normalised(15.0, 20.0, 20.0)


def cell(spoofer, value, kind):
    return {
        "detector": "snapshot-chi2",
        "spoofer": spoofer,
        "runs": 10,
        "spoofer_settings": {"name": kind},
        "stealthy_displacement_m": {"value": value},
        "alarm_rate": {"value": 0.01},
    }


def test_scores_of_a_report():
    values = {"none": 0.0, "ramp": 10.0, "slow": 8.0, "best": 20.0, "mine": 16.0}
    kinds = {"slow": "accelerating-ramp", "best": "profile", "mine": "onnx-policy"}
    report = {
        "cells": [cell(name, x, kinds.get(name, name)) for name, x in values.items()],
    }
    found = task_scores("T1", report, "mine")
    assert found["stealthy_displacement_m"] == {
        "none": 0.0,
        "ramp": 10.0,
        "profile": 20.0,
        "ppo": 16.0,
    }
    assert found["normalised"] == 0.6
    assert "normalised" not in task_scores("T1", report, None)
    with pytest.raises(
        ValueError, match=r"T6 has the detector pool\(members=ewma\+.*\), the report snap"
    ):
        task_scores("T6", report, "mine")


def test_stored_scores_are_of_tasks():
    for key, found in stored_scores().items():
        reached = found["undetected_displacement_m"]
        assert key in TASKS
        assert reached["none"] <= reached["ramp"]
        if "normalised" in found:
            told = normalised(reached["ppo"], reached["ramp"], reached["profile"])
            assert found["normalised"] == pytest.approx(told, abs=1e-3)


def test_the_page_tells_the_stored_scores():
    page = (Path(__file__).parents[1] / "docs" / "tasks.md").read_text()
    rows = [line.split(" | ") for line in page.splitlines() if re.match(r"\| T\d \| \d+ \|", line)]
    told = {row[0].strip("| "): [cell.strip(" |").replace(",", "") for cell in row] for row in rows}
    scores = stored_scores()
    assert sorted(told) == sorted(scores)
    for key, found in scores.items():
        reached = found["undetected_displacement_m"]
        numbers = [f"{reached[name]:.1f}" for name in ("none", "ramp", "profile", "ppo")]
        part = f"{found['normalised']:.2f}" if "normalised" in found else "-"
        assert told[key][1:] == [str(found["runs"]), *numbers, part]


def test_the_command_line_lists_the_tasks():
    listed = json.loads(RUNNER.invoke(app, ["tasks", "--json"]).stdout)
    assert [each["key"] for each in listed] == list(TASKS)
    table = RUNNER.invoke(app, ["tasks"]).stdout
    assert "spoofgym/BenchT4-v1" in table


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--task", "T9"], "unknown task 'T9'"),
        (["--task", "T1", "--detector", "ewma"], "--detector can't be given with --task"),
        (["--task", "T1", "--warmup-s", "20"], "--warmup-s can't be given with --task"),
    ],
)
def test_what_a_task_decides_cannot_be_told(words, message, tmp_path):
    result = RUNNER.invoke(app, ["bench", *words, "--out", str(tmp_path)])
    assert result.exit_code != 0
    assert message in result.output
