"""Play the tasks of spoofgym-bench-v1, hold T3 to T6 against the admission test, keep their cards.

    python -m tools.task_cards                  # plays what is missing, into results/tasks
    python -m tools.task_cards T4 --seeds 500   # one of them
    python -m tools.task_cards --tables-only    # docs/tasks.md again from the cards

The admission test, on evaluation runs: with the best classic, the detector against which the worst
attack of the suite gets the least far in half of the runs,

1. that attack gets at least twice as far as the floor (heading unknown, P_D 50 %);
2. the blind optimum gets at least 1.2 times as far as the best ramp of a constant rate;
3. P(HMI | attack) at the alert limit is between 10 and 90 %;
4. the 10th and the 90th percentile of the skies differ by at most a factor of 3, by their mean
   undetected displacement, where each sky has the attack of those found that gets farthest there;
   what the same runs give with their skies dealt out by chance is kept with it;
5. a test that needs no filter's memory, each satellite's range rate against a threshold, allows
   at least 1.1 times as much.

Killed, it goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofgym.bench.experiments import Store, run
from spoofgym.bench.experiments.calibration import calibrate_entries, missing_runs
from spoofgym.bench.experiments.campaign import Campaign, CampaignResults, summarize
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.report.campaign import markdown_table
from spoofgym.bench.report.tasks import (
    ADMISSION_HEAD,
    FILE,
    HEAD,
    admission_rows,
    score_rows,
    stored_cards,
)
from spoofgym.bench.runs.players import fitted, specify_detector
from spoofgym.bench.search.amplitude import Tuning
from spoofgym.bench.search.attack_suite import Selection
from spoofgym.cli.output import progress
from spoofgym.core.files import write_file
from spoofgym.core.settings import describe
from spoofgym.detectors.calibrated import STANDARD_RATE
from spoofgym.tasks import SUITE, TASKS, Task, task_of
from tools.pages import put_between

ROOT = Path(__file__).resolve().parents[1]
KEPT, PAGE = ROOT / "spoofgym" / "bench" / FILE, ROOT / "docs" / "tasks.md"
BEGIN, END = "<!-- cards:begin -->", "<!-- cards:end -->"
RATE = {"false_alarms_per_hour": STANDARD_RATE}
TRIVIAL = {"name": "shewhart", "signals": "range_rate", **RATE}
"""A threshold on each satellite's range-rate innovation of one epoch."""
CLASSICS = tuple(
    {"name": name, "signals": "range_rate", **RATE}
    for name in ("aime", "sequential-chi2", "cumulative-bank")
)
"""Together with a task's own detector; the tests of range rates that do best."""
SPOOFERS = ("ramp", "accelerating-ramp", "snapshot-chi2-profile", "blind-optimum", "feedback")
EXCEEDED = ("value", "low", "high", "letter", "spoofer")
MEASURE = "undetected_displacement_m"
TWICE, OPTIMISED, ALIKE, TRIVIALLY = 2.0, 1.2, 3.0, 1.1
HAZARDOUS = (0.1, 0.9)
DEALS = 200
FloatArray, IntArray = NDArray[np.float64], NDArray[np.int64]


def suite_of(task: Task, sizes: dict[str, int]) -> Suite:
    """The campaign of a task: its detector, and the classics where it has to be admitted."""
    whom: tuple[dict[str, Any], ...] = (task.detector,)
    if not task.historical:
        own = {specify_detector(spec).label for spec in whom}
        # the members of a pool are its classics
        others = (TRIVIAL,) if task.pooled else (*CLASSICS, TRIVIAL)
        whom = (*whom, *(spec for spec in others if specify_detector(spec).label not in own))
    limit = {} if task.alert_limit_m is None else {"alert_limit_m": task.alert_limit_m}
    return Suite(
        **task.world_kwargs,
        **limit,
        detectors=whom,
        spoofers=[fitted({"name": name}) for name in SPOOFERS],
        runs=sizes["seeds"],
        tuning=Tuning(runs=sizes["training"], sift_runs=max(sizes["training"] // 16, 1)),
        selection=Selection(runs=sizes["selection"], sift_runs=max(sizes["selection"] // 4, 1)),
        notes=(f"task {task.key} of {SUITE}",),
    )


def played(task: Task, out: Path, sizes: dict[str, int]) -> dict[str, Any]:
    """Play a task, and return its card."""
    suite = suite_of(task, sizes)
    world, whom = suite.world, suite.detector_entries
    with progress(max(missing_runs(world, whom), 1)) as bar:
        calibrate_entries(world, whom, progress=bar)
    suite.check_fit()
    campaign = Campaign(suite)
    reader = run(campaign, Store(out / task.key), progress=progress)
    return card_of(task, campaign.results(reader))


def card_of(task: Task, results: CampaignResults) -> dict[str, Any]:
    """What is kept of a task's campaign."""
    summary = summarize(results)
    own = specify_detector(task.detector).label
    detectors = {row["detector"]: row for row in summary["detectors"]}
    scores = {name_of(cell): score_of(cell) for cell in summary["cells"] if cell["detector"] == own}
    floor = summary["limits"]["floor"]
    card = {
        "campaign": summary["campaign"],
        "runs": summary["runs"],
        "detector": own,
        "alert_limit_m": task.alert_limit_m,
        "scores_m": scores,
        "floor_m": floor["floor_m"],
        "assumptions": floor["assumptions"],
        "bracket": detectors[own]["bracket"],
        "protection_m": {
            row["detector"]: {
                str(each["share"]): {key: each[key] for key in EXCEEDED}
                for each in row["exceeded"]
                if each["measure"] == MEASURE and not each["worst_skies"]
            }
            for row in summary["protection"]
        },
        "optima_mps": optima_of(summary),
    }
    if not task.historical:
        card["admission"] = admission(task, summary, results, card)
    return describe(card)


def optima_of(summary: dict[str, Any]) -> dict[str, list[float]]:
    """Rates of the blind optima at their knots, by the detectors that they were found against."""
    rates = {
        cell["detector"]: cell["spoofer_settings"]["rates_mps"]
        for cell in summary["cells"]
        if name_of(cell) == "blind-optimum"
    }
    return {label: each for label, each in rates.items() if len(set(each)) > 1}  # no mere ramps


def name_of(cell: dict[str, Any]) -> str:
    """Name of a cell's spoofer, without what is fitted."""
    return str(cell["spoofer"].partition("(")[0])


def score_of(cell: dict[str, Any]) -> dict[str, Any]:
    """Score of a spoofer."""
    keeps = bool(cell["within_budget"]) and cell["tuned_within_budget"] is not False
    score = cell["stealthy_displacement_m"]
    return {**score, "alarm_rate": cell["alarm_rate"]["value"], "within_budget": keeps}


def half_of(card: dict[str, Any], detector: str) -> float:
    """What the worst attack exceeds in half of the runs [m]."""
    return float(card["protection_m"][detector]["0.5"]["value"])


def admission(
    task: Task, summary: dict[str, Any], results: CampaignResults, card: dict[str, Any]
) -> dict[str, Any]:
    """The five figures of a task, and whether each is as it has to be."""
    trivial = specify_detector(TRIVIAL).label
    classics = [name for name in card["protection_m"] if name != trivial]
    best = min(classics, key=lambda name: half_of(card, name))
    half, floor = half_of(card, best), card["floor_m"]
    cells = {
        name_of(cell): float(cell["stealthy_displacement_m"]["value"] or 0.0)
        for cell in summary["cells"]
        if cell["detector"] == best
    }
    limit = task.alert_limit_m
    assert limit is not None  # as all that are not historical
    found = results.protection(best)
    assert found is not None  # every detector of the campaign has met the suite
    sky = found.sky[found.counts]
    moved = [winner.displacement[MEASURE][found.counts] for winner in found.winners]
    hazard = max(float((x > limit).mean()) for x in moved)
    skies, by_chance = spread(moved, sky), dealt(moved, sky)
    figures: dict[str, tuple[float, bool]] = {
        "over_floor": _at_least(half / floor["half"]["value"], TWICE),
        "optimum_over_ramp": _at_least(cells["blind-optimum"] / cells["ramp"], OPTIMISED),
        "p_hmi": (hazard, HAZARDOUS[0] <= hazard <= HAZARDOUS[1]),
        "skies": (skies, skies <= ALIKE),
        "trivial_over_best": _at_least(half_of(card, trivial) / half, TRIVIALLY),
    }
    return {
        "best_classic": best,
        "half_m": half,
        "alert_limit_m": limit,
        "limit_over_floor": limit / floor["certain"]["value"],
        "skies_by_chance": by_chance,
        "optimum_over_accelerating": cells["blind-optimum"] / cells["accelerating-ramp"],
        "figures": {name: {"value": x, "passes": ok} for name, (x, ok) in figures.items()},
    }


def spread(moved: list[FloatArray], sky: IntArray) -> float:
    """90th over 10th percentile of the skies' mean displacement, each by its worst attack. A mean,
    since the median of a few runs, each alarmed or not, falls to one side or the other."""
    skies = [max(float(x[sky == each].mean()) for x in moved) for each in np.unique(sky)]
    low, high = np.percentile(skies, (10.0, 90.0))
    return float(high / low)


def dealt(moved: list[FloatArray], sky: IntArray) -> float:
    """Median of that over deals of the skies to the runs by chance: what so few runs give alone."""
    generator = np.random.default_rng(0)
    return float(np.median([spread(moved, generator.permutation(sky)) for _ in range(DEALS)]))


def _at_least(value: float, least: float) -> tuple[float, bool]:
    return value, value >= least


def shown() -> str:
    """Tables of the page."""
    runs = {key: card["runs"] for key, card in stored_cards().items()}
    named = ", ".join(f"{key} {count}" for key, count in runs.items())
    lines = [
        *markdown_table(HEAD, score_rows()),
        "",
        f"Evaluation runs: {named}.",
        "",
        *markdown_table(ADMISSION_HEAD, admission_rows()),
        "",
    ]
    return "\n".join(lines)


def main(arguments: list[str]) -> None:
    """Play tasks, keep their cards, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("tasks", nargs="*", help=f"of {', '.join(TASKS)}; by default all")
    parser.add_argument("--out", type=Path, default=Path("results/tasks"))
    parser.add_argument("--seeds", type=int, default=500, help="evaluation runs of every cell")
    parser.add_argument("--training-seeds", type=int, default=192)
    parser.add_argument("--selection-seeds", type=int, default=96)
    parser.add_argument("--tables-only", action="store_true", help="play nothing")
    given = parser.parse_args(arguments)
    sizes = {name: getattr(given, f"{name}_seeds") for name in ("training", "selection")}
    for key in () if given.tables_only else given.tasks or TASKS:
        card = played(task_of(key), given.out, {**sizes, "seeds": given.seeds})
        kept = {**stored_cards(), key: card}
        kept = {name: kept[name] for name in TASKS if name in kept}
        text = json.dumps(kept, indent=1, allow_nan=False) + "\n"
        write_file(KEPT, text.encode())
        print(key, json.dumps(card.get("admission"), indent=1), flush=True)
    put_between(PAGE, BEGIN, END, shown())


if __name__ == "__main__":
    main(sys.argv[1:])
