"""The training script, end to end, with settings that take seconds."""

import json
import shutil
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
from train.ppo_spoofer import CHECKPOINT, PICTURE, RECORD, Arguments, Training, score_seed, train

TIMES = {"warmup_s": 8, "live_s": 5, "attack_s": 10, "time_to_alert_s": 2}
WORLD = {"timeline": TIMES}
QUICK = {
    "task": "T1",
    "detector": "snapshot-chi2:thresholds=nominal",
    "settings": json.dumps(WORLD),
    "steps": 200,
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


def arguments(out, **settings):
    return Arguments(out=out, **{**QUICK, **settings})


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    args = arguments(tmp_path_factory.mktemp("runs") / "tiny")
    return args, train(args)


def test_a_run_leaves_a_policy_that_plays_and_a_card_that_says_how_it_was_made(trained):
    args, results = trained
    policy = OnnxPolicy(str(args.out / "tiny.onnx"))
    pace = {"decision_interval_s": 2.5, "between": "linear"}
    assert (policy.knowledge, policy.decision_interval_s) == ("blind", 2.5)
    assert policy.between == "linear"
    envs = SpoofVecEnv(3, seed=0, knowledge="blind", **args.world, **pace)
    assert attach(policy, envs).act(envs.reset()).shape == (3, 1)
    envs.close()
    kept = args.policy(results["kept"])
    assert (args.out / "tiny.onnx").read_bytes() == kept.read_bytes()
    assert (args.out / PICTURE).stat().st_size > 1000
    card = SpooferCard.load(args.out / "tiny.json")
    assert card.training["arguments"] == args.identity
    assert card.decided_on == {(args.entropy, "training")}
    assert str(args.out.parent) not in json.dumps(card.model_dump(mode="json"))
    assert card.training["command"].startswith("python -m train.ppo_spoofer --out tiny --task T1")
    assert {"spoofgym", "torch", "stable-baselines3", "numpy"} <= set(card.versions)


def test_every_seed_has_a_learning_curve_and_a_score_on_the_same_runs(trained):
    args, results = trained
    curves = [read_record(args.out / f"seed-{seed}" / RECORD) for seed in args.seeds]
    for seed, points, row in zip(args.seeds, curves, results["seeds"], strict=True):
        assert [point["step"] for point in points] == [0, 100, 200]
        assert {"stealthy_m", "alarm_rate", "amplitude", "within_budget"} <= set(points[0])
        assert (row["seed"], row["steps"], row["diverged"]) == (seed, 200, None)
        found = row["score"]["stealthy_displacement_m"]["value"]
        ramp = results["rivals"]["ramp"]["stealthy_displacement_m"]["value"]
        assert row["ratios"]["ramp"]["value"] == pytest.approx(found / ramp, abs=1e-5)
        assert row["score"]["counted"] == results["rivals"]["ramp"]["counted"]
        assert row["untrained"]["spoofer"] == "untrained"
    assert curves[0][-1]["stealthy_m"] != curves[1][-1]["stealthy_m"]  # seeds differ
    # and share no runs, neither with each other nor with what scores them
    world = Evaluator(runs=2, fit_runs=80, **args.world).world
    draws = [world.generators(0, split, 1)[0] for split in ("training", "evaluation")]
    chances = (np.random.SeedSequence([seed, 0]).generate_state(1)[0] for seed in args.seeds)
    draws += map(np.random.default_rng, chances)
    assert len({each.bit_generator.state["state"]["state"] for each in draws}) == 4


def test_a_finished_run_stays_as_it_is_and_further_seeds_join_it(trained, tmp_path, monkeypatch):
    args, results = trained
    copy = replace(args, out=shutil.copytree(args.out, tmp_path / "tiny"))
    with pytest.raises(ValueError, match=r"other results.*gae_lambda: 0.98, not 0.9") as e:
        train(replace(copy, gae_lambda=0.9))
    assert "learning_rate" not in str(e.value)
    monkeypatch.setattr(Evaluator, "score", None)
    with monkeypatch.context() as patch:
        patch.setattr(ppo_spoofer, "Training", None)
        assert train(copy) == results
        assert (copy.out / "tiny.onnx").read_bytes() == (args.out / "tiny.onnx").read_bytes()
        more = train(replace(copy, seeds=(7,)))
    assert more["seeds"][0]["score"] == results["seeds"][1]["score"]
    broken = replace(args, out=tmp_path / "broken", seeds=(0,))
    Store(broken.out).open("ppo-spoofer", broken.config)
    (broken.out / "seed-0").mkdir()
    (broken.out / "seed-0" / CHECKPOINT).write_bytes(b"no archive")
    with pytest.raises(ValueError, match="is damaged, or of another model"):
        train(broken)


def test_a_killed_run_goes_on_to_the_same_result(trained, tmp_path, monkeypatch):
    args, results = trained
    again = replace(args, out=tmp_path / "tiny", seeds=(0,), rivals=())
    save = Training.save

    def save_and_die(training):
        save(training)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Training, "save", save_and_die)
        with pytest.raises(KeyboardInterrupt):
            train(again)
    (mine,), theirs = train(again)["seeds"], results["seeds"][0]
    assert {**mine, "wall_s": 0, "ratios": {}} == {**theirs, "wall_s": 0, "ratios": {}}
    file = "seed-0/tiny-0.onnx"
    assert (again.out / file).read_bytes() == (args.out / file).read_bytes()


def test_what_is_learned_from_can_be_copies_of_a_few_warm_ups(tmp_path):
    """The price follows the amplitude meanwhile, and what diverges keeps the best before it."""
    given = {"warm_pool": 6, "seeds": (0,), "rivals": (), "alarm_price": 6.0}
    args = arguments(tmp_path / "tiny", **given)
    assert "--warm-pool 6" in args.command()
    training = Training(args, 0, Evaluator(runs=20, fit_runs=80, threads=1, **args.world))
    learn, taken, prices = training.model.learn, [], []

    def learn_and_break(*given, **named):
        reward = dict(training.envs.venv.core._reward_parts)["reward_alarm"]
        prices.append(reward.penalty_m / 40.0)
        found = learn(*given, **named)
        with torch.no_grad():
            training.model.policy.action_net.weight.fill_(float("nan"))
        return found

    training.model.learn = learn_and_break
    with pytest.warns(UserWarning, match="training has diverged after 100 steps"):
        found = training.run(taken.append)
    assert sum(taken) == 100  # of rollouts that have ended
    (_, scored_once) = training.watch.history[1]
    expected = next_price(6.0, scored_once.value, args.price_gain)
    assert prices == pytest.approx([6.0, expected])
    assert training.price == expected != 6.0
    assert "is saved" in found["diverged"]
    assert found["chosen_at"] in (0, 100)
    assert score_seed(args, training.judge, found, {})["score"] is not None
    assert SpooferCard.load(args.policy(0).with_suffix(".json")).env_kwargs["warm_pool"] == 6
    again = Training(args, 0, training.judge)
    assert again.price == expected
    again.envs.close()


def environment(**given):
    quick = {"full_scale_mps": None, "decision_interval_s": None, "num_envs": 1}
    return arguments(Path("x"), **{**quick, **given}).make_envs()


def world(attack_s=10, **settings):
    return {"settings": json.dumps({"timeline": {**TIMES, "attack_s": attack_s}, **settings})}


def whole(task, **given):
    return {"detector": "never", "settings": "{}", "task": task, **given}


@pytest.mark.parametrize(
    ("given", "action", "length_m", "steps"),
    [
        ({"full_scale_mps": 3.0, "decision_interval_s": 2.5}, {"full_scale_mps": 3.0}, 40.0, 4),
        ({"decision_interval_s": 0.0}, {"full_scale_mps": 5.0}, 40.0, 20),  # of a short attack
        (world(40), {"name": "rate-setpoint", "full_scale_mps": 4.0}, 40.0, 4),
        ({**world(40), "length_m": 30.0}, {"full_scale_mps": 3.0}, 30.0, 4),
        (world(target_heading_deg="worst", decision_interval_s=5.0), {"dimensions": 2}, 40.0, 2),
        (world(attack="paper-ideal"), {}, 40.0, 1),  # without a wanted rate it stays as it is
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in (
                (whole("T1"), {"full_scale_mps": 4 * 40.0 / 150.0}, 40.0, 15),
                (whole("T3"), {"full_scale_mps": 4 * 20.0 / 150.0}, 20.0, 15),
                (whole("T4"), {"full_scale_mps": 5.0}, 556.0, 26),
                (whole("T6"), {}, 40.0, 15),
            )
        ),
    ],
)
def test_full_scale_and_decisions_fit_attack_and_alert_limit(given, action, length_m, steps):
    envs = environment(**given)
    assert (envs.core.episode_steps, envs.core.length_m) == (steps, length_m)
    if action:
        assert action.items() <= envs.env_kwargs["action"].items()
    elif "task" not in given:
        assert "action" not in envs.env_kwargs
        with pytest.raises(ValueError, match="`full_scale_mps` is that of a wanted rate"):
            environment(**given, full_scale_mps=2.0)
    envs.close()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("--task", "T9"), "unknown task 'T9'; valid: S1"),
        (("--alarm-price", 9), "`alarm_price`"),
        (("--learning-rate", "nan"), "`learning_rate`"),
        (("--seeds", 1, 1), "`seeds` must be different numbers"),
        (("--settings", "{"), "`settings` is not JSON"),
        (("--settings", '{"widow_s": 5}'), "widow_s"),
        (("--detector", "nobody"), "unknown detector 'nobody'"),
        (("--rivals", "nobody"), "nobody"),
        (("--decision-interval-s", 3), "window of 10 s must hold a whole number of decisions"),
        (("--rivals", "hidden-pool-ppo"), "does not fit this attack"),
    ],
)
def test_bad_input_is_refused_at_once(monkeypatch, capsys, tmp_path, given, message):
    world = ("--detector", QUICK["detector"], "--settings", json.dumps(WORLD))
    world = () if given[0] in ("--detector", "--settings") else world
    words = ["train.ppo_spoofer", "--out", tmp_path / "x", *world, *given]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    with pytest.raises(SystemExit) as ended:
        ppo_spoofer.main()
    assert ended.value.code
    said = f"{ended.value.code} {capsys.readouterr().err}".replace("│", " ")
    assert message in " ".join(said.split())
    assert not (tmp_path / "x").exists()
    with pytest.raises(ValueError, match="names the spoofer"):
        arguments(tmp_path / "a b")
