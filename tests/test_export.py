"""From a model to an ONNX file with its card: the same actions, the right card, or nothing."""

from __future__ import annotations

import json

import numpy as np
import pytest

# ruff: noqa: E402 - torch may be missing
torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("onnxscript")

import gymnasium as gym
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize

import spoofgym.export
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.detectors import make_detector
from spoofgym.envs import attach
from spoofgym.export import onnx
from spoofgym.policies.load import OnnxDetector
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers import OnnxPolicy
from spoofgym.spoofers.learned import make_function
from spoofgym.testing import check_detector

TIMELINE = {"warmup_s": 6.0, "live_s": 2.0, "attack_s": 10.0, "time_to_alert_s": 1.0}
NOMINAL = {"name": "snapshot-chi2", "thresholds": "nominal"}
WORLD = {"detector": NOMINAL, "timeline": TIMELINE}


@pytest.fixture(autouse=True)
def torch_threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def make(**settings):
    return SpoofVecEnv(4, seed=0, **{**WORLD, "knowledge": "blind", **settings})


def observations(envs, count=300):
    space = envs.observation_space
    drawn = np.random.default_rng(4).uniform(space.low, space.high, (count, *space.shape))
    return (0.3 * drawn).astype(np.float32)


NIGHTLY = [pytest.param(kind, marks=pytest.mark.nightly) for kind in (A2C, TD3, DDPG)]


@pytest.mark.parametrize("kind", [PPO, SAC, *NIGHTLY])
def test_a_file_acts_as_its_model_of_stable_baselines3(kind, tmp_path):
    further = {"learning_starts": 8} if kind in (SAC, TD3, DDPG) else {"n_steps": 16}
    envs = make()
    model = kind("MlpPolicy", envs, seed=0, device="cpu", **further)
    model.learn(64)
    onnx(model, path=tmp_path / "mine.onnx")
    seen = observations(envs)
    wanted, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(
        OnnxPolicy(str(tmp_path / "mine.onnx")).model.act(seen), wanted, atol=1e-5
    )


def test_the_normalization_of_observations_is_folded_in(tmp_path):
    envs = VecNormalize(make(), norm_reward=False)
    model = PPO("MlpPolicy", envs, n_steps=20, batch_size=80, seed=0, device="cpu")
    model.learn(160)
    onnx(model, path=tmp_path / "mine.onnx", amplitude=2.0)
    seen = observations(envs)
    planned = seen.copy()
    planned[:, :2] /= 2.0  # its own displacement and rate, as they were planned
    wanted, _ = model.predict(envs.normalize_obs(planned), deterministic=True)
    np.testing.assert_allclose(
        OnnxPolicy(str(tmp_path / "mine.onnx")).model.act(seen),
        np.clip(2.0 * np.clip(wanted, -1, 1), -1, 1),
        atol=2e-5,
    )
    assert np.abs(wanted - model.predict(seen, deterministic=True)[0]).max() > 0.01
    judge = Evaluator(**WORLD, runs=20, fit_runs=80)
    mine = judge.score(model, amplitude=2.0)
    file = judge.score(str(tmp_path / "mine.onnx"), amplitude=None)
    assert file.stealthy_displacement_m.value == pytest.approx(mine.stealthy_displacement_m.value)
    onnx(model.policy, envs, tmp_path / "alone.onnx", amplitude=2.0)  # a module, behind `envs`
    np.testing.assert_array_equal(
        OnnxPolicy(str(tmp_path / "alone.onnx")).model.act(seen),
        OnnxPolicy(str(tmp_path / "mine.onnx")).model.act(seen),
    )
    other = VecNormalize(make(), norm_reward=False)
    other.reset()
    with pytest.raises(ValueError, match="otherwise than the model's own environment"):
        onnx(model, other, tmp_path / "other.onnx")
    assert not (tmp_path / "other.onnx").exists()


def test_a_card_says_where_it_was_made_and_the_file_fits_there(tmp_path):
    envs = make(task="T3", domain={"worlds": 2, "turned_deg": [0.0, 360.0]})
    model = PPO("MlpPolicy", envs, n_steps=8, batch_size=32, seed=3, device="cpu")
    model.learn(32)
    card = onnx(model, path=tmp_path / "mine.onnx", training={"note": "short"})
    assert card.env_id == "spoofgym/TightlyCoupled-v0"
    assert card.env_kwargs["scenario"] == "trolley"
    assert card.knowledge.run_time == "blind"
    assert card.knowledge.design_time == "snapshot-chi2 and its world, by training"
    assert card.training == {
        "algorithm": "PPO",
        "steps": 32,
        "seed": 3,
        "amplitude": 1.0,
        "note": "short",
    }
    assert json.loads((tmp_path / "mine.json").read_text())["name"] == "mine"
    attach(str(tmp_path / "mine.onnx"), envs)
    with pytest.raises(ValueError, match="was made for another environment"):
        attach(str(tmp_path / "mine.onnx"), make())
    attach(str(tmp_path / "mine.onnx"), make(), transfer=True)


@pytest.mark.parametrize("vector", [False, True])
def test_a_torch_module_of_gymnasiums_environments(vector, tmp_path):
    settings = {**WORLD, "knowledge": "blind"}
    env_id = "spoofgym/TightlyCoupled-v0"
    envs = gym.make_vec(env_id, num_envs=2, **settings) if vector else gym.make(env_id, **settings)
    size = len(envs.unwrapped.observation_names)
    net = torch.nn.Sequential(torch.nn.Linear(size, 8), torch.nn.Tanh(), torch.nn.Linear(8, 1))
    card = onnx(net, envs, tmp_path / "net.onnx", designed_on="nothing")
    assert card.knowledge.design_time == "nothing"
    attach(str(tmp_path / "net.onnx"), envs)
    seen = np.random.default_rng(0).normal(size=(50, size)).astype(np.float32)
    act = OnnxPolicy(str(tmp_path / "net.onnx")).model.act
    np.testing.assert_allclose(act(seen), np.clip(make_function(net)(seen), -1, 1), atol=1e-5)
    assert net.training  # as it was
    envs.close()


@pytest.mark.parametrize("env_id", ["LooselyCoupled", "Snapshot", "WheeledRobot"])
def test_other_victims_have_cards_too(env_id, tmp_path):
    envs = SpoofVecEnv(2, env_id=f"spoofgym/{env_id}-v0", knowledge="blind")
    net = torch.nn.Linear(len(envs.observation_names), len(envs.action_names))
    card = onnx(net, envs, tmp_path / "net.onnx")
    assert card.env_id == f"spoofgym/{env_id}-v0"
    attach(str(tmp_path / "net.onnx"), envs)
    with pytest.raises(ValueError, match=r"does not fit|was made for another"):
        attach(str(tmp_path / "net.onnx"), make())


def test_a_detector_that_has_learned_is_a_detector_policy(tmp_path):
    envs = SpoofVecEnv(2, side="detector", pool="ramp", timeline=TIMELINE, seed=0)
    model = PPO("MlpPolicy", envs, n_steps=8, batch_size=16, seed=0, device="cpu")
    model.learn(16)
    card = onnx(model, path=tmp_path / "guard.onnx")
    assert card.kind == "detector-policy"
    assert card.training["steps"] == 16
    with pytest.raises(ValueError, match="a detector has no commands to scale"):
        onnx(model, path=tmp_path / "guard.onnx", amplitude=2.0)
    seen = observations(envs)
    wanted, _ = model.predict(seen, deterministic=True)
    act = OnnxDetector(tmp_path / "guard.onnx").model.act
    np.testing.assert_allclose(act(seen), wanted, atol=1e-5)


def test_nothing_of_this_machine_is_in_the_file(tmp_path):
    net = torch.nn.Linear(len(make().observation_names), 1)
    onnx(net, make(), tmp_path / "net.onnx")
    content = (tmp_path / "net.onnx").read_bytes()
    for word in (b"/home", b"/root", b"site-packages", b".py", str(tmp_path).encode()):
        assert word not in content


class Noisy(torch.nn.Module):
    def __init__(self, size):
        super().__init__()
        self.linear = torch.nn.Linear(size, 1)

    def forward(self, seen):
        return self.linear(seen) + 0.1 * torch.randn_like(seen[:, :1])


def test_what_does_not_fit_is_refused_and_nothing_is_written(tmp_path):
    envs = make()
    size = len(envs.observation_names)
    cases = [
        ((3, envs), TypeError, "can be exported, got int"),
        ((torch.nn.Linear(size, 1), None), TypeError, "`env` must be an environment of spoofgym"),
        ((torch.nn.Linear(size, 1), gym.make("CartPole-v1")), TypeError, "environment of spoofgym"),
        ((torch.nn.Linear(size + 1, 1), envs), ValueError, f"can't be run with {size} obs"),
        ((torch.nn.Linear(size, 2), envs), ValueError, r"actions of shape \(B, 1\), got \(2, 2\)"),
        ((Noisy(size), envs), ValueError, "has the operator RandomNormalLike"),
    ]
    for given, error, message in cases:
        with pytest.raises(error, match=message):
            onnx(*given, tmp_path / "x.onnx")
    net = torch.nn.Linear(size, 1)
    with pytest.raises(ValueError, match=r"`path` must end in \.onnx"):
        onnx(net, envs, tmp_path / "x.pt")
    with pytest.raises(ValueError, match="`amplitude` must be a number above 0, got 0"):
        onnx(net, envs, tmp_path / "x.onnx", amplitude=0.0)
    for training, message in (
        ([1], r"`training` must be a mapping, got \[1\]"),
        ({"decided_on": "x"}, "must be pairs of an entropy and a split"),
        ({"decided_on": [[0, 5]]}, "must be pairs of an entropy and a split"),
        ({"decided_on": [[0, "trial"]]}, "unknown split 'trial'; valid: calibration"),
    ):
        with pytest.raises(ValueError, match=message):
            onnx(net, envs, tmp_path / "x.onnx", training=training)
    with pytest.raises(ValueError, match=r"card of .*x y\.onnx: `name`: ") as found:
        onnx(net, envs, tmp_path / "x y.onnx")
    assert "\n" not in str(found.value)
    own = make(observation=["own-command"])
    with pytest.raises(ValueError, match="`observation` of its own"):
        onnx(torch.nn.Linear(len(own.observation_names), 1), own, tmp_path / "x.onnx")
    discrete = PPO("MlpPolicy", gym.make("CartPole-v1"), device="cpu")
    with pytest.raises(TypeError, match="environment of spoofgym"):
        onnx(discrete, path=tmp_path / "x.onnx")
    with pytest.raises(TypeError, match="only a policy with a Gaussian action"):
        onnx(discrete, envs, tmp_path / "x.onnx")
    assert list(tmp_path.iterdir()) == []


def test_a_recurrent_policy_is_refused(tmp_path):
    contrib = pytest.importorskip("sb3_contrib")
    envs = make()
    model = contrib.RecurrentPPO("MlpLstmPolicy", envs, n_steps=8, device="cpu")
    with pytest.raises(ValueError, match="is recurrent: it needs its state"):
        onnx(model, path=tmp_path / "x.onnx")
    with pytest.raises(ValueError, match="is recurrent"):
        Evaluator(**WORLD, runs=2, fit_runs=80).score(model)


def test_a_module_with_a_state_is_refused_in_one_line():
    module = torch.nn.LSTM(len(make().observation_names), 1)
    evaluator = Evaluator(**WORLD, runs=2, fit_runs=80)
    with pytest.raises(ValueError, match="LSTM must return actions, a tensor, got tuple"):
        evaluator.score(module, knowledge="blind")


class Endless(torch.nn.Module):
    def forward(self, seen):
        return seen[:, :1] / 0.0


def test_an_error_names_the_users_file_and_not_the_trial_of_it(tmp_path):
    with pytest.raises(ValueError, match=r"returned (NaN|inf|-inf)") as found:
        onnx(Endless(), make(), tmp_path / "mine.onnx")
    assert str(tmp_path / "mine.onnx") in str(found.value)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_acts_otherwise_is_not_written(tmp_path, monkeypatch):
    envs = make()
    net = torch.nn.Linear(len(envs.observation_names), 1)
    monkeypatch.setattr(spoofgym.export, "make_function", lambda _: lambda seen: seen[:, :1] * 0.0)
    with pytest.raises(ValueError, match="the exported file differs from the model by"):
        onnx(net, envs, tmp_path / "x.onnx")
    assert list(tmp_path.iterdir()) == []


class Recurrent(torch.nn.Module):
    """A gated unit, and a statistic that is linear in its state."""

    def __init__(self, observed, hidden=6, decided=1):
        super().__init__()
        self.cell = torch.nn.GRUCell(observed, hidden)
        self.head = torch.nn.Linear(hidden, decided)
        self.noise = torch.nn.Dropout(0.5)

    def forward(self, observation, hidden):
        after = self.cell(observation, hidden)
        return 3.0 * self.head(self.noise(after)), after


TERMS = ["innovation", "in-view", {"name": "classic", "detector": "snapshot-chi2"}]
OBSERVED = 24 + 12 + 1


def test_a_recurrent_module_becomes_a_detector_with_its_state(tmp_path):
    torch.manual_seed(0)
    module, path = Recurrent(OBSERVED).train(), tmp_path / "guard.onnx"
    card = spoofgym.export.detector(
        module,
        path,
        name="my guard",
        terms=TERMS,
        state={"hidden": 6},
        training={"steps": 3},
    )
    assert module.training
    assert module.noise.training
    assert (card.name, card.statistic, card.weighs, card.quiet_epochs) == (
        "my guard",
        "receiver",
        False,
        0,
    )
    assert card.threshold is None
    assert (card.training["steps"], "torch" in card.training["versions"]) == (3, True)
    assert [(each.name, each.size) for each in card.state] == [("hidden", 6)]
    assert [term["name"] for term in card.terms] == ["innovation", "in-view", "classic"]
    read = OnnxDetector(path)
    assert read.card == card
    rng, module = np.random.default_rng(2), module.eval()
    mine, hidden = np.zeros((7, 6), np.float32), torch.zeros(7, 6)
    for _ in range(20):
        seen = rng.normal(size=(7, OBSERVED)).astype(np.float32)
        action, (mine,) = read.model.step(seen, [mine])
        with torch.no_grad():
            wanted, hidden = module(torch.from_numpy(seen), hidden)
        np.testing.assert_allclose(action, wanted.clamp(-1.0, 1.0).numpy(), atol=1e-5)
    assert 0.0 < np.abs(action).max() <= 1.0
    found = make_detector({"name": str(path), "threshold": 0.8})
    assert (found.scale, found.detector.label) == (0.8, "my guard")


def test_a_module_without_a_state_may_weigh_slots(tmp_path):
    module = torch.nn.Linear(24, 24)
    options = {"statistic": "channel", "weighs": True, "exclusion_s": 30.0, "threshold": 0.7}
    card = spoofgym.export.detector(
        module, tmp_path / "guard.onnx", terms=["innovation"], **options
    )
    assert (card.exclusion_s, card.threshold, card.state) == (30.0, 0.7, ())
    assert card.action.names[12] == "weight_slot00"
    check_detector(str(tmp_path / "guard.onnx"))


class Forgets(Recurrent):
    """Returns no state."""

    def forward(self, observation, hidden):
        return super().forward(observation, hidden)[:1]


class Dice(Recurrent):
    """Draws random numbers."""

    def forward(self, observation, hidden):
        action, after = super().forward(observation, hidden)
        return action, after + 0.1 * torch.randn_like(after)


@pytest.mark.parametrize(
    ("module", "options", "message"),
    [
        (
            Forgets(OBSERVED),
            {},
            r"must return \(B, 1\), \(B, 6\), of action and states, got \(2, 1\)",
        ),
        (Recurrent(OBSERVED, decided=2), {}, r"of action and states, got \(2, 2\), \(2, 6\)"),
        (Recurrent(OBSERVED + 1), {}, r"can't be run with \(B, 37\), \(B, 6\), to return \(B, 1\)"),
        (Recurrent(OBSERVED), {"state": {"hidden": 5}}, r"can't be run with \(B, 37\), \(B, 5\)"),
        (Recurrent(OBSERVED), {"state": {}}, r"can't be run with \(B, 37\), to return \(B, 1\)"),
        (Recurrent(OBSERVED), {"terms": ["inovation"]}, "did you mean 'innovation'"),
        (
            Recurrent(OBSERVED),
            {"state": {"next hidden": 6}},
            "state 'next hidden' of size 6: `name`",
        ),
        (Recurrent(OBSERVED), {"state": {"hidden": -1}}, "state 'hidden' of size -1: `size`"),
        (Recurrent(OBSERVED), {"state": {"action": 6}}, "can't have the name 'action'"),
        (Recurrent(OBSERVED), {"state": [6]}, "`state` must be sizes by name"),
        (Recurrent(OBSERVED), {"threshold": 2.0}, r"card of .*guard\.onnx: `threshold`"),
        (Recurrent(OBSERVED), {"training": {"decided_on": [[0, "x"]]}}, "unknown split 'x'"),
        (Dice(OBSERVED), {}, "has the operator RandomNormalLike"),
    ],
    ids=[
        *("no state", "size", "observations", "state", "undeclared", "terms", "name", "negative"),
        *("taken", "no mapping", "threshold", "split", "chance"),
    ],
)
def test_a_module_that_is_no_detector_is_refused_and_nothing_is_written(
    module, options, message, tmp_path
):
    options = {"terms": TERMS, "state": {"hidden": 6}, **options}
    with pytest.raises(ValueError, match=message):
        spoofgym.export.detector(module, tmp_path / "guard.onnx", **options)
    assert not list(tmp_path.iterdir())
    with pytest.raises(TypeError, match="`module` must be a torch module, got function"):
        spoofgym.export.detector(lambda seen: seen, tmp_path / "guard.onnx", **options)
