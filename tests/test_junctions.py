"""From an environment to a score, the benchmark, the duel, a file and back: each works, or says in
one line what to add, and then works."""

import json
import re
import shlex
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import typer

# ruff: noqa: E402 - torch may be missing
torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

import spoofgym
from spoofgym import duel_v0
from spoofgym.envs import attach
from spoofgym.export import onnx

from .command_line import call, refused
from .envs.support import SHORT
from .nightly import heavy

IDS = [
    *("TightlyCoupled-v0", "Offsets-v0", "Zhong2025-v0"),
    *("BenchS1-v2", "BenchS2-v2", "BenchS3-v2"),
]
LONGER = ["timeline", "domain", "receiver"]
OTHERWISE = {
    "Offsets-v0": ["control", "basis"],
    "Zhong2025-v0": ["scenario"],
    **{key: ["scenario", *LONGER] for key in ("BenchS2-v2", "BenchS3-v2")},
}
"""What has to be added to the default world for a policy of an id, none for those not named."""
FEW = {"runs": 2, "fit_runs": 59, "amplitude": 1.0, "detector": "never"}
BENCH = ["--detector", "never", "--runs", 2, "--training-runs", 59, "--selection-runs", 0]


def told(message):
    """Settings that a message says to add: as text, and by name."""
    assert "\n" not in message
    words = shlex.split(re.sub(r"\)? ?(\(`transfer.*)?$", "", message.partition("add ")[2]))
    assert words[::2] == ["--set"] * (len(words) // 2)
    pairs = [word.partition("=") for word in words[1::2]]
    return words, {name: json.loads(value) for name, _, value in pairs}


def world(settings):
    """Settings as `evaluate` takes them."""
    further = {name: settings[name] for name in settings if name in ("control", "basis")}
    own = {name: value for name, value in settings.items() if name not in further}
    return {**own, "settings": further}


@pytest.fixture(scope="module", params=heavy(IDS, "BenchS1-v2", "BenchS3-v2"))
def policy(request, tmp_path_factory):
    """An id, an untrained policy of it as a file with its card, and what is to be added.

    BenchS1-v2 is TightlyCoupled-v0 by another name, and BenchS3-v2 as BenchS2-v2, but longer.
    """
    env = gym.make(f"spoofgym/{request.param}", detector="never")
    torch.manual_seed(0)
    net = torch.nn.Linear(env.observation_space.shape[0], env.action_space.shape[0])
    path = tmp_path_factory.mktemp("policies") / "mine.onnx"
    assert onnx(net, env, path).env_id == f"spoofgym/{request.param}"
    return env, str(path), OTHERWISE.get(request.param)


def test_a_file_comes_back_to_its_environment(policy):
    env, path, _ = policy
    observation = env.reset(seed=0)[0]
    action = attach(path, env).act(observation[None])[0]
    assert np.isfinite(env.step(action)[1])
    other = gym.make("spoofgym/Zhong2025-v0", attack="per-channel")
    with pytest.raises(ValueError, match="trained in another world, add --set "):
        attach(path, other, transfer=True)


def test_a_score_is_that_of_the_world_of_the_model_or_says_what_to_add(policy):
    env, path, added = policy
    score = spoofgym.evaluate(path, **FEW)
    assert (score.runs, score.world) == (2, env.spec.id)
    assert f"{env.spec.id}: " in str(score)
    default = {**FEW, "env": "spoofgym/TightlyCoupled-v0"}
    if added is None:
        assert spoofgym.evaluate(path, **default).twins == score.twins
        return
    with pytest.raises(ValueError, match="does not fit this attack") as caught:
        spoofgym.evaluate(path, **default)
    settings = told(str(caught.value))[1]
    assert {*settings} == {*added}
    again = spoofgym.evaluate(path, **FEW, **world(settings))
    np.testing.assert_array_equal(again.displacement_m, score.displacement_m)


@pytest.mark.parametrize("played", [False, pytest.param(True, marks=pytest.mark.nightly)])
def test_the_default_benchmark_plays_or_says_what_to_add(policy, played, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if not played:  # but for that it is ready to

        def stop(*given, **named):
            raise typer.Exit

        monkeypatch.setattr("spoofgym.cli.options.finish_experiment", stop)
    command, words = ["bench", *BENCH, "--spoofer", policy[1]], []
    if policy[0].spec.id in ("spoofgym/BenchS2-v2", "spoofgym/BenchS3-v2"):  # the floor takes long
        command += ["--budget", "quick"]
    if policy[2] is not None:
        words, settings = told(refused(*command))
        assert {*settings} == {*policy[2]}
    result = call(*command, *words)
    assert result.exit_code == 0, result.output


def test_a_duel_plays_or_says_what_to_add(policy):
    make, settings = partial(duel_v0.DetectorView, policy[1]), {}
    if policy[2] is not None:
        with pytest.raises(ValueError, match="does not fit this attack") as caught:
            make()
        settings = told(str(caught.value))[1]
    assert np.isfinite(make(**settings).reset(seed=0)[0]).all()


def test_an_own_detector_travels_by_its_module_and_class(tmp_path):
    """In an environment, on a card, in a score, in the duel."""
    own = {"name": "tests.envs.support:AlarmAt", "epoch": 10_000, "thresholds": "nominal"}
    world, path = {"timeline": SHORT}, tmp_path / "mine.onnx"
    env = gym.make("spoofgym/Zhong2025-v0", detector=own, knowledge="blind", **world)
    card = onnx(torch.nn.Linear(env.observation_space.shape[0], 1), env, path)
    assert card.env_kwargs["detector"] == own
    attach(str(path), env)
    score = spoofgym.evaluate(str(path), **{key: x for key, x in FEW.items() if key != "detector"})
    assert "against AlarmAt(epoch=10000), spoofgym/Zhong2025-v0 with timeline: " in str(score)
    view = duel_v0.SpooferView([own], scenario="zhong2025", **world)
    view.reset(seed=0)
    assert "tests.envs.support:AlarmAt" in view.unwrapped.opponent
