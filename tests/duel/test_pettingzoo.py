"""PettingZoo's own suite, and what it does not test: whole trajectories, fresh dicts, bad input."""

import hashlib
import inspect
import pickle
import subprocess
import sys

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test
from pettingzoo.utils import parallel_to_aec

from spoofgym import duel_v0

from .support import QUIET, aec, parallel

VARIANTS = [
    {},
    {"statistic": "channel", "payoff": "weighted", "knowledge": "oracle", "threshold": 0.9},
    {"weighs": False, "attack": {"name": "per-channel", "control": "rate"}},
    {"decision_interval_s": 1.5, "between": "linear"},
]
HARMLESS = [
    "ignore:reset has no option:UserWarning",
    "ignore:Agents have different observation space sizes:UserWarning",
    "ignore:Observations are different shapes:UserWarning",
    "ignore:Environment has not defined a render:UserWarning",
]


def harmless(test):
    for line in HARMLESS:
        test = pytest.mark.filterwarnings(line)(test)
    return test


@harmless
@pytest.mark.parametrize("kwargs", VARIANTS)
def test_parallel_suite(kwargs):
    parallel_api_test(parallel(**kwargs), num_cycles=60)
    parallel_seed_test(lambda: parallel(**kwargs), num_cycles=60)
    seed_test(lambda: parallel_to_aec(parallel(**kwargs)), num_cycles=60)


@harmless
@pytest.mark.parametrize("kwargs", VARIANTS)
def test_aec_suite(kwargs):
    api_test(aec(**kwargs), num_cycles=100)
    seed_test(lambda: aec(**kwargs), num_cycles=60)


def parallel_trace(env, seed, episodes=2):
    """Digest of all that happens, by actions of a generator."""
    rng, digest = np.random.default_rng(9), hashlib.sha256()
    for k in range(episodes):
        observations, infos = env.reset(seed=seed if k == 0 else None)
        digest.update(repr(sorted(infos.items())).encode())
        while env.agents:
            actions = {
                "spoofer_0": rng.uniform(-1.0, 1.0, 2),
                "detector_0": np.r_[rng.uniform(-1.0, 0.02), rng.uniform(-1.0, 1.0, 12)],
            }
            observations, *rest = env.step(actions)
            for name in sorted(observations):
                digest.update(observations[name].tobytes())
            digest.update(repr([sorted(part.items()) for part in rest]).encode())
    return digest.hexdigest()


def aec_trace(env, seed, episodes=2):
    rng, digest = np.random.default_rng(9), hashlib.sha256()
    for k in range(episodes):
        env.reset(seed=seed if k == 0 else None)
        for name in env.agent_iter():
            observation, *rest = env.last()
            digest.update(observation.tobytes() + repr((name, rest)).encode())
            size = env.action_space(name).shape[0]
            action = rng.uniform(-1.0, 1.0, size)
            if name == "detector_0":
                action[0] = min(action[0], 0.02)
            env.step(None if rest[1] else action)
    return digest.hexdigest()


@pytest.mark.parametrize(("make", "trace"), [(parallel, parallel_trace), (aec, aec_trace)])
def test_a_seed_fixes_the_whole_trajectory(make, trace):
    first, again = make(), make()
    assert trace(first, 3) == trace(again, 3)
    assert trace(first, 3) == trace(again, 3)  # reseeded, it begins anew
    assert trace(first, 4) != trace(again, 3)


def test_agents_end_together_and_nothing_that_is_returned_is_used_again():
    env = parallel()
    observations, infos = env.reset(seed=1)
    before = {name: array.copy() for name, array in observations.items()}
    returned, order = [observations, infos], ["detector_0", "spoofer_0"]
    while env.agents:
        actions = {"spoofer_0": np.array([0.0, 1.0]), "detector_0": QUIET}
        observations, rewards, terminated, truncated, infos = env.step(
            {name: actions[name] for name in order}
        )
        order.reverse()
        assert terminated["spoofer_0"] == terminated["detector_0"]
        assert not any(truncated.values())
        assert rewards["spoofer_0"] == -rewards["detector_0"]
        assert infos["spoofer_0"]["decision_delay"] == 1
        for part in (observations, rewards, terminated, truncated, infos):
            assert all(part is not other for other in returned)
            part["__all__"] = "as RLlib does"
            returned.append(part)
    assert terminated["spoofer_0"]
    for name, array in before.items():
        np.testing.assert_array_equal(returned[0][name], array)


def test_the_aec_form_keeps_the_exact_order():
    env = aec()
    env.reset(seed=2)
    batch = env.unwrapped.duel.core.engine.simulator
    seen = env.observe("detector_0")
    spoofer_seen, covariance = env.observe("spoofer_0"), batch.buffers.covariance
    env.step(np.array([0.0, 1.0]))
    assert env.agent_selection == "detector_0"
    assert not np.array_equal(env.observe("detector_0"), seen)  # the epoch has arrived
    np.testing.assert_array_equal(env.observe("spoofer_0"), spoofer_seen)
    predicted = batch.buffers.covariance
    assert not np.array_equal(predicted, covariance)
    seen = env.observe("detector_0")
    env.step(QUIET)
    assert env.agent_selection == "spoofer_0"
    assert not np.array_equal(batch.buffers.covariance, predicted)  # the filter has updated
    np.testing.assert_array_equal(env.observe("detector_0"), seen)
    assert env.metadata["decision_delay"] == 0


@pytest.mark.parametrize("make", [parallel, aec])
def test_a_pickled_duel_goes_on_identically(make):
    env = make().unwrapped
    env.reset(seed=6)
    for _ in range(3):
        if make is parallel:
            env.step({"spoofer_0": np.ones(2), "detector_0": QUIET})
        else:
            env.step(np.ones(2))
            env.step(QUIET)
    copy = pickle.loads(pickle.dumps(env))
    for each in (env, copy):
        if make is parallel:
            each.step({"spoofer_0": np.ones(2), "detector_0": QUIET})
        else:
            each.step(np.ones(2))
    for name in ("spoofer_0", "detector_0"):
        np.testing.assert_array_equal(env._observed()[name], copy._observed()[name])


def test_bad_actions_name_the_agent():
    env = parallel()
    with pytest.raises(RuntimeError, match="reset"):
        env.step({})
    env.reset(seed=0)
    good = {"spoofer_0": np.zeros(2), "detector_0": QUIET}
    bad = QUIET.copy()
    bad[4] = np.nan
    with pytest.raises(ValueError, match=r"detector_0: .*'weight_slot03' is nan"):
        env.step({**good, "detector_0": bad})
    with pytest.raises(ValueError, match=r"spoofer_0: .*shape \(2,\)"):
        env.step({**good, "spoofer_0": np.zeros(3)})
    with pytest.raises(ValueError, match=r"spoofer_0: .*is 1.5"):
        env.step({**good, "spoofer_0": np.array([1.5, 0.0])})
    with pytest.raises(ValueError, match=r"got those of spoofer_0"):
        env.step({"spoofer_0": np.zeros(2)})
    with pytest.warns(UserWarning, match="no option 'sead'; valid: domain"):
        env.reset(options={"sead": 1})
    while env.agents:
        env.step(good)
    with pytest.raises(RuntimeError, match="over"):
        env.step(good)


def test_bad_actions_of_the_aec_form():
    env = aec()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"spoofer_0: .*finite"):
        env.step(np.array([np.inf, 0.0]))
    env.step(np.zeros(2))
    with pytest.raises(ValueError, match=r"detector_0: .*shape \(13,\)"):
        env.step(np.zeros(2))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"statistic": "satellite"}, r"unknown statistic 'satellite'; valid: channel, receiver"),
        ({"payoff": "neyman-person"}, "did you mean 'neyman-pearson'"),
        ({"payoff": {"name": "weighted", "delay": 1.0}}, "no setting 'delay'; valid: false_alarm"),
        ({"payoff": {"name": "weighted", "error_per_m": -1.0}}, "`error_per_m` must be finite"),
        ({"threshold": 0.0}, r"\(0, 1\] or a calibration, got 0.0"),
        ({"threshold": "run"}, "'running', a number"),
        ({"false_alarm": 1.0}, r"`false_alarm` must be in \(0, 1\)"),
        ({"attack_probability": 1.5}, r"in \[0, 1\], got 1.5"),
        ({"threshold": None}, r"`threshold` must be 'running', a number in \(0, 1\] .* got None"),
        ({"threshold": True}, r"`threshold` must be 'running', a number .* got True"),
        ({"false_alarm": "x"}, r"`false_alarm` must be in \(0, 1\), got 'x'"),
        ({"attack_probability": "x"}, r"`attack_probability` must be a number in .* got 'x'"),
        ({"attack_probability": None}, r"`attack_probability` must be a number in .* got None"),
        ({"exclusion_s": "x"}, r"`exclusion_s` must be finite and >= 0, or None, got 'x'"),
        ({"exclusion_s": True}, r"`exclusion_s` must be finite and >= 0, or None, got True"),
        ({"decision_delay": 0}, r"duel_v0.parallel_env takes no `decision_delay`: it is 0 in duel"),
        ({"weighs": "yes"}, "`weighs` must be True or False"),
        ({"render_mode": "human"}, "nothing to render"),
        ({"thresholds": 0.5}, "did you mean 'threshold'"),
        ({"timeline": {"attack_s": 208.0}}, "lasts 418 s"),
        ({"decision_interval_s": 0.7}, "must be a multiple of the interval between epochs, 0.5 s"),
        ({"decision_interval_s": 2.0}, "window of 15 s must hold a whole number of decisions"),
        ({"between": "spline"}, "unknown between 'spline'; valid: hold, linear"),
    ],
)
def test_bad_settings(kwargs, message):
    with pytest.raises((ValueError, TypeError), match=message):
        parallel(**kwargs)


def test_raw_env_names_its_valid_arguments():
    with pytest.raises(TypeError, match=r"^duel_v0.env has no argument 'thresholds'") as told:
        duel_v0.raw_env(thresholds=0.5)
    valid = str(told.value).partition("valid: ")[2].partition(";")[0].split(", ")
    assert {*valid} == {*inspect.signature(duel_v0.env).parameters}


def test_pettingzoo_is_imported_when_it_is_needed():
    code = (
        "import sys; from spoofgym import duel_v0; duel_v0.DetectorView;"
        "assert 'pettingzoo' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
