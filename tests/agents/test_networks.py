"""A policy with an informed critic decides by what it sees, and is judged by everything."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from gymnasium import spaces

from agents.networks import FirstElements, InformedCritic, MlpShape

OBSERVED = spaces.Box(-10.0, 10.0, (5,), np.float32)
COMMANDED = spaces.Box(-1.0, 1.0, (2,), np.float32)
SEEN = 3


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def make_policy(**kwargs: Any) -> InformedCritic:
    torch.manual_seed(0)
    policy = InformedCritic(
        OBSERVED, COMMANDED, lambda _: 3e-4, **MlpShape().policy_kwargs(), seen=SEEN, **kwargs
    )
    with torch.no_grad():
        policy.action_net.weight.mul_(100.0)  # small at birth
    return policy


def observations(count: int = 50) -> torch.Tensor:
    rng = np.random.default_rng(3)
    return torch.as_tensor(rng.uniform(-1.0, 1.0, (count, 5)).astype(np.float32))


def changed(index: int) -> torch.Tensor:
    other = observations()
    other[:, index] += 0.5
    return other


@pytest.mark.parametrize("index", range(5))
def test_the_policy_acts_by_what_it_sees_and_the_critic_values_everything(index: int) -> None:
    policy = make_policy()
    with torch.no_grad():
        before, after = (
            (policy.get_distribution(seen).distribution.mean, policy.predict_values(seen))
            for seen in (observations(), changed(index))
        )
    assert torch.equal(before[0], after[0]) == (index >= SEEN)
    assert (before[1] != after[1]).all()


def test_learning_judges_actions_by_what_the_policy_sees() -> None:
    """`evaluate_actions` and `forward` take the same path as `predict`."""
    policy, seen = make_policy(), observations()
    actions, values, log_prob = policy(seen, deterministic=True)
    assert torch.equal(actions, policy.get_distribution(changed(4)).distribution.mean)
    assert torch.equal(values, policy.predict_values(seen))
    _, same, _ = policy.evaluate_actions(changed(4), actions)
    torch.testing.assert_close(same, log_prob)


def test_both_networks_see_scaled_elements() -> None:
    scale = [2.0, 0.5, 1.0, 4.0, 3.0]
    scaled, plain = make_policy(scale=scale), make_policy()
    weights = {
        name: weight for name, weight in plain.state_dict().items() if not name.endswith("factor")
    }
    scaled.load_state_dict(weights, strict=False)
    seen = observations()
    by_hand = seen * torch.tensor(scale)
    with torch.no_grad():
        for found, expected in (
            (scaled.predict_values(seen), plain.predict_values(by_hand)),
            (
                scaled.get_distribution(seen).distribution.mean,
                plain.get_distribution(by_hand).distribution.mean,
            ),
        ):
            torch.testing.assert_close(found, expected)


def test_what_is_hidden_becomes_zero() -> None:
    part = FirstElements(OBSERVED, 2, [2.0, 3.0, 5.0, 7.0, 11.0])
    assert part(torch.ones(1, 5)).tolist() == [[2.0, 3.0, 0.0, 0.0, 0.0]]
    assert FirstElements(OBSERVED, 5)(torch.ones(1, 5)).tolist() == [[1.0] * 5]


def test_factors_are_not_learned() -> None:
    """They lie in the file of a policy, and no optimiser moves them."""
    policy = make_policy()
    assert "pi_features_extractor.factor" in policy.state_dict()
    assert not any("factor" in name for name, _ in policy.named_parameters())


@pytest.mark.parametrize(
    ("seen", "scale", "message"),
    [
        (0, None, r"`seen` must be in \[1, 5\], got 0"),
        (6, None, r"`seen` must be in \[1, 5\], got 6"),
        (3, [1.0] * 3, "`scale` must have 5 elements, got 3"),
        (3, [1.0] * 4 + [float("nan")], r"`scale` must be finite, got \[1\.0, .*nan\]"),
    ],
)
def test_settings_are_checked(seen: int, scale: list[float] | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FirstElements(OBSERVED, seen, scale)
