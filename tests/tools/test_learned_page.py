"""The page on learned spoofers shows what is kept of the trainings."""

from __future__ import annotations

import json

from tools.learned_page import BEGIN, END, KEPT, PAGE, shown, taken
from tools.pages import part_between


def test_the_page_has_the_tables_of_the_kept_results():
    kept = json.loads(KEPT.read_text())
    assert part_between(PAGE.read_text(), BEGIN, END) == f"\n{shown(kept)}"


def test_the_headline_is_true():
    """More than three times the best constant ramp, every seed with its paired interval above."""
    kept = json.loads(KEPT.read_text())
    assert set(kept) == {"T3", "T5"}
    for found in kept.values():
        assert [row["seed"] for row in found["seeds"]] == [0, 1, 2, 3, 4]
        ratios = sorted(row["ratios"]["ramp"]["value"] for row in found["seeds"])
        assert ratios[2] > 3.0
        assert all(row["ratios"]["ramp"]["low"] > 1.0 for row in found["seeds"])
        assert all(row["score"]["within_budget"] for row in found["seeds"])
        again = taken({**found, "seeds": [_result(row) for row in found["seeds"]]})
        assert again == found


def _result(row):
    """A row as a training writes it."""
    untrained = {"stealthy_displacement_m": {"value": row["untrained_m"]}}
    return {**row, "untrained": untrained}
