"""Stored scores of tasks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from operator import itemgetter
from typing import Any

from ...tasks import DETECTOR_TASKS, TASKS, DetectorTask, Task, v2
from ..experiments.suite import DETECTOR_FILE as DETECTOR_FILE
from ..experiments.suite import FILE as FILE
from ..experiments.suite import stored_cards as stored_cards
from .campaign import OVER, attack_of_suite, bound_text, format_spoofer
from .table import Table, format_number, interval, metres, percent, share

Card = dict[str, Any]
SCORES = {"ramp": "blind", "accelerating-ramp": "blind", "open-loop": "blind", "feedback": "oracle"}
"""Spoofers with known scores, each fitted to the alarm budget, and what they observe."""
FIGURES = {
    "p_hmi": "P(HMI) [%]",
    "p_hmi at 10 min": "at 10 min [%]",
    "p_hmi at 1 h": "at 1 h [%]",
    "limit_over_half": "limit over the floor of 50 %",
    "skies": "skies, and by chance",
    "trivial_over_best": "trivial test",
}
"""Of the admission test, and how they are titled."""


def load_optima(key: str) -> list[list[float]]:
    """Rates [m/s] of open-loop attacks found in the world of a task, as far as its card has any."""
    return list(stored_cards().get(key, {}).get("optima_mps", {}).values())


def task_rows() -> list[Card]:
    """Cards of the youngest suite's tasks, each with its key."""
    return [{"task": key, **card} for key, card in stored_cards().items() if key in v2.TASKS]


def format_bounds(card: Card) -> str:
    """Floor for an attack that keeps the budget, optimized open-loop attack, zero-alarm bound."""
    floor, best = card["floor_m"]["stealthy"]["value"], card["bracket"]["open_loop"]
    reached = "-" if best is None else metres(best["value"], "unbounded")
    bound = bound_text(card["bracket"]["zero_alarm"])
    return f"[{metres(floor, 'unbounded')}, {reached}, {bound}]"


def _score(reached: Card) -> str:
    return interval(reached) + ("" if reached["within_budget"] else OVER)


def _worst(card: Card) -> str:
    worst = card["protection_m"][card["detector"]]["0.5"]
    return f"{interval(worst)}, {attack_of_suite(worst)}"


TASK_SCORES = Table(
    ("task", "task"),
    ("detector", "detector"),
    ("floor, optimized open-loop attack, zero-alarm bound [m]", format_bounds),
    *(
        (
            f"{format_spoofer(name, known)} [m]",
            lambda card, name=name: card["scores_m"].get(name),
            _score,
        )
        for name, known in SCORES.items()
    ),
    ("in 50 % of runs, the worst attack [m]", _worst),
)


def admission_rows() -> list[Card]:
    """Results of the admission test, each with the key of its task."""
    rows = task_rows()
    return [{"task": row["task"], **row["admission"]} for row in rows if "admission" in row]


def _figure(row: Card, name: str) -> str:
    figure = row["figures"][name]
    shown = share(0) if name.startswith("p_hmi") else "{:.2f}".format
    text = shown(figure["value"])
    chance = f", {row['skies_by_chance']:.2f}" if name == "skies" else ""
    return text + chance + ("" if figure["passes"] else " (fails)")


ADMISSION = Table(
    ("task", "task"),
    ("best classic", "best_classic"),
    ("alert limit [m]", "alert_limit_m", format_number),
    *((title, partial(_figure, name=name)) for name, title in FIGURES.items()),
    ("worst attack over the floor", "over_floor", "{:.2f}".format),
    ("open-loop over accelerating ramp", "optimum_over_accelerating", "{:.2f}".format),
)


COMMANDS = {"S": "python -m tools.task_cards {}", "D": "python -m tools.detector_cards {}"}
"""That play the cards of tasks, by the letter of these."""


def stored_detector_cards() -> dict[str, Card]:
    return stored_cards(DETECTOR_FILE)


def missing() -> dict[str, str]:
    """Tasks without a card, and the command that plays each."""
    there = {**stored_cards(), **stored_detector_cards()}
    every = (*v2.TASKS, *v2.DETECTOR_TASKS)
    return {key: COMMANDS[key[0]].format(key) for key in every if key not in there}


def list_tasks() -> list[Card]:
    """All tasks with their cards, JSON-able."""
    cards, absent = {**stored_cards(), **stored_detector_cards()}, missing()
    rows = []
    every: dict[str, Task | DetectorTask] = {**TASKS, **DETECTOR_TASKS}
    for key, task in every.items():
        row = {name: getattr(task, name) for name in ("suite", "env_id", "title", "alert_limit_m")}
        if isinstance(task, DetectorTask):
            row["public"] = [each.key for each in task.public]
            row["held_out"] = [each.key for each in task.held_out]
        else:
            row["historical"] = task.historical
        rows.append({"key": key, **row, "card": cards.get(key), "play": absent.get(key)})
    return rows


def format_share(estimate: Card, digits: int = 0) -> str:
    """Proportion in per cent, without its interval."""
    return "-" if estimate["value"] is None else share(digits)(estimate["value"])


def _public(score: Card) -> Card | None:
    public = [each["p_hmi"] for each in score["families"] if not each["held_out"]]
    return max(public, key=lambda each: each["value"] or 0.0, default=None)


EVENTS = ("clean", "clock_step", "satellite_loss", "front")
DETECTOR_SCORES = Table(
    ("detector", "detector"),
    ("P(HMI) [%], worst family", "p_hmi", percent),
    ("worst family", "worst_family"),
    ("worst public family [%]", _public, partial(format_share, digits=1)),
    ("exceeded in 50 % [m]", lambda score: score["exceeded_m"]["0.5"], interval),
    ("in 5 % [m]", lambda score: score["exceeded_m"]["0.05"], interval),
    (
        "false alarms [% of runs]",
        lambda score: score["false_alarms"]["clean, judged window"],
        percent,
    ),
    (
        "alarms with no event, clock step, lost satellite, front [% of runs]",
        lambda score: ", ".join(
            format_share(score["false_alarms"][event])
            for event in EVENTS
            if event in score["false_alarms"]  # a log has none
        ),
    ),
)
CARDS = Table(
    ("task", "task"),
    *DETECTOR_SCORES.columns,
    ("P(HMI) minus that of the best classic, paired [% of runs]", "less_best", percent),
)


def list_score_rows(cards: dict[str, Card]) -> list[Card]:
    """Scores of all detectors with the keys of their tasks, the best detector of a task first."""
    return [{"task": key, **score} for key, card in cards.items() for score in rank_scores(card)]


def rank_scores(card: Card) -> list[Card]:
    """Scores of a card, the best detector first; one without a run that counts comes last."""

    def hazard(score: Card) -> float:
        value = score["p_hmi"]["value"]
        return 2.0 if value is None else float(value)

    return sorted(card["detectors"], key=hazard)


TASK_LIST = Table(
    ("task", itemgetter(0)),
    ("suite", lambda row: row[1].suite),
    ("environment", lambda row: row[1].env_id),
    ("what it asks for", lambda row: row[1].title + (", historical" if row[1].historical else "")),
)
DETECTOR_TASK_LIST = Table(
    ("task", itemgetter(0)),
    ("suite", lambda row: row[1].suite),
    ("environment of a learner", lambda row: row[1].env_id),
    ("world", lambda row: row[1].title),
    (
        "families of attacks, * held out from training",
        lambda row: ", ".join(each.key + "*" * each.held_out for each in row[1].families),
    ),
)


def print_tasks(keys: Sequence[str] = (*TASKS, *DETECTOR_TASKS)) -> None:
    """Print tasks and their scores; `keys`: which ones."""
    tables: tuple[tuple[Table, str, Iterable[Any]], ...] = (
        (TASK_LIST, "for spoofers", TASKS.items()),
        (TASK_SCORES, "stealthy displacement", task_rows()),
        (ADMISSION, "admission", admission_rows()),
        (DETECTOR_TASK_LIST, "for detectors", DETECTOR_TASKS.items()),
        (CARDS, "protection", list_score_rows(stored_detector_cards())),
    )
    for table, title, every in tables:
        rows = [x for x in every if (x["task"] if isinstance(x, dict) else x[0]) in keys]
        if rows:
            table.print(title, rows)
    for key, command in missing().items():
        if key in keys:
            print(f"{key} has no reference scores yet: {command}")
