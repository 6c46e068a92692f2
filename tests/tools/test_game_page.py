"""The tables of the page on the game are those of the kept results."""

from __future__ import annotations

import json

import pytest

from agents.game_page import shown
from spoofgym.detectors import make_detector
from tools.game_page import BEGIN, END, KEPT, PAGE
from tools.pages import part_between


@pytest.fixture(scope="module")
def kept():
    return json.loads(KEPT.read_text(encoding="utf-8"))


def test_the_page_has_the_tables_of_the_kept_results(kept):
    assert part_between(PAGE.read_text(encoding="utf-8"), BEGIN, END) == f"\n{shown(kept)}"


def test_the_mixes_of_the_page_are_pools_that_an_environment_takes(kept):
    for pool in (kept["iterations"][0]["pool"], kept["final"]["pool"]):
        made = make_detector(pool)
        assert len(made.judges) == len(pool["members"])
        assert sum(pool["weights"]) == pytest.approx(1.0, abs=1e-3)


def test_every_pair_has_a_payoff_and_no_path_of_a_machine_is_kept(kept):
    assert len(kept["detectors"]) > 20
    for row in kept["values"].values():
        assert len(row) == len(kept["detectors"])
        assert all(0.0 <= value <= 1.0 for value in row)
    assert "/tmp" not in KEPT.read_text(encoding="utf-8")
    assert ".onnx" not in KEPT.read_text(encoding="utf-8")
