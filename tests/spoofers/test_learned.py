"""A policy in a file: run as it is, bit for bit in any batch."""

from __future__ import annotations

import copy
import hashlib
import multiprocessing
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from spoofgym.policies.card import SpooferCard
from spoofgym.spoofers import OnnxPolicy, make_spoofer
from spoofgym.testing import check_spoofer

from .policies import BLIND, network, write_policy


def observations(count: int, size: int = 6) -> np.ndarray:
    return np.random.default_rng(3).uniform(-2.0, 2.0, (count, size)).astype(np.float32)


def bound(path: Path, receivers: int = 3) -> OnnxPolicy:
    policy = OnnxPolicy(str(path))
    policy.bind(BLIND._replace(receivers=receivers))
    policy.reset()
    return policy


def expected(path: Path, seen: np.ndarray) -> np.ndarray:
    """What the network says, in NumPy and twice the precision."""
    tensors = onnx.load(path).graph.initializer
    weights = {item.name: numpy_helper.to_array(item).astype(np.float64) for item in tensors}
    h = seen.astype(np.float64)
    for k in range(2):
        h = np.tanh(h @ weights[f"w{k}"].T + weights[f"b{k}"])
    return np.clip(h @ weights["w2"].T + weights["b2"], -1.0, 1.0)


def test_it_does_what_the_network_says(tmp_path: Path) -> None:
    path = write_policy(tmp_path)
    seen = observations(500)
    action = bound(path, 500).act(seen)
    assert action.dtype == np.float64
    assert action.flags.c_contiguous
    assert np.abs(action).max() == 1.0  # some are clipped
    np.testing.assert_allclose(action, expected(path, seen), atol=1e-6)


def test_it_is_what_its_card_says(tmp_path: Path) -> None:
    policy = OnnxPolicy(str(write_policy(tmp_path, knowledge="tracking")))
    assert (policy.knowledge, policy.label, policy.designed_on) == (
        "tracking",
        "tiny",
        "ewma, zhong2025",
    )
    assert policy.sha256 == hashlib.sha256((tmp_path / "tiny.onnx").read_bytes()).hexdigest()
    assert policy == OnnxPolicy(str(tmp_path / "tiny.onnx"), policy.sha256)


@pytest.mark.parametrize(("inputs", "width"), [(6, 16), (6, 64), (60, 64), (61, 33)])
def test_the_bits_do_not_depend_on_the_batch(inputs: int, width: int, tmp_path: Path) -> None:
    names = tuple(f"element_{k}" for k in range(inputs))
    told = BLIND._replace(observation_names=names, observation_low=(), observation_high=())

    def card(fields: dict[str, Any]) -> None:
        fields["observation"] = {"names": names, "low": [-10.0] * inputs, "high": [10.0] * inputs}

    path = write_policy(tmp_path, model=lambda _: network(inputs, 2, width=width), card=card)
    policy = OnnxPolicy(str(path))
    seen = observations(1024, inputs)
    policy.bind(told._replace(receivers=1024))
    whole = policy.act(seen)
    for size in (1, 2, 3, 5, 7, 8, 15, 16, 33, 64, 100, 255, 256, 511, 1023):
        policy.bind(told._replace(receivers=size))
        begins = range(0, 1024 - size + 1, max(size, 41))
        for begin in begins:
            part = policy.act(seen[begin : begin + size])
            assert part.tobytes() == whole[begin : begin + size].tobytes(), (size, begin)


def test_it_keeps_the_contract_of_spoofers(tmp_path: Path) -> None:
    check_spoofer(str(write_policy(tmp_path, knowledge="tracking")))


def test_it_keeps_the_contract_with_another_attack(tmp_path: Path) -> None:
    attack = {"name": "per-channel", "control": "rate"}
    path = write_policy(tmp_path, env={"attack": attack})
    check_spoofer(str(path))
    with pytest.raises(ValueError, match=r"does not fit this attack: action: .*only on the card"):
        check_spoofer(str(path), attack="false-position")


@pytest.mark.parametrize("used", [False, True])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_it_copies_and_pickles_at_any_time(
    used: bool, copied: Callable[[OnnxPolicy], OnnxPolicy], tmp_path: Path
) -> None:
    path, seen = write_policy(tmp_path), observations(3)
    policy = bound(path)
    if used:
        policy.act(seen)
    other = copied(policy)
    path.unlink()  # its content is kept in memory
    assert other.act(seen).tobytes() == policy.act(seen).tobytes()
    assert other == policy


def _in_child(policy: OnnxPolicy, seen: np.ndarray, queue: Any) -> None:
    before = policy.model._session
    queue.put((policy.act(seen).tobytes(), policy.model._session is before))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # a fork in a process with threads
def test_a_forked_child_makes_its_own_session(tmp_path: Path) -> None:
    policy, seen = bound(write_policy(tmp_path)), observations(3)
    mine = policy.act(seen).tobytes()
    session = policy.model._session
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    child = context.Process(target=_in_child, args=(policy, seen, queue))
    child.start()
    assert queue.get() == (mine, False)
    child.join()
    assert child.exitcode == 0
    assert policy.act(seen).tobytes() == mine
    assert policy.model._session is session


def test_a_read_only_observation_of_another_layout_is_taken(tmp_path: Path) -> None:
    policy, seen = bound(write_policy(tmp_path)), observations(3)
    action = policy.act(seen)
    turned = np.asfortranarray(seen)
    turned.flags.writeable = False
    assert policy.act(turned).tobytes() == action.tobytes()


def test_the_card_is_there_for_who_holds_the_policy(tmp_path: Path) -> None:
    path = write_policy(tmp_path)
    assert make_spoofer(str(path)).card == SpooferCard.load(path.with_suffix(".json"))  # type: ignore[attr-defined]
