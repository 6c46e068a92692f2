"""The ledger of `docs/validation.md`: ``python -m tools.validation``.

Figures come from stored results, and from the tests that prove them; none is written by hand.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from spoofgym.bench.report.table import Table
from tools.pages import DOCS, ROOT, marks, put_between

PAGE = DOCS / "validation.md"
LEDGER = Path(__file__).with_suffix(".toml")
HEAD = "capability", "validated against", "limit of the test", "test"
COUNTS = {"printed_inside": "printed value and ours in the band", "agrees": "second program"}


def read_test(node: str) -> str:
    """Source of one test; a ValueError where it does not exist."""
    file, _, name = node.partition("::")
    found = re.search(rf"^def {name}\(.*?(?=^\S|\Z)", (ROOT / file).read_text(), re.M | re.S)
    if found is None:
        raise ValueError(f"there is no test {node}")
    return found[0]


def read_figure(row: Mapping[str, str]) -> str:
    """Figure of a row of the ledger, as its test asserts it."""
    found = re.search(row["find"], read_test(row["test"]))
    assert found is not None, row
    return row["figure"].format(*found.groups())


def is_given(row: Mapping[str, Any]) -> bool:
    """Whether printed value and ours are both none or both all, so that it could hardly fail."""
    unit = "%" if "%" in row["quantity"] else "share" if "[" not in row["quantity"] else ""
    ends = {"%": (0.0, 100.0), "share": (0.0, 1.0), "": ()}[unit]
    return row["paper"] == row["ours"] and row["ours"] in ends


def count_rows(rows: Iterable[Mapping[str, Any]], kind: str) -> str:
    counted = [row[kind] for row in rows if row[kind] is not None]
    return f"{sum(counted)} of {len(counted)}" if counted else "-"


def count_papers() -> list[tuple[str, ...]]:
    """Per paper and in all: how many rows agree, without those that could hardly fail, and with
    them."""
    files = sorted((DOCS / "papers").glob("*.json"))
    found = {x.stem: json.loads(x.read_text())["rows"] for x in files}
    found["all five"] = [row for rows in found.values() for row in rows]
    kept = {key: [row for row in rows if not is_given(row)] for key, rows in found.items()}
    return [
        (key, *(count_rows(rows, kind) for rows in (hard, found[key]) for kind in COUNTS))
        for key, hard in kept.items()
    ]


def build_tables() -> str:
    ledger = tomllib.loads(LEDGER.read_text())
    rows = [
        (row["what"], row["against"], read_figure(row), f"`{row['test'].rpartition('::')[2]}`")
        for row in ledger["row"]
    ]
    rates = json.loads((DOCS / "holdouts.json").read_text())
    measured = [f"{each['mean_passive_per_hour']:.3f}" for each in rates["worlds"]]
    modelled = [(x["what"], f"[{x['why']}]({x['page']})") for x in ledger["modelled"]]
    head = "paper", *COUNTS.values(), *(f"{title}, all rows" for title in COUNTS.values())
    papers = Table.of_texts(*head).markdown(count_papers())
    return "\n\n".join([
        Table.of_texts(*HEAD).markdown(rows),
        f"**False alarms** of the shipped calibrations, {rates['cells']} cells on fresh runs: "
        f"requested {rates['rate']:g} an hour, measured {', '.join(measured)} in the means of "
        "three worlds, passive detectors ([which, and the suite's world]"
        "(calibration_worlds.md#do-those-that-are-shipped-hold)).",
        "**Papers.** How many rows of their tables agree. The *band* of a row is the range in "
        "which the printed value and ours both have to lie: a margin around the printed value, the "
        "spread of our runs, or what the second program found; some are our choice. The *second "
        "program* was written separately from the same papers, and is unpublished. Its columns "
        "count the rows with a band around what it found: in how many our value lies in it "
        "([more](papers.md#how-to-read-a-row)). The first two counts leave out rows that could "
        "hardly fail: the printed value and ours are both 0 %, or both 100 %. *All rows* are the "
        "counts of the papers' own pages.",
        papers,
        "## Modelled only",
        Table.of_texts("capability", "why").markdown(modelled) + "\n",
    ])  # fmt: skip


if __name__ == "__main__":
    put_between(PAGE, *marks("ledger"), build_tables())
