"""The tables of observations in the docstrings say what the terms observe, and in which units."""

import re

import gymnasium as gym
import pytest

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.detectors.observation import Elapsed, InnovationSd, PredictedMotion
from spoofgym.duel_v0 import DetectorView
from spoofgym.envs import SpoofEnv
from spoofgym.envs.terms.action import CommandMap, default_action
from spoofgym.envs.terms.observation import default_terms
from tools.environments_page import observed

MOST = "oracle+reported"
TABLES = ("TightlyCoupled", "Zhong2025", "LooselyCoupled", "Snapshot", "WheeledRobot")
"""In the order of their tables in the docstring of `SpoofEnv`."""


def table_of(kind, number=0):
    """Rows of a table in a docstring: index, name, unit, scale, knowledge."""
    parts = re.split(r"^ *=====  =+ .*$", kind.__doc__, flags=re.MULTILINE)
    rows = parts[3 * number + 2].strip().splitlines()
    return [re.split(r" {2,}", row.strip()) for row in rows]


@pytest.mark.parametrize(("number", "name"), [*enumerate(TABLES)])
def test_a_table_is_what_the_terms_observe(number, name):
    env = gym.make(f"spoofgym/{name}-v0", knowledge=MOST).unwrapped
    setup = env.core.setup
    along = CommandMap(default_action(setup), setup).along_target
    terms = default_terms(setup, MOST, along_target=along)
    assert env.observation_names == tuple(n for term in terms for n in term.names(setup))
    rows = [[*row] for row in observed(terms, setup)]
    assert table_of(SpoofEnv, number) == rows


def test_the_table_of_the_detector_s_view_is_what_it_observes():
    one_sky = {"turn_on": "drawn"}  # which is made sooner
    names = gym.make("spoofgym/DetectorView-v0", domain=one_sky).unwrapped.observation_names
    scales = {
        "range_sd": InnovationSd.range_scale_m,
        "rate_sd": InnovationSd.rate_scale_mps,
        "predicted_velocity": PredictedMotion.velocity_scale_mps,
        "specific_force": PredictedMotion.force_scale_mps2,
        "angular_rate": PredictedMotion.rate_scale_rps,
        "elapsed": Elapsed.scale_s,
    }
    next_one = 0
    for index, words, _, scale in table_of(DetectorView):
        first, _, last = index.partition("-")
        word = re.sub(r"_(slotJJ|XXX)$", "", words)
        assert int(first) == next_one
        next_one = int(last or first) + 1
        assert {name.startswith(word) for name in names[int(first) : next_one]} == {True}
        assert float(scale) == scales.get(word, 1.0)
    assert next_one == len(names)
