"""Play the tasks of spoofgym-bench-v2, hold them against the admission test, keep their cards.

    python -m tools.task_cards                  # plays what is missing, into results/tasks
    python -m tools.task_cards S2 --entropy 1   # one of them, on other runs
    python -m tools.task_cards S1 --campaign results/headlines/S1   # from the standard suite

The conditions of the test are those of docs/tasks.md, on evaluation runs, which decide nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofgym.bench.experiments import Store, run_experiment
from spoofgym.bench.experiments.calibration import calibrate_players
from spoofgym.bench.experiments.campaign import Campaign, CampaignResults, summarize
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.report import tasks
from spoofgym.bench.runs.players import add_tuned_setting, specify_detector
from spoofgym.bench.scores.campaign import extract_name
from spoofgym.bench.search.amplitude import EXACT, Tuning
from spoofgym.bench.search.attack_suite import Selection
from spoofgym.cli.app import progress
from spoofgym.core.settings import describe
from spoofgym.detectors.calibrated import STANDARD_RATE
from spoofgym.simulation.domain import draw
from spoofgym.simulation.simulator import episode_seeds
from spoofgym.tasks import TASKS, Task, get_task
from spoofgym.tasks.v2 import TASKS as PLAYED
from spoofgym.truth.sensors import draw_source_keys
from tools.pages import DOCS, ROOT, fit_tables, keep_cards, put_between, render_page

CARD_FILE, PAGE = ROOT / "spoofgym" / "bench" / tasks.FILE, DOCS / "tasks.md"
START, END = "<!-- cards:begin -->", "<!-- cards:end -->"
RATE = {"false_alarms_per_hour": STANDARD_RATE}
TRIVIAL = {"name": "shewhart", "signals": "range_rate", **RATE}
"""A threshold on each satellite's range-rate innovation of one epoch."""
NON_LEARNED: tuple[dict[str, Any], ...] = tuple(
    {"name": name, "signals": "range_rate", **RATE}
    for name in ("aime", "sequential-chi2", "cumulative-bank")
)
"""Together with a task's own detector, and the same on the victim's filter."""
SPOOFERS = ("ramp", "accelerating-ramp", "open-loop", "feedback")
EXCEEDED = ("value", "low", "high", "letter", "spoofer")
MEASURE = "undetected_displacement_m"
HAZARDOUS, HAZARDOUS_THEN = (0.1, 0.9), (0.05, 0.95)
"""P(HMI) over all ages, and at some."""
AGES_S = {"at 10 min": (300.0, 1200.0), "at 1 h": (2400.0, 3600.0)}
WITHIN, ALIKE, TRIVIALLY = 3.0, 3.0, 1.1
DEALS = 200
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def list_classics(task: Task) -> list[dict[str, Any]]:
    """Detectors of a task's card: its own first, then on the victim's filter, then others."""
    own = task.detector
    plain = {key: value for key, value in own.items() if key != "filter"}
    return [own, plain, *map(dict, NON_LEARNED), dict(TRIVIAL)]


def build_suite(task: Task, sizes: dict[str, int]) -> Suite:
    settings = {**task.suite_kwargs, "detectors": list_classics(task)}
    return Suite(
        **settings,
        spoofers=[add_tuned_setting({"name": name}) for name in SPOOFERS],
        runs=sizes["runs"],
        entropy=sizes["entropy"],
        tuning=Tuning(runs=sizes["training"], sift_runs=sizes["training"] // 4, rule=EXACT),
        selection=Selection(runs=sizes["selection"], sift_runs=max(sizes["selection"] // 4, 1)),
        notes=(f"task {task.key} of {task.suite}",),
    )


def play_task(task: Task, out: Path, sizes: dict[str, int]) -> dict[str, Any]:
    suite = build_suite(task, sizes)
    calibrate_players(suite.world, suite.detector_players, progress=progress)
    suite.check_fit()
    campaign = Campaign(suite)
    reader = run_experiment(campaign, Store(out / task.key), progress=progress)
    return make_card(task, campaign.results(reader), find_ages(suite))


def read_campaign(task: Task, folder: Path) -> dict[str, Any]:
    """Card of a task from a finished campaign in its world, such as the standard suite."""
    results = CampaignResults.load(folder)
    config = results.config
    suite = Suite(**task.suite_kwargs, runs=config["runs"], entropy=config["entropy"])
    if suite.world.config != {key: config[key] for key in suite.world.config}:
        raise ValueError(f"the campaign in {folder} was not played in the world of {task.key}")
    return make_card(task, results, find_ages(suite))


def find_ages(suite: Suite) -> FloatArray:
    """(R,) age of the receiver at the onset of the evaluation runs [s]."""
    setup = suite.world.setup
    seeds = episode_seeds(suite.generators("evaluation", suite.runs))
    drawn = draw(setup.bounds, draw_source_keys(seeds)["domain"])
    return np.asarray(drawn.age * setup.interval_s, dtype=np.float64)


def make_card(task: Task, results: CampaignResults, age_s: FloatArray) -> dict[str, Any]:
    summary = summarize(results)
    own = specify_detector(task.detector).label
    detectors = {row["detector"]: row for row in summary["detectors"]}
    scores = {
        extract_name(cell["spoofer"]): make_score(cell)
        for cell in summary["cells"]
        if cell["detector"] == own
    }
    floor = summary["limits"]["floor"]
    card = {
        "campaign": summary["campaign"],
        "runs": summary["runs"],
        "entropy": results.config["entropy"],
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
        "optima_mps": list_optima(summary),
    }
    card["admission"] = admission(task, summary, results, card, age_s)
    described: dict[str, Any] = describe(card)
    return described


def list_optima(summary: dict[str, Any]) -> dict[str, list[float]]:
    """Rates of open-loop attacks at their knots, by the detectors that they were found against."""
    rates = {
        cell["detector"]: cell["spoofer_settings"]["rates_mps"]
        for cell in summary["cells"]
        if extract_name(cell["spoofer"]) == "open-loop"
    }
    return {label: each for label, each in rates.items() if len(set(each)) > 1}  # no mere ramps


def make_score(cell: dict[str, Any]) -> dict[str, Any]:
    keeps = bool(cell["within_budget"]) and cell["tuned_within_budget"] is not False
    score = cell["stealthy_displacement_m"]
    return {**score, "alarm_rate": cell["alarm_rate"]["value"], "within_budget": keeps}


def get_median_limit(card: dict[str, Any], detector: str) -> float:
    return float(card["protection_m"][detector]["0.5"]["value"])


def admission(
    task: Task,
    summary: dict[str, Any],
    results: CampaignResults,
    card: dict[str, Any],
    age_s: FloatArray,
) -> dict[str, Any]:
    """The figures that a task has to have, whether each is as it has to be, and those that it may
    have."""
    trivial = specify_detector(TRIVIAL).label
    classics = [name for name in card["protection_m"] if name != trivial]
    best = min(classics, key=lambda name: get_median_limit(card, name))
    half, floor = get_median_limit(card, best), card["floor_m"]
    cells = {
        extract_name(cell["spoofer"]): float(cell["stealthy_displacement_m"]["value"] or 0.0)
        for cell in summary["cells"]
        if cell["detector"] == best
    }
    limit = float(task.alert_limit_m or 0.0)  # which all of this suite have
    found = results.protection(best)
    assert found is not None  # every detector of the campaign has met the suite
    sky, age_s = found.sky[found.counts], age_s[found.counts]
    moved = [winner.displacement[MEASURE][found.counts] for winner in found.winners]

    def hazard(rows: NDArray[np.bool_]) -> float:
        return max(float((x[rows] > limit).mean()) for x in moved)

    figures = {
        "p_hmi": (hazard(age_s > 0.0), *HAZARDOUS),
        **{
            f"p_hmi {name}": (hazard((age_s >= low) & (age_s <= high)), *HAZARDOUS_THEN)
            for name, (low, high) in AGES_S.items()
        },
        "limit_over_half": (limit / floor["half"]["value"], 1.0 / WITHIN, WITHIN),
        "skies": (spread(moved, sky), 0.0, ALIKE),
        "trivial_over_best": (get_median_limit(card, trivial) / half, TRIVIALLY, math.inf),
    }
    return {
        "best_classic": best,
        "half_m": half,
        "alert_limit_m": limit,
        "skies_by_chance": dealt(moved, sky),
        "over_floor": half / floor["half"]["value"],
        "optimum_over_accelerating": cells["open-loop"] / cells["accelerating-ramp"],
        "figures": {
            name: {"value": x, "passes": bool(low <= x <= high)}
            for name, (x, low, high) in figures.items()
        },
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


def shown() -> str:
    page = render_page(
        "tasks.md.j2",
        scores=tasks.TASK_SCORES.markdown(tasks.task_rows()),
        admission=tasks.ADMISSION.markdown(tasks.admission_rows()),
        cards={key: card for key, card in tasks.stored_cards().items() if key in PLAYED},
        missing={key: command for key, command in tasks.missing().items() if key in PLAYED},
    )
    return fit_tables(page)


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("tasks", nargs="*", help=f"of {', '.join(PLAYED)}; by default all")
    parser.add_argument("--out", type=Path, default=Path("results/tasks"))
    parser.add_argument("--runs", type=int, default=500, help="evaluation runs of every cell")
    parser.add_argument("--training-runs", type=int, default=192, help="of which a quarter sifts")
    parser.add_argument("--selection-runs", type=int, default=96)
    parser.add_argument("--entropy", type=int, default=0, help="of all runs")
    parser.add_argument("--campaign", type=Path, help="finished one in the world of one task")
    parser.add_argument("--tables-only", action="store_true", help="play nothing")
    given = parser.parse_args(arguments)
    sizes = {name: getattr(given, f"{name}_runs") for name in ("training", "selection")}
    sizes |= {"runs": given.runs, "entropy": given.entropy}
    for key in () if given.tables_only else given.tasks or PLAYED:
        card = (
            read_campaign(get_task(key), given.campaign)
            if given.campaign
            else play_task(get_task(key), given.out, sizes)
        )
        keep_cards(CARD_FILE, {**tasks.stored_cards(), key: card}, TASKS)
        print(key, json.dumps(card.get("admission"), indent=1), flush=True)
    put_between(PAGE, START, END, shown())


if __name__ == "__main__":
    main(sys.argv[1:])
