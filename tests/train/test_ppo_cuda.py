"""The learner for a device, on the processor: a problem of tensors, and the engine in tensors."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "onnxscript", "tyro"):
    pytest.importorskip(name)

from spoofgym.policies import SpooferCard
from train.ppo_cuda import Learner, OnProcessor, Settings, build_table, play

SHORT = {"warmup_s": 8.0, "live_s": 5.0, "attack_s": 10.0, "time_to_alert_s": 2.0}
WORLD = {"timeline": SHORT, "receiver": None, "domain": None, "decision_interval_s": 1.0}


@pytest.fixture(autouse=True)
def one_thread():
    """As the command has it: more fight with those of other tests."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Follow:
    """Tensors alone: the action is to be half of what is observed; an episode has four steps."""

    num_envs, device = 256, torch.device("cpu")
    core = SimpleNamespace(
        episode_steps=4, length_m=1.0, observation_names=("wanted",), action_names=("given",)
    )

    def reset(self, *, seed):
        self.count, self.wanted = 0, torch.rand(self.num_envs, 1) * 2.0 - 1.0
        return self.wanted.clone(), {}

    def step_unchecked(self, actions):
        self.count, apart = self.count + 1, (actions - 0.5 * self.wanted)[:, 0].abs()
        self.wanted = torch.rand(self.num_envs, 1) * 2.0 - 1.0
        over = torch.full((self.num_envs,), self.count % 4 == 0)
        info = {"undetected_displacement_m": apart, "detected": torch.zeros_like(over)}
        return self.wanted.clone(), -apart.double(), over, torch.zeros_like(over), info

    def check(self):
        """There is nothing to be found."""


def test_the_learner_solves_a_problem_of_tensors_and_goes_on_from_its_tensors(tmp_path):
    settings = Settings(out=tmp_path, device="cpu", learning_rate=3e-3, log_std=-1.0)
    learner = Learner(Follow(), settings, 1)
    assert not any(x.any() for name, x in learner.tensors.items() if name.startswith("adam"))
    seen = torch.linspace(-1.0, 1.0, 21)[:, None]
    missed = lambda: float((learner.policy(seen) - 0.5 * seen).abs().mean().detach())  # noqa: E731
    learner.begin(1)
    at_first = missed()
    for k in range(30):
        learner.learn(k / 30)
    assert missed() < 0.2 * at_first < 0.06
    totals = learner.pop_totals()
    assert totals["episodes"] == 30 * Follow.num_envs
    kept = {name: tensor.clone() for name, tensor in learner.tensors.items()}
    other = Learner(Follow(), settings, 2)
    other.load(kept)
    for each in (learner, other):
        each.begin(3)
        each.learn(0.5)
    for name, tensor in learner.tensors.items():
        assert torch.equal(tensor, other.tensors[name]), name


@pytest.fixture
def settings(tmp_path):
    own = json.dumps({"scenario": "zhong2025", "imu_rate_hz": 50.0, **WORLD})
    met = json.dumps({"name": "snapshot-chi2", "thresholds": "nominal"})
    quick = {"num_envs": 4, "steps": 160, "stages": 2, "minibatches": 2, "n_epochs": 1}
    sizes = {"fit_runs": 80, "runs": 4}
    return Settings(
        out=tmp_path / "cuda", device="cpu", task="T1", detector=met, settings=own, **quick, **sizes
    )


def test_a_training_that_ctrl_c_ends_within_a_rollout_goes_on_and_is_scored(
    settings, tmp_path, monkeypatch
):
    learn, collect, calls, steps = Learner.learn, Learner._collect, [], []

    def watched(self, done):
        calls.append(done)
        learn(self, done)

    def interrupted(self):  # in the place of a graph that is replayed
        steps.append(len(calls))
        if steps.count(4) == 5 and len(calls) == 4:
            raise KeyboardInterrupt
        collect(self)

    monkeypatch.setattr(Learner, "learn", watched)
    monkeypatch.setattr(Learner, "_collect", interrupted)
    with pytest.raises(KeyboardInterrupt):
        play(settings)
    results = play(settings)
    assert calls == [0.0, 0.25, 0.5, 0.75, 0.5, 0.75]  # its second stage again
    whole = play(replace(settings, out=tmp_path / "whole" / "cuda"))
    assert whole["score-0"] == results["score-0"]
    assert whole["seed-0"]["curve"] == results["seed-0"]["curve"]
    file = settings.out / "seed-0" / "cuda-0.onnx"
    card = SpooferCard.load(file.with_suffix(".json"))
    assert card.training["algorithm"] == "train.ppo_cuda"
    assert card.env_kwargs["decision_interval_s"] == 1.0
    row, score = results["seed-0"], results["score-0"]
    assert [each["steps"] for each in row["curve"]] == [80, 160]
    assert all(each["episodes"] >= 8 for each in row["curve"])
    assert score["counted"]
    assert "| seed-0 |" in build_table(results)

    monkeypatch.setattr("train.ppo_cuda.train", None)  # it is finished
    assert play(settings) == results


def test_the_engine_in_tensors_is_the_vector_environment(settings):
    envs = OnProcessor(3, **settings.env_kwargs)
    first, _ = envs.reset(seed=1)
    assert first.dtype == torch.float32
    over = torch.zeros(3, dtype=torch.bool)
    while not over.any():
        seen, reward, ends, cuts, info = envs.step_unchecked(torch.ones(3, 1))
        over = ends | cuts
    assert seen.shape == first.shape
    assert reward.dtype == torch.float64
    assert info["undetected_displacement_m"][over].abs().sum() > 0.0 or info["detected"].any()
    envs.close()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"device": "tpu"}, "unknown device 'tpu'"),
        ({"knowledge": "all"}, "unknown knowledge 'all'"),
        ({"stages": 0}, "`stages`"),
        ({"settings": "{"}, "`settings`"),
        ({"settings": '{"imu_rate": 50.0}'}, "has no setting 'imu_rate'"),
    ],
)
def test_bad_input_is_refused(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        Settings(out=tmp_path, **changes)
