"""What feedback gains over the blind optimum, against every detector of the standard suite.

    python -m tools.feedback_gain                      # all of them, into results/feedback
    python -m tools.feedback_gain aime ewma --json     # those whose name has this in it
    python -m tools.feedback_gain --task T2            # the detector of a task, with a search

The curve of the blind optimum is that of docs/headlines.json, or is searched for in a task.  On the
same training runs the amplitude is fitted of that curve, played blind, and of `feedback-profile`
and `threshold-rider` along it, each with a few settings, one of which is feedback switched off.
The best of each kind there plays the evaluation runs, once.  All runs are fresh ones, of another
seed than those of the headlines, and the gain is paired, run by run.  The zero-alarm bound says how
much room there is above the blind optimum: none where no attack gets farther.

Killed, it goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from agents.folder import error_lines
from agents.seeds import marked
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.experiments.identity import versions
from spoofgym.bench.report.table import interval, number, titled
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.scores.campaign import bound_of
from spoofgym.bench.scores.spoofer import Score
from spoofgym.cli.output import print_json, print_table, progress
from spoofgym.core.files import write_file
from spoofgym.core.settings import digest_of
from spoofgym.tasks import task_of
from tools.headlines import KEPT

BLIND, WORLD = "blind-optimum", "trolley"
FEEDBACK, RIDER = "feedback-profile", "threshold-rider"
RATIOS = ((0.3, 1.0), (0.7, 1.15), (0.7, 2.0))
"""`full_ratio` and `zero_ratio` that are tried."""
OFF = {"full_ratio": 1.0, "zero_ratio": 1.01, "back": 0.0}
"""Nothing is held back: the curve as it is, up to the first alarm."""
RIDES = ((1.15, 20.0),)
"""`margin` and `horizon_s` that are tried."""
REACHED = 0.98
"""Part of the farthest reach of the attack from which on there is no room."""
HEAD = ("detector", "blind optimum [m]", "spoofer", "settings", "[m]", "times as far", "bound [m]")


def candidates(rates_mps: list[float]) -> dict[str, list[dict[str, Any]]]:
    """Spoofers along a curve, by their kind, with all settings that are tried."""
    curve = {"rates_mps": rates_mps}
    ratios = [{"full_ratio": full, "zero_ratio": zero, "back": 0.0} for full, zero in RATIOS]
    rides = [{"margin": margin, "horizon_s": horizon} for margin, horizon in RIDES]
    return {
        BLIND: [{"name": BLIND, **curve}],
        FEEDBACK: [{"name": FEEDBACK, **curve, **each} for each in ratios],
        RIDER: [{"name": RIDER, **curve, **each} for each in rides],
    }


def played(judge: Evaluator, rates_mps: list[float]) -> dict[str, Any]:
    """Gain of each kind over the blind optimum; feedback may be switched off."""
    found: dict[str, Any] = {"rates_mps": rates_mps}
    fits = {
        kind: [(judge.fit(spec), spec) for spec in specs]
        for kind, specs in candidates(rates_mps).items()
    }
    blind, _ = fits[BLIND][0]
    fits[FEEDBACK].append((blind, {"name": FEEDBACK, "rates_mps": rates_mps, **OFF}))
    scores: dict[str, Score] = {}
    for kind, tried in fits.items():
        fit, spec = max(tried, key=lambda each: each[0].score)
        scores[kind] = judge.score(spec, amplitude=fit.value)
        found[kind] = {
            **scores[kind].as_dict(),
            "settings": {key: x for key, x in spec.items() if key not in ("name", "rates_mps")},
            "amplitude": fit.value,
            "training_m": {_words(each): one.score for one, each in tried},
            "ratio": scores[kind].ratio_to(scores[BLIND], oracles=True).as_json(),
        }
    return found


def _words(spec: dict[str, Any]) -> str:
    """Settings along a curve."""
    return ", ".join(f"{key} {x:g}" for key, x in spec.items() if key not in ("name", "rates_mps"))


def headline(text: str) -> dict[str, dict[str, Any]]:
    """Detectors of the standard suite whose name has a text in it: spec, curve, bound, reach."""
    world = json.loads(KEPT.read_text())["worlds"][WORLD]
    brackets = {row["detector"]: row["bracket"] for row in world["detectors"]}
    reach = brackets["never"]["zero_alarm"]["value"]
    found = {}
    for cell in world["cells"]:
        label = cell["detector"]
        if cell["spoofer"] == BLIND and text in label:
            found[label] = {
                "rates_mps": cell["spoofer_settings"]["rates_mps"],
                "blind_m": cell["stealthy_displacement_m"],
                "bound": brackets[label]["zero_alarm"],
                "room": cell["stealthy_displacement_m"]["value"] < REACHED * reach,
            }
    return found


def cases(names: list[str], task: str | None) -> dict[str, dict[str, Any]]:
    """What is to be played, by the detector's label."""
    if task is not None:
        return {specify_detector(task_of(task).detector).label: {"room": True}}
    found: dict[str, dict[str, Any]] = {}
    for name in names or [""]:
        chosen = headline(name)
        if not chosen:
            raise ValueError(f"no detector of {KEPT.name} has {name!r} in its name")
        found |= chosen
    return found


def case_of(label: str, case: dict[str, Any], given: argparse.Namespace) -> dict[str, Any]:
    """Play one detector."""
    if not case["room"]:
        return case
    sizes = {"runs": given.runs, "fit_runs": given.fit_runs, "entropy": given.seed}
    if given.task is not None:
        judge = Evaluator(given.task, threads=given.threads, **sizes)
    else:
        world = task_of("T3").world_kwargs
        judge = Evaluator(detector=spec_of(label), threads=given.threads, **sizes, **world)
    rates = case.get("rates_mps")
    if rates is None:
        searched = judge.fit(BLIND).found
        assert searched is not None  # as of every blind optimum
        rates = searched["played"]["rates_mps"]
        bound = judge.optima.brackets.zero_alarm(judge.detector).as_json()
        case = {**case, "bound": bound_of(bound)}
    return {**case, **played(judge, rates)}


def spec_of(label: str) -> dict[str, Any]:
    """Settings of a detector of the standard suite."""
    from spoofgym.cli.bench import standard_suite

    suite = standard_suite(None, {"spoofers": []})
    (found,) = (entry.spec for entry in suite.detector_entries if entry.label == label)
    return dict(found)


def rows(label: str, found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table for one detector; `*` marks what is over the budget."""
    value = found["bound"]["value"]
    bound = "none" if value is None else number(value)
    if not found["room"]:
        return [(label, interval(found["blind_m"]), "-", "-", "-", "no room", bound)]
    blind = marked(found[BLIND])
    lines = []
    for kind in (FEEDBACK, RIDER):
        own = found[kind]
        settings = f"{_words(own['settings'])}, amplitude {own['amplitude']:.4g}"
        who = titled(kind, own["knowledge"])
        lines.append((label, blind, who, settings, marked(own), _ratio(own), bound))
    return lines


def _ratio(own: dict[str, Any]) -> str:
    return "{value:.2f} ({low:.2f} to {high:.2f})".format(**own["ratio"])


def run(arguments: list[str]) -> None:
    """Play what is missing, and print it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("detectors", nargs="*", help="parts of their names; by default all")
    parser.add_argument("--task", help="the detector of a task instead, T1 to T6")
    parser.add_argument("--out", type=Path, default=Path("results/feedback"))
    parser.add_argument("--runs", type=int, default=400, help="evaluation runs")
    parser.add_argument("--fit-runs", type=int, default=128, help="training runs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    whom = cases(given.detectors, given.task)
    found, fixed = {}, [RATIOS, RIDES, OFF, versions()]
    with progress(len(whom)) as bar:
        for label, case in whom.items():
            asked = [label, case, given.task, given.runs, given.fit_runs, given.seed]
            path = given.out / f"{digest_of([*asked, *fixed])}.json"
            if not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                kept = case_of(label, case, given)
                write_file(path, (json.dumps(kept, allow_nan=False) + "\n").encode())
            found[label] = json.loads(path.read_text())
            bar.advance(1.0, label)
    if given.json:
        print_json(found)
    else:
        lines = [row for label, each in found.items() for row in rows(label, each)]
        print_table(f"feedback, seed {given.seed}, {given.runs} runs", HEAD, lines)


def main(arguments: list[str]) -> None:
    """Command line."""
    with error_lines():
        run(arguments)


if __name__ == "__main__":
    main(sys.argv[1:])
