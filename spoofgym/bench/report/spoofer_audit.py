"""What a spoofer does to the detectors of the standard suite, beside the usual attacks."""

from __future__ import annotations

from typing import Any

from ..scores.campaign import CONTROLS, extract_name
from .campaign import OVER, bound_text, shorten_label
from .table import Table, format_number, interval, metres

Row = dict[str, Any]
REFERENCES = ("open-loop", "accelerating-ramp")
"""Attacks that a spoofer is compared with."""
PARTS = ("0.5", "0.05")
"""Of the runs, as keys of what is exceeded in them."""
WIDTHS = (26, 8, 22, 8, 13, 13)
"""Of the columns of the screen."""


def list_reach(summary: Row, spoofer: str) -> list[Row]:
    """A row for each detector of a campaign: false alarms, and what a spoofer and the usual attacks
    exceed at the alarm budget."""
    cells = {(cell["detector"], cell["spoofer"]): cell for cell in summary["cells"]}
    others = [name for _, name in cells if name not in ("none", spoofer)]
    rows = []
    for row in summary["detectors"]:
        own = cells[row["detector"], spoofer]
        rows.append(
            {
                "detector": row["detector"],
                "false_alarms_per_hour": row["false_alarms_per_hour"],
                "exceeded_m": own["exceeded_m"],
                "alarm_rate": own["alarm_rate"],
                "within_budget": own["within_budget"] and own["tuned_within_budget"] is not False,
                "others": {
                    extract_name(x): cells[row["detector"], x]["exceeded_m"] for x in others
                },
                "zero_alarm": row["bracket"]["zero_alarm"],
            }
        )
    return rows


def write_spoofer_audit(summary: Row, spoofer: str, task: str, budget: str) -> Row:
    """Audit of a spoofer in a task, JSON-able; its answer is that against the detector that holds
    it tightest, controls apart."""
    rows, floor = list_reach(summary, spoofer), (summary["limits"]["floor"] or {}).get("floor_m")
    own = [row for row in rows if extract_name(row["detector"]) not in CONTROLS] or rows
    known = [row for row in own if row["exceeded_m"]["0.5"]["value"] is not None]
    answer = f"{spoofer}: no score, as no run is silent without an attack"
    if known:
        best = min(known, key=lambda row: row["exceeded_m"]["0.5"]["value"])
        beside = [f"{x} {_value(found, '0.5')} m" for x, found in best["others"].items()]
        limit = floor and f"a perfect detector allows {metres(floor['half']['value'])} m"
        answer = (
            f"{spoofer}: {interval(best['exceeded_m']['0.5'])} m in half of the runs of the "
            f"tightest of {len(own)} detectors, {shorten_label(best['detector'])}, at "
            f"{100 * summary['budget']:g} % of alarms{'' if best['within_budget'] else OVER} "
            f"({', '.join([*beside, *([limit] if limit else [])])})"
        )
    plain = {key: summary[key] for key in ("runs", "entropy", "alert_limit_m")}
    names = {"side": "spoofer", "spoofer": spoofer, "task": task, "budget": budget}
    return {**names, **plain, "floor_m": floor, "detectors": rows, "answer": answer}


def _value(found: Row, part: str) -> str:
    return "-" if (x := found[part]["value"]) is None else format_number(x)


def format_reach(audit: Row) -> list[str]:
    """Lines of the screen, without the answer."""
    rows, floor = audit["detectors"], audit["floor_m"]
    others = [*rows[0]["others"]]
    table = Table(
        ("detector", lambda row: shorten_label(row["detector"]).replace(",", ", ")),
        ("false alarms /h", lambda row: metres(row["false_alarms_per_hour"]["value"])),
        (
            "in 50 % of runs [m]",
            lambda row: interval(row["exceeded_m"]["0.5"]) + ("" if row["within_budget"] else OVER),
        ),
        ("in 5 % [m]", lambda row: _value(row["exceeded_m"], "0.05")),
        *(
            (
                f"{name} 50, 5 %",
                lambda row, name=name: ", ".join(_value(row["others"][name], x) for x in PARTS),
            )
            for name in others
        ),
    )
    lines = [line for row in (None, *rows) for line in table.lines(row, WIDTHS[: 4 + len(others)])]
    limits = "a perfect detector allows: not known"
    if floor:
        ends = (metres(floor[name]["value"]) for name in ("half", "few"))
        limits = "a perfect detector allows {} m in 50 %, {} m in 5 % of runs".format(*ends)
    bounds = [(row["detector"], bound_text(row["zero_alarm"], "")) for row in rows]
    known = [f"{text} m against {shorten_label(name)}" for name, text in bounds if text]
    return [
        f"{audit['spoofer']} in {audit['task']}: {audit['runs']} runs, fitted to each detector's "
        f"alarms ({audit['budget']}, seed {audit['entropy']})",
        "",
        *lines,
        "",
        limits,
        f"no attack without alarm exceeds: {', '.join(known) or 'not known'}",
    ]
