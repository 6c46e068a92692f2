"""A detector against the reference of its task, on the same fresh runs.

    python -m tools.against_reference guard.onnx                # in D1, into results/against
    python -m tools.against_reference guard.onnx --parts ages   # one part of it
    python -m tools.against_reference guard.onnx --page         # and docs/hours.md

Three parts, paired run by run, each kept once it has ended: P(HMI) of every family of attacks, the
share of accelerating ramps found at onsets from 10 s to an hour after switch-on, and clean flights
of two hours, whose windows as long as an attack are counted by the time since switch-on.  Alarms
are rare; so windows above the level that a tenth of them exceeds are counted, too.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from agents.folder import Part, Records, error_lines, write_json
from spoofgym.bench.experiments.audit import Auditor
from spoofgym.bench.experiments.audit_worlds import ScoredDetector, Worlds
from spoofgym.bench.report.table import Table, percent
from spoofgym.bench.runs.panel import generators, in_any_world
from spoofgym.bench.scores.audit import format_age
from spoofgym.bench.scores.scores import select_clusters
from spoofgym.bench.scores.statistics import bounded_mean
from spoofgym.cli.app import progress
from spoofgym.core.registry import parse_spec
from spoofgym.detectors import Never
from spoofgym.detectors.calibrated import describe_identity, list_factors, unwrap
from spoofgym.simulation.monitors import PassiveDetectors
from spoofgym.simulation.simulator import run_serially
from spoofgym.tasks import get_detector_task

from .pages import DOCS, fit_tables, marks, put_between

PAGE, DATA_FILE = DOCS / "hours.md", DOCS / "hours.json"
AGES_S = (10.0, 60.0, 300.0, 1800.0, 3600.0)
REACH = (0.1, 0.2, 0.4, 0.8, 1.6)
"""How far the accelerating ramps displace by the end of the attack, in alert limits; a constant
ramp begins with a step of the velocity, which both detectors find at every age."""
BOUNDS_S = (0.0, 600.0, 1800.0, 3600.0, 7200.0)
"""Times since switch-on between which clean windows are counted."""
PARTS = "ages", "clean", "families"
OFTEN = 0.1  # share of all clean windows above the lower level


def play_families(auditor: Auditor, specs: Sequence[Any]) -> dict[str, Any]:
    """P(HMI) by family of the detector and the reference, and the first less the second."""
    ours, theirs = auditor.scores(specs, show=progress)
    families = [each.family for each in ours.families]
    return {
        "runs": ours.runs,
        "selection_runs": ours.selection_runs,
        "families": {
            key: {
                "held_out": ours.family(key).held_out,
                "p_hmi": [each.family(key).p_hmi.as_json() for each in (ours, theirs)],
                "less": ours.difference_to(theirs, key).as_json(),
            }
            for key in families
        },
        "worst": [each.worst.family for each in (ours, theirs)],
        "less": ours.difference_to(theirs).as_json(),
        "exceeded_m": [each.as_dict()["exceeded_m"] for each in (ours, theirs)],
        "false_alarms_per_hour": [
            each.as_dict()["false_alarms_per_hour"] for each in (ours, theirs)
        ],
    }


def play_ages(worlds: Worlds, detectors: Sequence[ScoredDetector], runs: int) -> dict[str, Any]:
    """Share of the ramps found at every age by both, and changes from the youngest."""
    ours, theirs = (
        worlds.probe_ages(each.judge, runs, len(AGES_S), AGES_S, REACH, accelerating=True)
        for each in detectors
    )
    return {
        "runs": runs,
        "reach": list(REACH),
        "ages": [
            {
                "age_s": age_s,
                "found": [probe.estimate_share(k).as_json() for probe in (ours, theirs)],
                "less": ours.compare_to(theirs, k).as_json(),
                "more_than_youngest": [
                    probe.compare_ages(k, 0).as_json() for probe in (ours, theirs)
                ],
            }
            for k, age_s in enumerate(AGES_S)
        ],
    }


def play_clean(worlds: Worlds, detectors: Sequence[ScoredDetector], runs: int) -> dict[str, Any]:
    """Clean windows with an alarm, and above the lower level, by the time since switch-on."""
    domain = {**worlds.task.world_kwargs["domain"], "age_s": [60.0, BOUNDS_S[-1]]}
    judges = [in_any_world(each.judge) for each in detectors]
    setup = worlds.setup(domain=domain)
    setup = setup.copy_with(detector=Never(), monitors=[PassiveDetectors(judges)])
    simulator = setup.simulator(runs, run_serially)
    rngs = generators(setup, worlds.entropy, "evaluation", np.arange(runs))
    simulator.switch_on(rngs, {"age_s": BOUNDS_S[-1]})
    window = setup.steps + setup.hold
    count = int(simulator.ages.min() - setup.filter_only) // window
    largest = np.zeros((count, runs, len(judges)))
    with progress(count) as bar:
        for each in largest:
            for _ in range(window):
                simulator.step(attacked=False)
                ratio = simulator.monitor(PassiveDetectors).memory["ratio"]
                np.maximum(each, ratio, out=each)
            bar.advance(1.0, "clean flights")
    begin = np.arange(count) * window * setup.interval_s
    parts = [(begin >= low) & (begin < high) for low, high in pairwise(BOUNDS_S)]
    sky = select_clusters(simulator.onset // setup.epochs_each)
    found = []
    for ratio in np.moveaxis(largest, 2, 0):
        levels = {"alarm": 1.0, "often": float(np.quantile(ratio, 1.0 - OFTEN))}
        own: dict[str, Any] = {"level": levels["often"], "alarms": int((ratio > 1.0).sum())}
        for name, level in levels.items():
            above = ratio > level
            shares = [above[x].mean(axis=0) if x.any() else np.full(runs, np.nan) for x in parts]
            own[name] = [bounded_mean(each, sky, 0.0).as_json() for each in shares]
            own[f"{name}_last_less_first"] = bounded_mean(
                shares[-1] - shares[0], sky, -1.0
            ).as_json()
        found.append(own)
    return {
        "runs": runs,
        "hours": runs * count * window * setup.interval_s / 3600.0,
        "window_s": window * setup.interval_s,
        "windows": [int(part.sum()) * runs for part in parts],
        "detectors": found,
    }


def take(found: dict[str, Any], kept: dict[str, Any]) -> dict[str, Any]:
    """Results of a task with those that are kept: parts, and families on as many runs."""
    whole = {**kept, **found}
    before, now = (each.get("families", {}) for each in (kept, found))
    if before and now and all(before[x] == now[x] for x in ("runs", "selection_runs")):
        whole["families"] = {**now, "families": {**before["families"], **now["families"]}}
    return whole


def _identify(detectors: Sequence[ScoredDetector]) -> list[Any]:
    """What results depend on of detectors: file or settings, and thresholds."""
    return [[describe_identity(unwrap(each.judge)), list_factors(each.judge)] for each in detectors]


def tabulate(found: dict[str, Any]) -> str:
    """Tables of the parts that there are, in Markdown."""
    parts = []
    if ages := found.get("ages"):
        table = Table.of_texts(
            "onset after switch-on", "found [%]", "reference [%]", "difference, paired [points]"
        )
        rows = [
            (
                format_age(each["age_s"]),
                *(percent(x) for x in each["found"]),
                percent(each["less"]),
            )
            for each in ages["ages"]
        ]
        parts.append(table.markdown(rows))
    if played := found.get("families"):
        table = Table.of_texts(
            "family", "P(HMI) [%]", "reference [%]", "difference, paired [points]"
        )
        rows = [
            (
                f"`{key}`",
                *(percent(x) for x in each["p_hmi"]),
                percent(each["less"]),
            )
            for key, each in played["families"].items()
        ]
        parts.append(table.markdown(rows))
    if clean := found.get("clean"):
        table = Table.of_texts(
            "time since switch-on [min]",
            "alarms [% of windows]",
            "reference",
            "above the lower level [%]",
            "reference",
        )
        minutes = [bound / 60.0 for bound in BOUNDS_S]
        both = clean["detectors"]
        rows = [
            (
                f"{minutes[k]:g} to {minutes[k + 1]:g}",
                *(percent(each[name][k]) for name in ("alarm", "often") for each in both),
            )
            for k in range(len(BOUNDS_S) - 1)
        ]
        parts.append(table.markdown(rows))
    return "\n\n".join(parts)


@error_lines()
def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("detector", help="an .onnx file, or a name with settings")
    parser.add_argument("--task", default="D1")
    parser.add_argument("--out", type=Path, default=Path("results/against"))
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=PARTS)
    parser.add_argument("--families", nargs="+", help="by default all of the task")
    parser.add_argument("--runs", type=int, default=64, help="of every family and age")
    parser.add_argument("--selection-runs", type=int, default=24)
    parser.add_argument("--clean-runs", type=int, default=64)
    parser.add_argument("--entropy", type=int, default=1, help="seed of all runs")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--page", action="store_true", help="write the tables of docs/hours.md")
    given = parser.parse_args(arguments)
    auditor = Auditor(
        given.task,
        "quick",
        runs=given.runs,
        selection_runs=given.selection_runs,
        families=given.families or [each.key for each in get_detector_task(given.task).families],
        entropy=given.entropy,
        threads=1,
        folder=given.out / "families",
    )
    specs = [parse_spec(given.detector), auditor.task.task.detector]
    detectors = auditor.worlds.build_detectors(specs)
    alone = {"task": given.task, "entropy": given.entropy, "of": _identify(detectors)}
    sizes = {
        "families": [given.runs, given.selection_runs, *(given.families or ())],
        "ages": [given.runs, *REACH],
        "clean": given.clean_runs,
    }
    makers = {
        "families": lambda *_: play_families(auditor, specs),
        "ages": lambda *_: play_ages(auditor.worlds, detectors, given.runs),
        "clean": lambda *_: play_clean(auditor.worlds, detectors, given.clean_runs),
    }
    parts = {name: Part({**alone, "size": sizes[name]}, makers[name]) for name in given.parts}
    found = Records("against", {}, parts).play(given.out / "parts", progress)
    print(json.dumps(found, indent=1) if given.json else tabulate(found))
    if given.page:
        kept = json.loads(DATA_FILE.read_text())
        kept[given.task] = take(found, kept.get(given.task, {}))
        write_json(DATA_FILE, kept)
        for task, each in kept.items():
            put_between(PAGE, *marks(f"hours-{task}"), fit_tables(f"{tabulate(each)}\n"))


if __name__ == "__main__":
    main(sys.argv[1:])
