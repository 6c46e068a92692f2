"""Cards of the tasks of `spoofgym-bench-v1`: scores, bracket and figures of their admission."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from ..tasks import SUITE, TASKS
from .tables import attack_of_suite, interval, number, titled

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
    text = files(__package__).joinpath(FILE).read_text(encoding="utf-8")
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
