r"""Spoofers trained in one world and played in another: detectors, flights, skies, sensors.

    python -m tools.transfer --task T3 --spoofer ramp --spoofer blind-optimum \
        --world 'aime={"detector": {"name": "aime", "signals": "range_rate"}}' \
        --world 'consumer={"scenario": "trolley-consumer"}'

A world is a name and what it changes in the task, as keyword arguments of an environment; the task
itself is the world `home`.  Each spoofer is trained in each of the worlds: its amplitude is fitted
there, and the curve of a blind optimum is searched for there.  One with a world behind its name,
such as `runs/mine.onnx@home`, has been trained in that one.  It is then played in all worlds,

- with the amplitude *as fitted at home*, and
- with the amplitude *refitted* in the world that it is played in,

both in times of the *native*, the same spoofer trained where it is played, run by run.  An
amplitude that is not refitted may break the alarm budget, which is marked: its displacement is no
score then.  Killed, it goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from agents.folder import error_lines
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.experiments.identity import versions
from spoofgym.bench.report.table import interval
from spoofgym.bench.runs.players import fitted, specify_spoofer
from spoofgym.bench.scores.spoofer import Score
from spoofgym.bench.search.amplitude import with_rates
from spoofgym.cli.output import print_json, print_table, progress
from spoofgym.core.files import write_file
from spoofgym.core.progress import ProgressCallback
from spoofgym.core.registry import check_choice, parse_spec
from spoofgym.core.settings import digest_of
from spoofgym.tasks import TASKS, task_of

HOME = "home"
HEAD = ("spoofer", "trained on", "played against", "as fitted at home", "refitted")
Row = dict[str, Any]


class Worlds:
    """Evaluators of all worlds, each made when it is first used."""

    def __init__(self, task: str, changes: Mapping[str, Mapping[str, Any]], **sizes: Any) -> None:
        base = {**task_of(task).world_kwargs, "detector": task_of(task).detector}
        self.settings = {name: {**base, **change} for name, change in changes.items()}
        self.sizes, self.versions = sizes, versions()
        self.judge: Callable[[str], Evaluator] = cache(self._judge)

    def _judge(self, name: str) -> Evaluator:
        return Evaluator(**self.settings[name], **self.sizes)

    def digest(self, name: str, *more: Any) -> str:
        """Digest of a world, the runs in it, and of what is done there."""
        sizes = {key: value for key, value in self.sizes.items() if key != "threads"}
        return digest_of([self.settings[name], sizes, self.versions, *more])


class Kept:
    """Results in a folder, by a digest of what they are of."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(self, digest: str, make: Callable[[], Row]) -> Row:
        """What is there, else what is made now."""
        path = self.folder / f"{digest}.json"
        if not path.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            write_file(path, (json.dumps(make(), allow_nan=False) + "\n").encode())
        found: Row = json.loads(path.read_text())
        return found


def trained(judge: Evaluator, spec: Row) -> Row:
    """Spec as it comes out of its training in a world, with what is fitted at its value."""
    entry = specify_spoofer(fitted(spec))
    if entry.tuned is None:
        return dict(entry.spec)
    found = judge.fit(entry.spec)
    if found.found is not None:
        entry = with_rates(entry, found.found["played"]["rates_mps"])
    return {**entry.with_value(found.value), "fitted": entry.tuned}


def unfitted(spec: Row) -> Row:
    """Spec whose fitted setting is open again; the rest of the training stays."""
    plain = {key: value for key, value in spec.items() if key != "fitted"}
    return {**plain, spec["fitted"]: "tuned"} if "fitted" in spec else plain


def as_trained(spec: Row) -> Row:
    """Spec to be played as it is."""
    return {key: value for key, value in spec.items() if key != "fitted"}


def case_of(judge: Evaluator, spec: Row, native: Row) -> Row:
    """Score of a trained spoofer in a world, its amplitude as it is and refitted."""
    best = _score(judge, as_trained(native))
    scores = {
        "as fitted at home": _score(judge, as_trained(spec)),
        "refitted": judge.score(unfitted(spec)),
    }
    found: Row = {
        name: {**score.as_dict(), "of_native": score.ratio_to(best, oracles=True).as_json()}
        for name, score in scores.items()
    }
    if "fitted" in spec:
        found["as fitted at home"]["value"] = spec[spec["fitted"]]
    return {"detector": judge.detector.label, "knowledge": best.knowledge, **found}


def _score(judge: Evaluator, spec: Row) -> Score:
    return judge.score(spec, amplitude=None)


def table(
    worlds: Worlds, spoofers: list[tuple[Row, str | None]], kept: Kept, bar: ProgressCallback
) -> list[Row]:
    """All cases: each spoofer, from each of its homes, in each world."""
    names, rows = list(worlds.settings), []

    def learned(spec: Row, home: str) -> Row:
        digest = worlds.digest(home, "trained", spec)
        return kept(digest, lambda: trained(worlds.judge(home), spec))

    for spec, only in spoofers:
        for home in names if only is None else [only]:
            for there in names:
                one, native = learned(spec, home), learned(spec, there)
                digest = worlds.digest(there, "played", one, native)
                found = kept(digest, lambda: case_of(worlds.judge(there), one, native))  # noqa: B023
                label = specify_spoofer(fitted(spec)).label
                rows.append({"spoofer": label, "home": home, "world": there, **found})
                bar.advance(1.0, f"{label}, {home} -> {there}")
    return rows


def line(row: Row) -> tuple[str, ...]:
    """Row of the table."""
    who = f"{row['spoofer']} ({row['knowledge']})"
    parts = [_part(row[name]) for name in HEAD[3:]]
    return (who, row["home"], f"{row['world']}: {row['detector']}", *parts)


def _part(found: Row) -> str:
    ratio = found["of_native"]
    times = (
        "-" if ratio["value"] is None else "{value:.2f} ({low:.2f} to {high:.2f})".format(**ratio)
    )
    keeps = found["within_budget"] and found["fit_within_budget"] is not False
    over = "" if keeps else ", over the budget"
    return f"{times}, {interval(found['stealthy_displacement_m'])} m{over}"


def _world(text: str) -> tuple[str, dict[str, Any]]:
    """Name of a world, and what it changes."""
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


def run(arguments: list[str]) -> None:
    """Play what is missing, and print it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--task", choices=TASKS, default="T3")
    parser.add_argument("--spoofer", action="append", required=True, help="NAME[@WORLD]")
    parser.add_argument("--world", action="append", default=[], help="NAME=JSON")
    parser.add_argument("--out", type=Path, default=Path("results/transfer"))
    parser.add_argument("--runs", type=int, default=400, help="evaluation runs")
    parser.add_argument("--fit-runs", type=int, default=128, help="training runs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    changes = {HOME: {}, **dict(map(_world, given.world))}
    worlds = Worlds(
        given.task,
        changes,
        runs=given.runs,
        fit_runs=given.fit_runs,
        entropy=given.seed,
        threads=given.threads,
    )
    spoofers = [_spoofer(text, changes) for text in given.spoofer]
    cases = sum((len(changes) if home is None else 1) * len(changes) for _, home in spoofers)
    with progress(cases) as bar:
        rows = table(worlds, spoofers, Kept(given.out), bar)
    if given.json:
        print_json(rows)
    else:
        print_table(f"transfer in the world of {given.task}", HEAD, [line(row) for row in rows])


def main(arguments: list[str]) -> None:
    """Command line."""
    with error_lines():
        run(arguments)


if __name__ == "__main__":
    main(sys.argv[1:])
