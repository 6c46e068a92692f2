"""Page of detectors that were scored by families of attacks, of an audit, too."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...policies.card import SPOOFER
from ...spoofers import make_spoofer
from ...spoofers.base import sees_statistics
from ...tasks import DETECTOR_TASKS, DetectorTask
from ..experiments.audit_cells import AuditPlan
from ..experiments.audit_worlds import NEAR_ALARM, TRAINED
from ..experiments.store import Store
from ..runs.episode import Episode, play_episode
from ..runs.panel import select_runs
from ..runs.players import PlayerSpec
from ..runs.record import MEASURES, Aim, Protection
from ..scores.campaign import score_hazard
from ..scores.detector import FamilyScore
from ..scores.scores import SHARES
from . import figures
from .page import Page, Picture, Sheet, list_played_settings, record_replay
from .table import Table, in_percent, interval, percent, render_template
from .tasks import DETECTOR_SCORES

Row = dict[str, Any]
FAMILIES = Table(
    ("family", lambda row: row["family"] + "*" * row["held_out"]),
    ("exceeded in 50 % of runs [m]", lambda row: row["exceeded_m"]["0.5"], interval),
    ("in 5 % of runs [m]", lambda row: row["exceeded_m"]["0.05"], interval),
    ("P(HMI) [% of runs]", "p_hmi", percent),
    ("its attacks", lambda row: explain_family(row["family"]) or None),
    ("the worst by P(HMI)", lambda row: row["attack"]["spoofer"]),
    ("runs that count", "counted"),
    ("detector", "detector"),
)
HELD_OUT = (
    "* held out: no detector may be trained on it. Each interval is that of one family; in the "
    "summary the worst family is picked again in every resample, so that its interval may differ. "
    "Attacks are chosen for each family apart, and families differ for that reason, too."
)
BENIGN = (
    "Public families are those not held out. False alarms are those in the judged window; the last "
    "column counts, of the runs without an attack that have such an event, those with an alarm at "
    "any time since switch-on. A front is one of the ionosphere."
)

SHARE_KEYS = tuple(f"{share:g}" for share in SHARES)
MOVED = "undetected displacement exceeded in 50 % of the runs"
PLAYED = {
    "task": "task",
    "title": "world",
    "alert_limit_m": "alert limit [m]",
    "window_s": "attack and time to alert [s]",
    "requested_per_hour": "false alarms that were requested [1/h]",
    "budget": "size of the audit",
    "runs": "runs of each family",
    "selection_runs": "runs that attacks were chosen on",
    "entropy": "seed",
    "cost_us": "time for an epoch of a receiver [us]",
}
UNSCORED = "There are no scores yet: the command that plays them goes on."


def build_scores_page(
    store: Store, scores: Mapping[str, Any] | None = None, replay: Row | None = None
) -> Page:
    """Report of a folder; `scores`: ``detectors``, as `DetectorScore.as_dict` or an audit has them,
    None of what is not finished."""
    config = store.config["config"]
    found, limit_m = load_families(store), config["alert_limit_m"]
    rows = [{"detector": each, **x.as_dict()} for each, own in found.items() for x in own]
    rows.sort(key=lambda row: row["exceeded_m"]["0.5"]["value"] or 0.0, reverse=True)
    records = [] if scores is None else scores["detectors"]
    played = {(row["detector"], row["family"]) for row in rows}
    task = DETECTOR_TASKS.get(config["task"])
    keys = [] if task is None else [each.key for each in task.families]
    if records:  # a part of the families may have been played
        keys = [each["family"] for each in records[-1]["families"]]
    begun = [each for each in found if each not in {record["detector"] for record in records}]
    missing = [f"{each} / {key}" for each in begun for key in keys if (each, key) not in played]
    names = ", ".join(found)
    hidden = "detector" if len(found) < 2 else ""  # whose name is the title
    tables = (
        Table(*(column for column in table.columns if column.title != hidden))
        for table in (DETECTOR_SCORES, FAMILIES)
    )
    searches = (cell.identity.get("search") for cell, _ in store.read_all() if cell.identity)
    more = config.get("world", {}), replay or {}, next(filter(None, searches), None)
    last = records[-1] if records else {}
    settings = [(text, last[key]) for key, text in PLAYED.items() if last.get(key) is not None]
    world = f": {last['title']}" if "title" in last else ""
    return Page(
        title=f"Detector {names}, task {config['task']}{world}" if found else config["task"],
        verdict=[x for each in records for x in write_score_verdict(each, *more)] or [UNSCORED],
        missing=missing if found else keys,
        pictures=list_score_pictures(found, rows, records, limit_m, task),
        sheets=[
            Sheet("Detectors", next(tables), records, BENIGN),
            Sheet("Families of attacks", next(tables), rows, HELD_OUT),
        ],
        replay=replay,
        played=[("detector", names), *settings, ("all", dict(list_played_settings(store)))],
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
    shown = record_replay(episode, task.alert_limit_m)
    every = (each for each in families if each.counted)
    shown["attack"] = _describe_attack(episode)
    if (most := max(every, key=lambda each: each.protection.score_worst(aim))) is not worst:
        shown["title"] += f", of those in the world of {task.key} itself, as {most.family} is not"
    return shown


def _describe_attack(episode: Episode) -> Row | None:
    """How the false position of a run moves, at five times from the first epoch to the end of the
    attack; None where the spoofer commands none."""
    setup, attack = episode.setup, episode.setup.attack
    moved = (frame.displacement_ne for frame in episode.frames[: setup.steps])
    way = [each for each in moved if each is not None]
    if not way:
        return None
    rates = np.linalg.norm(np.diff(way, axis=0, prepend=0.0), axis=1) / setup.interval_s
    rows = [max(round(part * len(way)) - 1, 0) for part in (0.0, 0.25, 0.5, 0.75, 1.0)]
    north, east = way[-1]
    return {
        "times_s": [(row + 1) * setup.interval_s for row in rows],
        "rates_mps": rates[rows].round(2).tolist(),
        "displacement_m": round(float(np.hypot(north, east)), 2),
        "heading_deg": round(float(np.degrees(np.arctan2(east, north))) % 360.0),
        "rate_limit_mps": attack.rate_limit_mps,
        "acceleration_limit_mps2": attack.acceleration_limit_mps2 * (attack.control != "rate"),
        "channels": attack.channels,
        "sees_statistic": sees_statistics(make_spoofer(episode.spoofer.spec).knowledge),
    }


def explain_family(key: str) -> str:
    """What the attacks of a family have in common, as the tasks say it; "" of an unknown one."""
    every = (each for task in DETECTOR_TASKS.values() for each in task.families)
    return {each.key: each.title for each in (*every, TRAINED)}.get(key, "")


def load_families(store: Store) -> dict[str, list[FamilyScore]]:
    """Scores by detector of the finished families; of several sizes that with most of them."""
    cells = [(cell.identity, found) for cell, found in store.read_all() if cell.identity]
    cells = [(named, found) for named, found in cells if isinstance(named.get("family"), dict)]
    sizes = [str((named["runs"], named["selection"])) for named, _ in cells]
    usual = Counter(sizes).most_common(1)[0][0] if sizes else ""
    scores: dict[str, list[FamilyScore]] = {}
    for (named, found), size in zip(cells, sizes, strict=True):
        if size == usual:
            family, worst = named["family"], Protection.from_parts(*found[:2])
            limit_m = store.config["config"]["alert_limit_m"]
            score = FamilyScore(family["key"], family["held_out"], limit_m, worst)
            scores.setdefault(worst.detector, []).append(score)
    return scores


def write_score_verdict(
    record: Row, world: Row, replay: Row, search: Row | None = None
) -> list[tuple[str, ...]]:
    """What a detector misses, by what attack, after how long, and how sure that is: heads and
    texts, in which each family of attacks stands once, explained. `search`: how open-loop attacks
    were looked for."""
    limit_m, families = record["alert_limit_m"], {x["family"]: x for x in record["families"]}
    far: dict[str, list[str]] = {}
    for share in SHARE_KEYS:
        best = max(families, key=lambda key: families[key]["exceeded_m"][share]["value"] or 0.0)
        far.setdefault(best, []).append(f"in {100 * float(share):g} %")
    worst = {
        key: [f"has the largest displacement exceeded {' and '.join(shares)} of the runs"]
        for key, shares in far.items()
    }
    farthest, most = next(iter(far)), record["p_hmi"]
    text = f"passes {limit_m:g} m with no alarm in time (P(HMI)) most often, in {percent(most)} % "
    text, other = f"{text}of its runs", families[farthest]["p_hmi"]
    if record["worst_family"] != farthest and other["value"] is not None:
        text += f", against {percent(other)} % of those of {farthest}"
        text += ", a difference within the intervals" * (other["high"] > most["low"])
    worst.setdefault(record["worst_family"], []).append(text)
    shown = replay if replay.get("detector") == record["detector"] else {}
    values = {"record": record, "worst": worst, "explain": explain_family}
    values |= {"world": world, "replay": shown, "search": search}
    lines = render_template("verdict.txt.j2", values).splitlines()
    return [tuple(line.split(": ", 1)) for line in lines]


def list_score_pictures(
    found: Mapping[str, Sequence[FamilyScore]],
    rows: Sequence[Row],
    records: Sequence[Row],
    limit_m: float,
    task: DetectorTask | None,
) -> list[Picture]:
    if not rows:
        return []
    others = () if task is None else (x.key for x in task.families if task.get_overrides(x))
    foreign, several = {*others}, len(found) > 1  # attacks and worlds that the floor is not of
    floors = [each["floor_m"]["half"]["value"] for each in records if each.get("floor_m")]
    own: dict[str, list[Row]] = {}
    for row in rows:
        own.setdefault(FAMILIES.columns[0].text(row), []).append(row)
    floor = floors[0] if floors else None
    moved = [
        figures.DotRow(
            f"{key}: {explain_family(each[0]['family'])}".removesuffix(": "),
            [figures.Dot(x["detector"] * several, x["exceeded_m"]["0.5"]) for x in each],
            (None if each[0]["family"] in foreign else floor, None),
        )
        for key, each in own.items()
    ]
    curves = [_hazard(name * several, families) for name, families in found.items()]
    hazards = [
        [{x["detector"]: x["p_hmi"]["value"] for x in each}.get(d) for d in found]
        for each in own.values()
    ]
    pictures = [
        Picture(
            "Undetected displacement by family of attacks",
            "What the worst attack of each family exceeds in half of the runs with no alarm in "
            "time, with its 95 % interval; * held out from training."
            + " Grey marks: what a perfect detector would allow the best attack (floor), for the "
            "families with the attack and ages of the task itself." * bool(floors),
            figures.draw_dots(moved, f"{MOVED} [m]", limit_m=limit_m),
            figures.dots_height(moved),
        ),
        Picture(
            "P(HMI) against alert limit",
            "How often the error passes an alert limit with no alarm in time, under the family of "
            "attacks that is worst at that limit.",
            figures.draw_lines(curves, "alert limit [m]", figures.HAZARD, log="x", limit_m=limit_m),
        ),
    ]
    if several:
        heat = Picture(
            "P(HMI) by family of attacks",
            f"How often the error passes {limit_m:g} m with no alarm in time [% of the runs]; the "
            "darker, the more often.",
            figures.draw_heat([*own], [*found], hazards),
            figures.heat_height([*own], [*found]),
        )
        pictures.insert(1, heat)
    if probed := [each for each in records if "ages" in each]:
        rates = probed[0]["ages"]["rate_mps"]
        caption = (
            f"The same {len(rates)} fixed ramps of {min(rates):.2g} to {max(rates):.2g} m/s in the "
            "same runs, begun at each of these times, with 95 % intervals. Attacks that are chosen "
            "against the detector may be missed more often."
        )
        x, y = "time from switch-on to the onset of the ramp [min]", "ramps with an alarm [%]"
        draw = figures.draw_lines([_ages(each, several) for each in probed], x, y, log="x")
        pictures.insert(0, Picture("Test ramps found, by the time since switch-on", caption, draw))
    return pictures


def _hazard(detector: str, families: Sequence[FamilyScore]) -> figures.Line:
    """P(HMI) of the worst family at every limit, with its interval."""

    def score(limit: float) -> Row:
        found = [score_hazard(family.protection, MEASURES[0], limit) for family in families]
        return max(found, key=lambda row: -1.0 if row["value"] is None else row["value"])

    return figures.make_hazard_curve(detector, score)


def _ages(record: Row, named: bool) -> figures.Line:
    ages = record["ages"]
    found = [in_percent(each) for each in ages["found"]]
    return figures.make_curve(record["detector"] * named, np.array(ages["age_s"]) / 60.0, found)
