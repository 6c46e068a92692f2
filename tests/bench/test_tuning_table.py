"""What a reader sees of a search for a setting."""

from __future__ import annotations

from spoofgym.bench.report.campaign import tuning_table
from spoofgym.bench.search.amplitude import Trial, TuningResult


def test_why_a_value_is_over_the_budget_can_be_read() -> None:
    kept = Trial(0.2, 400, 390, 0.02, 0.04, 30.0, True)
    sifted = Trial(0.3, 32, 30, 0.035, 0.12, 36.0, True)
    over = Trial(0.3, 400, 390, 0.035, 0.055, 40.0, False)
    found = TuningResult(
        "ewma", "ramp", "rate_mps", 0.2, True, 0.05, 400, 390, 0.02, 2, (kept, sifted, over)
    )
    search = found.as_dict()
    table = tuning_table(search)
    head = table.titles
    assert head[:3] == ("rate_mps", "runs", "counted")
    names = ("P(alarm | silent twin) [%]", "its upper limit [%]", "within budget")
    columns = [head.index(name) for name in names]
    rows = table.texts(search["trials"])
    assert [len(row) for row in rows] == [len(head)] * 3
    assert [tuple(row[i] for i in columns) for row in rows] == [
        ("2.0", "4.0", "yes"),
        ("3.5", "12.0", "yes"),  # a few runs sift by the rate
        ("3.5", "5.5", "no"),
    ]
    assert [row[0] for row in rows] == ["0.2 (chosen)", "0.3", "0.3"]
    assert TuningResult.from_dict(search) == found
