"""All five papers keep the frame, and their pages tell what their JSON files say."""

import json
import math
import re

import pytest

from baselines.papers import paper as papers
from baselines.papers.frame import Settings
from baselines.papers.page import DOCS, list_files, page_text
from baselines.papers.paper import KEYS, list_parts, load_paper, rows_from_record
from baselines.papers.tables import COUNTS, by_table

every_paper = pytest.mark.parametrize("key", KEYS)


def read(key):
    return json.loads((DOCS / f"{key}.json").read_text())


@every_paper
def test_parts_have_names_of_their_own_and_can_be_run_elsewhere(key):
    for quick in (True, False):
        first, other = (list_parts(load_paper(key), Settings(quick, seed)) for seed in (0, 1))
        assert [part.name for part in first] == [part.name for part in other]
        # all chance follows from the seed: another one changes what is run
        assert [part.settings for part in first] != [part.settings for part in other]


def test_every_other_link_of_the_index_leads_somewhere():
    docs = DOCS.parent
    targets = re.findall(r"\]\(([^)#:]+)\)", (docs / "README.md").read_text())
    files = [path for path in docs.rglob("*") if path.suffix in (".md", ".ipynb")]
    pages = {path.relative_to(docs).as_posix() for path in files} - {"README.md"}
    own = ("api/", "environments/")  # which have an index of their own
    listed = {page for page in pages if page == "api/README.md" or not page.startswith(own)}
    assert sorted(targets) == sorted(listed)


@every_paper
def test_a_page_agrees_with_its_json_and_bands_that_exclude_the_printed_value_are_not_met(key):
    stored, page = read(key), (DOCS / f"{key}.md").read_text()
    assert page == page_text(load_paper(key), stored), "run `python -m baselines.papers.page`"
    for name, text in list_files(stored).items():
        assert (DOCS / name).read_text() == text, name
    assert (DOCS / f"{key}.png").read_bytes().startswith(b"\x89PNG")
    rows = rows_from_record(stored)
    papers.check_rows(rows)
    assert {**stored, **papers.rows_record(rows)} == stored
    assert stored["paper"] == key
    assert by_table(stored["rows"])
    for verdict, words in (
        ("printed_inside", "printed values lie inside the tolerance of the reproduction"),
        ("agrees", "of our values agree with an independent implementation"),
    ):
        told = [row[verdict] for row in stored["rows"] if row[verdict] is not None]
        assert f"- {sum(told)} of {len(told)} {words}." in page
    drawn = {path.name for path in (DOCS / "figures").glob(f"{key}*")}
    assert drawn == set(stored["pictures"]) != set()
    for name in drawn:
        assert f"(figures/{name})" in page
        assert (DOCS / "figures" / name).read_bytes().startswith(b"\x89PNG")
    stored = read(key)
    for row in stored["rows"]:
        kind = row["origin"] and stored["origins"][row["origin"]]["kind"]
        # an independent band never serves as a margin around the paper
        assert (row["agrees"] is not None) == (kind == "independent")
        assert (row["kept"] is not None) == (kind == "bound")
        where = row["table"], row["row"], row["quantity"]
        if kind is None or False in [row[verdict] for verdict in COUNTS]:
            assert row["note"], where  # which says why
        if row["paper"] is None or kind is None:
            assert row["printed_inside"] is None
            continue
        low = -math.inf if row["low"] is None else row["low"]
        high = math.inf if row["high"] is None else row["high"]
        if row["ours"] is None or not low <= row["paper"] <= high or not low <= row["ours"] <= high:
            assert row["printed_inside"] is False, where
    for letter, origin in stored["origins"].items():
        words = origin["text"]
        assert "{" not in words, letter
        assert re.search("seed|SeedSequence|no noise|processor time", words), (letter, words)
        assert origin["kind"] != "independent" or "second program" in words, letter


def stored_rows(key):
    return {(row.table, row.row, row.quantity): row for row in rows_from_record(read(key))}


def test_ke2022_and_shadmehri2025_say_where_they_contradict_what_is_printed():
    rows = stored_rows("ke2022")
    twice = [
        rows[figure, "M2, ramp 0.05 m/s", "detection time [s]"] for figure in ("Fig. 8", "Fig. 10")
    ]
    assert [row.paper for row in twice] == [157.0, 147.0]
    assert all("contradicts itself" in row.note for row in twice)
    assert sum(row.band is not None for row in twice) == 1  # one value of ours counts once
    # its misses are held against all satellites
    for table, told, paper in (("6", "5 m", 74.0), ("8", "0.05 m/s", 42.0)):
        row = rows[f"Table {table}", f"M2, {told}, each satellite in turn", "missed [%]"]
        assert row.paper == paper
        assert "eight satellites" in row.band.origin.text
    rows = stored_rows("shadmehri2025")
    table = "Not in the paper: false alarms"
    row = rows[table, "R of 0.17 m, fixed", "alarms per epoch, 20-35 s"]
    assert row.agrees is False
    assert "taken for white ones" in row.note
    white, correlated = (
        [other.ours for (_, name, _), other in rows.items() if name.startswith(begin)]
        for begin in ("R of 0.17 m, fixed, white", "R of 0.17 m, fixed, correlated")
    )
    assert max(white) < 1e-3 < min(correlated)
    assert correlated == sorted(correlated)
