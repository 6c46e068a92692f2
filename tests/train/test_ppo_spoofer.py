"""The training script, end to end, with settings that take seconds."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "onnxscript", "tyro", "tensorboard"):
    pytest.importorskip(name)

from rich.console import Console
from stable_baselines3.common.logger import configure

from agents.record import read_record
from spoofgym.bench.scores import stealth_of
from spoofgym.bench.suite import Suite
from spoofgym.envs import attach
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers import Card, OnnxPolicy
from train import ppo_spoofer
from train.ppo_spoofer import CHECKPOINT, RECORD, Arguments, finish

ROOT = Path(__file__).resolve().parents[2]
QUICK = {
    "detector": "snapshot-chi2",
    "warmup_s": 6.0,
    "attack_s": 10.0,
    "steps": 600,
    "num_envs": 5,
    "batch_size": 50,
    "evaluations": 3,
    "tuning_runs": 6,
    "evaluation_runs": 6,
    "budget": 0.45,
    "final_runs": 7,
    "threads": 1,
}


@pytest.fixture(autouse=True)
def torch_threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def quiet():
    return Console(quiet=True)


def arguments(out, **settings):
    return Arguments(out=out, **{**QUICK, **settings})


def words(out, **settings):
    """The command line of the same."""
    given = {**QUICK, **settings}
    named = [[f"--{key.replace('_', '-')}", str(value)] for key, value in given.items()]
    return ["--out", str(out), *(word for pair in named for word in pair)]


def command(*given):
    return subprocess.run(
        [sys.executable, "-m", "train.ppo_spoofer", *given],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=3600,
    )


def refused(monkeypatch, *given):
    """What the command says before it ends with an error; another process would load torch anew."""
    monkeypatch.setattr(sys, "argv", ["train.ppo_spoofer", *given])
    with pytest.raises(SystemExit) as told:
        ppo_spoofer.main()
    assert isinstance(told.value.code, str)  # which Python prints, and fails
    return told.value.code


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    args = arguments(tmp_path_factory.mktemp("runs") / "tiny")
    before = torch.get_num_threads()
    finish(args, *ppo_spoofer.train(args, quiet()), quiet())
    torch.set_num_threads(before)
    return args


def test_a_run_leaves_a_policy_that_plays(trained):
    policy = OnnxPolicy(str(trained.out / "tiny.onnx"))
    assert policy.knowledge == "blind"
    envs = SpoofVecEnv(3, seed=0, **trained.env_kwargs)
    spoofer = attach(policy, envs)
    observation = envs.reset()
    assert spoofer.act(observation).shape == (3, 2)
    envs.close()


def test_the_card_tells_how_it_was_made(trained):
    card = Card.load(trained.out / "tiny.json")
    assert card.training["arguments"] == json.loads(json.dumps(trained.identity))
    assert str(trained.out.parent) not in card.training["command"]
    assert 0 <= card.training["steps"] <= trained.steps + 5 * 20
    assert [(score.split, score.entropy, score.runs) for score in card.scores] == [
        ("training", 0, 6),
        ("calibration", 0, 7),
    ]
    assert card.training["total_s"] > card.training["wall_s"] > 0.0
    assert card.env_kwargs["detector"]["false_alarm"] > 0.0  # settings that nobody gave, too
    assert [rival["spoofer"] for rival in card.rivals] == [
        "ramp(tuned)",
        "accelerating-ramp(tuned)",
    ]
    assert all(len({t["value"] for t in rival["trials"]}) >= 20 for rival in card.rivals)
    assert {"spoofgym", "torch", "stable-baselines3", "numpy"} <= set(card.versions)


def test_the_record_is_a_learning_curve(trained):
    points = read_record(trained.out / RECORD)
    steps = [point["step"] for point in points]
    assert steps == sorted(set(steps))
    assert (steps[0], steps[-1] >= trained.steps, len(points)) == (0, True, trained.evaluations + 1)
    for point in points:
        assert {"eval_undetected_m", "eval_alarm_rate", "within_budget", "wall_s"} <= set(point)
    assert any((trained.out / "tensorboard").iterdir())


def test_evaluation_and_training_share_no_runs(trained):
    suite = trained.suite
    states = [
        suite.generators(split, 1)[0].bit_generator.state["state"]["state"]
        for split in ("training", "calibration", "evaluation")
    ]
    chance = int(np.random.SeedSequence([trained.seed, 0]).generate_state(1)[0])
    receivers = np.random.default_rng(chance)
    states.append(receivers.bit_generator.state["state"]["state"])
    assert len(set(states)) == 4


def test_a_folder_with_a_run_is_not_overwritten(trained):
    with pytest.raises(SystemExit, match="holds a training run; go on with it by --resume"):
        ppo_spoofer.train(trained, quiet())


def test_a_resumed_run_with_other_settings_is_refused(trained):
    other = replace(trained, resume=True, gae_lambda=0.9, width=32)
    with pytest.raises(SystemExit) as told:
        ppo_spoofer.train(other, quiet())
    assert "other settings" in str(told.value)
    assert "gae_lambda: 0.95 there, 0.9 here" in str(told.value)
    assert "width: 64 there, 32 here" in str(told.value)
    assert "clip_range" not in str(told.value)


def test_a_finished_run_can_be_resumed_and_stays_as_it_is(trained):
    before = (trained.out / "tiny.onnx").read_bytes()
    ppo_spoofer.train(replace(trained, resume=True), quiet())
    assert (trained.out / "tiny.onnx").read_bytes() == before


KILLED = """
import os, runpy, signal
from agents.record import TrainingRecord
append = TrainingRecord.append
def append_and_die(record, *args, **values):
    append(record, *args, **values)
    if record.path.read_bytes().count(b"\\n") == 3:
        os.kill(os.getpid(), signal.SIGKILL)
TrainingRecord.append = append_and_die
runpy.run_module("train.ppo_spoofer", run_name="__main__", alter_sys=True)
"""


def test_a_killed_run_goes_on(tmp_path):
    """SIGKILL in the middle, then the same command with --resume."""
    out = tmp_path / "killed"
    given = words(out, steps=1000, evaluations=10)
    process = subprocess.run(
        [sys.executable, "-c", KILLED, *given], cwd=ROOT, capture_output=True, check=False
    )
    assert process.returncode == -signal.SIGKILL, process.stderr
    killed = read_record(out / RECORD)[-1]["step"]
    assert killed < 1000
    with zipfile.ZipFile(out / CHECKPOINT) as archive:
        saved = json.loads(archive.read("state.json"))["num_timesteps"]
    assert saved <= killed

    again = command(*given, "--resume")
    assert again.returncode == 0, again.stderr
    assert f"resumed after {saved:,} steps" in again.stdout
    steps = [point["step"] for point in read_record(out / RECORD)]
    assert steps == sorted(set(steps))
    assert (steps[0], steps[-1]) == (0, 1000)
    walls = [point["wall_s"] for point in read_record(out / RECORD)]
    assert walls == sorted(walls)
    assert len(Card.load(out / "killed.json").scores) == 2


def test_a_run_that_diverges_keeps_the_best(tmp_path, monkeypatch):
    said = refused(monkeypatch, *words(tmp_path / "wild", learning_rate=1e30))
    assert "training has diverged" in said
    assert "is kept" in said
    OnnxPolicy(str(tmp_path / "wild" / "wild.onnx"))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"steps": 0}, "`steps` must be at least 1, got 0"),
        ({"gamma": 1.5}, r"`gamma` must be in \[0, 1\], got 1.5"),
        ({"budget": float("nan")}, "`budget` must be in"),
        ({"final_runs": 1}, "`final_runs` must be at least 2"),
        ({"knowledge": "clairvoyant"}, "unknown knowledge 'clairvoyant'"),
        ({"n_steps": -1}, "`n_steps` must be at least 0, got -1"),
        ({"log_std_init": float("nan")}, "`log_std_init` must be in"),
        ({"detector": "mine:Detector"}, "a card can't name a class of another module"),
    ],
)
def test_settings_are_checked_at_once(tmp_path, settings, message):
    with pytest.raises(ValueError, match=message):
        arguments(tmp_path / "x", **settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"detector": "ewna"}, "did you mean 'ewma'"),
        ({"attack": "false-position:axes=n"}, "needs a command to the east"),
        ({"warmup_s": 4000.0}, "an episode takes"),
    ],
)
def test_what_it_is_to_learn_against_is_checked_before_anything_is_written(
    tmp_path, monkeypatch, settings, message
):
    assert message in refused(monkeypatch, *words(tmp_path / "x", **settings))
    assert not (tmp_path / "x").exists()


def test_a_discount_is_warned_of(tmp_path):
    with pytest.warns(UserWarning, match="`gamma` = 0.99: what is scored is not discounted"):
        arguments(tmp_path / "x", gamma=0.99)


def test_the_price_of_an_alarm_follows_the_alarms(trained):
    engine = SpoofVecEnv(5, seed=0, **(trained.env_kwargs | {"knowledge": "oracle"}))
    envs = ppo_spoofer.AlongHeading(engine, trained.heading_deg)
    rivals = json.loads((trained.out / "config.json").read_text())["rivals"]
    run = ppo_spoofer.Run(trained, envs, rivals)
    run.model = ppo_spoofer.make_model(trained, envs)
    run.model.set_logger(configure(None, []))
    assert run.factor == 1.0
    for alarmed, higher in ((True, True), (False, False)):
        before = run.factor
        for _ in range(20):
            run._ended = [(1.0, alarmed)] * 10
            run._on_rollout_end()
        assert (run.factor > before) is higher
    envs.close()


@pytest.mark.parametrize(
    ("settings", "knowledge", "still"),
    [
        ({"knowledge": "tracking", "heading_deg": 0.0}, "tracking", "east"),
        ({"attack": "false-position:control=rate,axes=e"}, "blind", None),
    ],
)
def test_other_knowledge_headings_and_controls(tmp_path, settings, knowledge, still):
    args = arguments(tmp_path / "other", **settings)
    best, _ = ppo_spoofer.train(args, quiet())
    policy = OnnxPolicy(str(best))
    assert policy.knowledge == knowledge
    envs = SpoofVecEnv(3, seed=0, **args.env_kwargs)
    spoofer = attach(policy, envs)
    action = spoofer.act(envs.reset())
    names = [name.split("_")[0] for name in envs.action_names]
    for name, column in zip(names, action.T, strict=True):
        assert (column == 0.0).all() == (name == still)
    envs.close()


def test_an_attack_that_moves_only_the_clock_is_refused(tmp_path, monkeypatch):
    given = words(tmp_path / "x", attack="per-channel")
    assert "no scale for a reward follows" in refused(monkeypatch, *given)
    assert not (tmp_path / "x").exists()


def test_a_damaged_checkpoint_is_named(trained, tmp_path):
    import shutil

    copy = tmp_path / "tiny"
    shutil.copytree(trained.out, copy)
    (copy / CHECKPOINT).write_bytes(b"PK no zip")
    with pytest.raises(SystemExit, match=r"checkpoint\.zip is damaged"):
        ppo_spoofer.train(replace(trained, out=copy, resume=True), quiet())


def test_the_best_policy_comes_back_with_the_checkpoint(trained, tmp_path):
    import shutil

    copy = tmp_path / "tiny"
    shutil.copytree(trained.out, copy)
    (copy / "tiny.onnx").write_bytes(b"torn")
    best, _ = ppo_spoofer.train(replace(trained, out=copy, resume=True), quiet())
    assert OnnxPolicy(str(best)).card.name == "tiny"


def test_a_pool_of_warm_ups_is_for_training_alone(trained):
    pooled = replace(trained, warm_pool=7)
    assert pooled.env_kwargs == {**trained.env_kwargs, "warm_pool": 7}  # what is on the card
    assert pooled.suite == trained.suite  # whose runs are warmed up one by one


def test_the_budget_is_that_of_the_benchmark(trained):
    assert trained.suite.tuning.budget == trained.budget == 0.45
    assert Arguments(out=trained.out).budget == Suite().tuning.budget
    found = ppo_spoofer.Evaluation(
        np.array([9.0, 1.0, 2.0, 3.0]),
        np.array([True, True, False, False]),
        np.array([False, True, True, True]),
    )
    assert (found.mean_m, found.alarm_rate) == (2.0, 1.0 / 3.0)
    assert found.stealth == stealth_of([1.0, 2.0, 3.0], [True, False, False], [True] * 3)
