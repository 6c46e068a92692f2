"""What the action space of offsets is worth: nested open-loop searches at exactly the budget.

    python -m tools.offsets_worth --list               # what it plays, and its CPU minutes
    python -m tools.offsets_worth                      # all of it, into results/offsets
    python -m tools.offsets_worth shewhart ewma --captured "5 of 8"
    python -m tools.offsets_worth --page               # the table of docs/offsets.md

In the papers' world, one direction, a false position, this with the common offset, and all
satellites are searched on the linear response, each from the one before; what is found is played on
the engine beside ramps, at exactly the alarm budget.  Ratios are paired, both amplitudes fitted
again in every draw.  A detector that takes weight off measurements is searched for as the passive
chart that it is without weights.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from agents.folder import Part, Records, error_lines, write_json
from baselines.offset_search import (
    SPACES,
    OffsetsBackend,
    OffsetsOptimizer,
    OffsetsReplay,
    coherent_curve,
    unseen_ramp,
)
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.at_budget import AlarmCurve, ratio_at_budget
from spoofgym.bench.scores.statistics import BUDGET
from spoofgym.bench.search.amplitude import EXACT
from spoofgym.bench.search.open_loop import PLAIN, SHAPES, SPLIT, OpenLoopSearch
from spoofgym.cli.app import print_json, progress
from spoofgym.simulation.setup import seeds_of_runs
from spoofgym.simulation.simulator import weighs
from spoofgym.simulation.tight import TightlyCoupledSetup

from .pages import DOCS, fit_tables, marks, put_between
from .scored import get_sizes, make_parser

PAGE, DATA_FILE = DOCS / "offsets.md", DOCS / "offsets.json"
MARKS = marks("offsets-worth")
WORLD, RATE_MPS = "zhong2025", 5.0
ALL, UNSEEN = "all", "unseen ramp"
CAPTURED = ("5 of 8", "4 of 8", ALL)
SEPARATION = {"name": "solution-separation", "filter": "augmented"}
DETECTORS: dict[str, dict[str, Any]] = {
    **{name: {"name": name} for name in ("shewhart", "ewma", "joint-chart", "snapshot-chi2")},
    "raim": {"name": "raim"},
    "solution-separation(filter=augmented)": SEPARATION,
}
SEARCH = OpenLoopSearch(runs=192, batch=96, generations=40)
MINUTES = 4.0  # of a core that a case takes, roughly, at 1024 runs
START_MPS = 0.5  # of a ramp at the amplitude 1
HEAD = (
    *("detector", "captured", "east ramp [m]", "accelerating ramp [m]", "unseen ramp [m]"),
    *("direction [m]", "position [m]", "with clock [m]", "satellites [m]"),
    *("satellites over position", "satellites over position and clock"),
)


def make_judge(detector: Mapping[str, Any], captured: str, **sizes: Any) -> Evaluator:
    attack: dict[str, Any] = {"name": "offsets", "basis": "rotated", "scales_mps": [RATE_MPS] * 3}
    attack |= {"channels": captured, "rate_limit_mps": RATE_MPS}
    return Evaluator(detector=detector, scenario=WORLD, attack=attack, rule=EXACT, **sizes)


def search(judge: Evaluator, captured: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Rates (a, Q) [m/s] of the attacks that are played, and what the searches say of theirs."""
    setup, detector = judge.world.setup, judge.world.judge(judge.detector)
    assert isinstance(setup, TightlyCoupledSetup)  # as in the papers' world
    if weighs(setup, detector):
        passive = {**judge.detector.spec, "weight_scale": None, "thresholds": "nominal"}
        passive.pop("false_alarms_per_hour", None)
        detector = judge.world.judge(specify_detector(passive))
    seeds = seeds_of_runs(judge.entropy, SPLIT, setup.name, range(SEARCH.runs))
    replay = OffsetsReplay(setup, [detector], seeds, threads=judge.threads)
    knots = replay.knots
    t = np.linspace(0.0, 1.0, knots)
    east = {name: coherent_curve(setup, knots, "east", f(t)) for name, f in SHAPES.items()}
    played = {name: START_MPS * east[name] for name in PLAIN}
    told, starts = {}, dict(east)
    if captured != ALL:
        taken = np.flatnonzero(setup.attack.select_channels(setup.world))
        played[UNSEEN] = START_MPS * unseen_ramp(setup, taken, int(replay.onset[0]), knots)
    for space in SPACES:
        if "clock" in space and UNSEEN in played:
            starts[UNSEEN] = played[UNSEEN]
        own = OffsetsOptimizer(OffsetsBackend(replay, 0, space), BUDGET, SEARCH)
        found = own.search_from(starts)
        played[space], starts = found.rates_mps, {"the space before": found.rates_mps}
        told[space] = {"start": found.start, "start_m": found.start_m, "m": found.displacement_m}
    return {name: rates.reshape(-1, knots) for name, rates in played.items()}, told


def play_case(detector: Mapping[str, Any], captured: str, **sizes: Any) -> dict[str, Any]:
    """Scores at the budget of rivals and of what was found, and ratios."""
    judge = make_judge(detector, captured, **sizes)
    rates, told = search(judge, captured)
    scores: dict[str, Any] = {}
    traces: dict[str, AlarmCurve] = {}
    for name, each in rates.items():
        curves = np.round(each / RATE_MPS, 7).tolist()
        same = next((x for x, one in scores.items() if one["curves"] == curves), None)
        if same is not None:  # the search has found nothing better
            scores[name], traces[name] = scores[same], traces[same]
            continue
        fit = judge.fit({"name": "action-curves", "curves": curves})
        assert fit.trace is not None
        assert fit.at_budget is not None
        traces[name] = fit.trace
        scores[name] = {**fit.at_budget, "curves": curves, "value": fit.value}
    ratios = {
        f"{name} / {other}": ratio_at_budget(traces[name], traces[other], BUDGET).as_json()
        for other in traces
        for name in SPACES
        if name != other
    }
    return {"scores": scores, "ratios": ratios, "search": told, "captured": captured}


def rows(label: str, found: Mapping[str, Any]) -> tuple[str, ...]:
    scores = {name: each[MEASURES[0]] for name, each in found["scores"].items()}
    cells = [interval(scores[x]) if x in scores else "-" for x in (*PLAIN, UNSEEN, *SPACES)]
    ratios = [found["ratios"][f"satellites / {x}"] for x in ("position", "position+clock")]
    words = [interval(each, 2) for each in ratios]
    return (f"`{label.partition(',')[0]}`", found["captured"], *cells, *words)


def build_table(kept: Mapping[str, Any]) -> str:
    lines = [rows(label, each) for label, each in kept["cases"].items()]
    return fit_tables(f"{Table.of_texts(*HEAD).markdown(lines)}\n")


@error_lines()
def main(arguments: list[str]) -> None:
    parser = make_parser(__doc__, "results/offsets", fit_runs=1024)
    parser.set_defaults(runs=1024)
    parser.add_argument("detectors", nargs="*", help="parts of their names; by default all")
    parser.add_argument("--captured", nargs="*", default=CAPTURED, choices=CAPTURED)
    parser.add_argument("--list", action="store_true", help="what is played, and its CPU minutes")
    parser.add_argument("--page", action="store_true", help="put what is finished on the page")
    given = parser.parse_args(arguments)
    sizes = get_sizes(given, 0)
    fixed = {name: each for name, each in sizes.items() if name != "threads"}
    names = [x for x in DETECTORS if any(part in x for part in given.detectors or [""])]
    cases = {
        f"{name}, {each}": (DETECTORS[name], each) for each in given.captured for name in names
    }
    if given.list:
        for label in cases:
            print(f"{label}: about {MINUTES * given.runs / 1024:.1f} CPU minutes")
        return
    parts = {
        label: Part(
            {**fixed, "case": case, "search": asdict(SEARCH)},
            lambda *_, x=case: play_case(*x, **sizes),
        )
        for label, case in cases.items()
    }
    found = Records("offsets", {}, parts).play(given.out, progress)
    if given.json:
        print_json(found)
    if given.page:
        kept = json.loads(DATA_FILE.read_text()) if DATA_FILE.exists() else {"cases": {}}
        kept |= {"world": WORLD, "runs": given.runs, "cases": {**kept["cases"], **found}}
        write_json(DATA_FILE, kept)
        put_between(PAGE, *MARKS, build_table(kept))
    Table.of_texts(*HEAD).print(
        f"offsets, {given.runs} runs", [rows(label, each) for label, each in found.items()]
    )


if __name__ == "__main__":
    main(sys.argv[1:])
