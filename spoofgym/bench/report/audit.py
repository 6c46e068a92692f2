"""The screen that an audit ends with: at most 40 lines of 100 columns, then report and answer."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..scores.audit import Audit, format_age
from ..scores.scores import SHARES
from .table import format_number, interval, percent

LINES, WIDTH = 39, 100
LABEL, VALUE = 34, 40  # characters of the first two columns
NO_REFERENCE = "no score of a non-learned detector is stored for this task"
BY = {"audit": "by the same families", "campaign": "in a campaign"}
"""Where a reference's figures come from."""


def format_screen(audit: Audit) -> list[str]:
    """Lines of the screen, without the answer."""
    found = audit.as_dict()
    lines = [line[:WIDTH] for line in (*_head(found), *_figures(found), *_families(found), "")]
    lines += _wrap(_ages(found))
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


def _head(found: dict[str, Any]) -> Iterator[str]:
    yield f"{found['task']}: {found['title']}"
    yield (
        f"{found['detector']}: {found['runs']} runs of each of {len(found['families'])} families, "
        f"chosen on {found['selection_runs']} ({found['budget']}, seed {found['entropy']})"
    )
    yield ""


def _figures(found: dict[str, Any]) -> Iterator[str]:
    reference, floor = found["reference"], found["floor_m"]
    beside = "" if reference is None else "best non-learned"
    yield _row("", "this detector", beside)
    requested = found["requested_per_hour"]
    measured = interval(found["false_alarms_per_hour"])
    yield _row(
        "false alarms an hour",
        measured + (", as published" if requested is None else f", requested {requested:g}"),
    )
    worst = found["worst_in_half"], found["worst_in_few"]
    for share, family in zip(SHARES, worst, strict=True):
        each = found["exceeded_m"][f"{share:g}"]
        stored = "" if reference is None else interval(reference["exceeded_m"][f"{share:g}"])
        yield _row(
            f"exceeded in {100 * share:g} % of runs [m]", f"{interval(each)} {family}", stored
        )
    limits = "not known"
    if floor is not None:
        ends = (format_number(floor[name]["value"] or 0.0) for name in ("half", "few"))
        limits = "{} in 50 %, {} in 5 % of runs".format(*ends)
    yield _row("a perfect detector allows [m]", limits)
    yield _row("no attack without alarm exceeds", _bound(found["zero_alarm"]))
    missed = percent(found["ages"]["missed"])
    yield _row("missed within the time to alert", f"{missed} % of test ramps")
    yield _row("time for an epoch of a receiver", f"{found['cost_us']:.2g} us")
    if reference is None:
        yield f"best non-learned: {NO_REFERENCE}"
    else:
        yield f"best non-learned: {reference['detector']}, {BY[reference['by']]}"
    yield ""


def _row(label: str, value: str, other: str = "") -> str:
    return f"{label:<{LABEL}}{value:<{VALUE}}{other}".rstrip()


def _bound(bound: dict[str, Any] | None) -> str:
    if bound is None:
        return "not looked for: needs the family open-loop"
    value = bound["restricted_m"] or bound["free_m"]
    if value is None:
        return textwrap.shorten(f"not known: {bound['why']}", WIDTH - LABEL, placeholder=" ...")
    return value if isinstance(value, str) else f"{format_number(value)} m in the mean"


def _families(found: dict[str, Any]) -> Iterator[str]:
    ranked = sorted(found["families"], key=lambda each: -(each["p_hmi"]["value"] or 0.0))
    limit = found["alert_limit_m"]
    yield f"P(HMI) at {limit:g} m by family [%], * of those held out from training"
    texts = [
        f"  {each['family'] + '*' * each['held_out']:<20}{percent(each['p_hmi'], 0)}"
        for each in ranked
    ]
    half = (len(texts) + 1) // 2
    for k in range(half):
        yield f"{texts[k]:<48}{''.join(texts[k + half : k + half + 1])}".rstrip()


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
