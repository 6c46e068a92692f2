"""Ledger, costs, tested versions, bibliography and leaderboards are what their commands make."""

import json
from importlib.metadata import PackageNotFoundError, version

import pytest

from spoofgym.bench.report import tasks
from tools import bibliography, costs, leaderboard, offsets_worth, validation, versions
from tools.pages import marks, part_between


@pytest.mark.parametrize(
    ("page", "between", "make"),
    [
        (validation.PAGE, marks("ledger"), validation.build_tables),
        (
            costs.PAGE,
            marks("costs"),
            lambda: costs.build_tables(json.loads(costs.DATA_FILE.read_text())),
        ),
        (versions.PAGE, versions.MARKS, versions.make_table),
        (
            offsets_worth.PAGE,
            offsets_worth.MARKS,
            lambda: offsets_worth.build_table(json.loads(offsets_worth.DATA_FILE.read_text())),
        ),
        (bibliography.PAGE, bibliography.MARKS, bibliography.build_list),
        (leaderboard.PAGE, (leaderboard.START, leaderboard.END), leaderboard.shown),
    ],
)
def test_a_page_holds_what_its_command_makes(page, between, make):
    assert part_between(page.read_text(), *between) == f"\n{make()}"


def test_rows_that_could_hardly_fail_are_not_counted():
    row = {"quantity": "alarms [%]", "paper": 100.0, "ours": 100.0, "agrees": True}
    harder = [{**row, "ours": 99.0}, {**row, "quantity": "delay [s]"}, {**row, "paper": None}]
    assert [validation.is_given(each) for each in (row, *harder)] == [True, False, False, False]
    assert validation.count_rows([*harder, {**row, "agrees": False}], "agrees") == "3 of 4"


def test_what_is_installed_is_what_the_table_says():
    here = versions.read_versions("constraints.txt")
    if version("gymnasium") != here["gymnasium"]:  # in the environment of `make test-ray`
        here = versions.read_versions("constraints-ray.txt")
    found = {}
    for name in versions.PACKAGES:
        try:
            found[name] = version(name).partition("+")[0]
        except PackageNotFoundError:
            continue
    assert len(found) >= 5
    assert {name: each for name, each in found.items() if here.get(name, each) != each} == {}


def test_leaderboards_say_what_has_no_score_and_the_best_of_a_task_stands_first():
    text = leaderboard.shown()
    assert all(command in text for command in tasks.missing().values())
    assert "\n\n\n" not in text
    detectors, spoofers = leaderboard.list_detectors(), leaderboard.list_spoofers()
    for key in {row["task"] for row in detectors}:
        tightest = [row["0.5"]["value"] for row in detectors if row["task"] == key]
        farthest = [row["score"]["value"] for row in spoofers if row["task"] == key]
        assert tightest == sorted(tightest) != []
        assert farthest == sorted(farthest, reverse=True) != []
