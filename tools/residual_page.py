"""The table on `docs/corrections.md`: ``python -m tools.residual_page runs/residual``.

Takes the results of `train.residual_ppo` in a folder into `docs/residual.json`; what they lack
stays as it is.  Those of `train.offsets_ppo` go into `docs/offsets.json` and the table of PPO on
`docs/offsets.md`.  Without a folder it writes the tables again, and that of
`docs/learned_suite.md` from what `train.suite_ppo` keeps.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agents.folder import write_json
from train import offsets_ppo, replay_ppo
from train.residual_ppo import build_table
from train.suite_ppo import SCORES, tabulate

from . import offsets_worth
from .pages import DOCS, fit_tables, marks, parse_folders, put_between

PAGE, DATA_FILE = DOCS / "corrections.md", DOCS / "residual.json"
SUITE, TASKS = DOCS / "learned_suite.md", DOCS / "learned_tasks.md"
OFFSETS, LEARNED = marks("offsets-learned"), "learned"
"""Where the table of PPO on offsets stands on its page, and the key of what it is made of."""


def take(results: dict[str, Any], kept: dict[str, Any]) -> dict[str, Any]:
    """Results with those that are kept, by detector and row; of other sizes they are refused."""
    before = kept.get("detectors", {})
    check_sizes(results, kept, ("steps", "runs", "world"), DATA_FILE)
    for detector, found in results["detectors"].items():
        rows = before.get(detector, {}).get("rows", {})
        before[detector] = {**found, "rows": {**rows, **found["rows"]}}
    return {**results, "detectors": before}


def take_offsets(results: dict[str, Any], kept: dict[str, Any]) -> dict[str, Any]:
    """As `take`, by case and detector."""
    check_sizes(results, kept, ("steps", "runs", "entropy", "world"), offsets_worth.DATA_FILE)
    return {**results, "cases": kept.get("cases", {}) | results["cases"]}


def check_sizes(
    results: dict[str, Any], kept: dict[str, Any], sizes: Sequence[str], file: Path
) -> None:
    if differing := [x for x in sizes if kept and kept[x] != results[x]]:
        raise ValueError(f"{file.name} has results of other {', '.join(differing)}")


def main() -> None:
    kept = json.loads(DATA_FILE.read_text()) if DATA_FILE.exists() else {}
    offsets = json.loads(offsets_worth.DATA_FILE.read_text())
    for folder in parse_folders("Write the tables of PPO that corrects, and of that on offsets."):
        results = json.loads((folder / "results.json").read_text())
        if "cases" in results:
            offsets[LEARNED] = take_offsets(results, offsets.get(LEARNED, {}))
        else:
            kept = take(results, kept)
    write_json(DATA_FILE, kept)
    write_json(offsets_worth.DATA_FILE, offsets)
    table = fit_tables(f"{offsets_ppo.build_table(offsets[LEARNED])}\n")
    put_between(offsets_worth.PAGE, *OFFSETS, table)
    put_between(PAGE, *marks("residual"), fit_tables(f"{build_table(kept)}\n"))
    put_between(SUITE, *marks("suite"), f"{tabulate(json.loads(SCORES.read_text()))}\n")
    replayed = json.loads(replay_ppo.SCORES.read_text())
    put_between(TASKS, *marks("replay"), fit_tables(f"{replay_ppo.build_table(replayed)}\n"))


if __name__ == "__main__":
    main()
