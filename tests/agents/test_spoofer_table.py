"""The table of many trained spoofers says who is over the budget, and who has not been trained."""

from __future__ import annotations

from agents.spoofer_table import page


def score(value, within=True, knowledge="blind"):
    return {
        "stealthy_displacement_m": {"value": value, "low": value - 1.0, "high": value + 1.0},
        "within_budget": within,
        "fit_within_budget": True,
        "knowledge": knowledge,
    }


def cell(*values, over=(), optimum=None):
    rows = [
        {
            "score": None if value is None else score(value, value not in over),
            "ratios": {"blind-optimum": {"value": (value or 0.0) / 10.0, "low": 0.0, "high": 2.0}},
        }
        for value in values
    ]
    rivals = {} if optimum is None else {"blind-optimum": score(optimum)}
    return {"seeds": rows, "rivals": rivals}


def cells_of(text, line=-1):
    return [part.strip() for part in text.splitlines()[line].strip("|").split(" | ")]


def test_a_line_has_what_is_there_and_a_dash_for_the_rest():
    found = page({"T3/ewma/blind": cell(9.0, 12.0, 8.0, optimum=10.0)})
    row = dict(zip(cells_of(found, 0), cells_of(found), strict=True))
    assert row["world"] == "T3"
    assert row["PPO (blind)"] == "9.0 [8.0, 12.0]"
    assert row["of the blind-optimum"] == "0.90 (0.00 to 2.00)"
    assert row["blind-optimum (blind)"] == "10.0 (9.0 to 11.0)"
    assert row["PPO (oracle)"] == row["PPO (blind+reported)"] == row["feedback"] == "-"


def test_seeds_over_the_budget_are_counted_and_one_without_a_policy_is_nothing():
    found = page({"T5/aime/oracle": cell(9.0, None, 8.0, over=(9.0,))})
    row = dict(zip(cells_of(found, 0), cells_of(found), strict=True))
    assert row["PPO (oracle)"] == "8.0 [0.0, 9.0], 1 over"
    assert row["PPO (blind)"] == "-"


def test_a_line_for_each_detector_in_a_world():
    table = {f"T3/{name}/{known}": cell(1.0) for name in "ab" for known in ("blind", "oracle")}
    lines = page(table).splitlines()
    assert [line.split(" | ")[1] for line in lines[2:]] == ["a", "b"]
