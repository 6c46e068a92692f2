"""Make the README's table again from what `make bench` has written.

make bench
python -m tools.readme_bench results
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from spoofgym.bench import tables
from spoofgym.bench.report import markdown_table
from spoofgym.bench.store import ResultsFolder
from spoofgym.bench.summary import summarize
from tools.pages import put_between

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
BEGIN, END = "<!-- bench:start -->", "<!-- bench:end -->"
DETECTORS = {
    "detector": "detector",
    "clean runs with an alarm [%]": "measured: % of runs",
    "exceeded in 50 % of runs [m]": "exceeded in 50 % [m]",
    "in 5 % [m]": "in 5 % [m]",
    "in 50 %, worst skies [m]": "worst skies, in 50 % [m]",
    "worst attack": "worst attack",
}
"""Columns of the README's first table, and what they are in the campaign's."""
CONTROL = ", a control"


def shown(summary: dict[str, Any]) -> str:
    """The two tables, and what was played."""
    (group,) = tables.groups(summary)
    places = [tables.DETECTORS_HEAD.index(name) for name in DETECTORS.values()]
    rows = tables.detector_rows(summary, group)
    first = [[row[k] for k in places] for row in rows]
    for row, whole in zip(first, rows, strict=True):
        row[0] += CONTROL if whole[-1] == "control" else ""
        row[0] += f" ({whole[-1]})" if whole[-1] not in ("", "control") else ""
    (per_run,) = {
        row["claimed"]["per_run"] for row in summary["detectors"] if row["claimed"] is not None
    }
    return "\n".join(
        [
            f"All detectors are calibrated to {group.rate} false alarms an hour, "
            f"{100 * per_run:.3g} % of runs without an attack. {summary['runs']} runs",
            f"of the world `{summary['scenario']}`, sky, heading, onset and turn-on constants of "
            "the sensors drawn for each; 95 % intervals in brackets; campaign",
            f"{summary['campaign']}. How far the worst attack of the suite gets before anyone "
            "notices:",
            "",
            *markdown_table(list(DETECTORS), first),
            "",
            "Spoofers that keep to 5 % of alarms, each with an amplitude fitted to the detector, "
            "and what they reach on average:",
            "",
            *markdown_table(*_attacks(summary, group)),
            "",
        ]
    )


def _attacks(
    summary: dict[str, Any], group: tables.Group
) -> tuple[list[str], list[tuple[str, ...]]]:
    """Stealthy displacements, a row for each spoofer, a column for each detector."""
    cells = {(cell["detector"], cell["spoofer"]): cell for cell in summary["cells"]}
    spoofers = dict.fromkeys(name for _, name in cells if name != "none")
    rows = []
    for name in spoofers:
        found = [cells[label, name] for label in group.detectors]
        reached = (tables.interval(cell["stealthy_displacement_m"]) for cell in found)
        over = ("" if cell["within_budget"] else tables.OVER for cell in found)
        rows.append((name, *(a + b for a, b in zip(reached, over, strict=True))))
    return ["stealthy displacement [m]", *group.detectors], rows


def main(arguments: list[str]) -> None:
    """Put the tables of a results folder into the README."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("results"))
    folder = ResultsFolder(parser.parse_args(arguments).folder)
    picture = "\n![The campaign](docs/campaign.png)\n"
    put_between(README, BEGIN, END, shown(summarize(folder)) + picture)


if __name__ == "__main__":
    main(sys.argv[1:])
