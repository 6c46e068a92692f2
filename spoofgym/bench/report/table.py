"""Columns to text, Markdown, JSON.

Tables of a campaign: what is in their rows, on the terminal and in the report.

A table never compares detectors at different rates of false alarms: there is one for each rate, and
what is played with nominal thresholds comes by name, without a comparison.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from ...detectors.calibrated import NOISY_WARMUP
from ...spoofers.base import sees_statistics
from ..scores.campaign import CONTROLS, FREE, HALF, NOMINAL, STEALTHY, headline, name_of
from ..search.attack_suite import ORACLES
from .bounds import ABOVE_BOUND, bound_cell, bracket_marks, floor_cell

DETECTORS_HEAD = (
    "detector",
    "claimed: % of runs, per hour",
    "measured: % of runs",
    "measured: per hour",
    "floor of 50 % [m]",
    "exceeded in 50 % [m]",
    "in 5 % [m]",
    "worst skies, in 50 % [m]",
    "worst attack",
    "floor, stealthy [m]",
    "blind optimum [m]",
    "zero-alarm bound [m]",
    "mark",
)
ATTACKS_HEAD = (
    "detector",
    "spoofer",
    "made for",
    "setting",
    "P(alarm | silent twin) [%]",
    "stealthy displacement [m]",
    "median [m]",
    "alarmed as 0 [m]",
    "missed [%]",
    "delay [s]",
)
CLEAN_HEAD = (
    "detector",
    "availability lost [%]",
    "runs with an alarm before the onset [%]",
    "innocent satellites blamed [s an hour]",
    "navigation error, RMS [m]",
    "largest while coasting [m]",
)
ORACLE = " (oracle)"
"""Behind the name of a spoofer that sees the detector's statistics, as nobody can in practice."""
KNOWLEDGE_HEAD = ("spoofer", "knows at run time", "was designed on")
UNTOLD = {"name", "heading_deg", "label", "designed_on", "file"}
"""Settings that a table leaves out: they are in other columns, or in the results only."""
OVER, NONE_WITHIN = ", over budget", " (none within the budget)"


class Group(NamedTuple):
    """Detectors at one rate of false alarms an hour; ``""`` for nominal thresholds."""

    rate: str
    detectors: list[str]

    @property
    def title(self) -> str:
        if not self.rate:
            return "with nominal thresholds, whose rates of false alarms differ"
        return f"at {self.rate} false alarms an hour"


def groups(summary: dict[str, Any]) -> list[Group]:
    """Detectors that may share a table; one that never alarms is in all of them."""
    footing = {row["detector"]: row["footing"] for row in summary["detectors"]}
    rates = sorted({rate for rate in footing.values() if rate not in (NOMINAL, FREE)}, key=float)
    free = [label for label, rate in footing.items() if rate == FREE]
    found = [
        Group(rate, [label for label, own in footing.items() if own in (rate, FREE)])
        for rate in rates
    ]
    nominal = [label for label, rate in footing.items() if rate == NOMINAL]
    if nominal or not found:
        found.append(Group("", sorted([*nominal, *([] if found else free)])))
    return [group for group in found if group.detectors]


def percent(estimate: dict[str, Any]) -> str:
    """Proportion with its interval, in per cent."""
    return interval({key: None if x is None else 100.0 * x for key, x in estimate.items()}, 1)


def interval(estimate: dict[str, Any], digits: int | None = None) -> str:
    """Number with its interval. `estimate`: ``value``, ``low``, ``high``; None where unknown;
    `digits`: after the point; as many as suit the size by default."""
    value, low, high = (estimate[key] for key in ("value", "low", "high"))
    if value is None:
        return "-"
    known = [abs(each) for each in (low, high) if each is not None]
    if digits is None:
        digits = _digits(max(known, default=abs(value)))
    texts = ["?" if each is None else f"{each:.{digits}f}" for each in (low, high)]
    return f"{value:.{digits}f} ({texts[0]} to {texts[1]})"


def number(value: float) -> str:
    """Number without its interval, with as many digits as suit its size."""
    return f"{value:.{_digits(abs(value))}f}"


def _digits(size: float) -> int:
    return 0 if size >= 100.0 else 1 if size >= 1.0 else 2


def setting_of(cell: dict[str, Any]) -> str:
    parts = [
        _setting(key, value)
        for key, value in cell["spoofer_settings"].items()
        if key not in UNTOLD and value not in (None, [])
    ]
    mark = "" if cell["tuned_within_budget"] in {None, True} else NONE_WITHIN
    return (", ".join(parts) or "-") + mark


def _setting(key: str, value: Any) -> str:
    """One setting, short: of a list its length and range, of a digest its first letters."""
    if isinstance(value, float):
        return f"{key}={value:g}"
    if isinstance(value, list) and all(isinstance(item, int | float) for item in value):
        return f"{key}: {len(value)} from {min(value):.3g} to {max(value):.3g}"
    if key == "sha256":
        return f"{key}={str(value)[:8]}"
    return f"{key}={value}"


def made_for(cell: dict[str, Any]) -> str:
    """Which detector a spoofer was made for. Returns its label, marked where this is another
    detector, receiver, scenario, timeline or attack; what the spoofer says of itself where that is
    all there is; ``-`` for none."""
    knowledge = cell["knowledge"]
    if knowledge["detector"] is None:
        return "-" if knowledge["design_time"] == "nothing" else str(knowledge["design_time"])
    transfer = knowledge["transfer"]
    mark = "" if not transfer else " (transfer)"
    if set(transfer) - {"detector"}:
        mark = f" (transfer: {', '.join(transfer)})"
    return f"{knowledge['detector']}{mark}"


def detector_rows(summary: dict[str, Any], group: Group) -> list[tuple[str, ...]]:
    """Rows of the table of detectors, in the order of `DETECTORS_HEAD`."""
    protections = {row["detector"]: row for row in summary["protection"]}
    rows: list[tuple[str, ...]] = []
    for row in _of(summary["detectors"], group):
        label, bracket = row["detector"], row["bracket"]
        found = protections.get(label)
        rows.append(
            (
                label,
                _claimed(row["claimed"]),
                percent(row["false_alarm_per_run"]),
                interval(row["false_alarms_per_hour"]),
                floor_cell(bracket, HALF),
                _exceeded(found, 0.5),
                _exceeded(found, 0.05),
                _exceeded(found, 0.5, skies=True),
                _worst(found),
                floor_cell(bracket, STEALTHY),
                _optimum(bracket["blind_optimum"]),
                bound_cell(bracket),
                mark_of(summary, label) if group.rate else "; ".join(bracket_marks(bracket)) or "-",
            )
        )
    return rows


def _of(rows: list[dict[str, Any]], group: Group) -> list[dict[str, Any]]:
    order = {label: k for k, label in enumerate(group.detectors)}
    return sorted(
        (row for row in rows if row["detector"] in order), key=lambda row: order[row["detector"]]
    )


def _claimed(claimed: dict[str, Any] | None) -> str:
    if claimed is None:
        return "-"
    tail = ", fitted tail" if claimed["extrapolated"] else ""
    return f"{100 * claimed['per_run']:.3g}, {claimed['false_alarms_per_hour']:g}{tail}"


def _exceeded(found: dict[str, Any] | None, share: float, *, skies: bool = False) -> str:
    row = headline(found, share, skies=skies)
    return "-" if row is None else interval(row)


def _worst(found: dict[str, Any] | None) -> str:
    """Letter, spoofer and value of the attack that is the worst in half of the runs."""
    row = headline(found, 0.5)
    if row is None:
        return "-"
    return f"{attack_of_suite(row)}, {row['setting']}={row['at']:g}"


def attack_of_suite(row: dict[str, Any]) -> str:
    """Letter and spoofer of an attack of the suite, marked where it is an oracle."""
    return f"({row['letter']}) {row['spoofer']}{ORACLE if row['letter'] in ORACLES else ''}"


def _optimum(reached: dict[str, Any] | None) -> str:
    """Stealthy displacement of the blind optimum."""
    if reached is None:
        return "-"
    if reached["tuned_within_budget"] is False:
        return interval(reached) + NONE_WITHIN
    return interval(reached) + ("" if reached["within_budget"] else OVER)


def mark_of(summary: dict[str, Any], detector: str) -> str:
    """What is to be known of a detector. Whether and where it is worse than one that never alarms,
    or by chance; whether the worst attack comes as far as against one that never alarms; whether it
    alarms before the onset in more runs than a calibration can stand for; whether the search for
    attacks has failed, and which attacks are above its zero-alarm bound."""
    bracket = next(row["bracket"] for row in summary["detectors"] if row["detector"] == detector)
    if name_of(detector) in CONTROLS:
        return "; ".join(["control", *bracket_marks(bracket)])
    where = [
        row["score"] if row["spoofer"] is None else f"{row['score']}, {row['spoofer']}"
        for row in summary["comparisons"]
        if row["detector"] == detector and row["above"]
    ]
    marks = [f"worse than chance: {'; '.join(dict.fromkeys(where))}"] if where else []
    worst = [
        row["below"]
        for row in summary["comparisons"]
        if (row["detector"], row["spoofer"]) == (detector, None) and row["control"] == "never"
    ]
    if worst and not any(worst):
        marks.append("no better than never")
    for row in summary["detectors"]:
        early = (row["claimed"] or {}).get("warmup_alarms", 0.0)
        if row["detector"] == detector and early > NOISY_WARMUP:
            marks.append(f"alarms before the onset in {100 * early:.0f} % of clean runs")
    return "; ".join([*marks, *bracket_marks(bracket)])


def titled(spoofer: str, knowledge: str) -> str:
    """Name of a spoofer in a table of several, marked where it is an oracle."""
    return spoofer + (ORACLE if sees_statistics(knowledge) else "")


def attack_rows(summary: dict[str, Any], group: Group) -> list[tuple[str, ...]]:
    """Rows of the table of attacks, in the order of `ATTACKS_HEAD`."""
    above = {
        (row["detector"], each["spoofer"])
        for row in summary["detectors"]
        for each in row["bracket"]["above_zero_alarm"]
    }
    return [
        (
            cell["detector"],
            titled(cell["spoofer"], cell["knowledge"]["run_time"]),
            made_for(cell),
            setting_of(cell),
            percent(cell["alarm_rate"]) + ("" if cell["within_budget"] else OVER),
            interval(cell["stealthy_displacement_m"])
            + (ABOVE_BOUND if (cell["detector"], cell["spoofer"]) in above else ""),
            "-" if cell["median_m"] is None else number(cell["median_m"]),
            interval(cell["alarmed_as_0_m"]),
            percent(cell["missed"]),
            interval(cell["delay_s"]),
        )
        for cell in _of(summary["cells"], group)
        if cell["spoofer"] != "none"
    ]


def clean_rows(summary: dict[str, Any], group: Group) -> list[tuple[str, ...]]:
    """Rows of the table of what a detector costs without attack, in the order of `CLEAN_HEAD`."""
    return [
        (
            row["detector"],
            interval({k: 100.0 * x for k, x in row["false_alarm_per_epoch"].items()}, 2),
            percent(row["warmup_alarm_per_run"]),
            "-" if row["blamed_s_per_hour"] is None else number(row["blamed_s_per_hour"]),
            f"{row['navigation_rms_m']:.2f}",
            "-" if row["coasting_error_m"] is None else number(row["coasting_error_m"]),
        )
        for row in _of(summary["detectors"], group)
    ]


def knowledge_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of what the spoofers know: name, at run time, at design time."""
    known = {cell["spoofer"]: cell["knowledge"] for cell in summary["cells"]}
    return [(name, x["run_time"], x["design_time"]) for name, x in known.items()]


ALARMS_HEAD = ("P(alarm | silent twin) [%]", "its upper limit [%]")


def alarm_texts(tried: Mapping[str, Any]) -> tuple[str, str]:
    """Alarm rate of the runs that count, and the limit that is compared with the budget."""
    return f"{100 * tried['alarm_rate']:.1f}", f"{100 * tried['alarm_limit']:.1f}"


def tuning_head(search: dict[str, Any]) -> tuple[str, ...]:
    rest = ("counted", *ALARMS_HEAD, "stealthy displacement [m]", "within budget")
    return (search["setting"], "runs", *rest)


def tuning_rows(search: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of a search, in the order of `tuning_head`. Returns text; a value that was
    tried on a few runs only is sifted by its rate."""
    rows: list[tuple[str, ...]] = []
    for trial in search["trials"]:
        everyone = trial["runs"] == search["runs"]
        chosen = everyone and trial["value"] == search["value"]
        rows.append(
            (
                f"{trial['value']:g}" + (" (chosen)" if chosen else ""),
                str(trial["runs"]),
                str(trial["counted"]),
                *alarm_texts(trial),
                f"{trial['stealthy_displacement_m']:.2f}",
                "yes" if trial["within_budget"] else "no",
            )
        )
    return rows
