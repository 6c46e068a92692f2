"""What a program writes into a page stays between its marks."""

import json

import pytest

from agents.game_page import shown
from spoofgym.detectors import make_detector
from tests.docs.test_sizes import list_tables
from tools.game_page import DATA_FILE, END, PAGE, START
from tools.pages import fit_tables, part_between, put_between

TEXT = "before\n<!-- a -->\nold\n<!-- b -->\nafter\n"


def test_a_part_is_replaced_and_nothing_else(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(TEXT)
    for _ in range(2):
        put_between(page, "<!-- a -->", "<!-- b -->", "new\n")
        assert page.read_text() == TEXT.replace("old", "new")
    assert part_between(page.read_text(), "<!-- a -->", "<!-- b -->") == "\nnew\n"


def test_a_large_table_is_divided_and_nothing_is_lost():
    head = "|task|name|" + "".join(f"v{k}|" for k in range(6)) + "\n" + 8 * "|---" + "|\n"
    rows = [
        f"|{t}|{n}|" + "".join(f"{t}{n}{k}|" for k in range(6)) for t in "ab" for n in range(12)
    ]
    text = fit_tables("before\n\n" + head + "\n".join(rows) + "\n\nafter\n")
    sizes = list_tables(text)
    assert sizes == 8 * [(6, 5)]
    assert all(f"{t}{n}{k}|" in text for t in "ab" for n in range(12) for k in range(6))
    assert fit_tables(text) == text


@pytest.mark.parametrize("text", ["", TEXT.replace("b", "c"), TEXT + TEXT])
def test_a_page_without_its_marks_is_left_as_it_is(tmp_path, text):
    page = tmp_path / "page.md"
    page.write_text(text)
    with pytest.raises(ValueError, match="must stand there once each"):
        put_between(page, "<!-- a -->", "<!-- b -->", "new\n")
    assert page.read_text() == text


def test_the_page_has_the_tables_of_the_kept_results_and_its_mixes_are_pools():
    text = DATA_FILE.read_text(encoding="utf-8")
    kept = json.loads(text)
    assert part_between(PAGE.read_text(encoding="utf-8"), START, END) == fit_tables(
        f"\n{shown(kept)}"
    )
    for pool in (kept["iterations"][0]["pool"], kept["final"]["pool"]):
        assert len(make_detector(pool).judges) == len(pool["members"])
        assert sum(pool["weights"]) == pytest.approx(1.0, abs=1e-3)
    assert len(kept["detectors"]) > 20
    for row in kept["values"].values():  # every pair has a payoff
        assert len(row) == len(kept["detectors"])
        assert all(0.0 <= value <= 1.0 for value in row)
    assert "/tmp" not in text  # nor any other path of a machine
    assert ".onnx" not in text
