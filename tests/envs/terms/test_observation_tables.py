"""The tables of observations in the docstrings say what the terms observe, and in which units."""

import re
from itertools import groupby

import gymnasium as gym
import pytest

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.core.declared import list_declarations
from spoofgym.detectors.observation import Elapsed, InnovationSd, PredictedMotion
from spoofgym.duel_v0 import DetectorView
from spoofgym.envs import SpoofEnv
from spoofgym.envs.terms.action import CommandMap, default_action
from spoofgym.envs.terms.observation import default_terms

MOST = "oracle+reported"
TABLES = ("TightlyCoupled", "Zhong2025", "LooselyCoupled", "Snapshot", "WheeledRobot")
"""In the order of their tables in the docstring of `SpoofEnv`."""


def table_of(kind, number=0):
    """Rows of a table in a docstring: index, name, unit, scale, knowledge."""
    parts = re.split(r"^ *=====  =+ .*$", kind.__doc__, flags=re.MULTILINE)
    rows = parts[3 * number + 2].strip().splitlines()
    return [re.split(r" {2,}", row.strip()) for row in rows]


SCALES = {
    "own_displacement": "scale_m",
    "own_rate": "rate_scale_mps",
    "target_position": "position_scale_m",
    "target_velocity": "velocity_scale_mps",
    "error": "scale_m",
    "reported": "scale_m",
}
"""Setting that is observed as 1, by the first words of an element's name."""


def unit_of(name, term, setup):
    times = {"time": setup.steps * setup.interval_s, "report_age": 1.0}
    for word, scale in times.items():
        if name.startswith(word):
            return "s", scale
    found = [scale for word, scale in SCALES.items() if name.startswith(word)]
    if not found:
        return "1", 1.0
    return list_declarations(type(term))[found[0]][0].unit, getattr(term, found[0])


def observed(terms, setup):
    """First and last index, name, unit, scale and knowledge; what slots have alike in one row."""
    rows, start = [], 0
    for term in terms:
        for key, names in groupby(term.names(setup), key=lambda n: n.split("_")[0] * ("slot" in n)):
            names = list(names)
            for part in [names] if key else [[name] for name in names]:
                words = dict.fromkeys(re.sub(r"slot\d+", "slotJJ", name) for name in part)
                unit, scale = unit_of(part[0], term, setup)
                rows.append([start, start + len(part) - 1, ", ".join(words), unit, scale])
                rows[-1].append(term.knowledge)
                start += len(part)
    return rows


@pytest.mark.parametrize(("number", "name"), [*enumerate(TABLES)])
def test_a_table_is_what_the_terms_observe(number, name):
    env = gym.make(f"spoofgym/{name}-v0", knowledge=MOST).unwrapped
    setup = env.core.setup
    along = CommandMap(default_action(setup), setup).along_target
    terms = default_terms(setup, MOST, along_target=along)
    assert env.observation_names == tuple(n for term in terms for n in term.names(setup))
    rows = []
    for first, last, words, unit, scale, knowledge in observed(terms, setup):
        index = str(first) if first == last else f"{first}-{last}"
        rows.append([index, words, unit, f"{float(f'{scale:.4g}'):g}", knowledge])
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
