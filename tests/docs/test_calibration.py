"""The page on calibration: its code runs, and what it says of numbers of runs is so."""

import json
import re

import pytest

from spoofgym.detectors import Calibration
from spoofgym.detectors.calibration_file import SHIPPED_FOLDER, compute_min_runs, run_probability
from tools.calibrations import HEADLINES, build_setup
from tools.holdouts import DATA_FILE, END, START, load_world, shown
from tools.pages import part_between

from .pages import play, text_of

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

PAGE, WORLDS = "calibration.md", "calibration_worlds.md"


def test_the_code_runs_in_its_order(monkeypatch):
    assert play(PAGE, monkeypatch).env.unwrapped.core.setup.detector
    page = play(WORLDS, monkeypatch, [("runs=1000", "runs=24")])
    assert page.env.unwrapped.core.setup.detector.point.false_alarms_per_hour == 0.2
    assert [each.detector["name"] for each in page.found] == ["snapshot-chi2", "ewma"]
    assert [each.runs for each in page.held] == [24, 24]


@pytest.mark.parametrize("rate", [0.2, 0.002])
def test_it_takes_as_many_runs_as_the_page_says(rate):
    least = compute_min_runs(run_probability(rate, 160.0))
    said = rf"{least:,} (clean runs )?for {rate:g} an hour"
    assert re.search(said, text_of(PAGE)), said


def shipped_names(world):
    folder = SHIPPED_FOLDER / build_setup(world).conditions.digest
    return {Calibration.load(path).detector["name"] for path in folder.glob("*.json")}


@pytest.mark.parametrize("name", HEADLINES)
def test_as_many_runs_are_shipped_as_the_page_says(name):
    later = ("cumulative-bank", "fma", "solution-separation")  # came later, and have fewer runs
    fewer = ", ".join(f"`{each}`" for each in later)
    for said in (f"| 200,000; 20,000 of {fewer} | 6000 to 12,000 |", "their 17th largest ratio"):
        assert said in text_of(PAGE)
    world = load_world(name, only=shipped_names(name))  # a new detector may have none yet
    points = {made.detector["name"]: made.point(0.002) for made, _ in world.passive}
    assert {points.pop(each).runs for each in later} == {20_000}
    assert {(point.runs, point.rank) for point in points.values()} == {(200_000, 17)}
    assert all(6_000 <= made.runs <= 12_000 for made, _ in world.weighing)
    folder = world.passive[0][0].path.parent
    rescaled = [Calibration.load(path) for path in folder.glob("*-rescaled.json")]
    assert {made.runs for made in rescaled} == {200_000}


def test_the_hold_outs_are_those_of_the_file_and_hold():
    kept = json.loads(DATA_FILE.read_text())
    assert part_between(text_of(WORLDS), START, END) == f"\n{shown(kept)}"
    rows = [row for world in kept["worlds"] for row in world["detectors"]]
    rare = [row["rare"] for row in rows if row["passive"]]
    assert kept["cells"] == len(rows) + len(rare)
    assert f"all {kept['cells']} counts lie where they should" in text_of(WORLDS)
    assert all(row["holds"] for row in rows + rare)
    assert {row["runs"] for row in rare} == {100_000}
    for world in kept["worlds"]:
        assert abs(world["mean_passive_per_hour"] / kept["rate"] - 1.0) < 0.1
