"""The table on `docs/corrections.md`: ``python -m tools.residual_page runs/residual``.

Takes the results of `train.residual_ppo` in a folder into `docs/residual.json`; what they lack
stays as it is.  Without a folder it writes the table again, and that of `docs/learned_suite.md`
from what `train.suite_ppo` keeps.
"""

from __future__ import annotations

import json
from typing import Any

from agents.folder import write_json
from train import replay_ppo
from train.residual_ppo import build_table
from train.suite_ppo import SCORES, tabulate

from .pages import DOCS, fit_tables, marks, parse_folders, put_between

PAGE, DATA_FILE = DOCS / "corrections.md", DOCS / "residual.json"
SUITE, TASKS = DOCS / "learned_suite.md", DOCS / "learned_tasks.md"


def take(results: dict[str, Any], kept: dict[str, Any]) -> dict[str, Any]:
    """Results with those that are kept, by detector and row; of other sizes they are refused."""
    before = kept.get("detectors", {})
    if differing := [x for x in ("steps", "runs", "world") if kept and kept[x] != results[x]]:
        raise ValueError(f"{DATA_FILE.name} has results of other {', '.join(differing)}")
    for detector, found in results["detectors"].items():
        rows = before.get(detector, {}).get("rows", {})
        before[detector] = {**found, "rows": {**rows, **found["rows"]}}
    return {**results, "detectors": before}


def main() -> None:
    kept = json.loads(DATA_FILE.read_text()) if DATA_FILE.exists() else {}
    for folder in parse_folders("Write the page of residual spoofers."):
        kept = take(json.loads((folder / "results.json").read_text()), kept)
    write_json(DATA_FILE, kept)
    put_between(PAGE, *marks("residual"), fit_tables(f"{build_table(kept)}\n"))
    put_between(SUITE, *marks("suite"), f"{tabulate(json.loads(SCORES.read_text()))}\n")
    replayed = json.loads(replay_ppo.SCORES.read_text())
    put_between(TASKS, *marks("replay"), fit_tables(f"{replay_ppo.build_table(replayed)}\n"))


if __name__ == "__main__":
    main()
