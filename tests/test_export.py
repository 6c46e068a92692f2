"""From a model to an ONNX file with its card: the same actions, the right card, or nothing."""

import json
from functools import partial

import numpy as np
import pytest

# ruff: noqa: E402 - torch may be missing
torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("onnxscript")

import gymnasium as gym
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

import spoofgym.export
from spoofgym import wrappers
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.detectors import Calibrated, SnapshotChi2, make_detector
from spoofgym.detectors.build import spec_of_judge
from spoofgym.envs import attach
from spoofgym.export import onnx
from spoofgym.policies.load import OnnxDetector
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers import OnnxPolicy
from spoofgym.spoofers.learned import make_function
from spoofgym.testing import check_detector

from .nightly import heavy

TIMELINE = {"warmup_s": 6.0, "live_s": 2.0, "attack_s": 10.0, "time_to_alert_s": 1.0}
WORLD = {
    "scenario": "zhong2025",
    "detector": {"name": "snapshot-chi2", "thresholds": "nominal"},
    "timeline": TIMELINE,
}


def make(**settings):
    world = {key: x for key, x in WORLD.items() if key != "scenario" or "task" not in settings}
    return SpoofVecEnv(4, seed=0, **{**world, "knowledge": "blind", **settings})


def read(path):
    return OnnxPolicy(str(path)).model.act


def observations(envs, count=300):
    space = envs.observation_space
    drawn = np.random.default_rng(4).uniform(space.low, space.high, (count, *space.shape))
    return (0.3 * drawn).astype(np.float32)


@pytest.mark.parametrize("kind", heavy([PPO, SAC, A2C, TD3, DDPG], A2C, TD3, DDPG))
def test_a_file_acts_as_its_model_of_stable_baselines3(kind, tmp_path):
    further = {"learning_starts": 8} if kind in (SAC, TD3, DDPG) else {"n_steps": 16}
    envs = make()
    model = kind("MlpPolicy", envs, seed=0, device="cpu", **further)
    model.learn(64)
    onnx(model, path=tmp_path / "mine.onnx")
    seen = observations(envs)
    wanted, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(read(tmp_path / "mine.onnx")(seen), wanted, atol=1e-5)


def test_the_normalization_of_observations_is_folded_in(tmp_path):
    envs = VecNormalize(make(), norm_reward=False)
    model = PPO("MlpPolicy", envs, n_steps=20, batch_size=80, seed=0, device="cpu")
    model.learn(160)
    onnx(model, path=tmp_path / "mine.onnx", amplitude=2.0)
    seen = observations(envs)
    planned = seen.copy()
    planned[:, :2] /= 2.0  # its own displacement and rate, as they were planned
    wanted, _ = model.predict(envs.normalize_obs(planned), deterministic=True)
    acted = read(tmp_path / "mine.onnx")(seen)
    np.testing.assert_allclose(acted, np.clip(2.0 * np.clip(wanted, -1, 1), -1, 1), atol=2e-5)
    assert np.abs(wanted - model.predict(seen, deterministic=True)[0]).max() > 0.01
    onnx(model.policy, envs, tmp_path / "alone.onnx", amplitude=2.0)  # a module, behind `envs`
    np.testing.assert_array_equal(read(tmp_path / "alone.onnx")(seen), acted)
    other = VecNormalize(make(), norm_reward=False)
    other.reset()
    with pytest.raises(ValueError, match="differently from the model's own environment"):
        onnx(model, other, tmp_path / "other.onnx")
    assert not (tmp_path / "other.onnx").exists()


def test_a_card_says_where_it_was_made_and_the_file_fits_there(tmp_path):
    envs = make(task="T3", domain={"worlds": 2, "turned_deg": [0.0, 360.0]})
    path = tmp_path / "a.onnx"
    model = PPO("MlpPolicy", envs, n_steps=8, batch_size=32, seed=3, device="cpu")
    model.learn(32)
    card = onnx(model, path=path, training={"note": "short"})
    assert (card.env_id, card.env_kwargs["scenario"]) == ("spoofgym/BenchT3-v1", "trolley")
    told = (card.knowledge.run_time, card.knowledge.design_time)
    assert told == ("blind", "snapshot-chi2 and its world, by training")
    expected = {"algorithm": "PPO", "steps": 32, "seed": 3, "amplitude": 1.0, "note": "short"}
    assert card.training == expected
    assert json.loads(path.with_suffix(".json").read_text())["name"] == "a"
    attach(str(path), envs)
    with pytest.raises(ValueError, match="was made for another environment"):
        attach(str(path), make())
    attach(str(path), make(), transfer=True)


def sb3(env_id, **settings):
    return SpoofVecEnv(2, env_id=env_id, **settings)


@pytest.mark.parametrize(
    ("name", "build"),
    [
        ("Zhong2025", gym.make),
        ("Snapshot", sb3),
        pytest.param("Zhong2025", gym.make_vec, marks=pytest.mark.nightly),
        pytest.param("LooselyCoupled", sb3, marks=pytest.mark.nightly),
        pytest.param("WheeledRobot", sb3, marks=pytest.mark.nightly),
    ],
)
def test_a_torch_module_of_any_environment(name, build, tmp_path):
    env_id, path = f"spoofgym/{name}-v0", tmp_path / "net.onnx"
    envs = build(env_id, knowledge="blind", **(WORLD if name == "Zhong2025" else {}))
    core = getattr(envs, "unwrapped", envs)
    size, count = len(core.observation_names), len(core.action_names)
    net = torch.nn.Sequential(torch.nn.Linear(size, 8), torch.nn.Tanh(), torch.nn.Linear(8, count))
    card = onnx(net, envs, path, designed_on="nothing")
    assert (card.env_id, card.knowledge.design_time) == (env_id, "nothing")
    attach(str(path), envs)
    seen = np.random.default_rng(0).normal(size=(50, size)).astype(np.float32)
    expected = np.clip(make_function(net)(seen), -1, 1)
    np.testing.assert_allclose(read(path)(seen), expected, atol=1e-5)
    assert net.training  # as it was
    for word in (b"/home", b"/root", b"site-packages", b".py", str(tmp_path).encode()):
        assert word not in path.read_bytes()  # nothing of this machine
    if name != "Zhong2025":
        with pytest.raises(ValueError, match=r"does not fit|was made for another"):
            attach(str(path), make())


def test_a_detector_that_has_learned_is_a_detector_policy(tmp_path):
    envs = SpoofVecEnv(2, side="detector", pool="ramp", scenario="zhong2025", timeline=TIMELINE)
    path = tmp_path / "g.onnx"
    model = PPO("MlpPolicy", envs, n_steps=8, batch_size=16, seed=0, device="cpu")
    model.learn(16)
    card = onnx(model, path=path)
    assert (card.kind, card.training["steps"]) == ("detector-policy", 16)
    with pytest.raises(ValueError, match="a detector has no commands to scale"):
        onnx(model, path=path, amplitude=2.0)
    seen = observations(envs)
    wanted, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(OnnxDetector(path).model.act(seen), wanted, atol=1e-5)


class Noisy(torch.nn.Linear):
    def forward(self, seen):
        return super().forward(seen) + 0.1 * torch.randn_like(seen[:, :1])


class Endless(torch.nn.Module):
    def forward(self, seen):
        return seen[:, :1] / 0.0


def test_what_does_not_fit_is_refused_and_nothing_is_written(tmp_path, monkeypatch):
    envs, own = make(), make(observation=["own-command"])
    linear, size = torch.nn.Linear, len(envs.observation_names)
    discrete = PPO("MlpPolicy", gym.make("CartPole-v1"), device="cpu")
    for model, env, error, message in (
        (3, envs, TypeError, "can be exported, got int"),
        (linear(size, 1), None, TypeError, "`env` must be an environment of spoofgym"),
        (discrete, envs, TypeError, "only a policy with a Gaussian action"),
        (linear(size + 1, 1), envs, ValueError, rf"can't be run with \(B, {size}\)"),
        (linear(size, 2), envs, ValueError, r"must return \(B, 1\) for .* got \(2, 2\)"),
        (
            linear(len(own.observation_names), 1),
            own,
            ValueError,
            "without the `observation` of this environment",
        ),
        (Noisy(size, 1), envs, ValueError, "has the operator RandomNormalLike"),
        (Endless(), envs, ValueError, rf"{tmp_path / 'x.onnx'}.* returned (NaN|inf|-inf)"),
    ):
        with pytest.raises(error, match=message):
            onnx(model, env, tmp_path / "x.onnx")
    for name, options, message in (
        ("x.onnx", {"amplitude": 0.0}, "`amplitude` must be a number above 0, got 0"),
        ("x.onnx", {"training": [1]}, r"`training` must be a mapping, got \[1\]"),
        ("x.onnx", {"training": {"decided_on": [[0, "trial"]]}}, "unknown split 'trial'; valid: "),
        ("x y.onnx", {}, r"card of .*x y\.onnx: `name`: [^\n]*$"),
    ):
        with pytest.raises(ValueError, match=message):
            onnx(linear(size, 1), envs, tmp_path / name, **options)
    monkeypatch.setattr(spoofgym.export, "make_function", lambda _: lambda seen: seen[:, :1] * 0.0)
    with pytest.raises(ValueError, match="the exported file differs from the model by"):
        onnx(linear(size, 1), envs, tmp_path / "x.onnx")
    assert list(tmp_path.iterdir()) == []


def test_what_has_a_state_is_refused(tmp_path):
    judge, envs = Evaluator(**WORLD, runs=2, fit_runs=80), make()
    module = torch.nn.LSTM(len(envs.observation_names), 1)
    with pytest.raises(ValueError, match="LSTM must return actions, a tensor, got tuple"):
        judge.score(module, knowledge="blind")
    contrib = pytest.importorskip("sb3_contrib")
    model = contrib.RecurrentPPO("MlpLstmPolicy", envs, n_steps=8, device="cpu")
    with pytest.raises(ValueError, match="is recurrent: it needs its state"):
        onnx(model, path=tmp_path / "x.onnx")
    with pytest.raises(ValueError, match="is recurrent"):
        judge.score(model)


class Recurrent(torch.nn.Module):
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
    options = {"name": "my guard", "state": {"hidden": 6}, "training": {"steps": 3}}
    card = spoofgym.export.detector(module, path, terms=TERMS, **options)
    assert module.training
    assert module.noise.training
    told = (card.name, card.statistic, card.weighs, card.quiet_epochs, card.threshold)
    assert told == ("my guard", "receiver", False, 0, None)
    assert (card.training["steps"], "torch" in card.training["versions"]) == (3, True)
    assert [(each.name, each.size) for each in card.state] == [("hidden", 6)]
    assert [term["name"] for term in card.terms] == ["innovation", "in-view", "classic"]
    kept = OnnxDetector(path)
    assert kept.card == card
    rng, module = np.random.default_rng(2), module.eval()
    mine, hidden = np.zeros((7, 6), np.float32), torch.zeros(7, 6)
    for _ in range(20):
        seen = rng.normal(size=(7, OBSERVED)).astype(np.float32)
        action, (mine,) = kept.model.step(seen, [mine])
        with torch.no_grad():
            wanted, hidden = module(torch.from_numpy(seen), hidden)
        np.testing.assert_allclose(action, wanted.clamp(-1.0, 1.0).numpy(), atol=1e-5)
    assert 0.0 < np.abs(action).max() <= 1.0
    found = make_detector({"name": str(path), "threshold": 0.8})
    assert (found.scale, found.detector.label) == (0.8, "my guard")


def test_a_module_without_a_state_may_weigh_slots(tmp_path):
    options = {"statistic": "channel", "weighs": True, "exclusion_s": 30.0, "threshold": 0.7}
    path = tmp_path / "guard.onnx"
    card = spoofgym.export.detector(torch.nn.Linear(24, 24), path, terms=["innovation"], **options)
    assert (card.exclusion_s, card.threshold, card.state) == (30.0, 0.7, ())
    assert card.action.names[12] == "weight_slot00"
    check_detector(str(path))


class Forgets(Recurrent):
    def forward(self, observation, hidden):
        return super().forward(observation, hidden)[:1]


@pytest.mark.parametrize(
    ("module", "options", "message"),
    [
        (Forgets, {}, r"for action and states, got \(2, 1\)"),
        (partial(Recurrent, decided=2), {}, r"for action and states, got \(2, 2\), \(2, 6\)"),
        (Recurrent, {"state": {"hidden": 5}}, r"can't be run with \(B, 37\), \(B, 5\)"),
        (Recurrent, {"state": {"next hidden": 6}}, "state 'next hidden' of size 6: `name`"),
        (Recurrent, {"state": {"action": 6}}, "can't have the name 'action'"),
        (Recurrent, {"state": [6]}, "`state` must be sizes by name"),
        (Recurrent, {"threshold": 2.0}, r"card of .*guard\.onnx: `threshold`"),
    ],
)
def test_a_module_that_is_no_detector_is_refused_and_nothing_is_written(
    module, options, message, tmp_path
):
    options = {"terms": TERMS, "state": {"hidden": 6}, **options}
    with pytest.raises(ValueError, match=message):
        spoofgym.export.detector(module(OBSERVED), tmp_path / "guard.onnx", **options)
    assert not list(tmp_path.iterdir())
    with pytest.raises(TypeError, match="`module` must be a torch module, got function"):
        spoofgym.export.detector(lambda seen: seen, tmp_path / "guard.onnx", **options)


class Own(gym.Wrapper):
    """A detector that knows nothing of this library."""


class Half(gym.ObservationWrapper):
    def observation(self, observation):
        return 0.5 * observation


def test_a_wrapper_that_changes_what_is_observed_is_refused_by_its_name(tmp_path):
    """By an export, by a score, and before a policy from a card."""
    plain = partial(gym.make, "spoofgym/Zhong2025-v0", knowledge="blind", **WORLD)
    judge = Evaluator(runs=2, fit_runs=59, **WORLD)
    for wrapped, name in (
        (Half(plain()), "tests.test_export:Half"),
        (VecFrameStack(make(), 3), "stable_baselines3.*:VecFrameStack"),
    ):
        model = PPO("MlpPolicy", wrapped, n_steps=8, batch_size=8, device="cpu")
        for use in (partial(onnx, path=tmp_path / "x.onnx"), judge.score):
            with pytest.raises(ValueError, match=f"the wrapper {name} changes every observation"):
                use(model)
    onnx(torch.nn.Linear(len(make().observation_names), 1), plain(), tmp_path / "y.onnx")
    for env in (Half(plain()), VecNormalize(make())):
        with pytest.raises(ValueError, match=r"changes every observation, and 'y' is played with"):
            attach(str(tmp_path / "y.onnx"), env)


def test_a_model_without_its_normalization_is_refused(tmp_path):
    envs, statistics = VecNormalize(make(), gamma=1.0), tmp_path / "envs.pkl"
    model = PPO("MlpPolicy", envs, n_steps=8, batch_size=32, n_epochs=1, device="cpu")
    model.learn(32)
    model.save(tmp_path / "model")
    envs.save(statistics)
    load = partial(PPO.load, tmp_path / "model", device="cpu")
    judge = Evaluator(runs=2, fit_runs=59, **WORLD)
    score = partial(judge.score, amplitude=1.0)
    for bare in (make(), VecNormalize(make())):  # without statistics, or with none of its own
        for use in (score, partial(onnx, path=tmp_path / "x.onnx")):
            with pytest.raises(ValueError, match=r"with a VecNormalize.*env=VecNormalize\.load"):
                use(load(env=bare))
    for use in (score, partial(onnx, env=make(), path=tmp_path / "x.onnx")):
        with pytest.raises(ValueError, match="trained with a VecNormalize"):
            use(load())
    assert not (tmp_path / "x.onnx").exists()
    again = score(load(env=VecNormalize.load(statistics, make())))
    assert again.displacement_m.tolist() == score(model).displacement_m.tolist()


def test_a_card_names_the_detector_that_a_wrapper_has_set(tmp_path):
    """Within the loop and outside, an object of a module that can be imported."""
    own = Calibrated(SnapshotChi2(signals="pseudorange"), scale=0.8)
    written = spec_of_judge(own)
    task = gym.make("spoofgym/BenchT1-v1")
    wrapped = [
        wrappers.DetectorWrapper(task, own),
        wrappers.PassiveDetector(gym.make("spoofgym/BenchT1-v1"), own),
        sb3("spoofgym/Zhong2025-v0", detector=own),
    ]
    for number, env in enumerate(wrapped):
        path = tmp_path / f"{number}.onnx"
        model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu")
        card = onnx(model, path=path)
        assert card.env_kwargs["detector"] == written
        assert "epoch" not in card.env_kwargs

    model = PPO("MlpPolicy", Own(gym.make("spoofgym/BenchT1-v1")), n_steps=8, batch_size=8)
    card = onnx(model, path=tmp_path / "own.onnx")
    assert card.training["wrappers"] == ["tests.test_export:Own"]
    assert card.knowledge.design_time.endswith(
        " in tests.test_export:Own and its world, by training"
    )

    class Local(SnapshotChi2):
        pass

    env = sb3("spoofgym/Zhong2025-v0", detector=Local())
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu")
    with pytest.raises(ValueError, match=r"no card can name .*Local'"):
        onnx(model, path=tmp_path / "local.onnx")
