"""The ledger and the costs are what their commands make."""

import json

from tools import costs, validation
from tools.pages import marks, part_between


def test_the_ledger_is_made_of_tests_and_stored_results():
    page = validation.PAGE.read_text()
    assert part_between(page, *marks("ledger")) == f"\n{validation.build_tables()}"


def test_rows_that_could_hardly_fail_are_not_counted():
    row = {"quantity": "alarms [%]", "paper": 100.0, "ours": 100.0, "agrees": True}
    harder = [{**row, "ours": 99.0}, {**row, "quantity": "delay [s]"}, {**row, "paper": None}]
    assert [validation.is_given(each) for each in (row, *harder)] == [True, False, False, False]
    assert validation.count_rows([*harder, {**row, "agrees": False}], "agrees") == "3 of 4"


def test_the_costs_are_those_that_were_measured():
    stored = costs.build_tables(json.loads(costs.DATA_FILE.read_text()))
    assert part_between(costs.PAGE.read_text(), *marks("costs")) == f"\n{stored}"
