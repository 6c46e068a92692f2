"""The tables of the page on the game are those of the kept results."""

import json

import pytest

from agents.game_page import shown
from spoofgym.detectors import make_detector
from tools.game_page import DATA_FILE, END, PAGE, START
from tools.pages import part_between


def test_the_page_has_the_tables_of_the_kept_results_and_its_mixes_are_pools():
    text = DATA_FILE.read_text(encoding="utf-8")
    kept = json.loads(text)
    assert part_between(PAGE.read_text(encoding="utf-8"), START, END) == f"\n{shown(kept)}"
    for pool in (kept["iterations"][0]["pool"], kept["final"]["pool"]):
        assert len(make_detector(pool).judges) == len(pool["members"])
        assert sum(pool["weights"]) == pytest.approx(1.0, abs=1e-3)
    assert len(kept["detectors"]) > 20
    for row in kept["values"].values():  # every pair has a payoff
        assert len(row) == len(kept["detectors"])
        assert all(0.0 <= value <= 1.0 for value in row)
    assert "/tmp" not in text  # nor any other path of a machine
    assert ".onnx" not in text
