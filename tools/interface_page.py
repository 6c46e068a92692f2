"""The tables of `docs/detector_interface.md`, from the docstrings of what they are of.

python -m tools.interface_page
"""

from __future__ import annotations

import inspect
from typing import Any

from numpydoc.docscrape import NumpyDocString

from spoofgym.bench.report.table import Table
from spoofgym.detectors import Detector, DetectorContext, Verdict
from spoofgym.receiver.epoch import Epoch
from tools.pages import DOCS, fit_tables, marks, put_between

PAGE = DOCS / "detector_interface.md"
CHOSEN = "needs", "scope", "measures", "silent_epochs", "memory_epochs", "memory", "paper"
"""Attributes of a detector that a class from outside may need."""
PARTS: dict[str, tuple[type[Any], tuple[str, ...]]] = {
    "epoch": (Epoch, ()),
    "verdict": (Verdict, ()),
    "context": (DetectorContext, ()),
    "detector": (Detector, CHOSEN),
}


def build_table(kind: type[Any], chosen: tuple[str, ...]) -> str:
    """Table of the attributes in a docstring, or of those that are chosen, by name."""
    found = NumpyDocString(inspect.getdoc(kind) or "")["Attributes"]
    rows = {name: " ".join(text).replace("``", "`") for name, _, text in found}
    texts = [(f"`{name.replace(', ', '`, `')}`", rows[name]) for name in chosen or rows]
    return fit_tables(Table.of_texts("name", "what it is").markdown(texts) + "\n").rstrip() + "\n"


def main() -> None:
    for name, (kind, chosen) in PARTS.items():
        put_between(PAGE, *marks(name), build_table(kind, chosen))


if __name__ == "__main__":
    main()
