"""All five papers keep the frame, and their pages tell what their JSON files say."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from baselines.papers.frame import Row, Settings
from baselines.papers.page import DOCS, page_text
from baselines.papers.paper import KEYS, check_rows, load_paper, parts_of
from baselines.papers.tables import by_table

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(params=KEYS)
def key(request):
    return request.param


@pytest.mark.parametrize("quick", [True, False])
def test_parts_have_names_of_their_own_and_can_be_run_elsewhere(key, quick):
    first, other = (parts_of(load_paper(key), Settings(quick, seed)) for seed in (0, 1))
    assert [part.name for part in first] == [part.name for part in other]
    # all chance follows from the seed: another one changes what is run
    assert [part.settings for part in first] != [part.settings for part in other]


def test_the_texts_say_something_and_cite_the_paper(key):
    paper = load_paper(key)
    for name in ("TITLE", "CLAIMS", "FOUND", "READINGS"):
        assert getattr(paper, name).strip(), name
        assert not getattr(paper, name).lstrip().startswith("#"), "headings are the page's own"
    assert key[-4:] in paper.TITLE
    assert f"{{{key}," in (ROOT / "references.bib").read_text()


@pytest.mark.parametrize("key", KEYS)
def test_the_index_of_the_docs_and_the_readme_name_every_paper(key):
    assert f"](papers/{key}.md)" in (DOCS.parent / "README.md").read_text()
    assert f"| `{key}` |" in (ROOT / "README.md").read_text()


def test_every_other_link_of_the_index_leads_somewhere():
    targets = re.findall(r"\]\(([^)#:]+)\)", (DOCS.parent / "README.md").read_text())
    pages = {path.relative_to(DOCS.parent).as_posix() for path in DOCS.parent.rglob("*.md")}
    # the API has an index of its own
    listed = {page for page in pages if page == "api/README.md" or not page.startswith("api/")}
    assert sorted(targets) == sorted(listed - {"README.md"})


@pytest.fixture
def stored(key):
    return json.loads((DOCS / f"{key}.json").read_text())


def test_a_page_agrees_with_its_json(key, stored):
    page = (DOCS / f"{key}.md").read_text()
    assert page == page_text(load_paper(key), stored), "run `python -m baselines.papers.page`"


def test_stored_rows_are_finite_and_their_bands_in_order(key, stored):
    rows = [
        Row(**{name: value for name, value in row.items() if name != "inside"})
        for row in stored["rows"]
    ]
    check_rows(rows)
    assert [row.inside for row in rows] == [row["inside"] for row in stored["rows"]]
    assert stored["paper"] == key
    assert by_table(stored["rows"])


def test_a_value_outside_its_band_has_a_note(key, stored):
    for row in stored["rows"]:
        if row["inside"] is False:
            assert row["note"], (row["table"], row["row"], row["quantity"])
