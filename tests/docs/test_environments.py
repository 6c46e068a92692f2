"""The pages of environments are made from what is registered."""

import re

import gymnasium as gym
import pytest

from spoofgym.truth.sensors import IMU_GRADES
from tools.environments_page import IDS, build_detector_page, build_spoofer_page, format_bounds
from tools.interface_page import PARTS, build_table
from tools.pages import marks, part_between

from ..nightly import heavy
from .pages import text_of


@pytest.mark.parametrize("name", heavy(sorted(IDS), "TightlyCoupled", "Offsets"))
def test_a_page_is_that_of_its_environment(name):
    page = text_of(f"environments/{name}.md")
    assert page == build_spoofer_page(name)
    env = gym.make(f"spoofgym/{name}-v0", knowledge="oracle+reported").unwrapped
    *_, last = re.findall(r"^[|] (?:\d+-)?(\d+) [|]", page, flags=re.MULTILINE)
    blind, tracking, oracle, every = re.findall(r"(\d+) elements", page)[:4]
    assert int(last) + 1 == int(every) == len(env.observation_names)
    space = env.observation_space
    for first, bounds in re.findall(r"^[|] (\d+)\S* [|].*[|] (.*) [|]$", page, re.MULTILINE):
        assert bounds == format_bounds(space.low[int(first)], space.high[int(first)])
    assert f" | {blind} ({tracking}, {oracle}): " in text_of("environments.md")


def test_the_detector_has_a_page_and_every_id_is_in_the_index():
    assert text_of("environments/DetectorView.md") == build_detector_page()
    index = text_of("environments.md")
    named = {f"spoofgym/{name}" for name in re.findall(r"`(?:spoofgym/)?(\w+-v\d+)`", index)}
    for first, last in re.findall(r"`(Bench[A-Z]\d-v\d)` to `(Bench[A-Z]\d-v\d)`", index):
        named |= {f"spoofgym/{first[:6]}{k}{first[7:]}" for k in range(1, int(last[6]) + 1)}
    assert {name for name in gym.registry if name.startswith("spoofgym/")} == named


def test_the_grades_of_sensors_have_their_figures():
    for name, grade in IMU_GRADES.items():
        biases = (max(map(abs, x)) for x in (grade.accel_bias_ug, grade.gyro_bias_deg_per_h))
        noise = grade.accel_noise_ug_per_rthz, grade.gyro_noise_deg_per_rth
        cells = " | ".join(f"{x:.6g}" for x in (*biases, *noise))
        assert f"| `{name}` | {cells} |\n" in text_of("worlds.md")


def test_what_a_detector_gets_is_what_its_docstrings_say():
    page = text_of("detector_interface.md")
    for name, (kind, chosen) in PARTS.items():
        table = build_table(kind, chosen)
        assert part_between(page, *marks(name)).strip() == table.strip()
        assert chosen or set(re.findall(r"`(\w+)`", table)) >= set(kind._fields)
