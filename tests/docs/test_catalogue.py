"""The catalogue leaves nothing out."""

import re

import gymnasium as gym

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.attacks import ATTACKS, THREATS
from spoofgym.detectors import DETECTORS
from spoofgym.detectors.observation import DETECTOR_TERMS
from spoofgym.policies import list_shipped
from spoofgym.spoofers import KNOWLEDGE, SPOOFERS

from .pages import text_of

PAGE = text_of("catalogue.md")
ROWS = {line.split("`")[1]: line for line in PAGE.splitlines() if line.startswith("| `")}


def test_every_registered_name_is_in_a_table_and_every_environment_named():
    for kinds in (DETECTORS, DETECTOR_TERMS, SPOOFERS, ATTACKS, list_shipped()):
        assert set(kinds) <= set(ROWS)
    for name, kind in DETECTORS.items():
        assert f"`{kind.paper}`" in ROWS[name]
    assert [name for name in THREATS if f"`{name}`" not in PAGE] == []
    for name in KNOWLEDGE:
        assert all(f"`{word}`" in PAGE for word in name.replace("+", " +").split())
    ids = [name for name in gym.registry if name.startswith("spoofgym/")]
    named = {f"spoofgym/{name}" for name in re.findall(r"`(?:spoofgym/)?(\w+-v\d+)`", PAGE)}
    named |= {f"spoofgym/BenchT{k}-v1" for k in range(2, 6)}  # "T1 to T6"
    named |= {f"spoofgym/BenchD{k}-v1" for k in range(2, 4)}
    named |= {f"spoofgym/Bench{side}2-v2" for side in "SD"}
    assert set(ids) == named
