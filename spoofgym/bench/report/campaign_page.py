"""Page of a campaign: verdict in words, drawings, tables, and its worst run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import compress
from typing import Any

import numpy as np

from ...policies.card import SPOOFER
from ..experiments.campaign import CampaignResults
from ..experiments.suite import Suite
from ..runs.episode import play_episode
from ..runs.players import PlayerSpec
from ..runs.record import MEASURES, Aim
from ..scores.campaign import CONTROLS, HALF, STEALTHY, extract_name, headline, score_hazard
from ..scores.statistics import exceedance
from . import figures, page
from .campaign import (
    ATTACKS,
    CLEAN,
    COMPARISONS,
    DETECTORS,
    EXACTLY,
    INTEGRITY,
    KNOWLEDGE,
    FalseAlarmGroup,
    Row,
    attack_of_suite,
    attack_rows,
    detector_rows,
    exact_rows,
    groups,
    integrity_rows,
    known_spoofers,
    list_notes,
    select_reach,
)
from .table import in_percent, interval, metres, percent

FEW = 4  # curves that are drawn with their bands
WORST = "worst attack, 50 %"
AT_BUDGET = (
    "The amplitude is that at which exactly this share of the evaluation runs alarms. The "
    "intervals include its fit and the spread of the threshold, which clean runs set. The "
    "strongest is chosen on one half of the runs, scored on the other, and may lie below the best."
)


def build_page(results: CampaignResults, summary: Row, replay: Row | None = None) -> page.Page:
    """Report of a campaign; `replay`: its worst run, as `record_replay` has it."""
    found = groups(summary)
    shown = [group.title if len(found) > 1 else "" for group in found]
    parts = list(zip(found, shown, strict=True))
    return page.Page(
        title=f"Campaign: {summary['scenario']}",
        verdict=write_campaign_verdict(results.config, summary),
        missing=summary["missing"],
        pictures=[x for part in parts for x in list_campaign_pictures(results, summary, *part)],
        sheets=[
            *(x for part in parts for x in list_sheets(summary, *part)),
            page.Sheet("Compared with the controls", COMPARISONS, summary["comparisons"], "", True),
            page.Sheet("Spoofers", KNOWLEDGE, [*known_spoofers(summary).items()], "", True),
        ],
        notes=[*results.config["notes"], *list_notes(summary)],
        replay=replay,
        played=[("campaign", summary["campaign"]), *page.list_played_settings(results.store)],
        scores=summary,
    )


def write_campaign_verdict(config: Mapping[str, Any], summary: Row) -> list[str]:
    """What a campaign has found, in words."""
    lines = []
    for group in groups(summary):
        rows = [
            row
            for row in detector_rows(summary, group)
            if extract_name(row["detector"]) not in CONTROLS and select_reach(row) is not None
        ]
        rows.sort(key=lambda row: select_reach(row)["value"])  # type: ignore[index]
        if group.rate and rows:
            best, worst = (_describe_reach(summary, row) for row in (rows[0], rows[-1]))
            lines.append(f"{group.title.capitalize()}, {rows[0]['detector']} detects best: {best}")
            if len(rows) > 1:
                lines.append(f"{rows[-1]['detector']} lets most through: {worst}")
        elif rows:
            lines.append("Rates of false alarms at nominal thresholds differ: no comparison.")
            lines += [f"{row['detector']}: {_describe_reach(summary, row)}" for row in rows[:4]]
        marks: dict[str, list[str]] = {}
        for row in rows:
            for mark in (each for each in row["mark"].split("; ") if each not in ("", "-")):
                marks.setdefault(mark, []).append(row["detector"])
        lines += [f"{mark.capitalize()}: {', '.join(names)}." for mark, names in marks.items()]
    attack_s = config["timeline"]["attack_s"]
    sure = f"Attacks of {attack_s:g} s, {summary['runs']} runs each; in brackets 95 % intervals."
    return [*lines, f"{sure} Another attack may reach more."]


def _describe_reach(summary: Row, row: Row) -> str:
    half, few = (headline(row["protection"], share) for share in (0.5, 0.05))
    floor = row["bracket"]["floor_m"][HALF if half else STEALTHY]
    limits = "" if floor is None else f"; a perfect detector would still allow {metres(floor)} m"
    if half is None or few is None:
        best = row["bracket"]["best_attack"]
        return f"{best['spoofer']} displaces by {interval(best)} m within the budget{limits}."
    limit_m = summary["alert_limit_m"]
    hazard = [
        f", and beyond the alert limit of {limit_m:g} m in {percent(each)} %"
        for each in row["protection"]["p_hmi"]
        if (each["measure"], each["alert_limit_m"]) == (MEASURES[0], limit_m)
    ]
    return (
        f"attack {attack_of_suite(half)} displaces by {interval(half)} m in half of the runs "
        f"before any alarm, by {interval(few)} m in 5 % of them{''.join(hazard)}{limits}."
    )


def list_campaign_pictures(
    results: CampaignResults, summary: Row, group: FalseAlarmGroup, title: str
) -> list[page.Picture]:
    """Drawings of the detectors at one rate of false alarms."""
    rows, limit_m = detector_rows(summary, group), summary["alert_limit_m"]
    cells = group.rows([cell for cell in summary["cells"] if cell["spoofer"] != "none"])
    strongest: dict[str, Row] = {}
    for cell in sorted(cells, key=lambda each: each["stealthy_displacement_m"]["value"] or 0.0):
        strongest[cell["detector"]] = cell
    shown = [strongest[row["detector"]] for row in rows if row["detector"] in strongest]
    few, onset = len(shown) <= FEW, "time since the onset [s]"
    courses = [_course(results, cell, few) for cell in shown]
    curves = [x for row in rows if (x := _hazard(results, row, strongest, few)) is not None]
    missed = [_missed_dots(row, cells) for row in rows]
    survivals = [_survival(cell, few) for cell in shown if cell["survival"]]
    pictures = [
        picture_displacements(summary, group),
        page.Picture(
            "Displacement against time",
            "Median of the induced error under the strongest attack on each detector; X: half "
            "of the runs have alarmed.",
            figures.draw_lines(courses, onset, "induced error [m]", log="y"),
        ),
        page.Picture(
            "P(HMI) against alert limit",
            "Share of the runs in which the worst attack at each alert limit exceeds it with "
            "no alarm up to the time to alert after it.",
            figures.draw_lines(curves, "alert limit [m]", figures.HAZARD, log="x", limit_m=limit_m),
        ),
        page.Picture(
            "Missed within the time to alert",
            "Of the runs whose error crosses the alert limit; no mark where none does.",
            figures.draw_dots(missed, f"missed [% of the runs beyond {limit_m:g} m]", log=False),
            figures.dots_height(missed),
        ),
        page.Picture(
            "Still undetected",
            "Kaplan-Meier estimate under the strongest attack on each detector.",
            figures.draw_lines(survivals, onset, "attacks undetected [share]"),
        ),
    ]
    crossed = any(dot.estimate["value"] is not None for row in missed for dot in row.dots)
    there = bool(cells), bool(courses), bool(curves), crossed, bool(survivals)
    tail = f", {title}" if title else ""
    return [x._replace(title=x.title + tail) for x in compress(pictures, there)]


def picture_displacements(summary: Row, group: FalseAlarmGroup) -> page.Picture:
    """How far every attack gets against the detectors at one rate of false alarms."""
    cells = group.rows([cell for cell in summary["cells"] if cell["spoofer"] != "none"])
    dots = [_displacement_dots(row, cells) for row in detector_rows(summary, group)]
    return page.Picture(
        "Undetected displacement",
        "Stealthy displacement of every attack (hollow: over budget), and what the worst one "
        "exceeds in 50 % of the runs. Grey: floor and zero-alarm bound, where known.",
        figures.draw_dots(dots, "displacement [m]", limit_m=summary["alert_limit_m"]),
        figures.dots_height(dots),
    )


def _displacement_dots(row: Row, cells: Sequence[Row]) -> figures.DotRow:
    dots = [
        figures.Dot(
            cell["spoofer"],
            cell["stealthy_displacement_m"],
            cell["within_budget"] and cell["tuned_within_budget"] is not False,
        )
        for cell in cells
        if cell["detector"] == row["detector"]
    ]
    if (half := headline(row["protection"], 0.5)) is not None:
        dots.append(figures.Dot(WORST, half))
    bracket = row["bracket"]
    ends = bracket["floor_m"][STEALTHY], bracket["zero_alarm"]["value"]
    low, high = (x if isinstance(x, float | int) else None for x in ends)
    return figures.DotRow(row["detector"], dots, (low, high))


def _missed_dots(row: Row, cells: Sequence[Row]) -> figures.DotRow:
    own = [cell for cell in cells if cell["detector"] == row["detector"]]
    return figures.DotRow(
        row["detector"], [figures.Dot(x["spoofer"], in_percent(x["missed"])) for x in own]
    )


def _line(cell: Row, x: Any, y: Any, band: Any, few: bool, end: int | None = None) -> figures.Line:
    grey = extract_name(cell["detector"]) in CONTROLS
    label = f"{cell['detector']}: {cell['spoofer']}"
    return figures.Line(label, x, y, band if few else None, grey, end)


def _course(results: CampaignResults, cell: Row, few: bool) -> figures.Line:
    record = results.runs(cell["detector"], cell["spoofer"])
    assert record is not None  # it has been scored
    error = {k: np.maximum(x, figures.SMALLEST_M) for k, x in record.series["error_m"].items()}
    alarmed = np.asarray(record.series["alarmed"]) >= 0.5
    end = int(alarmed.argmax()) if alarmed.any() else None
    band = error["p05"], error["p95"]
    return _line(cell, record.series["time_s"], error["p50"], band, few, end)


def _hazard(
    results: CampaignResults, row: Row, strongest: Mapping[str, Row], few: bool
) -> figures.Line | None:
    """P(HMI) of the worst attack at every limit, or of the strongest one without a suite."""
    label, found = row["detector"], results.protection(row["detector"])
    grey = extract_name(label) in CONTROLS
    if found is not None:
        worst = partial(score_hazard, found, MEASURES[0])
        return figures.make_hazard_curve(label, worst, few=few, grey=grey)
    if label not in strongest:
        return None
    record = results.runs(label, strongest[label]["spoofer"])
    assert record is not None  # it has been scored
    moved = record.displacement_m[record.counts]
    score = lambda limit: exceedance(moved, [limit])[0].as_json()  # noqa: E731
    return figures.make_hazard_curve(f"{label}: {record.spoofer}", score, few=few, grey=grey)


def _survival(cell: Row, few: bool) -> figures.Line:
    x, y, low, high = (
        [start, *(each[key] for each in cell["survival"])]
        for key, start in (("time_s", 0.0), ("share", 1.0), ("low", 1.0), ("high", 1.0))
    )
    return _line(cell, x, y, (low, high), few)


def list_sheets(summary: Row, group: FalseAlarmGroup, title: str) -> list[page.Sheet]:
    """Tables of the detectors at one rate of false alarms."""
    levels = integrity_rows(summary, group)
    tail = f" {title}" if title else ""
    exact = f"At exactly {100 * summary['budget']:g} % alarms{tail}"
    return [
        page.Sheet(f"Detectors {group.title}", DETECTORS, detector_rows(summary, group)),
        page.Sheet(f"Stealthy attacks{tail}", ATTACKS, attack_rows(summary, group), "", True),
        page.Sheet(exact, EXACTLY, exact_rows(summary, group), AT_BUDGET, True),
        page.Sheet(
            f"Price of the detectors{tail}", CLEAN, group.rows(summary["detectors"]), "", True
        ),
        page.Sheet(f"Protection level{tail}", INTEGRITY, levels, "", True),
    ]


def choose_worst_run(results: CampaignResults, summary: Row) -> tuple[str, str, Any, int] | None:
    """Detector that detects best, label and settings of the worst attack on it, and the run in
    which that gets farthest; None where there is no attack."""
    rows = [row for group in groups(summary) for row in detector_rows(summary, group)]
    rows = [row for row in rows if select_reach(row) is not None]
    own = [row for row in rows if extract_name(row["detector"]) not in CONTROLS] or rows
    if not own:
        return None
    detector = min(own, key=lambda row: select_reach(row)["value"])  # type: ignore[index]
    label, found = detector["detector"], results.protection(detector["detector"])
    if found is not None:
        winner = found.worst(Aim(MEASURES[0], 0.5))
        moved = np.where(found.counts, winner.displacement[MEASURES[0]], -1.0)
        return label, winner.spoofer, winner.spec, int(moved.argmax())
    record = results.runs(label, detector["bracket"]["best_attack"]["spoofer"])
    assert record is not None  # it has been scored
    moved = np.where(record.counts, record.displacement_m, -1.0)
    return label, record.spoofer, record.head["spoofer_settings"], int(moved.argmax())


def replay_worst(suite: Suite, results: CampaignResults, summary: Row) -> None:
    """Play the worst run again, and store it, unless it is stored already."""
    worst = choose_worst_run(results, summary)
    if worst is None or page.load_replay(results.store) is not None:
        return
    label, spoofer, spec, run = worst
    (detector,) = (each for each in suite.detector_players if each.label == label)
    player = PlayerSpec(spoofer, SPOOFER, spec)
    episode = play_episode(suite.world, detector, player, run, suite.entropy)
    page.store_replay(results.store, page.record_replay(episode, summary["alert_limit_m"]))
