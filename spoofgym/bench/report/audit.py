"""The screens that audits of detectors and spoofers end with: 40 lines of 100 columns at most."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ..scores.audit import Audit, format_age
from ..scores.campaign import CONTROLS, extract_name
from ..scores.scores import SHARES
from .campaign import OVER, bound_text, shorten_label
from .table import Table, format_number, interval, metres, percent, render_template

LINES, WIDTH = 39, 100
LABEL = 34  # characters of the first column
Row = dict[str, Any]
REFERENCES = ("open-loop", "accelerating-ramp")
"""Attacks that a spoofer is compared with."""
HALF, FEW = (f"{share:g}" for share in SHARES)
WIDTHS = (26, 8, 22, 8, 13, 13)
"""Of the columns of a spoofer's screen."""


def format_screen(audit: Audit) -> list[str]:
    """Lines of the screen, without the answer."""
    found = audit.as_dict()
    lines = [*_figures(found), "", *_wrap(_ages(found))]
    lines += [""] if found["warnings"] else []
    for text in found["warnings"]:
        lines += _wrap(text, "! ")
    if len(lines) > LINES:
        lines = [*lines[: LINES - 1], "... the rest is in --json"]
    return lines


def _wrap(text: str, bullet: str = "") -> list[str]:
    indent = " " * max(len(bullet), 2)
    lines = textwrap.wrap(text, WIDTH, initial_indent=bullet, subsequent_indent=indent)
    return [line.replace("\xa0", " ") for line in lines]


def _figures(found: Row) -> list[str]:
    """Figures and families, these by their P(HMI)."""
    ranked = sorted(found["families"], key=lambda each: -(each["p_hmi"]["value"] or 0.0))
    texts = [
        f"  {each['family'] + '*' * each['held_out']:<20}{percent(each['p_hmi'], 0)}"
        for each in ranked
    ]
    values = {**found, "ranked": texts, "bound": _bound(found["zero_alarm"])}
    return [x.rstrip()[:WIDTH] for x in render_template("screen.txt.j2", values).splitlines()]


def _bound(bound: dict[str, Any] | None) -> str:
    if bound is None:
        return "not looked for: needs the family open-loop"
    value = bound["restricted_m"] or bound["free_m"]
    if value is None:
        reason = bound.get("reason", bound["why"])
        return f"not known ({textwrap.shorten(reason, WIDTH - LABEL - 12, placeholder=' ...')})"
    return value if isinstance(value, str) else f"{format_number(value)} m in the mean"


def _ages(found: dict[str, Any]) -> str:
    ages = found["ages"]
    pairs = zip(ages["age_s"], ages["found"], strict=True)
    shown = (
        f"{format_age(age)} {'-' if (x := each['value']) is None else f'{100 * x:.0f} %'}".replace(
            " ", "\xa0"
        )
        for age, each in pairs
    )
    return f"test ramps found, by the time from switch-on to the onset: {', '.join(shown)}"


def print_audits(
    screens: Sequence[Sequence[str]], reports: Sequence[Path], answers: Sequence[str]
) -> None:
    """Print a screen of each audit, and the answers last."""
    for each in screens:
        print("\n".join(each), end="\n\n")
    for path in reports:
        print(f"Report: {path}")
    print(*answers, sep="\n")


def write_spoofer_audit(summary: Row, spoofer: str, task: str, budget: str) -> Row:
    """Audit of a spoofer by a campaign, JSON-able: a row for each detector, with what it and the
    usual attacks exceed at the alarm budget. Its answer is that against the detector that holds it
    tightest, controls apart."""
    cells = {(cell["detector"], cell["spoofer"]): cell for cell in summary["cells"]}
    others = dict.fromkeys(name for _, name in cells if name not in ("none", spoofer))
    rows = []
    for row in summary["detectors"]:
        label, own = row["detector"], cells[row["detector"], spoofer]
        rows.append(
            {
                **{key: row[key] for key in ("detector", "false_alarms_per_hour")},
                **{key: own[key] for key in ("exceeded_m", "alarm_rate")},
                "within_budget": own["within_budget"] and own["tuned_within_budget"] is not False,
                "others": {extract_name(x): cells[label, x]["exceeded_m"] for x in others},
                "zero_alarm": row["bracket"]["zero_alarm"],
            }
        )
    floor = (summary["limits"]["floor"] or {}).get("floor_m")
    counted = [row for row in rows if extract_name(row["detector"]) not in CONTROLS] or rows
    known = [row for row in counted if row["exceeded_m"][HALF]["value"] is not None]
    answer = f"{spoofer}: no score, as no run is silent without an attack"
    if known:
        best = min(known, key=lambda row: row["exceeded_m"][HALF]["value"])
        beside = [f"{x} {metres(found[HALF]['value'])} m" for x, found in best["others"].items()]
        beside += [f"a perfect detector allows {metres(floor['half']['value'])} m"] if floor else []
        answer = (
            f"{spoofer}: {interval(best['exceeded_m'][HALF])} m in half of the runs of the "
            f"tightest of {len(counted)} detectors, {shorten_label(best['detector'])}, at "
            f"{100 * summary['budget']:g} % of alarms{'' if best['within_budget'] else OVER} "
            f"({', '.join(beside)})"
        )
    plain = {key: summary[key] for key in ("runs", "entropy", "alert_limit_m")}
    names = {"side": "spoofer", "spoofer": spoofer, "task": task, "budget": budget}
    return {**names, **plain, "floor_m": floor, "detectors": rows, "answer": answer}


def _both_exceeded(name: str, row: Row) -> str:
    return ", ".join(metres(row["others"][name][part]["value"]) for part in (HALF, FEW))


def format_reach(audit: Row) -> list[str]:
    """Lines of a spoofer's screen, without the answer."""
    rows, floor = audit["detectors"], audit["floor_m"]
    table = Table(
        ("detector", lambda row: shorten_label(row["detector"]).replace(",", ", ")),
        ("false alarms /h", lambda row: metres(row["false_alarms_per_hour"]["value"])),
        (
            "in 50 % of runs [m]",
            lambda row: interval(row["exceeded_m"][HALF]) + ("" if row["within_budget"] else OVER),
        ),
        ("in 5 % [m]", lambda row: metres(row["exceeded_m"][FEW]["value"])),
        *((f"{name} 50, 5 %", partial(_both_exceeded, name)) for name in rows[0]["others"]),
    )
    widths = WIDTHS[: 4 + len(rows[0]["others"])]
    ends = [metres(floor[name]["value"]) for name in ("half", "few")] if floor else []
    limits = "{} m in 50 %, {} m in 5 % of runs".format(*ends) if ends else "not known"
    bounds = [(row["detector"], bound_text(row["zero_alarm"], "")) for row in rows]
    known = [f"{text} m against {shorten_label(name)}" for name, text in bounds if text]
    return [
        f"{audit['spoofer']} in {audit['task']}: {audit['runs']} runs, fitted to each detector's "
        f"alarms ({audit['budget']}, seed {audit['entropy']})",
        "",
        *(line for row in (None, *rows) for line in table.lines(row, widths)),
        "",
        f"a perfect detector allows: {limits}",
        f"no attack without alarm exceeds: {', '.join(known) or 'not known'}",
    ]
