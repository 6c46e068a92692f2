"""What feedback gains over the open-loop attack, against every detector of the standard suite.

    python -m tools.feedback_gain                      # all of them, into results/feedback
    python -m tools.feedback_gain aime ewma --json     # those whose name has this in it
    python -m tools.feedback_gain --task T2            # the detector of a task, with a search

The curve of the open-loop attack is that of docs/headlines.json, or is searched for in a task. On
the same training runs the amplitude is fitted of that curve, played blind, and of `feedback-
profile` and `threshold-rider` along it, each with a few settings. The best of each kind plays the
evaluation runs, fresh ones of another seed than those of the headlines; the gain is paired, run by
run. The zero-alarm bound says how much room there is above the optimized open-loop attack.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any

from agents.folder import Part, Records, error_lines
from agents.seeds import mark_displacement
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.experiments.suite import RATE, list_standard_detectors
from spoofgym.bench.report.campaign import bound_text, format_spoofer
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.scores.campaign import select_bound
from spoofgym.bench.scores.spoofer import SpooferScore
from spoofgym.bench.search.amplitude import TuningResult
from spoofgym.cli.app import print_json, progress
from spoofgym.tasks import get_task

from .headlines import DATA_FILE
from .scored import get_sizes, make_parser

OPEN_LOOP, WORLD = "open-loop", "trolley"
FEEDBACK, RIDER = "feedback-profile", "threshold-rider"
TRIED: dict[str, list[dict[str, float]]] = {
    OPEN_LOOP: [{}],
    FEEDBACK: [
        {"full_ratio": full, "zero_ratio": zero, "back": 0.0}
        for full, zero in ((0.3, 1.0), (0.7, 1.15), (0.7, 2.0))
    ],
    RIDER: [{"margin": 1.15, "horizon_s": 20.0}],
}
OFF = {"full_ratio": 1.0, "zero_ratio": 1.01, "back": 0.0}
"""Nothing is held back: the curve as it is, up to the first alarm."""
REACHED = 0.98  # part of the attack's farthest reach, beyond which there is no room
HEAD = (
    "detector",
    "optimized open-loop attack [m]",
    "spoofer",
    "settings",
    "[m]",
    "times as far",
    "bound [m]",
)


def play_kinds(judge: Evaluator, rates_mps: list[float]) -> dict[str, Any]:
    """Gain of each kind over the optimized open-loop attack; feedback may be switched off."""
    found: dict[str, Any] = {"rates_mps": rates_mps}
    scores: dict[str, SpooferScore] = {}
    fits: dict[str, list[tuple[TuningResult, dict[str, float]]]] = {}
    for kind, settings in TRIED.items():
        curve = {"name": kind, "rates_mps": rates_mps}
        fits[kind] = [(judge.fit({**curve, **own}), own) for own in settings]
        if kind == FEEDBACK:
            fits[kind].append((fits[OPEN_LOOP][0][0], OFF))
        fit, own = max(fits[kind], key=lambda each: each[0].score)
        scores[kind] = judge.score({**curve, **own}, amplitude=fit.value)
        found[kind] = {
            **scores[kind].as_dict(),
            "settings": own,
            "amplitude": fit.value,
            "training_m": {_words(each): one.score for one, each in fits[kind]},
            "ratio": scores[kind].ratio_to(scores[OPEN_LOOP], oracles=True).as_json(),
        }
    return found


def _words(settings: dict[str, float]) -> str:
    return ", ".join(f"{key} {x:g}" for key, x in settings.items())


def cases(names: Sequence[str], task: str | None = None) -> dict[str, dict[str, Any]]:
    """Curve, bound and room of detectors by their labels: that of a task, or those of the standard
    suite with one of the names in it."""
    if task is not None:
        return {specify_detector(get_task(task).detector).label: {"room": True}}
    world = json.loads(DATA_FILE.read_text())["worlds"][WORLD]
    brackets = {row["detector"]: row["bracket"] for row in world["detectors"]}
    reach = brackets["never"]["zero_alarm"]["value"]
    found = {
        cell["detector"]: {
            "rates_mps": cell["spoofer_settings"]["rates_mps"],
            "blind_m": cell["stealthy_displacement_m"],
            "bound": brackets[cell["detector"]]["zero_alarm"],
            "room": cell["stealthy_displacement_m"]["value"] < REACHED * reach,
        }
        for cell in world["cells"]
        if cell["spoofer"] == OPEN_LOOP
    }
    for name in names:
        if not any(name in label for label in found):
            raise ValueError(f"no detector of {DATA_FILE.name} has {name!r} in its name")
    return {label: found[label] for name in names or [""] for label in found if name in label}


def play_case(label: str, case: dict[str, Any], given: argparse.Namespace) -> dict[str, Any]:
    if not case["room"]:
        return case
    if given.task is not None:
        judge = Evaluator(given.task, **get_sizes(given, given.seed))
    else:
        world = get_task("T3").world_kwargs
        judge = Evaluator(detector=find_spec(label), **get_sizes(given, given.seed), **world)
    rates = case.get("rates_mps")
    if rates is None:
        searched = judge.fit(OPEN_LOOP).found
        assert searched is not None  # as of every optimized open-loop attack
        rates = searched["played"]["rates_mps"]
        bound = judge.optima.bounds.zero_alarm(judge.detector).as_json()
        case = {**case, "bound": select_bound(bound)}
    return {**case, **play_kinds(judge, rates)}


def find_spec(label: str) -> dict[str, Any]:
    specs = ({"false_alarms_per_hour": RATE, **spec} for spec in list_standard_detectors())
    (found,) = (each.spec for each in map(specify_detector, specs) if each.label == label)
    return dict(found)


def rows(label: str, found: dict[str, Any]) -> list[tuple[str, ...]]:
    bound = bound_text(found["bound"])
    if not found["room"]:
        return [(label, interval(found["blind_m"]), "-", "-", "-", "no room", bound)]
    blind = mark_displacement(found[OPEN_LOOP])
    lines = []
    for kind in (FEEDBACK, RIDER):
        own = found[kind]
        settings = f"{_words(own['settings'])}, amplitude {own['amplitude']:.4g}"
        who = format_spoofer(kind, own["knowledge"])
        lines.append(
            (label, blind, who, settings, mark_displacement(own), interval(own["ratio"], 2), bound)
        )
    return lines


@error_lines()
def main(arguments: list[str]) -> None:
    parser = make_parser(__doc__, "results/feedback")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("detectors", nargs="*", help="parts of their names; by default all")
    parser.add_argument("--task", help="the detector of a task instead, T1 to T6")
    given = parser.parse_args(arguments)
    fixed = {**get_sizes(given, given.seed), "task": given.task, "tried": [TRIED, OFF]}
    del fixed["threads"]
    parts = {
        label: Part({**fixed, "case": case}, lambda *_, x=(label, case): play_case(*x, given))
        for label, case in cases(given.detectors, given.task).items()
    }
    found = Records("feedback", {}, parts).play(given.out, progress)
    if given.json:
        print_json(found)
    else:
        lines = [row for label, each in found.items() for row in rows(label, each)]
        Table.of_texts(*HEAD).print(f"feedback, seed {given.seed}, {given.runs} runs", lines)


if __name__ == "__main__":
    main(sys.argv[1:])
