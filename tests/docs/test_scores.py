"""The page on scores shows what is kept of the standard suite, and the file is as it was made."""

import json

import pytest

from spoofgym.bench.experiments.suite import SPOOFERS as STANDARD
from spoofgym.bench.report.campaign import WIDTHS, WORST, list_spoofer_rows, state_answer
from spoofgym.core.settings import compute_digest
from tools.headlines import DATA_FILE, END, START, WORLD, shown
from tools.pages import part_between

from .pages import text_of

PAGE = "suite.md"


@pytest.fixture(scope="module")
def kept():
    return json.loads(DATA_FILE.read_text())


def test_the_table_is_that_of_the_file(kept):
    assert part_between(text_of(PAGE), START, END) == f"\n{shown(kept)}"
    assert kept["digest"] == compute_digest(kept["worlds"])


def test_the_terminal_shows_a_row_for_each_detector_within_100_columns_and_the_answer(kept):
    world = kept["worlds"][WORLD]
    rows = [{"detector": row["detector"], "protection": row} for row in world["protection"]]
    lines = [line for row in (None, *rows) for line in WORST.lines(row, WIDTHS)]
    assert len(lines) <= 2 * len(rows)
    assert max(map(len, lines)) <= 100
    assert " ".join(lines[0].split()) == "detector in 50 % of runs [m] in 5 % [m] worst attack"
    best = "solution-separation(filter=augmented,spacing=geometric): 33.1 ("
    answer = state_answer(world)
    assert answer.startswith(f"Tightest of {len(rows) - 2}: {best}")
    assert answer.endswith("/h (requested 0.2).")
    assert "m undetected in half of the runs (worst of the attack suite: " in answer
    rows = list_spoofer_rows(world)
    assert max(map(len, rows)) <= 96
    assert " ".join(rows[0].split()) == "detector spoofer at most 5 % of alarms [m]"
    best = [line for line in rows if line.startswith("snapshot-chi2 ")]
    assert [line.split()[1] for line in best] == [
        each["spoofer"]
        for each in world["cells"]
        if each["detector"].startswith("snapshot-chi2") and each["spoofer"] != "none"
    ]
    none = {**world, "protection": []}  # without the attack suite
    assert "undetected in the mean at 5 % of alarms (worst: " in state_answer(none)


def test_every_detector_has_the_same_rate_and_its_attacks(kept):
    world = kept["worlds"][WORLD]
    points = [point for each in world["calibrations"].values() for point in each]
    assert {point["false_alarms_per_hour"] for point in points} == {0.2}
    assert not any(point["extrapolated"] for point in points)
    labels = {row["detector"] for row in world["detectors"]}
    assert {"never", "snapshot-chi2", "ewma"} < labels
    assert len(labels) == 12
    assert {row["detector"] for row in world["protection"]} == labels
    wanted = {"none", *STANDARD}
    for label in labels:
        met = [c["spoofer"].split("(")[0] for c in world["cells"] if c["detector"] == label]
        assert {*met} == wanted


def test_no_ramp_gets_farther_than_the_open_loop_attack(kept):
    """Within the budget, by the intervals of the stored run."""
    reached = {}
    for cell in kept["worlds"][WORLD]["cells"]:
        if cell["within_budget"] and cell["tuned_within_budget"]:
            name = cell["spoofer"].split("(")[0]
            reached.setdefault(cell["detector"], {})[name] = cell["stealthy_displacement_m"]
    found = [each for each in reached.values() if "open-loop" in each]
    assert len(found) == 12
    for each in found:
        for name in {"ramp", "accelerating-ramp"} & {*each}:
            assert each["open-loop"]["high"] >= each[name]["low"], (name, each)


def test_chance_is_worth_nothing(kept):
    """The controls can't be told apart, but by one who obeys what a lottery says."""
    world = kept["worlds"][WORLD]
    rows = [
        row
        for row in world["comparisons"]
        if {row["detector"].split("(")[0], row["control"].split("(")[0]} == {"never", "lottery"}
    ]
    assert len(rows) > 4
    assert "feedback" not in {row["spoofer"] for row in rows}
    reached = {
        c["detector"].split("(")[0]: c["stealthy_displacement_m"]["value"]
        for c in world["cells"]
        if c["spoofer"] == "feedback"
    }
    assert reached["lottery"] == pytest.approx(reached["never"], rel=0.0055)
    for row in rows:
        low, high = row["difference_m"]["low"], row["difference_m"]["high"]
        assert low <= 0.0 <= high, row
