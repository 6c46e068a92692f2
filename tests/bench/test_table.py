"""One table is printed for a terminal, as Markdown and as JSON."""

import pytest
from jinja2 import UndefinedError

from spoofgym.bench.report.table import Table, interval, metres, percent, render_template, share

TABLE = Table(
    ("detector", "name"),
    ("per run [%]", "per_run", share(1)),
    ("alarms", lambda row: row["alarms"] or "none"),
)
ROWS = [
    {"name": "one | two\nlines", "per_run": 0.0125, "alarms": 3},
    {"name": "never", "per_run": None, "alarms": 0},
]


@pytest.mark.parametrize(
    ("ends", "digits", "text"),
    [
        ((8.7, 8.7, 8.7), None, "8.7 (within 0.05)"),
        ((476.43, 476.42, 476.44), None, "476 (within 0.5)"),
        ((0.004, 0.0, 0.004), None, "0.00 (within 0.005)"),
        ((-0.001, -0.004, 0.004), None, "-0.00 (within 0.005)"),
        ((100.0, 99.98, 100.0), 1, "100.0 (within 0.05)"),
        ((1.04, 1.06, 1.14), 1, "1.0 (within 0.15)"),
        ((1.0, 1.0, 1.1), None, "1.0 (1.0 to 1.1)"),
        ((8.7, 8.7, None), None, "8.7 (8.7 or more)"),
        ((8.7, None, 8.7), None, "8.7 (? to 8.7)"),
        ((12.345, 11.0, 13.21), None, "12.3 (11.0 to 13.2)"),
        ((0.0012, 0.0, 0.004), 3, "0.001 (0.000 to 0.004)"),
        ((359.2, 350.0, 366.0), None, "359 (350 to 366)"),
        ((None, None, None), None, "-"),
    ],
)
def test_no_interval_is_printed_without_a_width(ends, digits, text):
    assert interval(dict(zip(("value", "low", "high"), ends, strict=True)), digits) == text


def test_long_names_on_a_page_break_at_their_settings(tmp_path):
    (tmp_path / "name.html.j2").write_text("{{ name | breakable }}")
    for name, broken in (
        ("bank(filter=own,spacing=2)", "bank<wbr>(filter=<wbr>own,<wbr>spacing=<wbr>2)"),
        ("dash(tuned,last_s=60)", "dash<wbr>(tuned,<wbr>last_s=<wbr>60)"),
        ("<b>, 1.0 (0.9 to 1.1)", "&lt;b&gt;, 1.0 (0.9 to 1.1)"),
    ):
        assert render_template("name.html.j2", {"name": name}, tmp_path) == broken + "\n"


def test_a_column_takes_a_key_or_a_function_and_a_form(capsys):
    assert TABLE.titles == ("detector", "per run [%]", "alarms")
    assert TABLE.texts(ROWS) == [("one | two\nlines", "1.2", "3"), ("never", "-", "none")]
    assert TABLE["per run [%]"].text(ROWS[0]) == "1.2"
    assert Table.of_texts("a", "b").texts([("1", "2"), ["3", "4"]]) == [("1", "2"), ("3", "4")]
    # Markdown keeps a row in one line and a cell in its column
    assert TABLE.markdown(ROWS).splitlines() == [
        "| detector | per run [%] | alarms |",
        "|---|---|---|",
        r"| one \| two lines | 1.2 | 3 |",
        "| never | - | none |",
    ]
    # JSON has the values themselves
    assert TABLE.json(ROWS) == [{key: row[key] for key in ("name", "per_run")} for row in ROWS]
    TABLE.print("rates [red]", ROWS)  # a unit in brackets is no style
    title, *lines = capsys.readouterr().out.splitlines()
    assert title.strip() == "rates [red]"
    assert "per run [%]" in lines[1]
    (row,) = (line for line in lines if line.strip().startswith("never"))
    assert row.index("-") == lines[1].index("per run")
    estimate = {"value": 0.5, "low": 0.25, "high": None, "confidence": 0.95}
    assert percent(estimate) == "50.0 (25.0 or more)"
    assert percent({"value": None, "low": None, "high": None}) == "-"
    assert [metres(x) for x in (None, "unbounded", 12.34)] == ["-", "unbounded", "12.3"]
    with pytest.raises(UndefinedError):  # what a template lacks
        render_template("floor.txt.j2", {"summary": {}})
