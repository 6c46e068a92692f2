"""The catalogue leaves nothing out."""

import re

import gymnasium as gym
import pytest

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.attacks import ATTACKS, THREATS
from spoofgym.detectors import DETECTORS
from spoofgym.detectors.observation import DETECTOR_TERMS
from spoofgym.policies import DetectorCard, list_shipped
from spoofgym.spoofers import KNOWLEDGE, SPOOFERS

from .pages import ROOT, blocks_of, run, text_of

PAGE = text_of("catalogue.md")
ROWS = {line.split("`")[1]: line for line in PAGE.splitlines() if line.startswith("| `")}


def test_every_registered_name_is_in_a_table():
    for kinds in (DETECTORS, DETECTOR_TERMS, SPOOFERS, ATTACKS, list_shipped()):
        assert set(kinds) <= set(ROWS)
    assert [name for name in THREATS if f"`{name}`" not in PAGE] == []
    for name in KNOWLEDGE:
        assert all(f"`{word}`" in PAGE for word in name.replace("+", " +").split())


def test_every_environment_is_named():
    ids = [name for name in gym.registry if name.startswith("spoofgym/")]
    named = {f"spoofgym/{name}" for name in re.findall(r"`(?:spoofgym/)?(\w+-v\d+)`", PAGE)}
    named |= {f"spoofgym/BenchT{k}-v1" for k in range(2, 6)}  # "T1 to T6"
    named |= {f"spoofgym/BenchD{k}-v1" for k in range(2, 4)}
    assert len(ids) > 5
    assert set(ids) == named


def test_the_source_of_every_detector_is_in_the_bibliography():
    keys = re.findall(r"@\w+\{(\S+),", (ROOT / "references.bib").read_text())
    for name, kind in DETECTORS.items():
        assert kind.paper in keys
        assert f"`{kind.paper}`" in ROWS[name]


def test_a_learned_detector_is_written_as_the_page_says(tmp_path, monkeypatch):
    ((needs, code),) = blocks_of("catalogue.md")
    pytest.importorskip(needs)
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {"__name__": "page"}
    run(code, "catalogue.md", scope)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["guard.json", "guard.onnx"]
    card = DetectorCard.load("guard.json")
    assert card == scope["card"]
    assert [each.name for each in card.state] == ["hidden"]
