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
from spoofgym.bench.report.campaign import groups
from spoofgym.bench.report.campaign_page import picture_displacements
from spoofgym.bench.report.figures import save_drawing
from spoofgym.bench.report.table import Table, interval, metres
from spoofgym.bench.report.tasks import stored_detector_cards
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.campaign import HALF, headline
from spoofgym.tasks import get_task
from tools.headlines import DATA_FILE as FULL
from tools.headlines import WORLD
from tools.pages import DOCS, ROOT, put_between, render_page

README, SHARED, DRAWN = ROOT / "README.md", DOCS / "bench.json", DOCS / "campaign.png"
START, END = "<!-- bench:start -->", "<!-- bench:end -->"
LEARNED, REPLAYED = DOCS / "learned.json", DOCS / "learned_replay.json"
HOLDOUTS = DOCS / "holdouts.json"
COSTS = DOCS / "costs.json"
SHOWN = {
    "solution-separation(filter=augmented,spacing=geometric)": "solution separation, own filter",
    "solution-separation(spacing=geometric)": "solution separation, victim's filter",
    "cumulative-bank(signals=range_rate)": "cumulative bank",
    "snapshot-chi2": "snapshot chi-square",
    "ewma": "EWMA chart",
    "never": "none",
}
"""Rows of the README, of all that are played, by their titles there."""
SPOOFERS = {"ramp": "ramp", "open-loop": "searched open-loop", "feedback": "feedback"}
"""Whose stealthy displacements are shown, and their headings."""
STEALTHY = ": mean at 5 % of alarms [m]"
WORST = "worst attack: exceeded in half of the runs [m]"
OVER = "*"


def label(detector: str) -> str:
    """Short label: the rate of false alarms is the same for all."""
    return re.sub(r"\(false_alarms_per_hour=0\.2\)|, false_alarms_per_hour=0\.2", "", detector)


def shown(world: dict[str, Any], learned: dict[str, Any]) -> str:
    cells = {(cell["detector"], cell["spoofer"].partition("(")[0]): cell for cell in world["cells"]}
    protections = {label(row["detector"]): row for row in world["protection"]}
    names = {label(row["detector"]): row["detector"] for row in world["detectors"]}
    policies = choose_policies(learned)
    reach: Any = lambda each: interval(each["score"][MEASURES[0]])  # noqa: E731
    learned_column = ("learned" + STEALTHY, policies.get, reach)
    table = Table(
        ("detector", lambda short: SHOWN[short]),
        *(
            (title + STEALTHY, lambda short, x=x: cells[names[short], x], _format_displacement)
            for x, title in SPOOFERS.items()
            if not (policies and x == "feedback")
        ),
        *([learned_column] if policies else []),
        (WORST, lambda x: headline(protections[x], 0.5), interval),
    )
    values = {"table": table.markdown(SHOWN), "over": OVER, "policies": policies}
    values["gains"] = [_describe_gain(x, learned) for x in SHOWN if x in policies]
    values["counted"] = _count_false_alarms()
    values["audited"] = _find_audited()
    first = next(iter(SHOWN))
    values["best"] = interval(headline(protections[first], 0.5))
    cost = json.loads(COSTS.read_text())["rows"]["bench, standard"]
    values["minutes"] = round(cost["cpu_s"] / 60)
    values["covers_s"] = get_task(WORLD).detectors[0]["longest_s"]
    values["charted"] = world["calibrations"]["ewma"][0]["runs"]
    ramps = cells["never", "ramp"], cells[names[first], "ramp"]
    values["whole"], values["ramp"] = (metres(x["stealthy_displacement_m"]["value"]) for x in ramps)
    return render_page("bench.md.j2", world=world, **values)


def read_learned() -> dict[str, Any]:
    """Policies by name that were scored on the runs of the table, however they learned."""
    learned, replayed = (json.loads(file.read_text()) for file in (LEARNED, REPLAYED))
    scored = [each for name, each in replayed.items() if name.endswith(" readme") and each]
    return {"policies": {**learned["policies"], **{each["file"]: each for each in scored}}}


def list_policies(learned: dict[str, Any]) -> list[dict[str, Any]]:
    """Those that see the statistics."""
    return [each for each in learned["policies"].values() if each["knowledge"] == "statistics"]


def choose_policies(learned: dict[str, Any]) -> dict[str, Any]:
    """The scored policy of each detector, of several the one that was best on choice runs."""
    ranked = sorted(list_policies(learned), key=lambda each: max(each["choice_m"]))
    return {each["detector"]: each for each in ranked}


def add_learned(world: dict[str, Any], learned: dict[str, Any]) -> dict[str, Any]:
    """A world with the scored policies among its cells, as the picture shows them."""
    names = {label(row["detector"]): row["detector"] for row in world["detectors"]}
    cells = [
        {
            "detector": names[short],
            "spoofer": "learned",
            "stealthy_displacement_m": policy["score"][MEASURES[0]],
            "within_budget": True,
            "tuned_within_budget": True,
        }
        for short, policy in choose_policies(learned).items()
    ]
    return {**world, "cells": [*world["cells"], *cells]}


def _describe_gain(detector: str, learned: dict[str, Any]) -> str:
    """How far the seeds that were kept get over their base, and how many surely get farther."""
    seeds = [each["ratio"] for each in list_policies(learned) if each["detector"] == detector]
    if len(seeds) == 1:
        return f"{SHOWN[detector]} {interval(seeds[0], 2)}, one seed"
    values = sorted(each["value"] for each in seeds)
    farther = sum(each["low"] > 1.0 for each in seeds)
    reached = f"{SHOWN[detector]} {values[0]:.2f} to {values[-1]:.2f}"
    return f"{reached} (interval above 1: {farther} of {len(seeds)} seeds)"


def _count_false_alarms() -> dict[str, Any]:
    """Least and largest rate [per hour] of the shown detectors on the fresh runs of a hold-out."""
    rows = json.loads(HOLDOUTS.read_text())["tasks"][0]["detectors"]
    found = [each["per_hour"] for each in rows if each["name"] in SHOWN]
    return {"runs": f"{rows[0]['runs']:,}", "low": min(found), "high": max(found)}


def _find_audited() -> str:
    """What the worst attack of D1 exceeds in half of the runs against its best detector [m]."""
    card = stored_detector_cards()["D1"]
    (best,) = (x for x in card["detectors"] if x["detector"] == card["best_classic"])
    return f"{best['exceeded_m']['0.5']['value']:.0f}"


def _format_displacement(cell: dict[str, Any]) -> str:
    keeps = cell["within_budget"] and cell["tuned_within_budget"] is not False
    return interval(cell["stealthy_displacement_m"]) + ("" if keeps else OVER)


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
    world, learned = json.loads(FULL.read_text())["worlds"][WORLD], read_learned()
    (group,) = groups(world)
    dots = picture_displacements(add_learned(world, learned), group)
    save_drawing(dots.draw, dots.height_in, DRAWN)
    put_between(README, START, END, shown(world, learned))


if __name__ == "__main__":
    main(sys.argv[1:])
