"""Tables of a campaign.

A table never compares detectors at different rates of false alarms: there is one for each rate, and
what is played with nominal thresholds comes by name, without a comparison.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

from ...detectors.calibrated import NOISY_WARMUP
from ...spoofers.base import sees_statistics
from ..experiments.campaign import CampaignResults
from ..runs.record import MEASURES, STANFORD
from ..scores import campaign as scoring
from ..scores.statistics import Estimate
from ..search.attack_suite import ORACLES
from .table import Table, format_number, interval, metres, percent, render_template, share, yes_no

Row = dict[str, Any]
ORACLE = " (oracle)"
"""Behind the name of a spoofer that sees the detector's statistics, impossible in practice."""
HIDDEN_SETTINGS = {"name", "heading_deg", "label", "designed_on", "file"}
"""Settings that a table leaves out: they are in other columns, or in the results only."""
OVER, NONE_WITHIN = ", over budget", " (none within the budget)"
STRONGEST = "the strongest of these"
ABOVE_BOUND = ", above the zero-alarm bound"


class FalseAlarmGroup(NamedTuple):
    """Detectors at one rate of false alarms an hour; ``""`` for nominal thresholds."""

    rate: str
    detectors: list[str]

    @property
    def title(self) -> str:
        if not self.rate:
            return "with nominal thresholds, whose rates of false alarms differ"
        return f"at {self.rate} false alarms an hour"

    def rows(self, rows: list[Row]) -> list[Row]:
        """Rows of these detectors, in their order."""
        order = {label: k for k, label in enumerate(self.detectors)}
        own = (row for row in rows if row["detector"] in order)
        return sorted(own, key=lambda row: order[row["detector"]])


def groups(summary: Row) -> list[FalseAlarmGroup]:
    """Detectors by table: one table for each rate of false alarms, and one for thresholds as
    published. A detector that never alarms is in the table of every rate."""
    footing = {row["detector"]: row["footing"] for row in summary["detectors"]}
    rates = sorted(
        {rate for rate in footing.values() if rate not in (scoring.NOMINAL, scoring.ANY_RATE)},
        key=float,
    )
    free = [label for label, rate in footing.items() if rate == scoring.ANY_RATE]
    found = [
        FalseAlarmGroup(
            rate, [label for label, own in footing.items() if own in (rate, scoring.ANY_RATE)]
        )
        for rate in rates
    ]
    nominal = [label for label, rate in footing.items() if rate == scoring.NOMINAL]
    if nominal or not found:
        found.append(FalseAlarmGroup("", sorted([*nominal, *([] if found else free)])))
    return [group for group in found if group.detectors]


def _format_claim(claimed: Row) -> str:
    tail = ", fitted tail" if claimed["extrapolated"] else ""
    return f"{100 * claimed['per_run']:.3g}, {claimed['false_alarms_per_hour']:g}{tail}"


def _select_headline(share: float, skies: bool = False) -> Any:
    return lambda row: scoring.headline(row["protection"], share, skies=skies)


def attack_of_suite(row: Row) -> str:
    """Letter and spoofer of an attack of the suite, with a mark where the spoofer is an oracle."""
    return f"({row['letter']}) {row['spoofer']}{ORACLE if row['letter'] in ORACLES else ''}"


def _optimum(reached: Row) -> str:
    if reached["tuned_within_budget"] is False:
        return interval(reached) + NONE_WITHIN
    return interval(reached) + ("" if reached["within_budget"] else OVER)


def bound_text(bound: Row, unknown: str = "none") -> str:
    """Zero-alarm bound, ``<=`` before an upper one; `unknown` if absent."""
    sign = "<= " if bound["kind"] == "upper" else ""
    return unknown if bound["value"] is None else sign + metres(bound["value"])


def format_bound(bracket: Row) -> str:
    """Zero-alarm bound; ``none`` if it is known not to exist."""
    bound = bracket["zero_alarm"]
    return bound_text(bound, "none" if bound["why"] else "-")


DETECTORS = Table(
    ("detector", "detector"),
    ("claimed: % of runs, per hour", "claimed", _format_claim),
    ("measured: % of runs", "false_alarm_per_run", percent),
    ("measured: per hour", "false_alarms_per_hour", interval),
    ("floor of 50 % [m]", lambda row: row["bracket"]["floor_m"][scoring.HALF], format_number),
    ("exceeded in 50 % [m]", _select_headline(0.5), interval),
    ("in 5 % [m]", _select_headline(0.05), interval),
    ("worst skies, in 50 % [m]", _select_headline(0.5, skies=True), interval),
    (
        "worst attack",
        _select_headline(0.5),
        lambda row: f"{attack_of_suite(row)}, {row['setting']}={row['at']:g}",
    ),
    ("floor, stealthy [m]", lambda row: row["bracket"]["floor_m"][scoring.STEALTHY], format_number),
    ("optimized open-loop attack [m]", lambda row: row["bracket"]["open_loop"], _optimum),
    ("zero-alarm bound [m]", "bracket", format_bound),
    ("mark", "mark"),
)


def detector_rows(summary: Row, group: FalseAlarmGroup) -> list[Row]:
    """Rows of `DETECTORS`: those of the summary, with protection and mark."""
    protections = {row["detector"]: row for row in summary["protection"]}
    return [
        {
            **row,
            "protection": protections.get(row["detector"]),
            "mark": mark_detector(summary, row["detector"])
            if group.rate
            else "; ".join(list_bound_marks(row["bracket"])) or "-",
        }
        for row in group.rows(summary["detectors"])
    ]


def list_bound_marks(bracket: Row) -> list[str]:
    """What the bracket says of a detector's row."""
    marks = []
    if bracket["search_failed"]:
        marks.append(f"search failed: {', '.join(bracket['search_failed'])}")
    if bracket["above_zero_alarm"]:
        names = ", ".join(each["spoofer"] for each in bracket["above_zero_alarm"])
        marks.append(f"above the zero-alarm bound: {names}")
    return marks


def list_uncovered(summary: Row) -> list[str]:
    """Which detectors have no protection level for the attack's length, and why."""
    return [
        f"{row['detector']}: {row['protection_level']['why']}"
        for row in summary["detectors"]
        if "why" in row.get("protection_level", {})
    ]


def mark_detector(summary: Row, detector: str) -> str:
    """Remarks on a detector: where it is worse than a control, no better than `never`, alarms
    before the onset in many runs or above its claim; where a search has failed, or is above the
    bound."""
    (row,) = (row for row in summary["detectors"] if row["detector"] == detector)
    if scoring.extract_name(detector) in scoring.CONTROLS:
        return "; ".join(["control", *list_bound_marks(row["bracket"])])
    compared = [each for each in summary["comparisons"] if each["detector"] == detector]
    where = dict.fromkeys(_name_comparison(each) for each in compared if each["above"])
    marks = [f"worse than chance: {'; '.join(where)}"] if where else []
    own = (each for each in compared if each["spoofer"] is None)
    worst = [each["below"] for each in own if each["control"] == "never"]
    if worst and not any(worst):
        marks.append("no better than never")
    early = (row["claimed"] or {}).get("warmup_alarms", 0.0)
    if early > NOISY_WARMUP:
        marks.append(f"alarms before the onset in {100 * early:.0f} % of clean runs")
    measured, claimed = row["false_alarms_per_hour"], row["claimed"]
    if claimed and (measured["low"] or 0.0) > claimed["false_alarms_per_hour"]:  # beyond chance
        rates = f"{interval(measured)} an hour, claimed {claimed['false_alarms_per_hour']:g}"
        marks.append(f"false alarms above the claimed rate: {rates}")
    return "; ".join([*marks, *list_bound_marks(row["bracket"])])


def _name_comparison(row: Row) -> str:
    return row["score"] if row["spoofer"] is None else f"{row['score']}, {row['spoofer']}"


def format_spoofer(spoofer: str, knowledge: str) -> str:
    """Name of a spoofer in a table of several, marked where it is an oracle."""
    return spoofer + (ORACLE if sees_statistics(knowledge) else "")


def format_target(cell: Row) -> str:
    """Which detector a spoofer was made for, marked where here is another detector, receiver,
    scenario, timeline or attack; what the spoofer says of itself where that is all there is."""
    knowledge = cell["knowledge"]
    if knowledge["detector"] is None:
        return "-" if knowledge["design_time"] == "nothing" else str(knowledge["design_time"])
    transfer = knowledge["transfer"]
    mark = "" if not transfer else " (transfer)"
    if set(transfer) - {"detector"}:
        mark = f" (transfer: {', '.join(transfer)})"
    return f"{knowledge['detector']}{mark}"


def _settings(cell: Row) -> str:
    parts = [
        _setting(key, value)
        for key, value in cell["spoofer_settings"].items()
        if key not in HIDDEN_SETTINGS and value not in (None, [])
    ]
    mark = "" if cell["tuned_within_budget"] in {None, True} else NONE_WITHIN
    return (", ".join(parts) or "-") + mark


def _setting(key: str, value: Any) -> str:
    """One setting, short: of a list its length and range, of a digest its first letters."""
    if isinstance(value, float):
        return f"{key}={value:g}"
    if isinstance(value, list) and all(isinstance(item, int | float) for item in value):
        return f"{key}: {len(value)} from {min(value):.3g} to {max(value):.3g}"
    return f"{key}={str(value)[:8]}" if key == "sha256" else f"{key}={value}"


ATTACKS = Table(
    ("detector", "detector"),
    ("spoofer", lambda cell: format_spoofer(cell["spoofer"], cell["knowledge"]["run_time"])),
    ("made for", format_target),
    ("setting", _settings),
    (
        "P(alarm | silent twin) [%]",
        lambda cell: percent(cell["alarm_rate"]) + ("" if cell["within_budget"] else OVER),
    ),
    (
        "stealthy displacement [m]",
        lambda cell: interval(cell["stealthy_displacement_m"]) + cell["above"],
    ),
    ("in 50 % of runs [m]", lambda cell: cell["exceeded_m"]["0.5"], interval),
    ("in 5 % [m]", lambda cell: cell["exceeded_m"]["0.05"], interval),
    ("alarmed as 0 [m]", "alarmed_as_0_m", interval),
    ("missed [%]", "missed", percent),
    ("delay [s]", "delay_s", interval),
)


def _amplitude(found: Row) -> str:
    """Amplitude with its interval; its unit, and so its size, is that of any setting."""
    value, low, high = ("-" if found[k] is None else f"{found[k]:.4g}" for k in Estimate._fields)
    return f"{value} ({low} to {high})"


EXACTLY = Table(
    ("detector", "detector"),
    ("spoofer", lambda cell: format_spoofer(cell["spoofer"], cell["knowledge"]["run_time"])),
    ("amplitude or setting", lambda cell: cell["at_budget"].get("amplitude"), _amplitude),
    ("alarms there [%]", lambda cell: cell["at_budget"].get("alarm_rate"), share(1)),
    ("silent at any [%]", lambda cell: cell["at_budget"].get("silent_share"), share(1)),
    *(
        (f"{word} [m]", lambda cell, name=name: cell["at_budget"].get(name), interval)
        for word, name in zip(
            ("displacement", "vertical", "total error", "total vertical"), MEASURES, strict=True
        )
    ),
)
"""Attacks at exactly the alarm budget, with intervals that include the fit and the threshold."""


def exact_rows(summary: Row, group: FalseAlarmGroup) -> list[Row]:
    """Rows of `EXACTLY`: cells that were fitted to exactly the budget, and the strongest."""
    cells = [cell for cell in group.rows(summary["cells"]) if "at_budget" in cell]
    strongest = [
        {
            "detector": row["detector"],
            "spoofer": STRONGEST,
            "knowledge": {"run_time": ""},
            "at_budget": {MEASURES[0]: row["strongest_at_budget_m"]},
        }
        for row in group.rows(summary["detectors"])
        if "strongest_at_budget_m" in row
    ]
    return group.rows([*cells, *strongest])


def attack_rows(summary: Row, group: FalseAlarmGroup) -> list[Row]:
    """Rows of `ATTACKS`: cells, with a mark above the zero-alarm bound."""
    above = {
        (row["detector"], each["spoofer"])
        for row in summary["detectors"]
        for each in row["bracket"]["above_zero_alarm"]
    }
    return [
        {**cell, "above": ABOVE_BOUND if (cell["detector"], cell["spoofer"]) in above else ""}
        for cell in group.rows(summary["cells"])
        if cell["spoofer"] != "none"
    ]


CLEAN = Table(
    ("detector", "detector"),
    ("availability lost [%]", "false_alarm_per_epoch", partial(percent, digits=2)),
    ("runs with an alarm before the onset [%]", "warmup_alarm_per_run", percent),
    ("innocent satellites blamed [s an hour]", "blamed_s_per_hour", format_number),
    ("navigation error, RMS [m]", "navigation_rms_m", "{:.2f}".format),
    ("largest while coasting [m]", "coasting_error_m", format_number),
)
INTEGRITY = Table(
    ("detector", "detector"),
    (
        "protection level, median [m]",
        lambda row: row["protection_level"]["median_m"],
        format_number,
    ),
    *(
        (f"{name} [%]", lambda row, name=name: row["protection_level"][name], percent)
        for name in STANFORD
    ),
)
"""Stanford diagram of the clean runs."""


def integrity_rows(summary: Row, group: FalseAlarmGroup) -> list[Row]:
    """Rows of `INTEGRITY`: detectors that have a protection level for the attack's length."""
    rows = group.rows(summary["detectors"])
    return [row for row in rows if "median_m" in row.get("protection_level", {})]


KNOWLEDGE = Table(
    ("spoofer", itemgetter(0)),
    ("knows at run time", lambda row: row[1]["run_time"]),
    ("was designed on", lambda row: row[1]["design_time"]),
)
COMPARISONS = Table(
    ("score", _name_comparison),
    ("detectors", lambda row: f"{row['detector']} less {row['control']}"),
    (
        "difference [m]",
        lambda row: interval(row["difference_m"]) + (", above" if row["above"] else ""),
    ),
)


def known_spoofers(summary: Row) -> dict[str, Row]:
    return {cell["spoofer"]: cell["knowledge"] for cell in summary["cells"]}


ALARMS = (
    ("P(alarm | silent twin) [%]", "alarm_rate", share(1)),
    ("its upper limit [%]", "alarm_limit", share(1)),
)
"""Alarm rate of the runs that count, and the limit that is compared with the budget."""


def tuning_table(search: Row) -> Table:
    """Table of the trials of a search; a value that was tried on a few runs only is sifted."""

    def value(trial: Row) -> str:
        chosen = (trial["runs"], trial["value"]) == (search["runs"], search["value"])
        return f"{trial['value']:g}" + (" (chosen)" if chosen else "")

    return Table(
        (search["setting"], value),
        ("runs", "runs"),
        ("counted", "counted"),
        *ALARMS,
        ("stealthy displacement [m]", "stealthy_displacement_m", "{:.2f}".format),
        ("within budget", "within_budget", yes_no),
    )


def list_limit_notes(summary: Row) -> list[str]:
    """What the floors are, and under which assumptions they hold; or why they are absent."""
    lines = render_template("floor.txt.j2", {"summary": summary}).splitlines()
    return [line.removeprefix("- ") for line in lines]


def bound_notes(summary: Row) -> list[str]:
    """Which detectors have no zero-alarm bound, and why; one line for each reason."""
    labels: dict[str, list[str]] = {}
    for row in summary["detectors"]:
        bound = row["bracket"]["zero_alarm"]
        if bound["value"] is None and bound["why"]:
            labels.setdefault(bound["why"], []).append(row["detector"])
    return [f"{', '.join(names)}: {why}" for why, names in labels.items()]


def group_optima(summary: Row) -> dict[str, list[str]]:
    """Detectors by what their open-loop attacks were found by, and where a search found nothing."""
    labels: dict[str, list[str]] = {}
    for row in summary["detectors"]:
        optimum = row["bracket"]["open_loop"]
        if optimum is not None and optimum["by"] is not None:
            start = optimum["unbeaten_start"]
            text = f" (search found nothing better than the {start})" if start else ""
            labels.setdefault(optimum["by"], []).append(row["detector"] + text)
    return labels


def list_notes(summary: Row) -> list[str]:
    """Which limits there are, and how they were found, or why there are none."""
    return [
        *list_limit_notes(summary),
        *(f"No zero-alarm bound of {line}" for line in bound_notes(summary)),
        *(f"No protection level of {line}" for line in list_uncovered(summary)),
        *(
            f"Optimized open-loop attack by {by}: {', '.join(names)}"
            for by, names in group_optima(summary).items()
        ),
    ]


def print_campaign(summary: Row) -> None:
    for k, group in enumerate(groups(summary)):
        name = f"{summary['scenario']}, {group.title}"
        DETECTORS.print(f"{name}: detectors", detector_rows(summary, group))
        if k == 0:
            print(*list_notes(summary), "", sep="\n")
        if rows := attack_rows(summary, group):
            ATTACKS.print(f"{name}: stealthy attacks", rows, names=2)
        if rows := exact_rows(summary, group):
            EXACTLY.print(f"{name}: at exactly {100 * summary['budget']:g} % alarms", rows, names=2)
        CLEAN.print(f"{name}: price", group.rows(summary["detectors"]))
        if rows := integrity_rows(summary, group):
            INTEGRITY.print(f"{name}: protection level", rows)
    if summary["missing"]:
        print(f"not finished: {', '.join(summary['missing'])}")


def print_search(search: Row) -> None:
    """Print what was tried to fit a spoofer to the alarm budget."""
    tuning_table(search).print(
        f"{search['spoofer']} against {search['detector']}: P(alarm | silent twin) for a budget of "
        f"{100 * search['budget']:g} %, on the {search['counted']} of {search['runs']} runs that "
        "count; fewer only sift",
        search["trials"],
    )
    if not search["within_budget"]:
        print(f"nothing is within the budget; the smallest value is {search['value']:g}")


def shorten_label(detector: str) -> str:
    """Label of a detector without the rate of false alarms, which the report has."""
    return re.sub(r"\(false_alarms_per_hour=[^,)]*\)|, ?false_alarms_per_hour=[^,)]*", "", detector)


WORST = Table(
    ("detector", lambda row: shorten_label(row["detector"]).replace(",", ", ")),
    ("in 50 % of runs [m]", _select_headline(0.5), interval),
    ("in 5 % [m]", _select_headline(0.05), lambda found: metres(found["value"])),
    ("worst attack", _select_headline(0.5), itemgetter("spoofer")),
)
"""A detector, and what the worst attack of the suite exceeds undetected."""
WIDTHS = (44, 22, 10, 20)
"""Of its columns."""
SPOOFER_WIDTHS = (38, 24, 30)


class WorstRows:
    """The table of worst attacks, which grows with the detectors that are finished."""

    def __init__(self, config: Mapping[str, Any]) -> None:
        self.waiting = [entry["label"] for entry in config["detectors"]]
        self.titles = WORST.lines(None, WIDTHS)

    def list_new(self, results: CampaignResults) -> list[str]:
        """Lines of detectors that have been finished since the last call."""
        found = [worst for each in self.waiting if (worst := results.protection(each)) is not None]
        scores = [scoring.score_protection(each, ()) for each in found]
        rows = [{"detector": x["detector"], "protection": x} for x in scores]
        self.waiting = [x for x in self.waiting if x not in {each.detector for each in found}]
        lines = [line for row in rows for line in WORST.lines(row, WIDTHS)]
        titles, self.titles = (self.titles, []) if rows else ([], self.titles)
        return [*titles, *lines]


def list_spoofer_rows(summary: Row) -> list[str]:
    """Lines of a table that shows what every spoofer gets within the alarm budget."""
    title = f"at most {100 * summary['budget']:g} % of alarms [m]"
    table = Table(WORST.columns[0], ("spoofer", "spoofer"), (title, dict, _optimum))
    cells = [x | x["stealthy_displacement_m"] for x in summary["cells"] if x["spoofer"] != "none"]
    return [line for cell in (None, *cells) for line in table.lines(cell, SPOOFER_WIDTHS) if cells]


def select_reach(row: Row) -> Row | None:
    """What the worst attack exceeds in half of the runs, or the best one within the budget, of a
    row with protection."""
    reach = scoring.headline(row["protection"], 0.5) or row["bracket"]["best_attack"]
    return None if reach is None or reach["value"] is None else reach


def state_answer(summary: Row) -> str:
    """The detector that holds attacks tightest, controls apart, in one sentence."""
    protections = {row["detector"]: row for row in summary["protection"]}
    rows = [{**row, "protection": protections.get(row["detector"])} for row in summary["detectors"]]
    rows = [row for row in rows if not protections or row["protection"]]
    scores = [(row, reach) for row in rows if (reach := select_reach(row)) is not None]
    if not scores:
        return "No score: no run is silent without an attack, or no attack is within the budget."
    own = [
        each for each in scores if scoring.extract_name(each[0]["detector"]) not in scoring.CONTROLS
    ]
    row, found = min(own or scores, key=lambda each: each[1]["value"])
    where, worst = f"in the mean at {100 * summary['budget']:g} % of alarms", "worst"
    if protections:
        where, worst = "in half of the runs", "worst of the attack suite"
    claimed = row["claimed"]
    requested = f" (requested {claimed['false_alarms_per_hour']:g})" if claimed else ""
    return (
        f"{f'Tightest of {len(own)}: ' if len(own) > 1 else ''}"
        f"{shorten_label(row['detector'])}: {interval(found)} m undetected {where} ({worst}: "
        f"{found['spoofer']}), false alarms "
        f"{metres(row['false_alarms_per_hour']['value'])}/h{requested}."
    )
