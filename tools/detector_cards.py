"""Play the reference scores of the tasks for detectors: ``python -m tools.detector_cards D1``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.bench.experiments.audit import Auditor
from spoofgym.bench.experiments.calibration import calibrate_players
from spoofgym.bench.experiments.suite import list_task_detectors
from spoofgym.bench.report import tasks
from spoofgym.bench.report.table import Table
from spoofgym.bench.runs.players import specify_detector, specify_detectors
from spoofgym.bench.scores.campaign import CONTROLS, extract_name
from spoofgym.bench.scores.detector import DetectorScore
from spoofgym.cli.app import progress
from spoofgym.core.registry import check_choice, format_label
from spoofgym.tasks import DETECTOR_TASKS, DetectorTask, get_detector_task
from tools.pages import DOCS, ROOT, fit_tables, keep_cards, put_between, render_page

CARD_FILE, PAGE = ROOT / "spoofgym" / "bench" / tasks.DETECTOR_FILE, DOCS / "detector_tasks.md"
START, END = "<!-- detector-cards:begin -->", "<!-- detector-cards:end -->"


def play_task(
    task: DetectorTask, out: Path, runs: int, selection_runs: int, only: list[str] | None
) -> dict[str, Any]:
    """Play a task, and return its card; `only` some detectors, and the best classic stored."""
    everyone = {format_label(each, None): each for each in list_task_detectors(task.task)}
    for label in only or ():
        check_choice("detector of this task", label, everyone)
    before = tasks.stored_detector_cards().get(task.key, {})
    best = before.get("best_classic")  # others are compared with it
    chosen = [x for label, x in everyone.items() if only is None or label in {*only, best}]
    evaluator = Auditor(
        task.key, runs=runs, selection_runs=selection_runs, entropy=0, folder=out, threads=1
    )
    world, entries = evaluator.worlds.world, specify_detectors(chosen)
    labels = [each.label for each in entries]
    refused = calibrate_players(world, entries, progress=progress, optional=labels)
    whom = [spec for label, spec in zip(labels, chosen, strict=True) if label not in refused]
    scores = evaluator.scores(whom, show=progress)
    return {**make_card(scores), "left_out": refused}


def list_unscored(task: DetectorTask, card: dict[str, Any]) -> list[str]:
    """Labels of detectors that a card has no score of, and does not refuse, as yet."""
    known = {*(each["detector"] for each in card["detectors"]), *card["left_out"]}
    everyone = (specify_detector(each).label for each in list_task_detectors(task.task))
    return [label for label in everyone if label not in known]


def family_table(card: dict[str, Any]) -> Table:
    """Table of P(HMI) by family [%]."""
    columns = (
        (each["family"], lambda score, k=k: score["families"][k]["p_hmi"], tasks.format_share)
        for k, each in enumerate(card["detectors"][0]["families"])
    )
    return Table(("detector", "detector"), *columns)


def make_card(scores: list[DetectorScore]) -> dict[str, Any]:
    classics = [each for each in scores if extract_name(each.detector) not in CONTROLS]
    best = min(classics, key=lambda each: np.nan_to_num(each.p_hmi.value, nan=2.0))
    first = scores[0]
    return {
        "runs": first.runs,
        "selection_runs": first.selection_runs,
        "entropy": first.entropy,
        "best_classic": best.detector,
        "detectors": [
            {**each.as_dict(), "less_best": each.difference_to(best).as_json()} for each in scores
        ],
    }


def with_others(card: dict[str, Any], stored: dict[str, Any] | None) -> dict[str, Any]:
    """A card with the rows of a stored one that was played on the same runs, where the best
    classic, which all are compared with, has the same scores."""
    same = ("runs", "selection_runs", "entropy", "best_classic")
    if stored is None or any(card[name] != stored[name] for name in same):
        return card
    rows, old = ({each["detector"]: each for each in of["detectors"]} for of in (card, stored))
    best = card["best_classic"]
    if rows[best] != old[best]:
        return card
    kept = [each for name, each in old.items() if name not in rows and name not in card["left_out"]]
    left = {name: why for name, why in stored["left_out"].items() if name not in rows}
    return {
        **card,
        "detectors": [*card["detectors"], *kept],
        "left_out": {**left, **card["left_out"]},
    }


def shown() -> str:
    cards, waiting = tasks.stored_detector_cards(), {}
    for key, card in cards.items():
        if left := list_unscored(DETECTOR_TASKS[key], card):
            waiting.setdefault(", ".join(left), []).append(key)
    page = render_page(
        "detector_tasks.md.j2",
        scores=tasks.CARDS.markdown(tasks.list_score_rows(cards)),
        cards=cards,
        waiting=waiting,
        missing={k: x for k, x in tasks.missing().items() if k in DETECTOR_TASKS},
        family_table=family_table,
        rank_scores=tasks.rank_scores,
    )
    return fit_tables(page)


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("tasks", nargs="*", help=f"of {', '.join(DETECTOR_TASKS)}; default: all")
    parser.add_argument("--out", type=Path, default=Path("results/detectors"))
    parser.add_argument("--runs", type=int, default=200, help="evaluation runs of every family")
    parser.add_argument("--selection-runs", type=int, default=64)
    parser.add_argument("--only", nargs="+", help="as the page has them; others keep their scores")
    parser.add_argument("--tables-only", action="store_true", help="play nothing")
    given = parser.parse_args(arguments)
    for key in () if given.tables_only else given.tasks or DETECTOR_TASKS:
        sizes = given.runs, given.selection_runs
        card = play_task(get_detector_task(key), given.out, *sizes, given.only)
        card = with_others(card, tasks.stored_detector_cards().get(key))
        keep_cards(CARD_FILE, {**tasks.stored_detector_cards(), key: card}, DETECTOR_TASKS)
        for score in card["detectors"]:
            print(key, score["detector"], score["p_hmi"], score["worst_family"], flush=True)
    put_between(PAGE, START, END, shown())


if __name__ == "__main__":
    main(sys.argv[1:])
