"""The report of a campaign, for people, in Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from ..experiments.campaign import CampaignResults
from ..search.attack_suite import FAMILIES
from . import table as tables
from .bounds import bracket_section
from .table import tuning_head, tuning_rows


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def markdown(results: CampaignResults, summary: dict[str, Any]) -> str:
    config, code = results.config, results.store.config["code"]
    lines = [f"# Campaign: {summary['scenario']}", "", *_setting(config, code, summary), ""]
    if summary["missing"]:
        lines += [f"**Not finished**: {', '.join(summary['missing'])}.", ""]
    for group in tables.groups(summary):
        detectors = tables.detector_rows(summary, group)
        attacks, clean = tables.attack_rows(summary, group), tables.clean_rows(summary, group)
        lines += [f"## Detectors {group.title}", ""]
        lines += [*markdown_table(tables.DETECTORS_HEAD, detectors), ""]
        if attacks:
            lines += ["### Stealthy attacks", ""]
            lines += [*markdown_table(tables.ATTACKS_HEAD, attacks), ""]
        lines += ["### Price", "", *markdown_table(tables.CLEAN_HEAD, clean), ""]
    lines += ["## The bracket", "", *bracket_section(summary)]
    lines += ["## How to read it", "", *_reading(config, summary), ""]
    if summary["comparisons"]:
        lines += ["## Compared with the controls, run by run", "", *_comparisons(summary), ""]
    lines += [
        "## What the spoofers know",
        "",
        *markdown_table(tables.KNOWLEDGE_HEAD, tables.knowledge_rows(summary)),
        "",
    ]
    if summary["tuning"]:
        lines += ["## Tuning", "", *_tunings(summary["tuning"])]
    return "\n".join(lines).rstrip() + "\n"


def _setting(
    config: Mapping[str, Any], code: Mapping[str, str], summary: dict[str, Any]
) -> list[str]:
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
        f"- spoofgym {config['spoofgym']}, numpy {code['numpy']}, numba {code['numba']}; campaign "
        f"{summary['campaign']}",
    ]


def _victim(config: Mapping[str, Any], notes: list[str]) -> list[str]:
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


def _reading(config: Mapping[str, Any], summary: dict[str, Any]) -> list[str]:
    alert, budget = config["timeline"]["time_to_alert_s"], 100 * summary["budget"]
    lines = [
        "In brackets: 95 % intervals. A run *counts* where nothing but the attack can have raised "
        "an alarm: it is silent before the onset, and so is its clean twin (same seed, same "
        "detector, no attack) in the judged window. *Undetected displacement* of a run: largest "
        f"horizontal distance from the twin with no alarm up to {alert:g} s after it. *Stealthy "
        "displacement*: its mean over the runs that count (bootstrap of whole skies, where there "
        "are ten or more), of a spoofer whose P(alarm "
        f"| silent twin) is at most {budget:g} %, which the upper 95 % limit (Clopper-Pearson, "
        "one-sided) keeps on the training runs; every spoofer has an amplitude that is fitted to "
        "that. *Over budget*: the rate is above it on these runs. *Alarmed as 0*: the same mean, "
        "runs with an alarm counted 0. *Missed*: of the runs that count whose error crosses "
        f"{summary['alert_limit_m']:g} m, those without an alarm up to {alert:g} s after. "
        "*Delay*: median from the onset to an alarm that the attack raised, not to one by chance, "
        "which the twin has by then, too. *Made for*: the detector that a spoofer was tuned, "
        "optimised or trained against; with another detector, receiver, scenario, timeline or "
        "attack it is a transfer.",
        "",
        "False alarms are counted in the window of the attack, by the same runs without attack "
        "(exact intervals, Clopper-Pearson); *availability lost*: epochs with an alarm.",
    ]
    suite = summary["attack_suite"]
    if suite is None:
        return lines
    letters = ", ".join(f"({letter}) {what}" for letter, what in FAMILIES.items())
    return [
        *lines,
        "",
        f"*Exceeded*: the displacement that the worst attack of the suite {suite['name']} "
        f"{suite['version']} ({letters}) exceeds in that share of the runs that count, without an "
        f"alarm budget. The worst one was chosen on {suite['runs']} runs of its own. It is a "
        "floor: another attack may come farther. *Worst skies*: of the tenth of the skies in "
        "which most was displaced on those runs.",
    ]


def _comparisons(summary: dict[str, Any]) -> list[str]:
    """Detectors less controls."""
    rows = [
        (
            row["score"] if row["spoofer"] is None else f"{row['score']}, {row['spoofer']}",
            f"{row['detector']} less {row['control']}",
            tables.interval(row["difference_m"]) + (", above" if row["above"] else ""),
        )
        for row in summary["comparisons"]
    ]
    return [
        *markdown_table(("score", "detectors", "difference [m]"), rows),
        "",
        "`never` does not alarm, and `lottery` does by chance. A detector whose interval lies "
        "above 0 is worse than they are, and is marked. A tuned spoofer is set for every detector "
        "by itself.",
    ]


def _tunings(searches: list[dict[str, Any]]) -> list[str]:
    lines = []
    for search in searches:
        runs, name = search["runs"], search["setting"]
        chosen = f"{name} = {search['value']:g}"
        if not search["within_budget"]:
            chosen = f"nothing is within the budget; the smallest one is taken, {chosen}"
        lines += [
            f"### {search['detector']} / {search['spoofer']}",
            "",
            f"Chosen: {chosen}. Budget: P(alarm | silent twin) at most "
            f"{100 * search['budget']:g} %, by its upper 95 % limit on the {search['counted']} of "
            f"{runs} training runs that count; fewer runs only sift, by the rate itself.",
            "",
            *markdown_table(tuning_head(search), tuning_rows(search)),
            "",
        ]
    return lines
