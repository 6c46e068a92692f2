"""Tables of trainings say what everybody observes, and which seeds are over the budget."""

from agents.seeds import build_table, comparable
from agents.spoofer_table import page


def score(knowledge, value, within=True):
    return {
        "knowledge": knowledge,
        "stealthy_displacement_m": {"value": value, "low": value - 1.0, "high": value + 1.0},
        "alarm_rate": {"value": 0.0, "low": 0.0, "high": 0.0},
        "within_budget": within,
        "fit_within_budget": True,
    }


def test_the_table_says_what_everybody_observes_and_a_line_of_the_page_has_what_is_there():
    row = {"seed": 3, "wall_s": 60.0, "untrained": score("blind+reported", 1.0), "score": None}
    rivals = {"ramp": score("blind", 4.0), "feedback": score("oracle", 9.0)}
    title, head, rows = build_table({"detector": "mine", "seeds": [row], "rivals": rivals})
    assert title.startswith("against mine")
    assert {len(row) for row in rows} == {len(head)}
    known = {name: observes for name, observes, *_ in rows}
    assert known == {"ramp": "blind", "feedback": "oracle", "PPO, seed 3": "blind+reported"}
    # oracles are compared with oracles
    known = {"ramp": "blind", "feedback": "oracle", "both": "oracle+reported"}
    assert comparable(known, "tracking+reported") == ["ramp"]
    assert comparable(known, "oracle+reported") == ["ramp", "feedback", "both"]
    (row,) = rows_of(page({"T3/ewma/blind": cell(9.0, 12.0, 8.0, optimum=10.0)}))
    assert (row["world"], row["PPO (blind)"]) == ("T3", "9.0 [8.0, 12.0]")
    assert row["of the open-loop"] == "0.90 (0.00 to 2.00)"
    assert row["open-loop (blind)"] == "10.0 (9.0 to 11.0)"
    assert row["PPO (oracle)"] == row["PPO (blind+reported)"] == row["feedback"] == "-"
    # seeds over the budget are counted, and one without a policy is nothing
    (row,) = rows_of(page({"T5/aime/oracle": cell(9.0, None, 8.0, over=(9.0,))}))
    assert row["PPO (oracle)"] == "8.0 [0.0, 9.0], 1 over"
    assert row["PPO (blind)"] == "-"
    table = {f"T3/{name}/{known}": cell(1.0) for name in "ab" for known in ("blind", "oracle")}
    assert len(rows_of(page(table))) == 2  # one for each detector in a world


def cell(*values, over=(), optimum=None):
    rows = [
        {
            "score": None if value is None else score("blind", value, value not in over),
            "ratios": {"open-loop": {"value": (value or 0.0) / 10.0, "low": 0.0, "high": 2.0}},
        }
        for value in values
    ]
    rivals = {} if optimum is None else {"open-loop": score("blind", optimum)}
    return {"seeds": rows, "rivals": rivals}


def rows_of(table):
    head, _, *lines = ([x.strip() for x in y.strip("|").split(" | ")] for y in table.splitlines())
    return [dict(zip(head, line, strict=True)) for line in lines]
