"""Scores of a policy while stable-baselines3 trains it."""

from __future__ import annotations

import json

import numpy as np
import pytest

# ruff: noqa: E402 - stable-baselines3 may be missing
torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from spoofgym.policies.contract import NotFinite
from spoofgym.sb3 import ScoreCallback, SpoofVecEnv

WORLD = {
    "detector": {"name": "snapshot-chi2", "thresholds": "nominal"},
    "timeline": {"warmup_s": 6.0, "live_s": 2.0, "attack_s": 5.0, "time_to_alert_s": 1.0},
}


@pytest.fixture(autouse=True)
def torch_threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def learner(envs):
    return PPO("MlpPolicy", envs, n_steps=20, batch_size=160, gamma=1.0, seed=0, device="cpu")


def scored(**settings):
    return ScoreCallback(**{**WORLD, "fit_runs": 80, "verbose": 0, **settings})


def test_a_callback_scores_the_policy_as_it_learns_and_keeps_the_best(tmp_path):
    pytest.importorskip("onnxscript")
    envs = VecNormalize(SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD), norm_reward=False)
    callback = scored(every=160, path=tmp_path / "best.onnx")
    model = learner(envs)
    model.learn(480, callback=callback)
    steps = [step for step, _ in callback.history]
    assert steps == [0, 160, 320, 480]
    scores = [found.score for _, found in callback.history]
    assert callback.best_m == max(scores)
    assert steps[int(np.argmax(scores))] == callback.best_step
    again = callback.judge.fit(str(tmp_path / "best.onnx"))
    assert any(trial.value == 1.0 or trial.stealthy_displacement_m for trial in again.trials)
    kept = callback.judge.score(str(tmp_path / "best.onnx"), amplitude=None)
    assert kept.knowledge == "blind"
    assert callback.judge.fit(model).value == callback.history[-1][1].value


def test_a_score_changes_nothing_of_the_training():
    weights = []
    for callback in (None, scored(every=80)):
        model = learner(SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD))
        model.learn(320, callback=callback)
        weights.append([weight.detach().numpy().copy() for weight in model.policy.parameters()])
    assert all(np.array_equal(a, b) for a, b in zip(*weights, strict=True))


def test_a_diverged_training_ends_and_keeps_the_best():
    envs = SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD)
    callback = scored(every=160)
    model = learner(envs)

    def fit(policy, **_):
        if policy.num_timesteps >= 320:
            raise NotFinite("PPO returned NaN for receiver 0")
        return found(policy)

    found, callback.judge.fit = callback.judge.fit, fit
    with pytest.warns(UserWarning, match="diverged after 320 steps: .*the best one was"):
        model.learn(1600, callback=callback)
    assert model.num_timesteps < 1600
    assert "of step " in callback.diverged


class Poison(BaseCallback):
    """Makes the weights NaN, as an update that goes wrong does."""

    def _on_step(self):
        return True

    def _on_rollout_start(self):
        if self.num_timesteps >= 320:
            self.model.policy.action_net.weight.data.fill_(float("nan"))


@pytest.mark.parametrize("every", [160, 10**6])
def test_weights_that_are_no_numbers_end_a_training(every):
    callback = scored(every=every)
    model = learner(SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD))
    with pytest.warns(UserWarning, match="diverged after 320 steps: PPO has weights that are not"):
        model.learn(1600, callback=[Poison(), callback])
    assert model.num_timesteps < 500
    assert np.isfinite(np.concatenate([w.ravel() for w in weights_of(model).values()])).all()
    assert callback.history[-1][0] < 320


def test_a_score_says_that_weights_are_no_numbers():
    model = learner(SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD))
    model.policy.action_net.weight.data.fill_(float("nan"))
    with pytest.raises(NotFinite, match="PPO has weights that are not finite"):
        scored().judge.score(model, amplitude=None)


def test_a_callback_goes_on_from_its_state():
    """One judge for two callbacks; what the second has been given it does not score again."""
    first = scored(every=160)
    model = learner(SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD))
    model.learn(320, callback=first)
    second = ScoreCallback(judge=first.judge, every=160, verbose=0)
    second.restore(json.loads(json.dumps(first.state())))
    assert second.state() == first.state()
    model.learn(160, callback=second, reset_num_timesteps=False)
    assert [step for step, _ in second.history] == [0, 160, 320, 480]
    assert second.history[:3] == first.history
    with pytest.raises(ValueError, match="can't be given with `judge`"):
        ScoreCallback("T3", judge=first.judge)


def weights_of(model):
    return {name: w.detach().numpy().copy() for name, w in model.policy.named_parameters()}


class WeightLog(BaseCallback):
    """Keeps the weights that every rollout began with."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def _on_step(self):
        return True

    def _on_rollout_start(self):
        self.seen.append(weights_of(self.model))


def test_a_callback_scores_the_average_of_the_weights(tmp_path):
    pytest.importorskip("onnxscript")
    callback, log = scored(every=1600, average=0.75, path=tmp_path / "best.onnx"), WeightLog()
    model = learner(SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD))
    model.learn(480, callback=[callback, log])
    own = weights_of(model)
    expected = log.seen[0]
    for now in (*log.seen[1:], own):
        expected = {name: 0.75 * expected[name] + 0.25 * now[name] for name in now}
    with callback.averaged():
        inside = weights_of(model)
        refitted = callback.judge.fit(model)
    for name, weight in expected.items():
        np.testing.assert_allclose(inside[name], weight, rtol=1e-5, atol=1e-7)
    assert any(not np.array_equal(inside[name], own[name]) for name in own)
    assert all(np.array_equal(weight, own[name]) for name, weight in weights_of(model).items())
    assert callback.history[-1][1] == refitted
    assert callback.judge.fit(model) != refitted
    assert callback.best_step == 480
    kept = callback.judge.score(str(tmp_path / "best.onnx"), amplitude=None)
    with callback.averaged():
        live = callback.judge.score(model, amplitude=callback.best_amplitude)
    np.testing.assert_allclose(kept.displacement_m, live.displacement_m, rtol=1e-3)


def test_an_average_goes_on_from_a_state_as_if_it_had_not_stopped():
    """A stage that ends counts its last weights once, before and after."""
    judge = scored().judge
    averages = []
    for cut in (False, True):
        callback = ScoreCallback(judge=judge, every=1600, average=0.75, verbose=0)
        model = learner(SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD))
        model.learn(320, callback=callback)
        if cut:
            state = json.loads(json.dumps(callback.state()))
            callback = ScoreCallback(judge=judge, every=1600, average=0.75, verbose=0)
            callback.restore(state)
        model.learn(320, callback=callback, reset_num_timesteps=False)
        averages.append(callback.state()["average"])
    assert averages[0] == averages[1]


def test_nothing_is_averaged_unless_asked_for():
    callback = scored(every=1600)
    model = learner(SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD))
    model.learn(160, callback=callback)
    assert callback.state()["average"] == {}
    own = weights_of(model)
    with callback.averaged():
        assert all(np.array_equal(weight, own[name]) for name, weight in weights_of(model).items())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"every": 0}, "`every` must be"),
        ({"path": "best.zip"}, r"`path` must end in \.onnx"),
        ({"average": 1.0}, "`average` must be a number of at least 0 and below 1, got 1.0"),
    ],
)
def test_bad_settings_of_a_callback_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        scored(**settings)
