"""The parts of the reproduction: what runs, apart from what is told of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.robot_data_sets import DATA_SETS, RobotDataSet

from .measures import accuracy, latency, rates, recovery, retroactive
from .runs import FILTERS, Recording, judge, ramp_offsets, record

ATTACKED = ("jump", "slow", "both")
RAMP_START_S = 150.0


def table_part(seed: int, runs: int, hard_iron_deg: float) -> dict[str, Any]:
    """All data sets and filters. Returns ``"SET/FILTER/QUANTITY"``: (B,) figures of merit,
    latencies and recovery times; ``"SET/FILTER/P_*"``: rates."""
    out: dict[str, Any] = {}
    for name in ("psi1", "psi2", *ATTACKED):
        recording = record(name, seed, runs, odometer={"hard_iron_deg": hard_iron_deg})
        for quantity, value in accuracy(recording.fix_error).items():
            out[f"{name}/GNSS/{quantity}"] = value
        for word, detector in FILTERS.items():
            judged = judge(recording, detector)
            for quantity, value in accuracy(judged.error).items():
                out[f"{name}/{word}/{quantity}"] = value
            out |= _alarms(f"{name}/{word}", DATA_SETS[name], judged.alarm)
    return out


def _alarms(prefix: str, data_set: RobotDataSet, alarm: NDArray[np.bool_]) -> dict[str, Any]:
    out: dict[str, Any] = {
        f"{prefix}/{rate}": value for rate, value in rates(alarm, data_set.mark_attacked()).items()
    }
    for kind, windows in (("jump", data_set.jump_s), ("slow", data_set.slow_s)):
        for window in windows:
            epochs = data_set.epochs(window)
            out[f"{prefix}/{kind} latency"] = latency(alarm, epochs)
            out[f"{prefix}/{kind} recovery"] = recovery(alarm, epochs)
    out[f"{prefix}/alarm at the end"] = alarm[-1].astype(np.float64)
    return out


def trace_part(seed: int) -> dict[str, Any]:
    """One run of every data set, for the figures. Returns ``"SET/FILTER"``: (K, 2) errors [m];
    ``"truth"``: (K, 2) [m]."""
    out: dict[str, Any] = {}
    for name in ATTACKED:
        recording = record(name, seed, 1)
        out["truth"] = recording.truth
        out[f"{name}/GNSS"] = recording.fix_error[:, 0]
        for word, detector in FILTERS.items():
            out[f"{name}/{word}"] = judge(recording, detector).error[:, 0]
    return out


def _rule(kind: str, variant: str, window: int, threshold: float) -> dict[str, Any]:
    """The detector with one of its two rules."""
    spec: dict[str, Any] = {"name": "acna", "variant": variant}
    if kind == "jump":
        return {
            **spec,
            "jump_window": window,
            "jump_threshold_m": threshold,
            "slow_threshold_m": None,
        }
    return {**spec, "slow_window": window, "slow_threshold_m": threshold, "jump_threshold_m": None}


def sweep_part(
    seed: int, runs: int, kind: str, windows: list[int], thresholds: list[float]
) -> dict[str, Any]:
    """Figs. 9 to 12: one rule alone, over its window and threshold.  `kind`: ``jump``, ``slow``:
    the rule, on the data set of its attack; `thresholds`: Th_j or Th_s [m].  Returns ``P_D``,
    ``P_FA``, ``P_MD`` as the literal variant has them; ``P_D held``: with pending fixes held back;
    ``P_D told``: with alarms told of the whole window, of the held one for the jump and of the
    literal one for the slow change; each (windows, thresholds)."""
    recording = record(kind, seed, runs)
    attacked = DATA_SETS[kind].mark_attacked()
    shape = (len(windows), len(thresholds))
    out = {name: np.empty(shape) for name in ("P_D", "P_FA", "P_MD", "P_D held", "P_D told")}
    for i, window in enumerate(windows):
        for j, threshold in enumerate(thresholds):
            literal = judge(recording, _rule(kind, "literal", window, threshold)).alarm
            told = literal
            for name, value in rates(literal, attacked).items():
                out[name][i, j] = value
            if kind == "jump":
                told = judge(recording, _rule(kind, "held", window, threshold)).alarm
                out["P_D held"][i, j] = rates(told, attacked)["P_D"]
            else:
                out["P_D held"][i, j] = out["P_D"][i, j]
            out["P_D told"][i, j] = rates(retroactive(told, window), attacked)["P_D"]
    return {**out, "windows": windows, "thresholds": thresholds}


def ramp_part(seed: int, runs: int, ramp_rates: list[float]) -> dict[str, Any]:
    """What drift is slow enough not to be seen.  `ramp_rates`: rates of each axis [m/s].  Returns
    by rate: share of runs with an alarm in the 150 s of the ramp beyond those without one, mean
    latency of those [s], mean error at the end [m]."""
    course = RobotDataSet(slow_s=((RAMP_START_S, 300.0),))
    epochs = course.epochs(course.slow_s[0])
    seconds = list(range(1, 301))
    found, late, error = [], [], []
    for rate in ramp_rates:
        offsets = ramp_offsets(rate, RAMP_START_S, seconds, runs)
        judged = judge(
            record(course, seed, runs, offsets), {"name": "acna", "variant": "production"}
        )
        delay = latency(judged.alarm, epochs)
        seen = np.isfinite(delay)
        found.append(float(seen.mean()))
        late.append(float(np.mean(delay[seen])) if seen.any() else -1.0)
        error.append(float(np.hypot(*judged.error[-1].T).mean()))
    return {"rates": ramp_rates, "found": found, "latency": late, "error": error}


def assumption_part(seed: int, runs: int) -> dict[str, Any]:
    """What the printed thresholds need of the errors and of the anchor. Returns alarms on clean
    fixes: of both rules alone under white noise, and of the literal detector whose dead reckoning
    runs free from the begin; and sigma of GNSS under white noise."""
    white = {"correlated_sd_m": 0.0, "white_sd_m": 0.9}
    noisy = record("psi2", seed, runs, fix_errors=white)
    out: dict[str, Any] = {
        "white sigma": float(np.median(accuracy(noisy.fix_error)["sigma"])),
        "white jump P_FA": float(judge(noisy, _rule("jump", "literal", 2, 1.5)).alarm.mean()),
        "white slow P_FA": float(judge(noisy, _rule("slow", "literal", 5, 1.28)).alarm.mean()),
    }
    out["free P_FA"] = float(_judge_unanchored(record("psi2", seed, runs)).mean())
    return out


def _judge_unanchored(recording: Recording) -> NDArray[np.bool_]:
    """Slow rule whose dead reckoning is never anchored."""
    odometry = recording.first_fix + np.cumsum(recording.increment, axis=0)
    apart = recording.fix - odometry
    drift = np.hypot(apart[:, :, 0], apart[:, :, 1])
    total = np.cumsum(np.concatenate([np.zeros((5, drift.shape[1])), drift]), axis=0)
    return (total[5:] - total[:-5]) / 5.0 > 1.28
