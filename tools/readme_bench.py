"""Make the README's table from the stored full run, and keep what `make bench` plays of it.

make bench
python -m tools.readme_bench results     # keeps its rows in docs/bench.json
python -m tools.readme_bench             # the README's table and picture from docs/headlines.json

A test holds the rows that `make bench` plays against those of the full run, by interval.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

from agents.folder import write_json
from spoofgym.bench.experiments.campaign import CampaignResults, summarize
from spoofgym.bench.report.campaign import bound_text, groups
from spoofgym.bench.report.campaign_page import picture_displacements
from spoofgym.bench.report.figures import save_drawing
from spoofgym.bench.report.table import Table, format_number, metres
from spoofgym.bench.scores.campaign import HALF, STEALTHY, headline
from tools.headlines import DATA_FILE as FULL
from tools.headlines import WORLD
from tools.pages import DOCS, ROOT, put_between, render_page

README, SHARED, DRAWN = ROOT / "README.md", DOCS / "bench.json", DOCS / "campaign.png"
START, END = "<!-- bench:start -->", "<!-- bench:end -->"
SPOOFERS = {
    "ramp": "ramp",
    "accelerating-ramp": "accelerating ramp",
    "open-loop": "open-loop",
    "feedback": "feedback (sees statistics)",
}
"""Whose stealthy displacements are shown, and their headings."""
OVER = "*"
SHARES = {"in 50 % of runs": 0.5, "in 5 %": 0.05}


def label(detector: str) -> str:
    """Short label: the rate of false alarms is the same for all."""
    return re.sub(r"\(false_alarms_per_hour=0\.2\)|, false_alarms_per_hour=0\.2", "", detector)


def shown(world: dict[str, Any]) -> str:
    claims = (row["claimed"] for row in world["detectors"])
    (per_run,) = {claimed["per_run"] for claimed in claims if claimed is not None}
    cells = {(cell["detector"], cell["spoofer"].partition("(")[0]): cell for cell in world["cells"]}
    protections = {row["detector"]: row for row in world["protection"]}
    table = Table(
        ("detector", lambda row: label(row["detector"])),
        *(
            (
                title,
                lambda row, x=x: _value(headline(protections[row["detector"]], x)),
                format_number,
            )
            for title, x in SHARES.items()
        ),
        *(
            (title, lambda row, name=name: cells[row["detector"], name], _format_displacement)
            for name, title in SPOOFERS.items()
        ),
        ("bounds", "bracket", _format_bounds),
    )
    shown_table = table.markdown(world["detectors"])
    return render_page("bench.md.j2", world=world, per_run=per_run, table=shown_table, OVER=OVER)


def _value(estimate: dict[str, Any] | None) -> float | None:
    return None if estimate is None else estimate["value"]


def _format_displacement(cell: dict[str, Any]) -> str:
    keeps = cell["within_budget"] and cell["tuned_within_budget"] is not False
    return metres(_value(cell["stealthy_displacement_m"])) + ("" if keeps else OVER)


def _format_bounds(found: dict[str, Any]) -> str:
    floor, best = metres(found["floor_m"][STEALTHY]), metres(_value(found["open_loop"]))
    return f"[{floor}, {best}, {bound_text(found['zero_alarm'])}]"


def shared_rows(world: dict[str, Any]) -> dict[str, Any]:
    """Scores with their intervals, by detector, of a summary or of a world that is kept."""
    found: dict[str, Any] = {}
    for row in world["protection"]:
        scores = {HALF: headline(row, 0.5), "exceeded in 5 %": headline(row, 0.05)}
        for cell in world["cells"]:
            if cell["detector"] == row["detector"] and cell["spoofer"] != "none":
                scores[cell["spoofer"]] = cell["stealthy_displacement_m"]
        found[label(row["detector"])] = {
            score: {end: each[end] for end in ("value", "low", "high")}
            for score, each in scores.items()
            if each is not None
        }
    return found


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, nargs="?", help="results of `make bench`")
    given = parser.parse_args(arguments).folder
    if given is not None:
        summary = summarize(CampaignResults.load(given))
        kept = {"campaign": summary["campaign"], "rows": shared_rows(summary)}
        write_json(SHARED, kept)
    world = json.loads(FULL.read_text())["worlds"][WORLD]
    (group,) = groups(world)
    dots = picture_displacements(world, group)
    save_drawing(dots.draw, dots.height_in, DRAWN)
    picture = "\n![How far every attack gets](docs/campaign.png)\n"
    put_between(README, START, END, shown(world) + picture)


if __name__ == "__main__":
    main(sys.argv[1:])
