"""The page on calibration: its code runs, and what it says of numbers of runs is so."""

from __future__ import annotations

import json
import re

import pytest

from spoofgym.detectors.calibration import fewest_runs, run_probability
from tools.holdouts import BEGIN, END, KEPT, shown
from tools.pages import part_between

from .pages import blocks_of, broken_links, run, text_of

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

PAGE = "calibration.md"


def test_the_code_runs_in_its_order():
    scope = {}
    for _, code in blocks_of(PAGE):
        run(code.replace("runs=1000", "runs=24"), PAGE, scope)
    point = scope["env"].unwrapped.core.setup.detector.point
    assert point.false_alarms_per_hour == 0.2
    assert [each.detector["name"] for each in scope["found"]] == ["snapshot-chi2", "ewma"]
    assert [each.runs for each in scope["held"]] == [24, 24]


@pytest.mark.parametrize(("rate", "window_s"), [(0.2, 160.0), (0.002, 160.0)])
def test_it_takes_as_many_runs_as_the_page_says(rate, window_s):
    least = fewest_runs(run_probability(rate, window_s))
    said = rf"{least:,} (clean runs )?for {rate:g} an hour"
    assert re.search(said, text_of(PAGE)), said


def test_links_lead_somewhere():
    assert broken_links(PAGE) == []


def test_the_hold_outs_are_those_of_the_file_and_hold():
    kept = json.loads(KEPT.read_text())
    assert part_between(text_of(PAGE), BEGIN, END) == f"\n{shown(kept)}"
    assert kept["cells"] == sum(len(world["detectors"]) for world in kept["worlds"])
    for world in kept["worlds"]:
        assert all(row["holds"] for row in world["detectors"])
        assert abs(world["mean_passive_per_hour"] / kept["rate"] - 1.0) < 0.1
