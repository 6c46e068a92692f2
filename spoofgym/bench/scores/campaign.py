"""Scores of a campaign's detectors: what they cost without attack, compared with the negative
controls, and between their limits.

`never` does not alarm, and `lottery` alarms by chance at the rate requested of all.  A
detector against which a spoofer comes farther than against them has done harm, and is marked: its
interval lies above 0.  Detectors at different rates are never compared, and none at its nominal
thresholds is.  A spoofer that reads the detector's statistic obeys that of a lottery, too, which it
could ignore: against such a one `never` alone is a control.

The bracket of a detector has its floor, the best open-loop attack that was found within the alarm
budget, and its zero-alarm bound (`search.bounds`).  The best attack below the floor says that the
search has failed; its whole interval has to lie there, so that chance alone does not say it.  A
mean may lie above the zero-alarm bound, since the budget pays for some alarms; it is marked where
it does by more than two standard errors and 1 %.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...detectors.base import MISSED
from ...spoofers.base import sees_statistics
from ..runs import record
from . import scores, statistics
from .exceeded import draw_exceeded, estimate_exceeded

NOMINAL = "nominal"  # footing of detectors of which no rate was requested


def operating_point(config: Mapping[str, Any], detector: str) -> dict[str, Any]:
    """What was requested of a detector: ``claimed``, and the ``footing`` of its comparisons, the
    rate; ``"nominal"`` where none was requested, and ``"any"`` of a detector that never alarms."""
    found = config["calibrations"].get(detector, [])
    rates = {point["false_alarms_per_hour"] for point in found}
    claimed = None
    if found:
        first = found[0]
        names = ("per_run", "false_alarms_per_hour", "runs", "extrapolated", "warmup_alarms")
        claimed = {name: first[name] for name in names}
    if len(rates) == 1:
        footing = f"{rates.pop():g}"
    else:
        footing = ANY_RATE if detector in config["never_alarm"] else NOMINAL
    return {"claimed": claimed, "footing": footing}


def score_detector(clean: record.RunRecord) -> dict[str, Any]:
    """False alarms of a detector and their price, from its runs without attack: availability that
    is lost; satellites blamed [s an hour], None where channels are not judged; distance from the
    truth."""
    records, window_s = clean.records, clean.window * clean.interval_s
    warm = int(records["warmup_alarm"].sum())
    per_run = statistics.clopper_pearson(int(clean.alarmed.sum()), clean.runs)
    hours = clean.runs * window_s / 3600.0
    blamed = float(records["blamed"].sum()) * clean.interval_s / hours
    coasting = records["coasting_epochs"] > 0
    return {
        "detector": clean.detector,
        "window_s": window_s,
        "false_alarm_per_run": per_run.as_json(),
        "false_alarms_per_hour": scores.per_hour(per_run, window_s),
        "false_alarm_per_epoch": statistics.clustered_proportion(
            records["alarm_epochs"], clean.window
        ).as_json(),
        "warmup_alarm_per_run": statistics.clopper_pearson(warm, clean.runs).as_json(),
        "blamed_s_per_hour": round(blamed, 4) if clean.head["judges_channels"] else None,
        "navigation_rms_m": float(np.sqrt(np.mean(records["navigation_rms_m"] ** 2)).round(4)),
        "coasting_error_m": compute_mean(records["coasting_error_m"][coasting]),
        **score_protection_level(clean),
    }


def score_protection_level(clean: record.RunRecord) -> dict[str, Any]:
    """Protection level of a detector that has one, median over the clean runs, and the parts of the
    Stanford diagram; only ``why`` where the attack is longer than the level is for."""
    if "protection_level_m" not in clean.records:
        return {}
    window_s = clean.window * clean.interval_s
    longest_s = clean.head.get("protects_s", math.inf)
    if window_s > longest_s + 1e-9:
        why = f"the attack of {window_s:g} s is longer than the {longest_s:g} s of its bank"
        return {"protection_level": {"why": why}}
    shares = {
        name: statistics.clustered_proportion(
            clean.records[f"{name}_epochs"], clean.window
        ).as_json()
        for name in record.STANFORD
    }
    level = round_number(np.median(clean.records["protection_level_m"]))
    return {"protection_level": {"median_m": level, "missed": MISSED, **shares}}


def round_number(value: Any) -> float:
    """Number as it is written down."""
    return round(float(value), 4)


def compute_mean(x: NDArray[Any]) -> float | None:
    """Mean as it is written down; None of nothing."""
    return round_number(x.mean()) if len(x) else None


CONTROLS = ("never", "lottery")  # names of the negative controls
ANY_RATE = "any"  # footing of a detector that never alarms: it has no rate, and is compared at any
FalseAlarmGroups = Mapping[str, str]
Gap = tuple[str, str | None, statistics.Estimate, float]
"""Score, spoofer, difference of a detector to a control, and the control's own score [m]."""


def compare_controls(
    cells: Sequence[record.RunRecord],
    protections: Sequence[record.Protection],
    footings: FalseAlarmGroups,
) -> list[dict[str, Any]]:
    """Paired differences [m], detector less control, over the runs that count for both: ``above``
    where the interval lies above 0, ``below`` where it lies below by over `ALIKE` of the control's
    own."""
    pairs = [(d, c) for c in controls(footings) for d in footings if comparable(footings, d, c)]
    return [
        {
            "score": score,
            "spoofer": spoofer,
            "detector": detector,
            "control": control,
            "difference_m": difference.as_json(),
            "above": bool(difference.low > 0.0),
            "below": bool(difference.high < -scores.ALIKE * size),
        }
        for detector, control in pairs
        for score, spoofer, difference, size in (
            *_compare_displacements(cells, detector, control),
            *_compare_protections(protections, detector, control),
        )
    ]


def controls(footings: FalseAlarmGroups) -> list[str]:
    """Labels of the negative controls that were played."""
    return [label for label in footings if extract_name(label) in CONTROLS]


def extract_name(label: str) -> str:
    return label.partition("(")[0]


def comparable(footings: FalseAlarmGroups, detector: str, other: str) -> bool:
    """Whether two detectors have the same requested rate, and are not the same."""
    mine, theirs = footings[detector], footings[other]
    if detector == other or "nominal" in (mine, theirs):
        return False
    return mine == theirs or ANY_RATE in (mine, theirs)


def _compare_displacements(
    cells: Sequence[record.RunRecord], detector: str, control: str
) -> Iterator[Gap]:
    by_pair = {(cell.detector, cell.spoofer): cell for cell in cells}
    for (label, spoofer), mine in by_pair.items():
        theirs = by_pair.get((control, spoofer))
        if label != detector or spoofer == "none" or theirs is None:
            continue
        obeys = sees_statistics(str(mine.head["knowledge"]["run_time"]))
        if obeys and "lottery" in (extract_name(detector), extract_name(control)):
            continue
        gap = mine.displacement_m - theirs.displacement_m
        both = mine.counts & theirs.counts
        samples = statistics.draw_resamples(scores.select_clusters(mine.sky)[both])
        difference = statistics.bootstrap_mean(gap[both], samples)
        size = float(theirs.displacement_m[both].mean()) if both.any() else 0.0
        yield STEALTHY, spoofer, difference, size


def _compare_protections(
    protections: Sequence[record.Protection], detector: str, control: str
) -> Iterator[Gap]:
    """Displacement that the worst attack exceeds, by share."""
    by_label = {each.detector: each for each in protections}
    mine, theirs = by_label.get(detector), by_label.get(control)
    if mine is None or theirs is None:
        return
    for share in scores.SHARES:
        aim = record.Aim(record.MEASURES[0], share)
        both = mine.counts & theirs.counts
        samples = statistics.draw_resamples(scores.select_clusters(mine.sky)[both])
        x, y = (
            aim.score_displacement(each.worst(aim).displacement[aim.measure][both])
            for each in (mine, theirs)
        )
        difference = statistics.NOTHING
        if both.any():
            drawn = [draw_exceeded(each, aim, both, samples) for each in (mine, theirs)]
            difference = statistics.percentiles(x - y, drawn[0] - drawn[1])
        yield f"protection {100 * share:g} %", None, difference, y


STEALTHY, HALF = "stealthy displacement", "exceeded in 50 %"
"""Scores that have a floor, as the marks name them."""
PURPOSES = {STEALTHY: "stealthy", HALF: "half"}  # which floor is each score's
ERRORS = 2.0  # standard errors by which a mean has to lie above a bound
FIRST_ORDER = 0.01
"""Part of a bound by which it has to do so, too: bounds are of first order, at one heading."""
NORMAL_95 = 1.96  # half width of a 95 % interval, in standard errors
SAME_RATE = 1e-6  # relative difference of two rates of false alarms that are the same one
Limits = dict[str, Any]
Row = dict[str, Any]


def compute_bounds(
    point: Row,
    limits: Limits,
    cells: Sequence[Row],
    protection: Row | None,
    searches: Sequence[Row],
) -> Row:
    """Bracket of a detector, JSON-able, by its scores and what was tuned against it; `point`: the
    rate of `operating_point`. ``floor_m`` by score; ``best_attack`` within the budget and
    ``open_loop``; ``zero_alarm``; ``search_failed``, scores below their floor;
    ``above_zero_alarm``, attacks whose mean is above that bound."""
    floors = select_lower_limits(point, limits["floor"])
    attacks = [cell for cell in cells if cell["spoofer"] != "none"]
    found = [_score_attack(cell) for cell in attacks]
    within = [each for each in found if each["within_budget"] and each["value"] is not None]
    best = max(within, key=lambda each: float(each["value"]), default=None)
    bound = select_bound(limits["zero_alarm"].get(point["detector"]))
    # where no setting of any spoofer is within the budget, nothing was achieved
    nothing = attacks and all(cell["tuned_within_budget"] is False for cell in attacks)
    achieved = {STEALTHY: {"high": 0.0} if nothing else best, HALF: headline(protection, 0.5)}
    return {
        "floor_m": floors,
        "best_attack": best,
        "open_loop": _optimum(cells, searches),
        "zero_alarm": bound,
        "search_failed": [
            score for score, reached in achieved.items() if _below(reached, floors[score])
        ],
        "above_zero_alarm": [each for each in within if _above(each, bound)],
    }


def select_lower_limits(point: Row, floor: Row | None) -> dict[str, float | None]:
    """Floors at a detector's rate of false alarms; none at nominal thresholds or for a pool. A
    detector that never alarms has those of the others in its table, the first rate's."""
    nothing = dict.fromkeys(PURPOSES)
    if floor is None or "why" in floor:
        return nothing
    if point["claimed"] is None:
        if point["footing"] != "any":
            return nothing
        rate = floor["p_fa"]
    else:
        rate = point["claimed"]["per_run"]
    for each in floor["rates"]:
        if abs(each["p_fa"] - rate) <= SAME_RATE * rate:
            return {score: each["floor_m"][name]["value"] for score, name in PURPOSES.items()}
    return nothing


def headline(protection: Row | None, share: float, *, skies: bool = False) -> Row | None:
    """Row of the induced horizontal error that is exceeded in a share of the runs."""
    for row in [] if protection is None else protection["exceeded"]:
        wanted = ("undetected_displacement_m", share, skies)
        if (row["measure"], row["share"], row["worst_skies"]) == wanted:
            return dict(row)
    return None


def _score_attack(cell: Row) -> Row:
    """Stealthy displacement of an attack, and whether it keeps the budget."""
    tuned = cell["tuned_within_budget"]
    keeps = bool(cell["within_budget"]) and tuned is not False
    return {
        "spoofer": cell["spoofer"],
        **cell["stealthy_displacement_m"],
        "within_budget": keeps,
        "tuned_within_budget": tuned,
    }


def _optimum(cells: Sequence[Row], searches: Sequence[Row]) -> Row | None:
    """The optimized open-loop attack that gets farthest, one within the budget before others."""
    curves = [cell for cell in cells if cell["spoofer_settings"]["name"] == "open-loop"]
    found = [each for each in map(_score_attack, curves) if each["value"] is not None]
    if not found:
        return None
    best = max(found, key=lambda each: (each["within_budget"], float(each["value"])))
    search = {each["spoofer"]: each["found"] or {} for each in searches}.get(best["spoofer"], {})
    return {**best, "by": search.get("by"), "unbeaten_start": search.get("unbeaten_start")}


def select_bound(found: Row | None) -> Row:
    """Zero-alarm bound of the attack within its limits where there is one, else of a free one."""
    if found is None:
        return {"value": None, "kind": "", "attacker": "", "why": "not computed"}
    attacker = "free" if found["restricted_m"] is None else "restricted"
    value = found[f"{attacker}_m"]
    if value is None:
        return {"value": None, "kind": "", "attacker": "", "why": found["why"]}
    return {"value": value, "kind": found["kind"], "attacker": attacker, "why": ""}


def _below(reached: Row | None, floor: float | None) -> bool:
    """Whether the whole interval of what was achieved lies below its floor."""
    if reached is None or floor is None or reached["high"] is None:
        return False
    return float(reached["high"]) < floor


def _above(reached: Row, bound: Row) -> bool:
    """Whether a mean lies above a bound by more than some standard errors, and by a part of it."""
    value, ends = bound["value"], (reached["low"], reached["high"])
    if not isinstance(value, float | int) or None in ends:
        return False
    error = (float(ends[1]) - float(ends[0])) / (2.0 * NORMAL_95)
    return float(reached["value"]) - value > max(ERRORS * error, FIRST_ORDER * value)


SURVIVAL_TIMES = 8  # at how many times the share of undetected attacks is reported


def score_runs(cell: record.RunRecord, limits: Sequence[float], budget: float) -> dict[str, Any]:
    """Scores of one cell; `limits` of the P_HMI curve [m]."""
    counts = cell.counts
    stealth = scores.score_stealth(cell.displacement_m, cell.alarmed, counts)
    displacement = cell.displacement_m[counts]
    zeroed = np.where(cell.alarmed[counts], 0.0, displacement)
    samples = statistics.draw_resamples(scores.select_clusters(cell.sky)[counts])
    return {
        "detector": cell.detector,
        "spoofer": cell.spoofer,
        "spoofer_settings": cell.head["spoofer_settings"],
        "tuned_within_budget": cell.head["tuned_within_budget"],
        "knowledge": cell.head["knowledge"],
        "attack": cell.head["attack"],
        "runs": cell.runs,
        "counted": stealth.runs,
        "silent_before_onset": float((~cell.records["warmup_alarm"]).mean().round(6)),
        "alarm_rate": statistics.wilson(stealth.alarms, stealth.runs).as_json(),
        "within_budget": stealth.seems_to_keep(budget),
        "stealthy_displacement_m": statistics.bootstrap_mean(displacement, samples).as_json(),
        "exceeded_m": {
            f"{x:g}": estimate_reach(displacement, x, samples).as_json() for x in scores.SHARES
        },
        "alarmed_as_0_m": statistics.bootstrap_mean(zeroed, samples).as_json(),
        "largest_error_m": float(cell.records["largest_error_m"].mean().round(4)),
        "p_hmi": [
            {"alert_limit_m": limit, **estimate.as_json()}
            for limit, estimate in zip(
                limits, statistics.exceedance(displacement, limits), strict=True
            )
        ],
        **compute_times(cell),
    }


def estimate_reach(
    displacement: NDArray[Any], part: float, samples: NDArray[np.float64]
) -> statistics.Estimate:
    """What is exceeded in a part of the runs [m], with its 95 % interval."""
    if not len(displacement):
        return statistics.NOTHING
    drawn = statistics.largest_of_share(displacement, part, samples)
    found = statistics.percentiles(record.compute_upper_quantile(displacement, part), drawn)
    return statistics.bound_above(found, part, len(displacement))


def compute_times(cell: record.RunRecord) -> dict[str, Any]:
    """When the attack was noticed, of the runs that are silent before the onset: ``missed`` of
    those whose error crosses the alert limit, up to the time to alert after; ``after_crossing_s``,
    their median time from there to the alarm; ``detected`` and ``chance`` by the end; ``delay_s``,
    median from the onset to a detection; ``survival``, share still undetected by time."""
    records, step = cell.records, cell.interval_s
    silent = ~records["warmup_alarm"]
    first, twin = records["first_alarm"][silent], records["twin_alarm"][silent]
    chance = scores.by_chance(first, twin)
    detected = (first > 0) & ~chance
    alarm, crossing = records["first_alarm"][cell.counts], records["crossing"][cell.counts]
    missed = scores.missed_in_time(alarm, crossing, int(cell.head["hold"]))
    horizon = cell.window * step
    # a run is observed up to its alarm by chance, or up to that of its twin
    seen = np.where(twin > 0, twin * step, horizon)
    delay = np.where(detected, first * step, seen)
    times = np.linspace(0.0, horizon, SURVIVAL_TIMES + 1)[1:]
    late = (alarm - crossing)[(alarm > 0) & (crossing > 0)] * step
    found: dict[str, Any] = {
        "missed": statistics.wilson(int(missed.sum()), len(missed)).as_json(),
        "detected": statistics.wilson(int(detected.sum()), len(first)).as_json(),
        "chance": statistics.wilson(int(chance.sum()), len(first)).as_json(),
        "delay_s": _median(
            first[detected] * step, scores.select_clusters(cell.sky)[silent][detected]
        ).as_json(),
        "after_crossing_s": round_number(np.median(late)) if len(late) else None,
        "horizon_s": horizon,
        "survival": [],
    }
    if len(first) and cell.spoofer != "none":
        curve = scores.survival(delay, detected, times)
        rows = zip(*curve, strict=True)
        found["survival"] = [
            dict(zip(curve._fields, map(round_number, row), strict=True)) for row in rows
        ]
    return found


def _median(x: NDArray[Any], clusters: NDArray[np.int64]) -> statistics.Estimate:
    """Median with a percentile interval, by resamples of these runs alone."""
    if not len(x):
        return statistics.NOTHING
    drawn = statistics.largest_of_share(x, 0.5, statistics.draw_resamples(clusters))
    return statistics.percentiles(float(np.median(x)), drawn)


def score_protection(found: record.Protection, limits: Sequence[float]) -> dict[str, Any]:
    """What the worst attacks exceed, and P(HMI | attack). The worst of all winners counts, whatever
    each was chosen for, so that no figure contradicts another."""
    aims = [aim for winner in found.winners for aim in winner.aims]
    searched = sorted({aim.limit_m for aim in aims if aim.limit_m is not None} & set(limits))
    skies = None if found.skies is None else len(found.skies)
    return {
        "detector": found.detector,
        "counted": int(found.counts.sum()),
        "exceeded": [_score_aim(found, aim) for aim in aims if aim.share is not None],
        "p_hmi": [
            score_hazard(found, measure, limit)
            for measure in found.winners[0].displacement
            for limit in searched
        ],
        "worst_skies": skies,
    }


def _score_aim(found: record.Protection, aim: record.Aim) -> dict[str, Any]:
    """What the worst attack exceeds in a share of the runs."""
    assert aim.share is not None  # as chosen by the caller
    winner, rows = found.worst(aim), found.rows(aim)
    # the worst skies are few, and the interval is for these alone
    alike = np.arange(len(found.sky)) if aim.skies else scores.select_clusters(found.sky)
    estimate = estimate_exceeded(aim, (found, statistics.draw_resamples(alike[rows])))
    everywhere = found.score_worst(aim._replace(skies=False))
    if aim.skies and estimate.value < (1.0 - scores.ALIKE) * everywhere:
        estimate = statistics.NOTHING  # the few runs of the choice have not found the worst skies
    value = estimate.as_json()
    named = {"measure": aim.measure, "share": aim.share, "worst_skies": aim.skies}
    return {**named, "runs": int(rows.sum()), **value, **_attack(winner)}


def score_hazard(found: record.Protection, measure: str, limit: float) -> dict[str, Any]:
    """P(HMI | attack) at an alert limit [m]."""
    winner = found.worst(record.Aim(measure, limit_m=limit))
    (p,) = statistics.exceedance(winner.displacement[measure][found.counts], [limit])
    return {"measure": measure, "alert_limit_m": limit, **p.as_json(), **_attack(winner)}


def _attack(winner: record.Winner) -> dict[str, Any]:
    named = {"letter": winner.letter, "spoofer": winner.spoofer}
    return {**named, "setting": winner.setting, "at": winner.value}
