"""The report of a campaign, for people, in Markdown."""

from __future__ import annotations

import json
from typing import Any

from .tables import (
    CLEAN_HEAD,
    KNOWLEDGE_HEAD,
    RIVALS_HEAD,
    attack_rows,
    attacks_head,
    clean_rows,
    interval,
    knowledge_rows,
    reference_lines,
    rival_rows,
)
from .tuning_table import tuning_head, tuning_rows


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]


def _cell(text: str) -> str:
    """Text that stays within its cell."""
    return " ".join(text.split()).replace("|", "\\|")


def markdown(config: dict[str, Any], summary: dict[str, Any]) -> str:
    """Report of a campaign."""
    lines = [f"# Campaign: {summary['scenario']}", "", *_setting(config, summary), ""]
    if summary["missing"]:
        lines += [f"**Not finished**: {', '.join(summary['missing'])}.", ""]
    lines += ["## Attacks", "", *_table(attacks_head(summary), attack_rows(summary)), ""]
    lines += [*_reading(config, summary), ""]
    if summary["rivals"]:
        lines += ["## Spoofers compared, run by run", "", *_rivals(summary), ""]
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
        lines += ["", "A tuned spoofer is set for every detector by itself.", ""]
    lines += ["## What the spoofers know", "", *_table(KNOWLEDGE_HEAD, knowledge_rows(summary)), ""]
    if summary["tuning"]:
        lines += ["## Tuning", "", *_tunings(summary["tuning"])]
    return "\n".join(lines).rstrip() + "\n"


def _setting(config: dict[str, Any], summary: dict[str, Any]) -> list[str]:
    """What was run."""
    line, attack = config["timeline"], config["attack"]
    by = attack["control"]
    kinds = sorted({cell["attack"] for cell in summary["cells"]})
    knowledge = sorted({cell["knowledge"]["run_time"] for cell in summary["cells"]})
    notes = config["notes"]
    return [
        *_victim(config, [f"- {note}" for note in notes]),
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


def _victim(config: dict[str, Any], notes: list[str]) -> list[str]:
    """World and receiver."""
    if "settings" in config:
        given = {k: json.dumps(x) for k, x in config["settings"].items() if x is not None}
        own = ", ".join(f"{k}={text}" for k, text in given.items())
        return [f"- Environment: {config['env']}, {own}", *notes]
    scenario, receiver = config["scenario"], config["receiver"]
    errors, rate = scenario["errors"], scenario.get("imu_rate_hz")
    return [
        f"- Scenario: errors {errors if isinstance(errors, str) else errors['kind']}, "
        f"{scenario['imu']} inertial sensors{'' if rate is None else f' at {rate:g} Hz'}, "
        f"epochs of {scenario['epoch_interval_s']:g} s",
        *notes,
        f"- Receiver: tightly coupled, tuning {receiver['tuning']}, covariance update "
        f"{receiver['covariance_update']}",
    ]


def _reading(config: dict[str, Any], summary: dict[str, Any]) -> list[str]:
    """How the numbers are meant."""
    alert = config["timeline"]["time_to_alert_s"]
    horizon = summary["cells"][0]["delay_horizon_s"] if summary["cells"] else 0.0
    excluded = {cell["detector"]: cell["delay_excluded"] for cell in summary["cells"]}
    counts = ", ".join(f"{count} with {detector}" for detector, count in excluded.items())
    return [
        f"In brackets: 95 % intervals. *Alarm rate*: runs with an alarm within {horizon:g} s of "
        "the onset (Wilson), under attack the detection probability. *Delay*: from the onset to "
        f"the first alarm, restricted mean with horizon {horizon:g} s, missed runs censored "
        "(Kaplan-Meier, bootstrap); runs with a false alarm in the warm-up are excluded "
        f"({counts}). *Undetected displacement*: largest "
        "horizontal distance from the clean twin (same seed, same detector, no attack) with no "
        f"alarm up to {alert:g} s after it, mean over all runs, alarmed ones with what they had "
        "until then (bootstrap, paired over runs). *Over budget*: the alarm rate exceeds that of "
        f"the same runs without attack by more than {100 * summary['budget']:g} points. *Made "
        "for*: the detector that a spoofer was tuned, optimised or trained against; with another "
        "detector, receiver, scenario, timeline or attack it is a transfer.",
    ]


def _rivals(summary: dict[str, Any]) -> list[str]:
    """Spoofers against the best ramp and the best profile, and how these were chosen."""
    return [
        *_table(RIVALS_HEAD, rival_rows(summary)),
        "",
        *(f"- {line}" for line in reference_lines(summary)),
        "",
        "Ratio and difference of the mean undetected displacements, with 95 % intervals by the "
        "paired bootstrap over runs, the same resamples for all. *Best ramp*: of the ramps whose "
        "search found a value within the budget on training runs, the one with the larger mean on "
        "these evaluation runs, which favours the ramps. *Best profile*: of the profiles that were "
        "made for the detector and all else here, the one with the larger mean; where there is "
        "none, of the others whose alarm rate on these runs keeps the budget. A comparison with a "
        "spoofer over the budget is not on equal footing.",
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
            "false alarm in the warm-up. So that other runs keep it too, the excess counts with a "
            f"margin of {search['margin']:g} of its standard errors; fewer runs only sift, without "
            "a margin.",
            "",
            *_table(tuning_head(search), tuning_rows(search)),
            "",
        ]
    return lines
