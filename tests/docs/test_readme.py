"""The README's code runs, and its tables leave nothing out."""

import re
import sys
import tomllib
import types
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.attacks import ATTACKS
from spoofgym.detectors import DETECTORS
from spoofgym.spoofers import SPOOFERS
from spoofgym.testing import check_detector

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_every_block_of_code_runs(number, capsys, monkeypatch):
    module = types.ModuleType("readme")
    monkeypatch.setitem(sys.modules, "readme", module)  # pickle looks classes up
    exec(compile(BLOCKS[number], f"README.md block {number}", "exec"), module.__dict__)
    if number == 0:
        assert f"It prints `{capsys.readouterr().out.strip()}`" in README


def test_the_first_output_is_typical_of_its_push():
    """As the README says of the seeds 0 to 99, the first block's among them."""
    settings = {"detector": "ewma", "knowledge": "tracking"}
    envs = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=100, **settings)
    envs.reset(seed=0)
    reached, alarmed = np.full(100, np.nan), np.zeros(100, dtype=bool)
    while np.isnan(reached).any():
        _, _, over, _, info = envs.step(np.tile([0.2], (100, 1)))
        ended = over & np.isnan(reached)
        reached[ended] = info["undetected_displacement_m"][ended]
        alarmed[ended] = info["detected"][ended]
    low, middle, high = np.percentile(reached, [10, 50, 90])
    said = (
        f"over the seeds 0 to 99 the median is {middle:.0f} m, the 10th and the 90th percentile "
        f"are {low:.1f} and {high:.0f} m, and {alarmed.sum()} of them end with an alarm"
    )
    assert said in " ".join(README.split())
    (seed,) = re.findall(r"seed=(\d+)", BLOCKS[0])
    ((printed, alarm),) = re.findall(r"`undetected: (\S+) m, alarm: (True|False)`", README)
    assert alarm == str(alarmed[int(seed)]) == str(alarmed.sum() > 50)
    assert float(printed) == pytest.approx(reached[int(seed)], abs=0.051)
    low, high = np.percentile(reached, [40, 60])
    assert low - 0.05 < float(printed) < high + 0.05  # as it is rounded


def test_it_says_how_to_install_and_with_which_extras():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = re.findall(r"^pip install '?\.(?:\[(.*)\])?", README, flags=re.MULTILINE)
    assert lines[0] == ""
    named = {extra for line in lines[1:] for extra in line.split(",")}
    assert {"report", "flights", "train"} <= named <= {*extras["optional-dependencies"]}


def test_the_first_loop_is_short():
    lines = [line for line in BLOCKS[0].splitlines() if line.strip()]
    assert len(lines) <= 12


@pytest.mark.parametrize("kinds", [DETECTORS, SPOOFERS, ATTACKS])
def test_every_registered_name_stands_in_a_table(kinds):
    rows = [line for line in README.splitlines() if line.startswith("| `")]
    named = {line.split("`")[1] for line in rows}
    assert set(kinds) <= named


def test_every_link_to_a_file_leads_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize("name", sorted(DETECTORS))
def test_the_source_of_every_detector_is_in_the_bibliography(name):
    keys = re.findall(r"@\w+\{(\S+),", (ROOT / "references.bib").read_text())
    assert DETECTORS[name].paper in keys
    row = next(line for line in README.splitlines() if line.startswith(f"| `{name}`"))
    assert f"`{DETECTORS[name].paper}`" in row


def test_the_detector_of_the_contributors_guide_keeps_the_contract(monkeypatch):
    guide = (ROOT / "CONTRIBUTING.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", guide, flags=re.DOTALL)
    module = types.ModuleType("contributed")
    monkeypatch.setitem(sys.modules, "contributed", module)  # pickle looks classes up
    exec(compile(block, "CONTRIBUTING.md", "exec"), module.__dict__)
    check_detector(module.CumulativeSum())
