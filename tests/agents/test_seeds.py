"""The table of a training says what everybody observes, and oracles are compared with oracles."""

import pytest

from agents.seeds import comparable, table_of


def score(knowledge, value):
    estimate = {"value": value, "low": value, "high": value}
    return {
        "knowledge": knowledge,
        "stealthy_displacement_m": estimate,
        "alarm_rate": {**estimate, "value": 0.0},
        "within_budget": True,
        "fit_within_budget": None,
    }


def test_the_table_says_what_everybody_observes():
    row = {"seed": 3, "wall_s": 60.0, "untrained": score("blind+reported", 1.0), "score": None}
    rivals = {"ramp": score("blind", 4.0), "feedback": score("oracle", 9.0)}
    title, head, rows = table_of({"detector": "mine", "seeds": [row], "rivals": rivals})
    assert title.startswith("against mine")
    assert {len(row) for row in rows} == {len(head)}
    known = {name: observes for name, observes, *_ in rows}
    assert known == {"ramp": "blind", "feedback": "oracle", "PPO, seed 3": "blind+reported"}


@pytest.mark.parametrize(
    ("knowledge", "names"),
    [
        ("blind", ["ramp"]),
        ("tracking+reported", ["ramp"]),
        ("oracle", ["ramp", "feedback", "both"]),
        ("oracle+reported", ["ramp", "feedback", "both"]),
    ],
)
def test_oracles_are_compared_with_oracles(knowledge, names):
    known = {"ramp": "blind", "feedback": "oracle", "both": "oracle+reported"}
    assert comparable(known, knowledge) == names
