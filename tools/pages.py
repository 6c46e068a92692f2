"""Parts of pages that are made by programs."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from agents.folder import write_json
from spoofgym.bench.report import table
from spoofgym.core.files import write_file

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
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


def keep_cards(file: Path, cards: Mapping[str, Any], order: Iterable[str]) -> None:
    write_json(file, {name: cards[name] for name in order if name in cards})
