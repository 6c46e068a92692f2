"""Parts of pages that are made by programs."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable, Mapping
from itertools import groupby, pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

from agents.folder import write_json
from spoofgym.bench.report import table
from spoofgym.core.files import write_file

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
MOST_ROWS, MOST_COLUMNS = 10, 6
T = TypeVar("T")
TEMPLATES = Path(__file__).with_name("templates")


def parse_folders(description: str) -> list[Path]:
    """Folders of results of a command line; none for the page alone."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("folders", nargs="*", type=Path, help="results that are added to the page")
    return list(parser.parse_args().folders)


def marks(name: str) -> tuple[str, str]:
    return f"<!-- {name}:begin -->", f"<!-- {name}:end -->"


def part_between(text: str, begin: str, end: str) -> str:
    """What stands between two marks of a text; a ValueError where they are not there, once each."""
    if text.count(begin) != 1 or text.count(end) != 1:
        raise ValueError(f"the marks {begin} and {end} must stand there once each")
    return text.partition(begin)[2].partition(end)[0]


def put_between(page: Path, begin: str, end: str, text: str) -> None:
    whole = page.read_text()
    before = part_between(whole, begin, end)
    made = whole.replace(f"{begin}{before}{end}", f"{begin}\n{text}{end}")
    write_file(page, made.encode())


def render_page(name: str, **values: Any) -> str:
    """A template of the folder beside."""
    return table.render_template(name, values, TEMPLATES)


def fit_tables(text: str) -> str:
    """Divide Markdown tables that are larger than a page allows: by rows, where the first column
    gives groups by these, and by columns, each part with those that name its rows."""
    return re.sub(r"(?:^\|.*\n)+", lambda found: _divide(found[0]), text, flags=re.MULTILINE)


def _divide(table: str) -> str:
    head, ruler, *rows = (re.split(r"(?<!\\)\|", line)[1:-1] for line in table.splitlines())
    if len(rows) <= MOST_ROWS and len(head) <= MOST_COLUMNS:
        return table
    keys = next(k for k in range(1, len(head)) if len({(*row[:k],) for row in rows}) == len(rows))
    groups = [list(own) for _, own in groupby(rows, itemgetter(0))]
    if len(rows) <= MOST_ROWS or min(map(len, groups)) < 2:
        groups = [rows]
    parts = [some for own in groups for some in _share(own, MOST_ROWS)]
    names, values = [*range(keys)], [*range(keys, len(head))]
    tables = []
    for some in _share(values, MOST_COLUMNS - keys):
        for own in parts:
            filled = [row for row in own if any(row[k].strip(" -") for k in some)]
            lines = (head, ruler, *filled)
            tables += ["".join(f"|{'|'.join(row[k] for k in names + some)}|\n" for row in lines)]
    return "\n".join(tables)


def _share(items: list[T], most: int) -> list[list[T]]:
    """Parts of a list, as few as there can be of that size, and as even."""
    count = math.ceil(len(items) / most)
    ends = [round(k * len(items) / count) for k in range(count + 1)]
    return [items[a:b] for a, b in pairwise(ends)]


def keep_cards(file: Path, cards: Mapping[str, Any], order: Iterable[str]) -> None:
    write_json(file, {name: cards[name] for name in order if name in cards})
