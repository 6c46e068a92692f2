"""Write the leaderboards into their page, from stored scores: ``python -m tools.leaderboard``."""

from __future__ import annotations

from typing import Any

from spoofgym.bench.report import tasks
from spoofgym.bench.report.campaign import attack_of_suite
from spoofgym.bench.report.table import Table, format_number, interval, percent
from spoofgym.bench.scores.campaign import CONTROLS, extract_name
from spoofgym.tasks import get_task
from tools.pages import DOCS, fit_tables, marks, put_between, render_page

PAGE, (START, END) = DOCS / "submit.md", marks("leaderboard")
Row = dict[str, Any]
SPOOFERS = Table(
    ("task", "task"),
    ("spoofer", "spoofer"),
    ("knows", "knows"),
    ("stealthy displacement [m]", "score", interval),
    ("a perfect detector allows at 5 % [m]", "floor_m", format_number),
    ("by", "by"),
)
DETECTORS = Table(
    ("task", "task"),
    ("detector", "detector"),
    (
        "in 50 % of runs [m], worst attack",
        lambda row: f"{interval(row['0.5'])}, {attack_of_suite(row['0.5'])}",
    ),
    ("in 5 % [m]", lambda row: row["0.05"], interval),
    ("a perfect detector allows in 50 % [m]", "floor_m", format_number),
    ("by", "by"),
)
HAZARDS = Table(
    ("task", "task"),
    ("detector", "detector"),
    ("P(HMI) [%], worst family", lambda row: f"{percent(row['p_hmi'])}, {row['worst_family']}"),
    (
        "in 50 %, in 5 % of runs [m]",
        lambda row: ", ".join(interval(row["exceeded_m"][part]) for part in ("0.5", "0.05")),
    ),
    ("false alarms an hour", "false_alarms_per_hour", interval),
    ("by", "by"),
)
BY = {"by": "spoofgym"}


def list_spoofers() -> list[Row]:
    """Spoofers by task, the one that gets farthest first; those over the budget have no score."""
    rows = []
    for card in tasks.task_rows():
        floor = card["floor_m"]["stealthy"]["value"]
        scored = [(name, x) for name, x in card["scores_m"].items() if name in tasks.SCORES]
        for name, score in sorted(scored, key=lambda each: -each[1]["value"]):
            if score["within_budget"]:
                named = {"task": card["task"], "spoofer": name, "knows": tasks.SCORES[name]}
                rows.append({**named, "score": score, "floor_m": floor, **BY})
    return rows


def list_detectors() -> list[Row]:
    """Detectors by task for spoofers, the tightest first, controls apart."""
    rows = []
    for card in tasks.task_rows():
        floor, found = card["floor_m"]["half"]["value"], card["protection_m"].items()
        own = [each for each in found if extract_name(each[0]) not in CONTROLS]
        for name, moved in sorted(own, key=lambda each: each[1]["0.5"]["value"]):
            rows.append({"task": card["task"], "detector": name, "floor_m": floor, **moved, **BY})
    return rows


def shown() -> str:
    hazards = [{**row, **BY} for row in tasks.list_score_rows(tasks.stored_detector_cards())]
    page = render_page(
        "leaderboard.md.j2",
        spoofers=SPOOFERS.markdown(list_spoofers()),
        detectors=DETECTORS.markdown(list_detectors()),
        hazards=HAZARDS.markdown(hazards) if hazards else "",
        suite=get_task("S1").suite,
        missing=tasks.missing(),
    )
    return fit_tables(page)


if __name__ == "__main__":
    put_between(PAGE, START, END, shown())
