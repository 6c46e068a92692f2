"""Scores of a policy while stable-baselines3 trains it."""

import json

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from spoofgym.policies.contract import NotFinite
from spoofgym.sb3 import ScoreCallback, SpoofVecEnv

WORLD = {
    "scenario": "zhong2025",
    "detector": {"name": "snapshot-chi2", "thresholds": "nominal"},
    "timeline": {"warmup_s": 6.0, "live_s": 2.0, "attack_s": 5.0, "time_to_alert_s": 1.0},
}


@pytest.fixture(scope="module")
def judge():
    """Of training runs, whose ends are found once."""
    return scored().judge


def learner(envs=None):
    envs = envs or SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD)
    return PPO("MlpPolicy", envs, n_steps=20, batch_size=160, gamma=1.0, seed=0, device="cpu")


def scored(**settings):
    world = {} if "judge" in settings else {**WORLD, "fit_runs": 80, "runs": 24}
    return ScoreCallback(**{**world, "verbose": 0, **settings})


def weights_of(model):
    return {name: w.detach().numpy().copy() for name, w in model.policy.named_parameters()}


def test_a_callback_scores_the_policy_as_it_learns_and_knows_the_best(judge):
    envs = VecNormalize(SpoofVecEnv(8, knowledge="blind", seed=0, **WORLD), norm_reward=False)
    callback = scored(judge=judge, every=160)
    model = learner(envs)
    model.learn(320, callback=callback)
    steps = [step for step, _ in callback.history]
    assert steps == [0, 160, 320]
    scores = [found.score for _, found in callback.history]
    assert callback.best_m == max(scores)
    assert steps[int(np.argmax(scores))] == callback.best_step
    assert judge.fit(model).value == callback.history[-1][1].value
    assert callback.state()["average"] == {}  # nothing is, unless wanted
    second = scored(judge=judge, every=160)
    second.restore(json.loads(json.dumps(callback.state())))
    assert second.state() == callback.state()
    model.learn(160, callback=second, reset_num_timesteps=False)
    assert [step for step, _ in second.history] == [0, 160, 320, 480]
    assert second.history[:3] == callback.history


def test_a_score_changes_nothing_of_the_training(judge):
    weights = []
    for callback in (None, scored(judge=judge, every=80)):
        model = learner()
        model.learn(320, callback=callback)
        weights.append(weights_of(model))
    for name, weight in weights[0].items():
        np.testing.assert_array_equal(weight, weights[1][name])


class Rollouts(BaseCallback):
    def __init__(self, call):
        super().__init__()
        self._on_rollout_start = lambda: call(self.model)

    def _on_step(self):
        return True


def poison(model):
    """Make the weights NaN, as an update that goes wrong does."""
    if model.num_timesteps >= 320:
        model.policy.action_net.weight.data.fill_(float("nan"))


@pytest.mark.parametrize("every", [160, 10**6])
def test_weights_that_are_no_numbers_end_a_training(every, judge):
    callback, model = scored(judge=judge, every=every), learner()
    with pytest.warns(UserWarning, match="diverged after 320 steps: PPO has weights that are not"):
        model.learn(1600, callback=[Rollouts(poison), callback])
    assert model.num_timesteps < 500
    assert np.isfinite(np.concatenate([w.ravel() for w in weights_of(model).values()])).all()
    assert callback.history[-1][0] < 320
    model.policy.action_net.weight.data.fill_(float("nan"))
    with pytest.raises(NotFinite, match="PPO has weights that are not finite"):
        judge.score(model, amplitude=None)


def test_actions_that_are_no_numbers_end_a_training_and_the_best_is_kept(judge, monkeypatch):
    callback, model, fit = scored(judge=judge, every=160), learner(), judge.fit

    def failing(policy, **_):
        if policy.num_timesteps >= 320:
            raise NotFinite("PPO returned NaN for receiver 0")
        return fit(policy)

    monkeypatch.setattr(judge, "fit", failing)
    with pytest.warns(UserWarning, match="diverged after 320 steps: .*NaN.*the best one was"):
        model.learn(1600, callback=callback)
    assert model.num_timesteps < 1600
    assert "of step " in callback.diverged


def test_a_callback_scores_and_keeps_the_average_of_the_weights(tmp_path, judge):
    pytest.importorskip("onnxscript")
    seen, path = [], tmp_path / "best.onnx"
    callback, model = scored(judge=judge, every=1600, average=0.75, path=path), learner()
    log = Rollouts(lambda model: seen.append(weights_of(model)))
    model.learn(480, callback=[callback, log])
    own, expected = weights_of(model), seen[0]
    for now in (*seen[1:], own):
        expected = {name: 0.75 * expected[name] + 0.25 * now[name] for name in now}
    with callback.apply_average():
        inside = weights_of(model)
        refitted = judge.fit(model)
        live = judge.score(model, amplitude=callback.best_amplitude)
    for name, weight in expected.items():
        np.testing.assert_allclose(inside[name], weight, rtol=1e-5, atol=1e-7)
    assert any(not np.array_equal(inside[name], own[name]) for name in own)
    assert all(np.array_equal(weight, own[name]) for name, weight in weights_of(model).items())
    assert callback.history[-1][1] == refitted
    assert judge.fit(model) != refitted
    assert callback.best_step == 480
    kept = judge.score(str(path), amplitude=None)
    np.testing.assert_allclose(kept.displacement_m, live.displacement_m, rtol=1e-3)


def test_an_average_goes_on_from_a_state_as_if_it_had_not_stopped(judge):
    averages = []
    for cut in (False, True):
        callback, model = scored(judge=judge, every=1600, average=0.75), learner()
        model.learn(320, callback=callback)
        if cut:
            state = json.loads(json.dumps(callback.state()))
            callback = scored(judge=judge, every=1600, average=0.75)
            callback.restore(state)
        model.learn(320, callback=callback, reset_num_timesteps=False)
        averages.append(callback.state()["average"])
    assert averages[0] == averages[1]


@pytest.mark.parametrize(
    "settings", [{"every": 0}, {"path": "best.zip"}, {"average": 1.0}, {"task": "T3"}]
)
def test_bad_settings_of_a_callback_are_refused(judge, settings):
    (name,) = settings
    with pytest.raises(ValueError, match=f"`{name}`|can't be given with `judge`"):
        scored(judge=judge, **settings)
