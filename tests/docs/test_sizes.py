"""No page is a wall: at most 1,200 words, and tables of at most 10 rows and 6 columns.

Words are those of the text, without code and tables.
"""

import re

import pytest

from .as_users import PAGES, name_of
from .pages import ROOT

MOST_WORDS, MOST_ROWS, MOST_COLUMNS = 1200, 10, 6


def read_plain(text: str) -> str:
    return re.sub(r"^ *```.*?^ *```$", "", text, flags=re.DOTALL | re.MULTILINE)


def list_tables(text: str) -> list[tuple[int, int]]:
    """Rows, without their head, and columns of every table."""
    tables = re.findall(r"(?:^\|.*\n)+", read_plain(text) + "\n", flags=re.MULTILINE)
    rows = [table.splitlines() for table in tables]
    return [(len(lines) - 2, len(re.findall(r"(?<!\\)\|", lines[0])) - 1) for lines in rows]


def count_words(text: str) -> int:
    return sum(len(line.split()) for line in read_plain(text).splitlines() if line[:1] != "|")


def find_walls(text: str) -> list[str]:
    """What of a page is too large."""
    words, tables = count_words(text), list_tables(text)
    walls = [f"{words} words"] * (words > MOST_WORDS)
    large = [x for x in tables if x[0] > MOST_ROWS or x[1] > MOST_COLUMNS]
    return walls + [f"a table of {rows} x {columns}" for rows, columns in large]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_page_and_its_tables_are_no_wall(page):
    assert find_walls(page.read_text()) == []


def test_tables_for_contributors_are_no_wall():
    tables = list_tables((ROOT / "CONTRIBUTING.md").read_text())
    assert all(rows <= MOST_ROWS and columns <= MOST_COLUMNS for rows, columns in tables)


def test_walls_are_found():
    head, line = "| a | b |\n|---|---|\n", "| 1 | 2 |\n"
    assert find_walls("word " * 1200 + "\n\n" + head + 10 * line) == []
    assert find_walls("word " * 1201 + "\n\n" + head + 11 * line) == [
        "1201 words",
        "a table of 11 x 2",
    ]
    assert find_walls("| a | b | c | d | e | f | g |\n|---|---|\n") == ["a table of 0 x 7"]
    assert find_walls(f"```text\n{'word ' * 1300}\n{head}{11 * line}\n```\n") == []


def test_no_picture_is_large():
    pictures = [x for x in (ROOT / "docs").rglob("*") if x.suffix in {".png", ".svg", ".webp"}]
    assert len(pictures) > 40
    assert {x.name for x in pictures if x.stat().st_size > 1_500_000} == set()
