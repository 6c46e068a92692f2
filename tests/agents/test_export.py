"""An exported policy acts as the policy does, and is whole or absent."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("onnxscript")

import onnx
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.sac.policies import SACPolicy

from agents.export import PolicyExporter, export_policy
from agents.networks import InformedCritic, MlpShape
from spoofgym.spoofers import OnnxPolicy

from ..spoofers.policies import BLIND, card_fields

OBSERVED = spaces.Box(
    np.array(BLIND.observation_low, dtype=np.float32),
    np.array(BLIND.observation_high, dtype=np.float32),
)
COMMANDED = spaces.Box(-1.0, 1.0, (2,), np.float32)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def make_policy(seed: int = 0, gain: float = 100.0, **kwargs: Any) -> ActorCriticPolicy:
    torch.manual_seed(seed)
    given = {**MlpShape().policy_kwargs(), **kwargs}
    policy = ActorCriticPolicy(OBSERVED, COMMANDED, lambda _: 3e-4, **given)
    with torch.no_grad():
        policy.action_net.weight.mul_(gain)  # small at birth; now some actions are clipped
        for bias in (policy.action_net.bias, policy.mlp_extractor.policy_net[0].bias):
            bias.uniform_(-0.3, 0.3)
    return policy


def fields() -> dict[str, Any]:
    made = card_fields("unused", b"", BLIND, "blind", {})
    return {key: made[key] for key in made if key not in ("name", "kind", "file")}


@pytest.fixture(scope="module")
def exporter() -> PolicyExporter:
    """Tracing takes seconds, hence once."""
    return PolicyExporter(make_policy())


def seen(count: int) -> np.ndarray:
    """Observations up to 10, as they are met: at 100, single precision is off by 1e-6 itself."""
    rng = np.random.default_rng(5)
    low, high = np.maximum(OBSERVED.low, -10.0), np.minimum(OBSERVED.high, 10.0)
    return rng.uniform(low, high, (count, 6)).astype(np.float32)


def same_as(policy: ActorCriticPolicy, path: Path) -> bool:
    written = OnnxPolicy(str(path))
    written.bind(BLIND._replace(receivers=300))
    expected, _ = policy.predict(seen(300), deterministic=True)
    return bool(np.abs(written.act(seen(300)) - expected).max() <= 1e-6)


def test_a_file_acts_as_the_policy(exporter: PolicyExporter, tmp_path: Path) -> None:
    path = tmp_path / "zoo" / "learned.onnx"
    card = exporter.write(path, fields())
    assert same_as(exporter.policy, path)
    assert (card.name, card.kind, card.training["seed"]) == ("learned", "onnx-policy", 7)
    assert sorted(item.name for item in path.parent.iterdir()) == ["learned.json", "learned.onnx"]
    clipped, _ = exporter.policy.predict(seen(300), deterministic=True)
    assert 0.1 < (np.abs(clipped) == 1.0).mean() < 0.9


def test_the_same_policy_makes_the_same_file(exporter: PolicyExporter) -> None:
    assert exporter.content() == exporter.content()


def test_a_file_has_the_weights_of_the_moment(exporter: PolicyExporter, tmp_path: Path) -> None:
    before, weights = exporter.content(), exporter.policy.state_dict()
    weights = {name: weight.clone() for name, weight in weights.items()}
    try:
        exporter.policy.load_state_dict(make_policy(seed=1).state_dict())
        exporter.write(tmp_path / "later.onnx", fields())
        assert (tmp_path / "later.onnx").read_bytes() != before
        assert same_as(exporter.policy, tmp_path / "later.onnx")
    finally:
        exporter.policy.load_state_dict(weights)
    assert exporter.content() == before


def test_a_file_tells_nothing_of_this_machine(exporter: PolicyExporter) -> None:
    content = exporter.content()
    for word in (str(Path.cwd()), "site-packages", ".py", "stack_trace"):
        assert word.encode() not in content
    model = onnx.load_model_from_string(content)
    assert not any("value_net" in tensor.name for tensor in model.graph.initializer)
    assert len(content) < 30_000


def test_another_shape_is_exported_in_one_call(tmp_path: Path) -> None:
    shape = MlpShape(width=9, layers=3, log_std_init=0.5, ortho_init=False)
    policy = make_policy(gain=5.0, **shape.policy_kwargs())
    assert policy.log_std.tolist() == [0.5, 0.5]
    export_policy(policy, tmp_path / "other.onnx", fields())
    assert same_as(policy, tmp_path / "other.onnx")
    names = [t.name for t in onnx.load(tmp_path / "other.onnx").graph.initializer]
    assert len(names) == 2 * (3 + 1) + 3  # layers, two factors of the amplitude, directions


def test_a_file_that_acts_otherwise_is_not_written(
    exporter: PolicyExporter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "learned.onnx"
    exporter.write(path, fields())
    before = path.read_bytes(), path.with_suffix(".json").read_bytes()
    predict = exporter.policy.predict
    monkeypatch.setattr(
        exporter.policy,
        "predict",
        lambda *args, **kwargs: (predict(*args, **kwargs)[0] + 1e-4, None),
    )
    with pytest.raises(
        ValueError, match=r"'learned' differs from the policy by 0\.0001, more than"
    ):
        exporter.write(path, fields())
    assert (path.read_bytes(), path.with_suffix(".json").read_bytes()) == before
    assert len(list(tmp_path.iterdir())) == 2


def test_a_policy_of_not_a_numbers_is_not_written(exporter: PolicyExporter, tmp_path: Path) -> None:
    bias = exporter.policy.action_net.bias
    before = bias.detach().clone()
    try:
        with torch.no_grad():
            bias[0] = float("nan")
        with pytest.raises(ValueError, match="returned NaN"):
            exporter.write(tmp_path / "bad.onnx", fields())
    finally:
        with torch.no_grad():
            bias.copy_(before)
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_breaks_off_leaves_no_pair_that_fits(
    exporter: PolicyExporter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "learned.onnx"
    exporter.write(path, fields())
    with torch.no_grad():
        exporter.policy.action_net.bias.add_(0.01)
    replaced = []

    def dies_before_the_card(part: Path, target: Path) -> None:
        if target == path.with_suffix(".json"):
            raise KeyboardInterrupt
        replaced.append(target)
        original(part, target)

    original = os.replace
    monkeypatch.setattr(os, "replace", dies_before_the_card)
    with pytest.raises(KeyboardInterrupt):
        exporter.write(path, fields())
    monkeypatch.undo()
    assert replaced[-1] == path
    with pytest.raises(ValueError, match="its card has"):
        OnnxPolicy(str(path))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"observation": None}, "`file` and `observation` of an onnx-policy"),
        ({"colour": "red"}, r"colour\n.*Extra inputs"),
        (
            {
                "observation": {
                    "names": BLIND.observation_names,
                    "low": (-5.0,) * 6,
                    "high": BLIND.observation_high,
                }
            },
            "the card of 'learned' has other bounds",
        ),
        (
            {"action": {"names": ("a",), "low": (-1.0,), "high": (1.0,)}},
            r"of float32 \(batch, 2\); the card has one output of float32 \(batch, 1\)",
        ),
    ],
)
def test_a_card_that_does_not_fit_is_refused(
    exporter: PolicyExporter, tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        exporter.write(tmp_path / "learned.onnx", {**fields(), **changes})
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_exported_is_told(exporter: PolicyExporter, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"`path` must end in \.onnx, got .*learned\.zip"):
        exporter.write(tmp_path / "learned.zip", fields())
    with pytest.raises(TypeError, match=r"only an actor-critic policy .* got SACPolicy"):
        PolicyExporter(SACPolicy(OBSERVED, COMMANDED, lambda _: 3e-4))
    discrete = ActorCriticPolicy(OBSERVED, spaces.Discrete(3), lambda _: 3e-4)
    with pytest.raises(TypeError, match="with a Gaussian action"):
        PolicyExporter(discrete)


def planned(policy: ActorCriticPolicy, observation: np.ndarray, amplitude: float) -> np.ndarray:
    """The policy's own actions, its plan followed as many times as large."""
    own = np.array([name.startswith("own_") for name in BLIND.observation_names])
    shrunk = np.where(own, observation / amplitude, observation).astype(np.float32)
    hidden = policy.observation_space.shape[0] - shrunk.shape[1]
    # nothing that is hidden may matter, so it is anything here
    shrunk = np.pad(shrunk, ((0, 0), (0, hidden)), constant_values=1.0)
    return amplitude * policy.predict(shrunk, deterministic=True)[0]


def acts(path: Path) -> np.ndarray:
    written = OnnxPolicy(str(path))
    written.bind(BLIND._replace(receivers=300))
    return written.act(seen(300))


TURNED = [[0.6, 0.8], [0.8, -0.6]]


@pytest.fixture(scope="module", params=[None, [[0.0, 1.0], [-1.0, 0.0]], TURNED])
def turned(request: pytest.FixtureRequest) -> tuple[PolicyExporter, np.ndarray]:
    """Traced once for all amplitudes, and the directions of its actions."""
    exporter = PolicyExporter(make_policy(gain=20.0), request.param)
    return exporter, np.eye(2) if request.param is None else np.array(request.param)


@pytest.mark.parametrize("amplitude", [0.4, 1.0, 1.7])
def test_a_file_follows_the_plan_in_its_directions(
    turned: tuple[PolicyExporter, np.ndarray], amplitude: float, tmp_path: Path
) -> None:
    exporter, directions = turned
    exporter.write(tmp_path / "large.onnx", fields(), amplitude)
    expected = np.clip(planned(exporter.policy, seen(300), amplitude) @ directions, -1.0, 1.0)
    np.testing.assert_allclose(acts(tmp_path / "large.onnx"), expected, atol=1e-5)


def test_amplitude_and_directions_are_told_in_one_call(tmp_path: Path) -> None:
    policy = make_policy(gain=20.0)
    export_policy(policy, tmp_path / "large.onnx", fields(), 0.4, TURNED)
    expected = np.clip(planned(policy, seen(300), 0.4) @ TURNED, -1.0, 1.0)
    np.testing.assert_allclose(acts(tmp_path / "large.onnx"), expected, atol=1e-5)


@pytest.fixture(scope="module")
def informed() -> PolicyExporter:
    """One action along a heading; the critic sees two more elements than the card tells."""
    torch.manual_seed(0)
    more = np.full(2, 50.0, dtype=np.float32)
    policy = InformedCritic(
        spaces.Box(np.append(OBSERVED.low, -more), np.append(OBSERVED.high, more)),
        spaces.Box(-1.0, 1.0, (1,), np.float32),
        lambda _: 3e-4,
        **MlpShape().policy_kwargs(),
        seen=6,
        scale=[2.0, 2.0, 0.5, 0.5, 1.0, 1.0, 0.1, 0.1],
    )
    with torch.no_grad():
        policy.action_net.weight.mul_(20.0)
    return PolicyExporter(policy, [[0.6, 0.8]])


@pytest.mark.parametrize("amplitude", [0.5, 1.0, 1.7])
def test_the_file_of_an_informed_critic_needs_only_what_the_policy_sees(
    informed: PolicyExporter, amplitude: float, tmp_path: Path
) -> None:
    informed.write(tmp_path / "learned.onnx", fields(), amplitude)
    plan = planned(informed.policy, seen(300), amplitude)
    expected = np.clip(plan * [0.6, 0.8], -1.0, 1.0)
    np.testing.assert_allclose(acts(tmp_path / "learned.onnx"), expected, atol=1e-5)
    assert (np.abs(expected) < 1.0).mean() > 0.05
    names = [t.name for t in onnx.load(tmp_path / "learned.onnx").graph.initializer]
    assert not any("vf_" in name or "value" in name for name in names)


def test_a_card_of_all_that_the_critic_sees_is_refused(
    informed: PolicyExporter, tmp_path: Path
) -> None:
    told = fields()["observation"]
    observation = {
        "names": (*told["names"], "statistic", "threshold"),
        "low": (*told["low"], -50.0, -50.0),
        "high": (*told["high"], 50.0, 50.0),
    }
    with pytest.raises(ValueError, match=r"float32 \(batch, 6\); the card has .*\(batch, 8\)"):
        informed.write(tmp_path / "learned.onnx", {**fields(), "observation": observation})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("amplitude", [0.0, -1.0, float("nan"), float("inf")])
def test_amplitudes_are_checked(exporter: PolicyExporter, amplitude: float, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="`amplitude` must be finite and > 0, got"):
        exporter.write(tmp_path / "learned.onnx", fields(), amplitude)
    assert list(tmp_path.iterdir()) == []


def test_an_amplitude_needs_names(exporter: PolicyExporter) -> None:
    with pytest.raises(ValueError, match="an amplitude needs the 6 names of observations, got 0"):
        exporter.content(amplitude=2.0)


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        ([1.0, 0.0], r"a row for each of the policy's 2 actions, got shape \(2,\)"),
        ([[1.0, 0.0]], r"got shape \(1, 2\)"),
        ([[1.0, 0.0], [0.0, float("nan")]], "`directions` must be finite"),
    ],
)
def test_directions_are_checked(directions: list[Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PolicyExporter(make_policy(), directions)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"width": 0}, "`width` must be a whole number of at least 1, got 0"),
        ({"layers": 1.5}, r"`layers` must be a whole number of at least 1, got 1\.5"),
        ({"log_std_init": float("nan")}, "`log_std_init` must be finite, got nan"),
    ],
)
def test_shapes_are_checked(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MlpShape(**settings)
