"""The README's code runs, and its tables leave nothing out."""

import re
import sys
import types
from pathlib import Path

import pytest

from spoofgym.attacks import ATTACKS
from spoofgym.detectors import DETECTORS
from spoofgym.spoofers import SPOOFERS
from spoofgym.testing import check_detector

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_every_block_of_code_runs(number, capsys, monkeypatch):
    module = types.ModuleType("readme")
    monkeypatch.setitem(sys.modules, "readme", module)  # pickle looks classes up
    exec(compile(BLOCKS[number], f"README.md block {number}", "exec"), module.__dict__)
    if number == 0:
        assert re.search(r"undetected: -?\d+\.\d m, alarm: (True|False)", capsys.readouterr().out)


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
