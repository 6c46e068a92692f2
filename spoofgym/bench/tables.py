"""Tables of a campaign: what is in their rows, on the terminal and in the report."""

from __future__ import annotations

from typing import Any

ATTACKS_HEAD = (
    "detector",
    "spoofer",
    "made for",
    "setting",
    "alarm rate [%]",
    "delay [s]",
    "undetected displacement [m]",
)
CLEAN_HEAD = (
    "detector",
    "false alarms per run [%]",
    "per epoch [%]",
    "runs with one in the warm-up [%]",
    "navigation error, RMS [m]",
)


RIVALS_HEAD = (
    "detector",
    "spoofer",
    "alarm rate [%]",
    "above clean [points]",
    "ratio to the best ramp",
    "difference [m]",
    "ratio to the best profile",
    "difference [m]",
)
KNOWLEDGE_HEAD = ("spoofer", "knows at run time", "was designed on")
UNTOLD = {"name", "heading_deg", "label", "designed_on", "file"}
"""Settings that a table leaves out: they are in other columns, or in the results only."""
OVER = ", over budget"


def percent(estimate: dict[str, Any]) -> str:
    """Proportion with its interval, in per cent."""
    return interval({key: None if x is None else 100.0 * x for key, x in estimate.items()}, 1)


def interval(estimate: dict[str, Any], digits: int | None = None) -> str:
    """Number with its interval.

    `estimate`: ``value``, ``low``, ``high``; None where unknown; `digits`: after the point; as many
    as suit the size by default.
    """
    value, low, high = (estimate[key] for key in ("value", "low", "high"))
    if value is None:
        return "-"
    if digits is None:
        digits = _digits(max(abs(low), abs(high)))
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def number(value: float) -> str:
    """Number without its interval, with as many digits as suit its size."""
    return f"{value:.{_digits(abs(value))}f}"


def _digits(size: float) -> int:
    return 0 if size >= 100.0 else 1 if size >= 1.0 else 2


def setting_of(cell: dict[str, Any]) -> str:
    """What a spoofer was set to."""
    parts = [
        _setting(key, value)
        for key, value in cell["spoofer_settings"].items()
        if key not in UNTOLD and value not in (None, [])
    ]
    mark = "" if cell["tuned_within_budget"] in {None, True} else " (none within the budget)"
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
    """Which detector a spoofer was made for.

    Returns its label, marked where this is another detector, receiver, scenario, timeline or
    attack; what the spoofer says of itself where that is all there is; ``-`` for none.
    """
    knowledge = cell["knowledge"]
    if knowledge["detector"] is None:
        return "-" if knowledge["design_time"] == "nothing" else str(knowledge["design_time"])
    transfer = knowledge["transfer"]
    mark = "" if not transfer else " (transfer)"
    if set(transfer) - {"detector"}:
        mark = f" (transfer: {', '.join(transfer)})"
    return f"{knowledge['detector']}{mark}"


def alarms(rate: dict[str, Any], within_budget: bool | None) -> str:
    """Alarm rate, marked where it is over the budget.

    `within_budget`: None where it is not known.
    """
    return percent(rate) + (OVER if within_budget is False else "")


def attacks_head(summary: dict[str, Any]) -> tuple[str, ...]:
    """Head of the table of attacks."""
    return (*ATTACKS_HEAD, f"P(> {summary['alert_limit_m']:g} m) [%]")


def attack_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of attacks, in the order of `attacks_head`."""
    rows: list[tuple[str, ...]] = []
    for cell in summary["cells"]:
        clean = cell["spoofer"] == "none"
        limit = next(p for p in cell["p_hmi"] if p["alert_limit_m"] == summary["alert_limit_m"])
        rows.append(
            (
                cell["detector"],
                cell["spoofer"],
                made_for(cell),
                setting_of(cell),
                alarms(cell["alarm_rate"], cell["within_budget"]),
                "-" if clean else interval(cell["delay_s"]),
                "-" if clean else interval(cell["undetected_displacement_m"]),
                "-" if clean else percent(limit),
            )
        )
    return rows


def clean_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of false alarms, in the order of `CLEAN_HEAD`."""
    return [
        (
            row["detector"],
            percent(row["false_alarm_per_run"]),
            interval({k: 100.0 * x for k, x in row["false_alarm_per_epoch"].items()}, 2),
            percent(row["warmup_alarm_per_run"]),
            f"{row['navigation_rms_m']:.2f}",
        )
        for row in summary["detectors"]
    ]


def rival_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of spoofers compared, in the order of `RIVALS_HEAD`."""
    rows: list[tuple[str, ...]] = []
    for group in summary["rivals"]:
        for row in group["comparisons"]:
            gaps: list[str] = []
            for over in (row["over_ramp"], row["over_profile"]):
                gaps += (
                    ["-", "-"]
                    if over is None
                    else [interval(over["ratio"], 3), interval(over["difference_m"])]
                )
            rows.append((group["detector"], row["spoofer"], *_alarms(row), *gaps))
    return rows


def _alarms(row: dict[str, Any]) -> tuple[str, str]:
    """Alarm rate, and its excess over the clean one, marked where that is over the budget."""
    mark = "" if row["within_budget"] else OVER
    return f"{100 * row['alarm_rate']['value']:.1f}", percent(row["alarm_excess"]) + mark


def reference_lines(summary: dict[str, Any]) -> list[str]:
    """Which ramp and which profile the spoofers are compared with."""
    lines = []
    for group in summary["rivals"]:
        for word in ("ramp", "profile"):
            best = group[f"best_{word}"]
            if best is None:
                lines.append(f"No {word} keeps the alarm budget against {group['detector']}.")
                continue
            rate, excess = _alarms(best)
            lines.append(
                f"Best {word} against {group['detector']}: {best['spoofer']}, "
                f"{'' if best['made_for_it'] else 'not made for it, '}"
                f"{interval(best['undetected_displacement_m'])} m, alarm rate {rate} %, points "
                f"above clean: {excess}."
            )
    return lines


def knowledge_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of what the spoofers know: name, at run time, at design time."""
    known = {cell["spoofer"]: cell["knowledge"] for cell in summary["cells"]}
    return [(name, x["run_time"], x["design_time"]) for name, x in known.items()]
