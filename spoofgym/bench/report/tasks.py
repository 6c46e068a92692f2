"""Stored scores of tasks."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from ...core.registry import label_of
from ...detectors import zoo
from ...detectors.learned_card import DetectorCard, card_path
from ...tasks import DETECTOR_TASKS, SUITE, TASKS, DetectorTask, task_of
from ..experiments.suite import everyone_in, in_order
from ..runs.world import World
from .table import attack_of_suite, interval, number, titled

FILE = "task_cards_v1.json"
"""Stored with this module; made by `tools.task_cards`."""
SCORES = {
    "ramp": "blind",
    "accelerating-ramp": "blind",
    "snapshot-chi2-profile": "blind",
    "blind-optimum": "blind",
    "feedback": "oracle",
}
"""Spoofers whose scores are known, each fitted to the alarm budget, and what they observe."""
HEAD = (
    "task",
    "detector",
    "floor, blind optimum, zero-alarm bound [m]",
    *(f"{titled(name, known)} [m]" for name, known in SCORES.items()),
    "in 50 % of runs, the worst attack [m]",
)
ADMISSION_HEAD = (
    "task",
    "best classic",
    "alert limit [m]",
    "(i) over the floor",
    "(ii) optimum over ramp",
    "(iii) P(HMI) [%]",
    "(iv) skies, and by chance",
    "(v) trivial test",
    "optimum over accelerating ramp",
)
FIGURES = ("over_floor", "optimum_over_ramp", "p_hmi", "skies", "trivial_over_best")
"""Of the admission test, in its order."""
FAILED = " (fails)"


def stored_cards() -> dict[str, dict[str, Any]]:
    text = files("spoofgym.bench").joinpath(FILE).read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = json.loads(text)
    return found


def optima_of(key: str) -> list[list[float]]:
    """Rates [m/s] of the blind optima found in the world of a task, as far as its card has them."""
    return list(stored_cards().get(key, {}).get("optima_mps", {}).values())


def listed() -> list[dict[str, Any]]:
    """All tasks with their cards, JSON-able."""
    cards = stored_cards()
    return [
        {
            "key": key,
            "suite": SUITE,
            "env_id": task.env_id,
            "title": task.title,
            "historical": task.historical,
            "alert_limit_m": task.alert_limit_m,
            "card": cards.get(key),
        }
        for key, task in TASKS.items()
    ]


def score_rows() -> list[tuple[str, ...]]:
    """Rows of the table of scores, in the order of `HEAD`."""
    rows: list[tuple[str, ...]] = []
    for key, card in stored_cards().items():
        reached = (card["scores_m"].get(name) for name in SCORES)
        worst = card["protection_m"][card["detector"]]["0.5"]
        named = f"{interval(worst)}, {attack_of_suite(worst)}"
        rows.append((key, card["detector"], bracket_text(card), *map(_score, reached), named))
    return rows


def bracket_text(card: dict[str, Any]) -> str:
    """Floor for an attack that keeps the budget, blind optimum, zero-alarm bound."""
    floor, best = card["floor_m"]["stealthy"], card["bracket"]["blind_optimum"]
    bound = card["bracket"]["zero_alarm"]
    parts = [_metres(floor["value"])]
    parts.append("-" if best is None else _metres(best["value"]))
    sign = "<= " if bound["kind"] == "upper" else ""
    parts.append("none" if bound["value"] is None else sign + _metres(bound["value"]))
    return f"[{', '.join(parts)}]"


def _metres(value: float | str | None) -> str:
    if value is None:
        return "unbounded"
    return value if isinstance(value, str) else number(value)


def _score(reached: dict[str, Any] | None) -> str:
    if reached is None:
        return "-"
    return interval(reached) + ("" if reached["within_budget"] else ", over budget")


def admission_rows() -> list[tuple[str, ...]]:
    """Rows of the table of the admission test, in the order of `ADMISSION_HEAD`."""
    rows: list[tuple[str, ...]] = []
    for key, card in stored_cards().items():
        found = card.get("admission")
        if found is None:
            continue
        limit = f"{number(found['alert_limit_m'])}, {found['limit_over_floor']:.2f} x the floor"
        chance = {"skies": f", {found['skies_by_chance']:.2f}"}
        figures = (_figure(found["figures"][name], name, chance.get(name, "")) for name in FIGURES)
        other = f"{found['optimum_over_accelerating']:.2f}"
        rows.append((key, found["best_classic"], limit, *figures, other))
    return rows


def _figure(found: dict[str, Any], name: str, more: str) -> str:
    value = f"{100 * found['value']:.0f}" if name == "p_hmi" else f"{found['value']:.2f}"
    return value + more + ("" if found["passes"] else FAILED)


DETECTOR_FILE = "detector_cards_v1.json"
"""Stored with this module; made by `tools.detector_cards`."""
COMMAND = "python -m tools.detector_cards {}"
DETECTOR_HEAD = (
    "task",
    "detector",
    "P(HMI) [%], worst family",
    "worst family",
    "worst public family [%]",
    "exceeded in 50 % [m]",
    "in 5 % [m]",
    "false alarms [% of runs]",
    "clock step, lost satellite, front [%]",
)


CARD_HEAD = (*DETECTOR_HEAD, "less the best classic, paired [% of runs]")


def classics_of(task: DetectorTask) -> tuple[dict[str, Any], ...]:
    """Detectors with a reference score: both controls, and all classics that suit the world. At 0.2
    false alarms an hour in the task's world; of solution separation the bank of the task. Tests of
    range rates are there a second time where their defaults test pseudoranges, or both, and tests
    with a drift term with rescaled innovations."""
    bank = next(each for each in task.task.detectors if each["name"] == "solution-separation")
    plain = {key: value for key, value in bank.items() if key != "false_alarms_per_hour"}
    everyone = in_order(everyone_in(World(given=task.task.world_kwargs).setup, rescaled=True))
    return tuple(plain if each["name"] == plain["name"] else each for each in everyone)


def unplayed(task: DetectorTask, card: dict[str, Any]) -> list[str]:
    """Labels of detectors that a card has no score of, and does not refuse, as yet."""
    known = {*(each["detector"] for each in card["detectors"]), *card["left_out"]}
    everyone = (label_of(each, None) for each in (*classics_of(task), *learned_of(task)))
    return [label for label in everyone if label not in known]


def learned_of(task: DetectorTask) -> tuple[dict[str, Any], ...]:
    """Shipped detectors that have learned in this world, and so from no family held out here. A
    world whose counterfeit is another one holds out what they have learned from."""
    return tuple({"name": name} for name in zoo.shipped() if _learned_in(name, task))


def _learned_in(name: str, task: DetectorTask) -> bool:
    card = DetectorCard.load(card_path(zoo.path_of(name)))
    return task_of(card.training["task"]).settings == task.task.settings


def stored_detector_cards() -> dict[str, dict[str, Any]]:
    """Cards by the keys of the tasks; those that have not been played are absent."""
    text = files("spoofgym.bench").joinpath(DETECTOR_FILE).read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = json.loads(text)
    return found


def missing() -> dict[str, str]:
    """Tasks without a card, and the command that plays each."""
    there = stored_detector_cards()
    return {key: COMMAND.format(key) for key in DETECTOR_TASKS if key not in there}


def listed_detectors() -> list[dict[str, Any]]:
    """All tasks with their cards, JSON-able."""
    cards, absent = stored_detector_cards(), missing()
    return [
        {
            "key": key,
            "suite": SUITE,
            "env_id": task.env_id,
            "title": task.title,
            "alert_limit_m": task.alert_limit_m,
            "public": [each.key for each in task.public],
            "held_out": [each.key for each in task.held_out],
            "card": cards.get(key),
            "play": absent.get(key),
        }
        for key, task in DETECTOR_TASKS.items()
    ]


def detector_score_rows(cards: dict[str, dict[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of the table of scores, in the order of `HEAD`, the best detector of a task first."""
    return [(key, *_row(score)) for key, card in cards.items() for score in _ranked(card)]


def card_rows(cards: dict[str, dict[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of `score_rows`, each with its paired difference to the best classic of the task."""
    return [
        (key, *_row(score), _percent(score["less_best"], bounds=True))
        for key, card in cards.items()
        for score in _ranked(card)
    ]


def family_rows(card: dict[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of P(HMI) by family [%], the best detector first."""
    scores = _ranked(card)
    names = [each["family"] for each in scores[0]["families"]]
    rows = [
        (score["detector"], *(_percent(each["p_hmi"]) for each in score["families"]))
        for score in scores
    ]
    return ("detector", *names), rows


def _ranked(card: dict[str, Any]) -> list[dict[str, Any]]:
    """Scores of a card, the best detector first."""
    return sorted(card["detectors"], key=_hazard)


def _hazard(score: dict[str, Any]) -> float:
    """P(HMI) of a score; above 1 where no run counts, so that it comes last."""
    value = score["p_hmi"]["value"]
    return 2.0 if value is None else float(value)


def _row(score: dict[str, Any]) -> tuple[str, ...]:
    public = [each["p_hmi"] for each in score["families"] if not each["held_out"]]
    worst = max(public, key=lambda each: each["value"] or 0.0, default=None)
    alarms = score["false_alarms"]
    events = ("clock_step", "satellite_loss", "front")
    return (
        score["detector"],
        _percent(score["p_hmi"], bounds=True),
        score["worst_family"],
        "-" if worst is None else _percent(worst),
        interval(score["exceeded_m"]["0.5"]),
        interval(score["exceeded_m"]["0.05"]),
        _percent(alarms["clean, judged window"], bounds=True),
        ", ".join(_percent(alarms[event]) for event in events),
    )


def _percent(estimate: dict[str, float | None], *, bounds: bool = False) -> str:
    if estimate["value"] is None:
        return "-"
    if not bounds:
        return f"{100.0 * estimate['value']:.0f}"
    low, high = (100.0 * (estimate[name] or 0.0) for name in ("low", "high"))
    return f"{100.0 * estimate['value']:.1f} ({low:.1f} to {high:.1f})"
