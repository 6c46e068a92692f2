"""Page of detectors that were scored by families of attacks, of an audit, too."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...policies.card import SPOOFER
from ...tasks import DETECTOR_TASKS
from ..experiments.audit_cells import AuditPlan
from ..experiments.audit_worlds import NEAR_ALARM
from ..experiments.store import Store
from ..runs.episode import play_episode
from ..runs.panel import select_runs
from ..runs.players import PlayerSpec
from ..runs.record import MEASURES, Aim, Protection
from ..scores.audit import format_age
from ..scores.campaign import score_hazard
from ..scores.detector import FamilyScore
from ..scores.scores import SHARES
from . import figures
from .page import Page, Picture, Sheet, list_played_settings, record_replay
from .table import Table, interval, metres, percent, yes_no
from .tasks import DETECTOR_SCORES

Row = dict[str, Any]
FAMILIES = Table(
    ("detector", "detector"),
    ("family", "family"),
    ("held out", "held_out", yes_no),
    ("P(HMI) [%]", "p_hmi", percent),
    ("exceeded in 50 % [m]", lambda row: row["exceeded_m"]["0.5"], interval),
    ("in 5 % [m]", lambda row: row["exceeded_m"]["0.05"], interval),
    ("worst attack", lambda row: f"({row['attack']['letter']}) {row['attack']['spoofer']}"),
    ("runs that count", "counted"),
)

UNSCORED = "There are no scores yet: the command that plays them goes on."


def build_scores_page(
    store: Store, scores: Mapping[str, Any] | None = None, replay: Row | None = None
) -> Page:
    """Report of a folder; `scores`: ``detectors``, as `DetectorScore.as_dict` or an audit has them,
    None of what is not finished."""
    config = store.config["config"]
    found, limit_m = load_families(store), config["alert_limit_m"]
    rows = [{"detector": each, **x.as_dict()} for each, own in found.items() for x in own]
    records = [] if scores is None else scores["detectors"]
    played = {(row["detector"], row["family"]) for row in rows}
    task = DETECTOR_TASKS.get(config["task"])
    keys = [] if task is None else [each.key for each in task.families]
    if records:  # a part of the families may have been played
        keys = [each["family"] for each in records[-1]["families"]]
    begun = [each for each in found if each not in {record["detector"] for record in records}]
    missing = [f"{each} / {key}" for each in begun for key in keys if (each, key) not in played]
    return Page(
        title=": ".join(filter(None, (config["task"], ", ".join(found)))),
        verdict=[line for record in records for line in write_score_verdict(record)] or [UNSCORED],
        missing=missing if found else keys,
        pictures=list_score_pictures(found, rows, records, limit_m),
        sheets=[
            Sheet("Detectors", DETECTOR_SCORES, records),
            Sheet("Families of attacks", FAMILIES, rows),
        ],
        replay=replay,
        played=list_played_settings(store),
        scores=scores,
    )


def replay_worst_attack(
    plan: AuditPlan, detector: PlayerSpec, families: Sequence[FamilyScore]
) -> Row:
    """The run in which the worst attack in the task's own world gets farthest, played again, as
    `record_replay` has it; empty where all of its families are of other worlds."""
    aim, task = Aim(MEASURES[0], SHARES[0]), plan.task
    played = {x.key: x for x in plan.families if x.onset != NEAR_ALARM}
    played = {key: x for key, x in played.items() if not task.get_overrides(x)}
    own = [each for each in families if each.family in played and each.counted]
    if not own:
        return {}
    worst = max(own, key=lambda each: each.protection.score_worst(aim))
    attack, world = worst.protection.worst(aim), plan.worlds.world
    moved = np.where(worst.protection.counts, attack.displacement[MEASURES[0]], -1.0)
    onset = played[worst.family].onset
    numbers = select_runs(world.setup, plan.entropy, "evaluation", plan.runs, onset)
    player = PlayerSpec(attack.spoofer, SPOOFER, dict(attack.spec))
    episode = play_episode(world, detector, player, int(numbers[moved.argmax()]), plan.entropy)
    return record_replay(episode, task.alert_limit_m)


def load_families(store: Store) -> dict[str, list[FamilyScore]]:
    """Scores by detector of the finished families; of several sizes that with most of them."""
    cells = [(cell.identity, found) for cell, found in store.read_all() if cell.identity]
    cells = [(named, found) for named, found in cells if isinstance(named.get("family"), dict)]
    sizes = [str((named["runs"], named["selection"])) for named, _ in cells]
    usual = Counter(sizes).most_common(1)[0][0] if sizes else ""
    scores: dict[str, list[FamilyScore]] = {}
    for (named, found), size in zip(cells, sizes, strict=True):
        if size == usual:
            family, worst = named["family"], Protection.from_parts(found.arrays, found.record)
            limit_m = store.config["config"]["alert_limit_m"]
            score = FamilyScore(family["key"], family["held_out"], limit_m, worst)
            scores.setdefault(worst.detector, []).append(score)
    return scores


def write_score_verdict(record: Row) -> list[str]:
    """What is known of a detector, in words, the answer of an audit first."""
    half, few = (interval(record["exceeded_m"][share]) for share in ("0.5", "0.05"))
    rate, limit = interval(record["false_alarms_per_hour"]), f"{record['alert_limit_m']:g} m"
    lines = [record["answer"] + "."] if "answer" in record else []
    lines += [f"Warning: {text}." for text in record.get("warnings", [])]
    lines += [f"Simulated world: {record['title']}."] if "title" in record else []
    lines.append(
        f"{record['detector']}: under the family of attacks that is worst by this measure, "
        f"{record['worst_family']}, the error is beyond {limit} without an alarm in time in "
        f"{percent(record['p_hmi'])} % of the runs. The attacks that displace most, by {half} m in "
        f"half of the runs and by {few} m in 5 % of them, may be of another family. False alarms: "
        f"{rate} an hour."
    )
    if "ages" in record:
        ages = record["ages"]
        found = ", ".join(
            f"{percent(share, 0)} % after {format_age(age)}"
            for age, share in zip(ages["age_s"], ages["found"], strict=True)
        )
        lines.append(
            f"By the time from switch-on to the attack, it finds of plain test ramps {found}. Of "
            f"those that pass {limit}, over all these times, {percent(ages['missed'])} % raise no "
            f"alarm in time. Attack and time to alert last {record['window_s']:g} s together."
        )
        if record["floor_m"] and (floor := record["floor_m"]["half"]["value"]) is not None:
            lines.append(f"A perfect detector would allow {metres(floor)} m in half of the runs.")
        if other := record["reference"]:
            moved = interval(other["exceeded_m"]["0.5"])
            lines.append(f"{other['detector']}, the best non-learned one, allows {moved} m there.")
    few_runs = record["exceeded_m"]["0.05"]["high"] is None
    return [
        *lines,
        f"{record['runs']} runs of every family, attacks chosen on {record['selection_runs']} "
        f"others{', too few to bound what 5 % exceed' if few_runs else ''}; in brackets 95 % "
        "intervals. Another attack may reach more.",
    ]


def list_score_pictures(
    found: Mapping[str, Sequence[FamilyScore]],
    rows: Sequence[Row],
    records: Sequence[Row],
    limit_m: float,
) -> list[Picture]:
    if not rows:
        return []
    floors = [each["floor_m"]["half"]["value"] for each in records if each.get("floor_m")]
    keys = dict.fromkeys(row["family"] for row in rows)
    own = {key: [row for row in rows if row["family"] == key] for key in keys}
    band = (floors[0] if floors else None, None)
    moved = [
        figures.DotRow(
            key, [figures.Dot(x["detector"], x["exceeded_m"]["0.5"]) for x in own[key]], band
        )
        for key in keys
    ]
    curves = [_hazard(detector, families) for detector, families in found.items()]
    pictures = [
        Picture(
            "Displacement by family of attacks",
            "Undetected displacement that the worst attack of each family exceeds in 50 % of the "
            "runs. Grey: floor, where known.",
            figures.draw_dots(moved, "displacement [m]", limit_m=limit_m),
            figures.dots_height(moved),
        ),
        Picture(
            "P(HMI) against alert limit",
            "The largest over all attacks of all families at each alert limit.",
            figures.draw_lines(curves, "alert limit [m]", "P(HMI)", log="x", limit_m=limit_m),
        ),
    ]
    if ages := [_ages(each) for each in records if "ages" in each]:
        title, caption = "Found at every age", "Test ramps found, by time from switch-on to onset."
        draw = figures.draw_lines(ages, "time since switch-on [s]", "share found", log="x")
        pictures.insert(0, Picture(title, caption, draw))
    return pictures


def _hazard(detector: str, families: Sequence[FamilyScore]) -> figures.Line:
    """P(HMI) of the worst family at every limit, with its interval."""

    def score(limit: float) -> Row:
        found = [score_hazard(family.protection, MEASURES[0], limit) for family in families]
        return max(found, key=lambda row: -1.0 if row["value"] is None else row["value"])

    return figures.make_hazard_curve(detector, score)


def _ages(record: Row) -> figures.Line:
    ages = record["ages"]
    return figures.make_curve(record["detector"], ages["age_s"], ages["found"])
