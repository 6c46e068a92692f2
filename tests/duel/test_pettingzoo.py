"""PettingZoo's own suite, and what it does not test: fresh dicts, order, bad input."""

import inspect
import subprocess
import sys

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test

from spoofgym import duel_v0

from .support import QUIET, aec, parallel

KNOWN = "reset has no option|Agents have diff|Observations are diff|Environment has not defined"
SELDOM = {"decision_interval_s": 1.5, "between": "linear"}
harmless = pytest.mark.filterwarnings(f"ignore:({KNOWN}):UserWarning")


@harmless
@pytest.mark.parametrize(
    "kwargs",
    [
        {"statistic": "channel", "payoff": "weighted", "knowledge": "oracle", "threshold": 0.9},
        {"weighs": False, "attack": {"name": "per-channel", "control": "rate"}, **SELDOM},
    ],
)
def test_pettingzoos_suite(kwargs):
    parallel_api_test(parallel(**kwargs), num_cycles=40)
    api_test(aec(**kwargs), num_cycles=40)


def test_agents_end_together_and_nothing_that_is_returned_is_used_again():
    env = parallel()
    observations, infos = env.reset(seed=1)
    before = {name: array.copy() for name, array in observations.items()}
    returned = [observations, infos]
    actions = {"spoofer_0": np.array([0.0, 1.0]), "detector_0": QUIET}
    while env.agents:
        actions = dict(reversed(actions.items()))  # in any order
        parts = _, rewards, terminated, truncated, infos = env.step(actions)
        assert terminated["spoofer_0"] == terminated["detector_0"]
        assert not any(truncated.values())
        assert rewards["spoofer_0"] == -rewards["detector_0"]
        assert infos["spoofer_0"]["decision_delay"] == 1
        for part in parts:
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


def test_bad_actions_name_the_agent_and_bad_arguments_the_valid_ones():
    env = parallel()
    with pytest.raises(RuntimeError, match="reset"):
        env.step({})
    env.reset(seed=0)
    good = {"spoofer_0": np.zeros(2), "detector_0": QUIET}
    for bad, message in (
        ({**good, "detector_0": np.where(np.arange(13) == 4, np.nan, QUIET)}, "slot03' is nan"),
        ({**good, "spoofer_0": np.zeros(3)}, r"spoofer_0: .*shape \(2,\)"),
        ({**good, "spoofer_0": np.array([1.5, 0.0])}, r"spoofer_0: .*is 1.5"),
        ({"spoofer_0": np.zeros(2)}, "got those of spoofer_0"),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(bad)
    with pytest.warns(UserWarning, match="no option 'sead'; valid: domain"):
        env.reset(options={"sead": 1})
    while env.agents:
        env.step(good)
    with pytest.raises(RuntimeError, match="over"):
        env.step(good)
    env = aec()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"spoofer_0: .*finite"):
        env.step(np.array([np.inf, 0.0]))
    env.step(np.zeros(2))
    with pytest.raises(ValueError, match=r"detector_0: .*shape \(13,\)"):
        env.step(np.zeros(2))
    with pytest.raises(
        TypeError, match=r"^duel_v0.env got an unexpected keyword argument 'thresholds'"
    ) as told:
        duel_v0.raw_env(thresholds=0.5)
    valid = str(told.value).partition("valid: ")[2].partition(";")[0].split(", ")
    assert {*valid} == {*inspect.signature(duel_v0.env).parameters}


@pytest.mark.nightly
def test_pettingzoo_is_imported_when_it_is_needed():
    code = (
        "import sys; from spoofgym import duel_v0; duel_v0.DetectorView;"
        "assert 'pettingzoo' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
