"""Results of a training with several seeds: their table, and the policy that is kept."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import interval
from spoofgym.bench.scores.spoofer import SpooferScore
from spoofgym.core.files import write_file
from spoofgym.policies import SpooferCard
from spoofgym.policies.card import Score as CardScore
from spoofgym.spoofers.base import sees_statistics

LOUDEST = 1e5
"""Largest amplitude that is tried of a network that has not learned, which hardly answers."""


def comparable(rivals: Mapping[str, str], knowledge: str) -> list[str]:
    """Names of those, by what they observe, that a spoofer of some knowledge is compared with:
    oracles only where it is one."""
    oracle = sees_statistics(knowledge)
    return [name for name, known in rivals.items() if oracle or not sees_statistics(known)]


def get_displacement(score: Mapping[str, Any] | None) -> float:
    """Stealthy displacement of a score as JSON [m]; 0 where nothing kept the budget."""
    return float(score["stealthy_displacement_m"]["value"]) if score else 0.0


def keeps_budget(score: Mapping[str, Any]) -> bool:
    """As `Score.keeps_budget`, of a score as JSON."""
    return bool(score["within_budget"]) and score["fit_within_budget"] is not False


def mark_displacement(score: Mapping[str, Any]) -> str:
    """Displacement with its interval, `*` where it is over the budget."""
    return interval(score["stealthy_displacement_m"]) + ("" if keeps_budget(score) else "*")


def format_range(values: Sequence[float]) -> str:
    return f"{median(values):.1f} [{min(values):.1f}, {max(values):.1f}]"


def reached_by(rows: Sequence[Mapping[str, Any]], key: str = "score") -> str:
    """Median over the seeds, the least and largest of them, and how many are over the budget."""
    scores = [row[key] for row in rows]
    over = sum(1 for score in scores if score and not keeps_budget(score))
    return format_range([get_displacement(score) for score in scores]) + (
        f", {over} over" if over else ""
    )


def find_median_seed(rows: Iterable[Mapping[str, Any]], rival: str) -> Mapping[str, Any]:
    """The seed whose ratio to a rival is the median one, the lower of two; 0 if it has no score."""

    def ratio(row: Mapping[str, Any]) -> float:
        return float(row["ratios"][rival]["value"]) if row["score"] else 0.0

    ordered = sorted(rows, key=ratio)
    return ordered[(len(ordered) - 1) // 2]


KIND_HEAD = (
    *("task", "arguments", "seeds", "stealthy displacement, median and range [m]"),
    *("over the best constant ramp, median seed", "untrained [m]"),
)


def kind_cells(
    task: str, kind: str, rows: Sequence[Mapping[str, Any]], ramp: Mapping[str, Any]
) -> tuple[str, ...]:
    """Trainings of one kind, in the order of `KIND_HEAD`; those that diverged count as 0 m."""
    middle, lost = find_median_seed(rows, "ramp"), sum(not row["score"] for row in rows)
    ratio = interval(middle["ratios"]["ramp"], 2) if middle["score"] else "0"
    seeds = f"{len(rows)}, {lost} diverged" if lost else str(len(rows))
    return (
        *(task, kind, seeds, reached_by(rows)),
        f"{ratio} of {get_displacement(ramp):.1f} m",
        reached_by(rows, "untrained"),
    )


TABLE_HEAD = (
    *("spoofer", "observes", "stealthy displacement [m]", "alarms [%]"),
    *("untrained [m]", "minutes"),
)


def build_table(results: Mapping[str, Any]) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
    """Title, head and rows: scores of all seeds, with what the network got before it learned, and
    of the rivals."""
    reached = [get_displacement(row["score"]) for row in results["seeds"] if row["score"]]
    middle = f"; median of {len(reached)} seeds {median(reached):.2f} m" if reached else ""
    rows = [(name, x["knowledge"], *_cells(x), "", "") for name, x in results["rivals"].items()]
    for row in results["seeds"]:
        cells = _cells(row["score"]) if row["score"] else ("none within the budget", "")
        untrained = row["untrained"]
        further = f"{get_displacement(untrained):.2f}", f"{row['wall_s'] / 60.0:.1f}"
        rows.append((f"PPO, seed {row['seed']}", untrained["knowledge"], *cells, *further))
    return f"against {results['detector']}, evaluation runs{middle}", TABLE_HEAD, rows


def _cells(score: Mapping[str, Any]) -> tuple[str, str]:
    """Displacement with its interval, marked where it is over the budget, and alarms."""
    return mark_displacement(score), f"{100.0 * score['alarm_rate']['value']:.1f}"


def on_card(score: SpooferScore, judge: Evaluator) -> CardScore:
    """A score as a card has it."""
    moved = score.stealthy_displacement_m
    return CardScore(
        detector=score.detector,
        split="evaluation",
        entropy=judge.entropy,
        runs=score.runs,
        counted=score.counted,
        undetected_displacement_m=moved.value,
        low=moved.low,
        high=moved.high,
        alarm_rate=score.alarm_rate.value,
        clean_alarm_rate=score.clean_alarm_rate,
        budget=score.budget,
    )


def copy_policy(
    source: Path,
    target: Path,
    training: Mapping[str, Any] | None = None,
    scores: Sequence[CardScore] = (),
) -> None:
    """Write a policy and its card under another name, with more on its training and scores."""
    content = source.read_bytes()
    card = SpooferCard.load(source.with_suffix(".json"))
    if card.file is None:
        raise ValueError(f"{source} is no policy of a file: its card is of {card.kind}")
    own = {
        "name": target.stem,
        "file": card.file.model_copy(update={"name": target.name}),
        "training": {**card.training, **(training or {})},
        "scores": (*card.scores, *scores),
    }
    write_file(target, content)
    card.model_copy(update=own).save(target.with_suffix(".json"))
