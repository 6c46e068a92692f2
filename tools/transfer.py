r"""Spoofers trained in one world and played in another: detectors, flights, skies, sensors.

    python -m tools.transfer --task T3 --spoofer ramp --spoofer open-loop \
        --world 'aime={"detector": {"name": "aime", "signals": "range_rate"}}' \
        --world 'consumer={"scenario": "trolley-consumer"}'

A world is a name and what it changes in the task, as keyword arguments of an environment; the task
itself is the world `home`.  Each spoofer is fitted in each of the worlds, or was trained in the one
behind its name, as `runs/mine.onnx@home`.  It is then played in all worlds, *as fitted at home* and
*refitted* there, both in times of the *native*, the same spoofer trained where it is played, run by
run.  What is over the alarm budget is no score, and is marked.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any

from agents.folder import Part, Records, describe_identity, error_lines
from agents.seeds import keeps_budget
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.players import add_tuned_setting, specify_spoofer
from spoofgym.bench.search.amplitude import with_rates
from spoofgym.cli.app import print_json, progress
from spoofgym.core.progress import ProgressBar
from spoofgym.core.registry import check_choice, parse_spec
from spoofgym.tasks import TASKS, get_task

from .scored import get_sizes, make_parser

HOME = "home"
HEAD = ("spoofer", "trained on", "played against", "as fitted at home", "refitted")
Row = dict[str, Any]


def evaluators(
    task: str, changes: Mapping[str, Mapping[str, Any]], **sizes: Any
) -> dict[str, Evaluator]:
    base = {**get_task(task).world_kwargs, "detector": get_task(task).detector}
    return {name: Evaluator(**{**base, **change, **sizes}) for name, change in changes.items()}


def train_spoofer(judge: Evaluator, spec: Row) -> Row:
    """Spec as it comes out of its training in a world, and the setting that is fitted, if any."""
    entry = specify_spoofer(add_tuned_setting(spec))
    if entry.tuned is None:
        return {"spec": entry.spec, "fitted": None}
    found = judge.fit(entry.spec)
    if found.found is not None:
        entry = with_rates(entry, found.found["played"]["rates_mps"])
    return {"spec": entry.with_value(found.value), "fitted": entry.tuned}


def score_case(judge: Evaluator, one: Row, native: Row) -> Row:
    """Score of a trained spoofer in a world, its amplitude as it is and refitted."""
    spec, setting = one["spec"], one["fitted"]
    best = judge.score(native["spec"], amplitude=None)
    scores = {
        "as fitted at home": judge.score(spec, amplitude=None),
        "refitted": judge.score({**spec, setting: "tuned"} if setting else spec),
    }
    found: Row = {
        name: {**score.as_dict(), "of_native": score.ratio_to(best, oracles=True).as_json()}
        for name, score in scores.items()
    }
    if setting:
        found["as fitted at home"]["value"] = spec[setting]
    return {"detector": judge.detector.label, "knowledge": best.knowledge, **found}


def table(
    worlds: Mapping[str, Evaluator],
    spoofers: list[tuple[Row, str | None]],
    out: Path,
    bar: ProgressBar | None = None,
) -> list[Row]:
    parts: dict[str, Part] = {}
    rows: dict[str, Row] = {}

    def make_training(spec: Row, judge: Evaluator) -> Part:
        return Part(describe_identity(judge, spec), lambda *_: train_spoofer(judge, spec))

    def make_score(one: str, native: str, judge: Evaluator) -> Part:
        identity = {each: parts[each].identity for each in (one, native)}
        make = lambda before, _: score_case(judge, before[one], before[native])  # noqa: E731
        return Part(identity, make, (one, native))

    for spec, only in spoofers:
        label = specify_spoofer(add_tuned_setting(spec)).label
        homes = {name: f"{label}, {name}" for name in worlds}
        parts |= {key: make_training(spec, worlds[name]) for name, key in homes.items()}
        for home, there in product(worlds if only is None else [only], worlds):
            key = f"{label}, {home} - {there}"
            parts[key] = make_score(homes[home], homes[there], worlds[there])
            rows[key] = {"spoofer": label, "home": home, "world": there}
    found = Records("transfer", {}, parts).play(out, bar)
    return [{**row, **found[key]} for key, row in rows.items()]


def line(row: Row) -> tuple[str, ...]:
    who = f"{row['spoofer']} ({row['knowledge']})"
    parts = [_part(row[name]) for name in HEAD[3:]]
    return (who, row["home"], f"{row['world']}: {row['detector']}", *parts)


def _part(found: Row) -> str:
    over = "" if keeps_budget(found) else ", over the budget"
    metres = interval(found["stealthy_displacement_m"])
    return f"{interval(found['of_native'], 2)}, {metres} m{over}"


def _world(text: str) -> tuple[str, dict[str, Any]]:
    name, sign, rest = text.partition("=")
    try:
        changes = json.loads(rest)
    except json.JSONDecodeError as error:
        raise ValueError(f"--world {text!r} must be NAME=JSON: {error}") from error
    if not (name and sign and isinstance(changes, dict)):
        raise ValueError(f"--world {text!r} must be NAME=JSON with an object of settings")
    return name, changes


def _spoofer(text: str, worlds: Mapping[str, Any]) -> tuple[Row, str | None]:
    """Spec of a spoofer, and the world that it has been trained in, if there is one."""
    name, sign, home = text.rpartition("@")
    if not sign:
        return parse_spec(text), None
    check_choice("world", home, worlds)
    return parse_spec(name), home


@error_lines()
def main(arguments: list[str]) -> None:
    parser = make_parser(__doc__, "results/transfer")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--task", choices=TASKS, default="T3")
    parser.add_argument("--spoofer", action="append", required=True, help="NAME[@WORLD]")
    parser.add_argument("--world", action="append", default=[], help="NAME=JSON")
    given = parser.parse_args(arguments)
    changes = {HOME: {}, **dict(map(_world, given.world))}
    spoofers = [_spoofer(text, changes) for text in given.spoofer]
    worlds = evaluators(given.task, changes, **get_sizes(given, given.seed))
    rows = table(worlds, spoofers, given.out, progress)
    if given.json:
        print_json(rows)
    else:
        Table.of_texts(*HEAD).print(f"transfer in the world of {given.task}", map(line, rows))


if __name__ == "__main__":
    main(sys.argv[1:])
