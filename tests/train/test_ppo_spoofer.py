"""The training script, end to end, with settings that take seconds."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "onnxscript", "tyro", "matplotlib"):
    pytest.importorskip(name)

from agents.learning import next_price
from agents.record import read_record
from spoofgym.bench.experiments import Store
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.envs import attach
from spoofgym.policies import SpooferCard
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers import OnnxPolicy
from train import ppo_spoofer
from train.ppo_spoofer import (
    CHECKPOINT,
    PICTURE,
    RECORD,
    RESULTS,
    Arguments,
    Training,
    scored,
    train,
)

ROOT = Path(__file__).resolve().parents[2]
WORLD = {"timeline": {"warmup_s": 8, "live_s": 5, "attack_s": 10, "time_to_alert_s": 2}}
QUICK = {
    "task": "T1",
    "detector": "snapshot-chi2:thresholds=nominal",
    "settings": json.dumps(WORLD),
    "steps": 400,
    "num_envs": 5,
    "batch_size": 50,
    "n_epochs": 2,
    "full_scale_mps": 1.0,
    "decision_interval_s": 2.5,
    "stages": 2,
    "fit_runs": 80,
    "runs": 20,
    "rivals": ("ramp",),
    "seeds": (0, 7),
    "threads": 1,
}


@pytest.fixture(autouse=True)
def torch_threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def arguments(out, **settings):
    return Arguments(out=out, **{**QUICK, **settings})


@pytest.fixture
def refused(monkeypatch, capsys):
    """What the command prints before it ends with an error."""

    def called(*given):
        monkeypatch.setattr(sys, "argv", ["train.ppo_spoofer", *map(str, given)])
        with pytest.raises(SystemExit) as ended:
            ppo_spoofer.main()
        assert ended.value.code
        return " ".join(f"{ended.value.code} {capsys.readouterr().err}".replace("│", " ").split())

    return called


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    args = arguments(tmp_path_factory.mktemp("runs") / "tiny")
    return args, train(args)


def test_a_run_leaves_a_policy_that_plays(trained):
    args, results = trained
    policy = OnnxPolicy(str(args.out / "tiny.onnx"))
    assert policy.knowledge == "blind"
    assert (policy.decision_interval_s, policy.between) == (2.5, "linear")
    pace = {"decision_interval_s": 2.5, "between": "linear"}
    envs = SpoofVecEnv(3, seed=0, knowledge="blind", **args.world, **pace)
    spoofer = attach(policy, envs)
    assert spoofer.act(envs.reset()).shape == (3, 1)
    envs.close()
    kept = args.out / f"seed-{results['kept']}" / f"tiny-{results['kept']}.onnx"
    assert (args.out / "tiny.onnx").read_bytes() == kept.read_bytes()
    assert (args.out / PICTURE).stat().st_size > 1000


def test_the_card_says_how_it_was_made(trained):
    args, _ = trained
    card = SpooferCard.load(args.out / "tiny.json")
    assert card.training["arguments"] == args.identity
    assert card.decided_on == {(args.entropy, "training")}
    assert str(args.out.parent) not in json.dumps(card.model_dump(mode="json"))
    assert card.training["command"].startswith("python -m train.ppo_spoofer --out tiny --task T1")
    assert {"spoofgym", "torch", "stable-baselines3", "numpy"} <= set(card.versions)


def test_every_seed_has_a_learning_curve_and_a_score_on_the_same_runs(trained):
    args, results = trained
    for seed, row in zip(args.seeds, results["seeds"], strict=True):
        points = read_record(args.out / f"seed-{seed}" / RECORD)
        assert [point["step"] for point in points] == [0, 200, 400]
        assert {"stealthy_m", "alarm_rate", "amplitude", "within_budget"} <= set(points[0])
        assert (row["seed"], row["steps"], row["diverged"]) == (seed, 400, None)
        found = row["score"]["stealthy_displacement_m"]["value"]
        ramp = results["rivals"]["ramp"]["stealthy_displacement_m"]["value"]
        assert row["ratios"]["ramp"]["value"] == pytest.approx(found / ramp, abs=1e-5)
        assert row["score"]["counted"] == results["rivals"]["ramp"]["counted"]
        assert row["untrained"]["spoofer"] == "untrained"
    curves = [read_record(args.out / f"seed-{seed}" / RECORD)[-1] for seed in args.seeds]
    assert curves[0]["stealthy_m"] != curves[1]["stealthy_m"]  # seeds differ


def test_a_finished_run_stays_as_it_is(trained, monkeypatch):
    args, results = trained
    before = (args.out / "tiny.onnx").read_bytes()
    monkeypatch.setattr(Evaluator, "score", None)
    monkeypatch.setattr(ppo_spoofer, "Training", None)
    assert train(args) == results
    assert (args.out / "tiny.onnx").read_bytes() == before


def test_further_seeds_join_a_run(trained, tmp_path):
    args, results = trained
    copy = shutil.copytree(args.out, tmp_path / "tiny")
    more = train(replace(args, out=copy, seeds=(7,), rivals=()))
    assert more["seeds"][0]["score"] == results["seeds"][1]["score"]


def test_other_settings_are_refused(trained):
    args, _ = trained
    with pytest.raises(ValueError, match=r"other results.*gae_lambda: 0.98, not 0.9") as e:
        train(replace(args, gae_lambda=0.9))
    assert "learning_rate" not in str(e.value)


def killed_after_the_first_checkpoint(args, monkeypatch):
    """Results of a training that died after its first checkpoint, and went on."""
    save = Training.save

    def save_and_die(training):
        save(training)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Training, "save", save_and_die)
        with pytest.raises(KeyboardInterrupt):
            train(args)
    assert not (args.out / "seed-7").exists()
    return train(args)


def test_what_is_learned_from_can_be_copies_of_a_few_warm_ups(tmp_path, monkeypatch):
    given = {"warm_pool": 6, "seeds": (0,), "rivals": ()}
    args = arguments(tmp_path / "whole" / "tiny", **given)
    assert "--warm-pool 6" in args.command()
    results = train(args)
    card = SpooferCard.load(args.out / "tiny.json")
    assert card.env_kwargs["warm_pool"] == 6
    again = arguments(tmp_path / "tiny", **given)
    (mine,), (theirs,) = (
        [{**row, "wall_s": 0} for row in found["seeds"]]
        for found in (killed_after_the_first_checkpoint(again, monkeypatch), results)
    )
    assert mine == theirs
    with pytest.raises(ValueError, match=r"`warm_pool` must be in \[1, 1e\+06\], got 0"):
        arguments(tmp_path / "none", warm_pool=0)


def test_a_killed_run_goes_on_to_the_same_result(trained, tmp_path, monkeypatch):
    args, results = trained
    again = replace(args, out=tmp_path / "tiny")
    found = killed_after_the_first_checkpoint(again, monkeypatch)
    for mine, theirs in zip(found["seeds"], results["seeds"], strict=True):
        assert {**mine, "wall_s": 0} == {**theirs, "wall_s": 0}
    for file in ("tiny.onnx", "seed-0/tiny-0.onnx", "seed-7/tiny-7.onnx"):
        assert (again.out / file).read_bytes() == (args.out / file).read_bytes()


def test_a_damaged_checkpoint_is_refused(trained, tmp_path):
    args, _ = trained
    again = replace(args, out=tmp_path / "tiny", seeds=(0,))
    Store(again.out).open("ppo-spoofer", again.config)
    (again.out / "seed-0").mkdir()
    (again.out / "seed-0" / CHECKPOINT).write_bytes(b"no archive")
    with pytest.raises(ValueError, match="is damaged, or of another model"):
        train(again)


def test_a_training_that_diverges_keeps_the_best_and_says_so(trained, tmp_path):
    args, _ = trained
    again = replace(args, out=tmp_path / "tiny", seeds=(0,))
    training = Training(again, 0, Evaluator(runs=20, fit_runs=80, threads=1, **again.world))
    learn = training.model.learn

    def learn_and_break(*given, **named):
        found = learn(*given, **named)
        with torch.no_grad():
            training.model.policy.action_net.weight.fill_(float("nan"))
        return found

    training.model.learn = learn_and_break
    with pytest.warns(UserWarning, match="training has diverged after 200 steps"):
        found = training.run(lambda steps: None)
    assert "is kept" in found["diverged"]
    assert found["chosen_at"] in (0, 200)
    assert scored(again, training.judge, found, {})["score"] is not None


def test_evaluation_and_training_share_no_runs(trained):
    args, _ = trained
    world = Evaluator(runs=2, fit_runs=80, **args.world).world
    states = [
        world.generators(0, split, 1)[0].bit_generator.state["state"]["state"]
        for split in ("training", "evaluation")
    ]
    for seed in args.seeds:
        chance = int(np.random.SeedSequence([seed, 0]).generate_state(1)[0])
        states.append(np.random.default_rng(chance).bit_generator.state["state"]["state"])
    assert len(set(states)) == 4


def test_the_full_scale_is_the_limit_of_a_short_attack_or_what_is_given():
    for given, expected in ((3.0, 3.0), (None, 5.0)):
        envs = arguments(Path("x"), full_scale_mps=given).make_envs()
        assert envs.env_kwargs["action"] == {"name": "rate-setpoint", "full_scale_mps": expected}
        envs.close()
    assert arguments(Path("x"), detector="", settings="{}").world == {"task": "T1"}


@pytest.mark.parametrize(
    ("given", "action", "length_m"),
    [
        ({"task": "T4", "detector": "never"}, {"full_scale_mps": 5.0}, 556.0),
        ({"task": "T3", "detector": "never"}, {"full_scale_mps": 4 * 20.0 / 150.0}, 20.0),
        (
            {"task": "T3", "detector": "never", "length_m": 30.0},
            {"full_scale_mps": 4 * 30.0 / 150.0},
            30.0,
        ),
        ({"settings": '{"target_heading_deg": "worst"}'}, {"dimensions": 2}, 40.0),
    ],
)
def test_the_full_scale_fits_the_attack_and_the_alert_limit_of_the_task(given, action, length_m):
    quick = {"settings": "{}", "full_scale_mps": None, "num_envs": 1}
    envs = arguments(Path("x"), **{**quick, **given}).make_envs()
    assert action.items() <= envs.env_kwargs["action"].items()
    assert envs.core.length_m == length_m
    envs.close()


def test_an_attack_without_a_wanted_rate_is_commanded_as_it_is():
    settings = json.dumps({**WORLD, "attack": "paper-ideal"})
    envs = arguments(Path("x"), settings=settings, full_scale_mps=None).make_envs()
    assert "action" not in envs.env_kwargs
    envs.close()
    with pytest.raises(ValueError, match="`full_scale_mps` is that of a wanted rate"):
        arguments(Path("x"), settings=settings, full_scale_mps=2.0).make_envs()


def test_the_price_follows_the_amplitude_and_is_kept(tmp_path):
    args = arguments(tmp_path, seeds=(0,), alarm_price=6.0)
    judge = Evaluator(runs=args.runs, fit_runs=args.fit_runs, threads=1, **args.world)
    training = Training(args, 0, judge)
    assert training.price == 6.0
    taken = []
    training.run(taken.append)
    assert sum(taken) == args.steps
    expected = 6.0
    for _, found in training.watch.history[1:]:
        expected = next_price(expected, found.value, args.price_gain)
    assert training.price == expected != 6.0
    paid = dict(training.envs.venv.core._reward_parts)["reward_alarm"].penalty_m
    before = next_price(6.0, training.watch.history[1][1].value, args.price_gain)
    assert paid == pytest.approx(40.0 * before)
    again = Training(args, 0, judge)
    assert again.price == expected
    again.envs.close()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("--task", "T9"), "unknown task 'T9'; valid: T1"),
        (("--knowledge", "psychic"), "unknown knowledge 'psychic'; valid: "),
        (("--alarm-price", 9), r"`alarm_price` must be in [1, 8], got 9"),
        (("--steps", 0), r"`steps` must be in [1, inf], got 0"),
        (("--gae-lambda", 1.5), r"`gae_lambda` must be in [0, 1], got 1.5"),
        (("--learning-rate", "nan"), r"`learning_rate` must be in [0, 1], got nan"),
        (("--seeds", 1, 1), "`seeds` must be different numbers, 0 or more, got (1, 1)"),
        (("--settings", "{"), "`settings` is not JSON"),
        (("--settings", "[1]"), "`settings` must be a JSON object"),
        (("--settings", '{"widow_s": 5}'), "widow_s"),
        (("--detector", "nobody"), "unknown detector 'nobody'"),
        (("--rivals", "nobody"), "nobody"),
        (
            (
                *("--detector", QUICK["detector"], "--settings", json.dumps(WORLD)),
                *("--rivals", "hidden-pool-ppo"),
            ),
            "does not fit this attack",
        ),
    ],
)
def test_bad_input_is_refused_at_once(refused, tmp_path, given, message):
    assert message in refused("--out", tmp_path / "x", *given)
    assert not list(tmp_path.glob("x/seed-*"))


def test_a_name_has_to_be_a_name(refused, tmp_path):
    assert "names the spoofer" in refused("--out", tmp_path / "a b")


def test_the_command_prints_help():
    shown = subprocess.run(
        [sys.executable, "-m", "train.ppo_spoofer", "--help"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "--full-scale-mps" in shown.stdout
    assert RESULTS in shown.stdout


@pytest.mark.parametrize(
    ("every_s", "given", "steps"),
    [
        (2.5, {}, 4),
        (0.0, {}, 20),
        (None, {}, 1),
        (None, {"decision_interval_s": 5.0}, 2),  # of the world, where everybody decides so
    ],
)
def test_it_decides_as_often_as_is_asked_for(every_s, given, steps):
    settings = json.dumps({**WORLD, **given})
    envs = arguments(Path("x"), decision_interval_s=every_s, settings=settings).make_envs()
    assert envs.core.episode_steps == steps
    envs.close()


@pytest.mark.parametrize(
    ("task", "interval_s", "decisions"), [("T1", 10.0, 15), ("T4", 12.5, 26), ("T6", 10.0, 15)]
)
def test_decisions_divide_the_attack_of_a_task(task, interval_s, decisions):
    envs = Arguments(out=Path("x"), task=task, num_envs=1, threads=1).make_envs()
    assert envs.core.setup.decision_interval_s == interval_s
    assert envs.core.episode_steps == decisions
    envs.close()


def test_an_interval_that_does_not_fit_leaves_no_folder(refused, tmp_path):
    settings = json.dumps(WORLD)
    given = ("--out", tmp_path / "x", "--task", "T1", "--settings", settings)
    detector = ("--detector", "snapshot-chi2:thresholds=nominal")
    said = refused(*given, *detector, "--decision-interval-s", "3")
    assert "window of 10 s must hold a whole number of decisions" in said
    assert not (tmp_path / "x").exists()
