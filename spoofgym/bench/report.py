"""The report of a campaign: tables for people, in Markdown."""

from __future__ import annotations

from typing import Any

from .summary import TABLE_LIMIT_M

ATTACKS_HEAD = (
    "detector",
    "spoofer",
    "setting",
    "alarm rate [%]",
    "delay [s]",
    "undetected displacement [m]",
    f"P(> {TABLE_LIMIT_M:g} m) [%]",
)
CLEAN_HEAD = (
    "detector",
    "false alarms per run [%]",
    "per epoch [%]",
    "runs with one in the warm-up [%]",
    "navigation error, RMS [m]",
)


def percent(estimate: dict[str, Any]) -> str:
    """Proportion with its interval, in per cent.

    Parameters
    ----------
    estimate : dict
        ``value``, ``low``, ``high``.

    Returns
    -------
    str
        Such as ``16.5 (12.0 to 22.3)``.
    """
    return interval({key: None if x is None else 100.0 * x for key, x in estimate.items()}, 1)


def interval(estimate: dict[str, Any], digits: int | None = None) -> str:
    """Number with its interval.

    Parameters
    ----------
    estimate : dict
        ``value``, ``low``, ``high``; None where unknown.
    digits : int, optional
        After the point; as many as suit the size by default.

    Returns
    -------
    str
        Such as ``12.6 (11.9 to 13.2)``, ``-`` where unknown.
    """
    value, low, high = (estimate[key] for key in ("value", "low", "high"))
    if value is None:
        return "-"
    if digits is None:
        digits = 0 if max(abs(low), abs(high)) >= 100.0 else 1 if abs(high) >= 1.0 else 2
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def setting_of(cell: dict[str, Any]) -> str:
    """What a spoofer was set to.

    Parameters
    ----------
    cell : dict
        Scores of a cell.

    Returns
    -------
    str
        Its settings but the heading.
    """
    settings = cell["spoofer_settings"]
    parts = [
        f"{key}={value:g}" if isinstance(value, float) else f"{key}={value}"
        for key, value in settings.items()
        if key not in {"name", "heading_deg"}
    ]
    mark = "" if cell["tuned_within_budget"] in {None, True} else " (none within the budget)"
    return (", ".join(parts) or "-") + mark


def attack_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of attacks, in the order of `ATTACKS_HEAD`.

    Parameters
    ----------
    summary : dict
        Of `summarize`.

    Returns
    -------
    list of tuple
        Text.
    """
    rows: list[tuple[str, ...]] = []
    for cell in summary["cells"]:
        clean = cell["spoofer"] == "none"
        limit = next(p for p in cell["p_hmi"] if p["alert_limit_m"] == TABLE_LIMIT_M)
        rows.append(
            (
                cell["detector"],
                cell["spoofer"],
                setting_of(cell),
                percent(cell["alarm_rate"]),
                "-" if clean else interval(cell["delay_s"]),
                "-" if clean else interval(cell["undetected_displacement_m"]),
                "-" if clean else percent(limit),
            )
        )
    return rows


def clean_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of false alarms, in the order of `CLEAN_HEAD`.

    Parameters
    ----------
    summary : dict
        Of `summarize`.

    Returns
    -------
    list of tuple
        Text.
    """
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


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(row) + " |" for row in rows]


def markdown(config: dict[str, Any], summary: dict[str, Any]) -> str:
    """Report of a campaign.

    Parameters
    ----------
    config : dict
        Of the campaign.
    summary : dict
        Of `summarize`.

    Returns
    -------
    str
        Markdown.
    """
    lines = [f"# Campaign: {summary['scenario']}", "", *_setting(config, summary), ""]
    if summary["missing"]:
        lines += [f"**Not finished**: {', '.join(summary['missing'])}.", ""]
    lines += ["## Attacks", "", *_table(ATTACKS_HEAD, attack_rows(summary)), ""]
    lines += [*_reading(config, summary), ""]
    lines += ["## Without attack", "", *_table(CLEAN_HEAD, clean_rows(summary)), ""]
    lines += [
        "False alarms are counted in the window of the attack, by the same runs without attack. "
        "Intervals are exact (Clopper-Pearson); those per epoch are for as many independent epochs "
        "as the correlated ones of a run are worth, and for the number of runs where there was no "
        "alarm.",
        "",
    ]
    if summary["differences"]:
        lines += ["## Detectors compared, run by run", ""]
        rows: list[tuple[str, ...]] = [
            (
                row["spoofer"],
                f"{row['detector']} less {row['reference']}",
                interval(row["undetected_displacement_m"]),
            )
            for row in summary["differences"]
        ]
        lines += _table(("spoofer", "detectors", "undetected displacement [m]"), rows)
        lines += ["", "A tuned spoofer is set anew for every detector.", ""]
    if summary["tuning"]:
        lines += ["## Tuning", "", *_tunings(summary["tuning"])]
    return "\n".join(lines).rstrip() + "\n"


def _setting(config: dict[str, Any], summary: dict[str, Any]) -> list[str]:
    """What was run."""
    scenario, receiver, line = config["scenario"], config["receiver"], config["timeline"]
    attack = config["attack"]
    by = attack["control"]
    errors = scenario["errors"]
    kinds = sorted({cell["attack"] for cell in summary["cells"]})
    knowledge = sorted({cell["knowledge"]["run_time"] for cell in summary["cells"]})
    notes = config["notes"]
    return [
        f"- Scenario: errors {errors if isinstance(errors, str) else errors['kind']}, "
        f"{scenario['imu']} inertial sensors, epochs of {scenario['epoch_interval_s']:g} s",
        *(f"- {note}" for note in notes),
        f"- Receiver: tightly coupled, tuning {receiver['tuning']}, covariance update "
        f"{receiver['covariance_update']}",
        f"- Attack: {', '.join(kinds)}, commanded by {by}, limits "
        + (f"{attack['acceleration_limit_mps2']:g} m/s^2 and " if by == "acceleration" else "")
        + f"{attack['rate_limit_mps']:g} m/s",
        f"- Timeline: warm-up {line['warmup_s']:g} s with detectors live in its last "
        f"{line['live_s']:g} s, attack {line['attack_s']:g} s, then "
        f"{line['time_to_alert_s']:g} s in which the offsets hold their rate and alarms count",
        f"- {config['runs']} evaluation runs, the same for all cells (entropy "
        f"{config['entropy']}); knowledge of the spoofers at run time: {', '.join(knowledge)}",
        f"- spoofgym {config['versions']['spoofgym']}, numpy {config['versions']['numpy']}, numba "
        f"{config['versions']['numba']}; campaign {summary['campaign']}",
    ]


def _reading(config: dict[str, Any], summary: dict[str, Any]) -> list[str]:
    """How the numbers are meant."""
    alert = config["timeline"]["time_to_alert_s"]
    horizon = summary["cells"][0]["delay_horizon_s"] if summary["cells"] else 0.0
    excluded = {cell["detector"]: cell["delay_excluded"] for cell in summary["cells"]}
    told = ", ".join(f"{count} with {detector}" for detector, count in excluded.items())
    return [
        f"In brackets: 95 % intervals. *Alarm rate*: runs with an alarm within {horizon:g} s of "
        "the onset (Wilson), under attack the detection probability. *Delay*: from the onset to "
        f"the first alarm, restricted mean with horizon {horizon:g} s, missed runs censored "
        "(Kaplan-Meier, bootstrap); runs with a false alarm in the warm-up are excluded "
        f"({told}). *Undetected displacement*: largest "
        "horizontal distance from the clean twin (same seed, same detector, no attack) with no "
        f"alarm up to {alert:g} s after it, mean over all runs, alarmed ones with what they had "
        "until then (bootstrap, paired over runs).",
    ]


def _tunings(searches: list[dict[str, Any]]) -> list[str]:
    """What was tried to find the settings."""
    lines = []
    for search in searches:
        runs, name = search["runs"], search["setting"]
        chosen = f"{name} = {search['value']:g}"
        if not search["within_budget"]:
            chosen = f"nothing is within the budget; the smallest one is taken, {chosen}"
        lines += [
            f"### {search['detector']} / {search['spoofer']}",
            "",
            f"Chosen: {chosen}. Budget: alarm rate at most {100 * search['budget']:g} % of the "
            f"runs above the clean one, which is {100 * search['clean_alarm_rate']:.1f} % of "
            f"{runs} training runs; none is excluded, {search['warmup_alarms']} of them had a "
            "false alarm in the warm-up.",
            "",
        ]
        rows: list[tuple[str, ...]] = [
            (
                f"{trial['value']:g}" + (" (chosen)" if _is_choice(search, trial) else ""),
                str(trial["runs"]),
                f"{100 * trial['alarm_rate']:.1f}",
                f"{trial['undetected_displacement_m']:.2f}",
                "yes" if trial["within_budget"] else "no",
            )
            for trial in search["trials"]
        ]
        head = (name, "runs", "alarm rate [%]", "undetected displacement [m]", "within budget")
        lines += [*_table(head, rows), ""]
    return lines


def _is_choice(search: dict[str, Any], trial: dict[str, Any]) -> bool:
    return bool(trial["value"] == search["value"] and trial["runs"] == search["runs"])
