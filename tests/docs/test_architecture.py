"""The page on the architecture names files and things that exist, and its picture is up to date."""

from __future__ import annotations

import re
import runpy

import pytest

from .pages import ROOT, text_of

PAGE = text_of("architecture.md")
SPAN = re.compile(r"`([^`\n]+)`")
PATHS = sorted({span for span in SPAN.findall(PAGE) if re.fullmatch(r"[\w./]*(/|\.py)", span)})
ROWS = [line for line in PAGE.splitlines() if line.startswith("|") and ".py`" in line]


def places(path):
    """Where a path of the page may be: in the package, or in the checkout."""
    return [top / path for top in (ROOT / "spoofgym", ROOT) if (top / path).exists()]


def test_the_picture_is_that_of_the_layers():
    house = runpy.run_path(str(ROOT / "docs" / "house.py"))
    assert (ROOT / "docs" / "house.svg").read_text() == house["draw"]()


@pytest.mark.parametrize("path", PATHS)
def test_a_path_of_the_page_exists(path):
    assert places(path)


@pytest.mark.parametrize("row", ROWS)
def test_what_a_row_names_is_in_a_file_of_the_row(row):
    spans = SPAN.findall(row)
    files = [place for span in spans for place in places(span) if place.is_file()]
    sources = "\n".join(file.read_text() for file in files)
    for span in spans:
        if re.fullmatch(r"[A-Za-z_.]+", span) and not span.endswith((".py", "/")):
            for name in span.split("."):
                assert re.search(rf"\b{name}\b", sources), name


def test_the_files_of_the_flow_of_a_step_exist():
    (flow,) = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)
    paths = re.findall(r"(?<=\s)[\w/]+\.py", flow)
    assert len(paths) > 10
    assert [path for path in paths if not places(path)] == []
