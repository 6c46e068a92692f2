"""Make the README's table from the stored full run, and keep what `make bench` plays of it.

make bench
python -m tools.readme_bench results     # keeps its rows in docs/bench.json, and its picture
python -m tools.readme_bench             # the README's table again from docs/headlines.json

A test holds the rows that `make bench` plays against those of the full run, by interval.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path
from typing import Any

from spoofgym.bench.experiments.campaign import PICTURE, CampaignResults, summarize
from spoofgym.bench.report import table as tables
from spoofgym.bench.report.campaign import markdown_table
from spoofgym.bench.scores.campaign import HALF, STEALTHY, headline
from spoofgym.core.files import write_file
from tools.headlines import KEPT as FULL
from tools.pages import put_between

ROOT = Path(__file__).resolve().parents[1]
README, SHARED = ROOT / "README.md", ROOT / "docs" / "bench.json"
DRAWN = ROOT / "docs" / "campaign.png"
BEGIN, END = "<!-- bench:start -->", "<!-- bench:end -->"
WORLD = "trolley"
"""World of the full run that the README shows: that of task T3."""
SPOOFERS = {
    "ramp": "ramp",
    "snapshot-chi2-profile": "profile",
    "blind-optimum": "open-loop",
    "feedback": "feedback (sees statistics)",
}
"""Whose stealthy displacements are shown, and their headings."""
DEFAULTS = ("snapshot-chi2", "windowed-chi2", "ewma", "joint-chart", "innovation-rate", "raim")
"""Detectors with their own settings that the README shows, besides the first ones."""
HEAD = ("detector", "in 50 % of runs", "in 5 %", *SPOOFERS.values(), "bounds")
OVER = "*"
SHARES = (0.5, 0.05)


def label(detector: str) -> str:
    """Short label: the rate of false alarms is the same for all."""
    return detector.replace("(false_alarms_per_hour=0.2)", "").replace(
        ", false_alarms_per_hour=0.2", ""
    )


def chosen(world: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of the detectors that the README shows, in the order of the suite."""
    rows = []
    for row in world["detectors"]:
        name = label(row["detector"])
        first = name in ("never", "lottery", "solution-separation") or "range_rate" in name
        if first or name in DEFAULTS:
            rows.append(row)
    return rows


def shown(world: dict[str, Any]) -> str:
    """The table, and what was played."""
    (per_run,) = {
        row["claimed"]["per_run"] for row in world["detectors"] if row["claimed"] is not None
    }
    floor = world["limits"]["floor"]["floor_m"]
    return "\n".join(
        [
            "Displacement in metres that the worst attack of the suite exceeds undetected, "
            "and what spoofers reach undetected with alarms in at most 5 % of the runs",
            f"(`{OVER}`: in more). All detectors have 0.2 false alarms an hour, "
            f"{100 * per_run:.3g} % of runs. World of task T3, `{world['scenario']}`: "
            f"{world['runs']} runs, sky, heading,",
            "onset and sensors drawn for each; "
            f"`{world['command']}`, campaign {world['campaign']}. An ideal detector would allow "
            f"{tables.number(floor['half']['value'])} m in half of the runs. The bounds are the",
            "lower limit of a stealthy attack (ideal detector), the optimized open-loop attack "
            "(`blind-optimum`), and the zero-alarm bound ([assumptions](docs/limits.md)).",
            "",
            *markdown_table(HEAD, [_row(world, row) for row in chosen(world)]),
            "",
        ]
    )


def _row(world: dict[str, Any], row: dict[str, Any]) -> tuple[str, ...]:
    name = row["detector"]
    cells = {
        cell["spoofer"].partition("(")[0]: cell
        for cell in world["cells"]
        if cell["detector"] == name
    }
    protection = next(each for each in world["protection"] if each["detector"] == name)
    worst = (headline(protection, share) for share in SHARES)
    reached = (_reached(cells[spoofer]) for spoofer in SPOOFERS)
    return (label(name), *(_number(each) for each in worst), *reached, _bracket(row["bracket"]))


def _number(estimate: dict[str, Any] | None) -> str:
    if estimate is None or estimate["value"] is None:
        return "-"
    return tables.number(estimate["value"])


def _reached(cell: dict[str, Any]) -> str:
    keeps = cell["within_budget"] and cell["tuned_within_budget"] is not False
    return _number(cell["stealthy_displacement_m"]) + ("" if keeps else OVER)


def _bracket(found: dict[str, Any]) -> str:
    """Lower limit, optimized open-loop attack and zero-alarm bound of a detector."""
    floor, best = found["floor_m"][STEALTHY], found["blind_optimum"]
    bound = found["zero_alarm"]
    sign = "<= " if bound["kind"] == "upper" else ""
    last = "none" if bound["value"] is None else sign + _metres(bound["value"])
    return f"[{_metres(floor)}, {'-' if best is None else _metres(best['value'])}, {last}]"


def _metres(value: float | str | None) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else tables.number(value)


def shared_rows(world: dict[str, Any]) -> dict[str, Any]:
    """Scores with their intervals, by detector, of a summary or of a world that is kept."""
    found: dict[str, Any] = {}
    for row in world["protection"]:
        name = row["detector"]
        worst = {HALF: headline(row, 0.5), "exceeded in 5 %": headline(row, 0.05)}
        cells = {
            cell["spoofer"]: cell["stealthy_displacement_m"]
            for cell in world["cells"]
            if cell["detector"] == name and cell["spoofer"] != "none"
        }
        ends = ("value", "low", "high")
        found[label(name)] = {
            score: {end: each[end] for end in ends}
            for score, each in {**worst, **cells}.items()
            if each is not None
        }
    return found


def main(arguments: list[str]) -> None:
    """Keep what `make bench` has played, and write the README's table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, nargs="?", help="results of `make bench`")
    given = parser.parse_args(arguments).folder
    if given is not None:
        summary = summarize(CampaignResults.load(given))
        kept = {"campaign": summary["campaign"], "rows": shared_rows(summary)}
        write_file(SHARED, (json.dumps(kept, indent=1, allow_nan=False) + "\n").encode())
        shutil.copyfile(given / PICTURE, DRAWN)
    world = json.loads(FULL.read_text())["worlds"][WORLD]
    picture = "\n![The campaign](docs/campaign.png)\n"
    put_between(README, BEGIN, END, shown(world) + picture)


if __name__ == "__main__":
    main(sys.argv[1:])
