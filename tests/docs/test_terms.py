"""The pages on terms: their code runs, and their tables are those of the registry."""

from __future__ import annotations

import importlib.util
import re
import sys
import types
from pathlib import Path

import pytest

from spoofgym.envs.terms import TERMS, term_table

from .pages import blocks_of

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = ("terms.md", "own_observation_term.md")


@pytest.mark.parametrize("page", PAGES)
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch):
    text, blocks = (DOCS / page).read_text(), blocks_of(page)
    assert blocks
    if "RecordEpochs" in text:
        pytest.importorskip("pyarrow")
    for kind in TERMS:  # a page may add to the registry
        kept = dict(TERMS[kind])
        monkeypatch.setitem(TERMS, kind, kept)
    monkeypatch.chdir(tmp_path)
    module = types.ModuleType("page")
    monkeypatch.setitem(sys.modules, "page", module)
    for number, (needs, block) in enumerate(blocks):
        if needs is not None and importlib.util.find_spec(needs) is None:
            continue
        exec(compile(block, f"{page} block {number}", "exec"), module.__dict__)


@pytest.mark.parametrize("kind", TERMS)
def test_the_table_is_that_of_the_registry(kind):
    text = (DOCS / "terms.md").read_text()
    (table,) = re.findall(rf"<!-- {kind} -->\n(.*?)\n<!-- -->", text, flags=re.DOTALL)
    assert table == term_table(kind)


def test_the_pages_are_listed():
    listed = (DOCS / "README.md").read_text()
    assert all(f"({page})" in listed for page in PAGES)
