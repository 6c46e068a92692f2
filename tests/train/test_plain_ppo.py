"""Plain PPO with few steps."""

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "tyro"):
    pytest.importorskip(name)

from dataclasses import replace

from stable_baselines3 import PPO

import spoofgym.tasks
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.tasks import Task
from tools.learned_page import shown_of_plain
from train import plain_ppo
from train.plain_ppo import Settings, build_table, play

SHORT = {"warmup_s": 8.0, "live_s": 5.0, "attack_s": 10.0, "time_to_alert_s": 2.0}


@pytest.fixture
def settings(tmp_path, monkeypatch):
    """Few runs of a short rollout, against a detector that a ramp has to obey."""
    met = {"name": "snapshot-chi2", "thresholds": "nominal"}
    task = Task("T1", "short", {"timeline": SHORT}, (met,), 5.0)
    monkeypatch.setitem(spoofgym.tasks.TASKS, "T1", task)
    monkeypatch.setitem(plain_ppo.PLAIN, "n_steps", 20)
    monkeypatch.setitem(plain_ppo.PLAIN, "batch_size", 40)
    quick = {"steps": 40, "scores": 1, "fit_runs": 80, "runs": 10, "num_envs": 2}
    return Settings(out=tmp_path, task="T1", kinds=("plain",), seeds=(3,), **quick)


def test_a_seed_is_trained_once_and_compared_on_the_same_runs(settings, monkeypatch):
    results = play(settings)
    (row,) = results["kinds"]["plain"]
    assert [step for step, _ in row["curve"]] == [0, 40]
    score = row["score"]["stealthy_displacement_m"]["value"]
    ramp = results["ramps"]["ramp"]["stealthy_displacement_m"]["value"]
    assert row["ratios"]["ramp"]["value"] == pytest.approx(score / ramp, abs=1e-5)
    assert row["untrained"]["counted"] == row["score"]["counted"]
    assert "| T1 | plain | 1 |" in build_table(results)

    monkeypatch.setattr(plain_ppo, "train", None)  # it is finished
    monkeypatch.setattr(Evaluator, "score", None)
    assert play(settings) == results
    with pytest.raises(ValueError, match=r"other results \(config\.steps: 40, not 80\)"):
        play(replace(settings, steps=80))
    # results on other runs say so, and have a folder of their own
    assert replace(settings, entropy=1).identity == {**settings.identity, "entropy": 1}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kinds": ("fancy",)}, "unknown kind 'fancy'; valid: defaults, plain"),
        ({"steps": 3, "scores": 4}, r"`scores` must be in \[1, 3\], the steps, got 4"),
    ],
)
def test_bad_input_is_refused(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        Settings(out=tmp_path, **changes)


@pytest.mark.nightly
def test_a_seed_that_diverges_has_no_score_and_stops_no_other(settings, monkeypatch):
    """Within an update, where torch raises, and after its last minibatch, where nothing does."""
    train = PPO.train
    broken = []

    def diverge(self):
        train(self)
        if self.seed in (3, 4):
            broken.append(self.seed)
            with torch.no_grad():
                self.policy.action_net.weight.fill_(float("nan"))
            if self.seed == 3:
                raise ValueError("Expected parameter loc to satisfy the constraint\nbut found nan")

    monkeypatch.setattr(PPO, "train", diverge)
    with pytest.warns(UserWarning, match="training has diverged after 40 steps"):
        results = play(replace(settings, seeds=(3, 4, 5)))
    assert broken == [3, 4]
    rows = results["kinds"]["plain"]
    assert [(row["score"], row["ratios"]) for row in rows[:2]] == [(None, {})] * 2
    assert "Expected parameter loc" in rows[0]["diverged"]
    assert "weights that are not finite" in rows[1]["diverged"]
    assert rows[2]["diverged"] is None
    assert rows[2]["score"]["counted"] == rows[2]["untrained"]["counted"]
    assert "| T1 | plain | 3, 2 diverged | 0.0 [" in build_table(results)
    assert "| 0: " in shown_of_plain({"T1": results})
