"""The parts of a run: what is simulated, and what is kept of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofgym.detectors.innovation import two_sided_quantile

from .delays import end_delay, onset_delay
from .runs import COMPARATORS, METHODS, PRODUCTION, SATELLITES, TABLED, fly

FloatArray = NDArray[np.float64]


def table_part(attack: str, runs: int, seed: int) -> dict[str, Any]:
    """The three methods and the comparators against one attack. Returns ``alarm_NAME`` (K, R) and
    ``others_NAME`` (R,) for every method and comparator, of M1 also ``upper_M1`` (K, R), its alarms
    above the upper limit alone, and ``trace_M`` (4, K), innovation, its standard deviation, average
    and threshold of the first run of a method."""
    out: dict[str, Any] = {}
    plain = {"M1": METHODS["M1"], **COMPARATORS}
    for group in (plain, {"M2": METHODS["M2"]}, {"M3": METHODS["M3"]}, {"production": PRODUCTION}):
        flown = fly(attack, list(group.values()), runs, seed)
        for d, name in enumerate(group):
            out[f"alarm_{name}"] = flown.alarm[d]
            out[f"others_{name}"] = flown.others[d]
        first = next(iter(group))
        if first == "M1":
            limit = two_sided_quantile(METHODS["M1"]["false_alarm"])
            out["upper_M1"] = flown.innovation > limit * flown.sd
        trace = (flown.innovation, flown.sd, flown.average, flown.threshold)
        out[f"trace_{first}"] = np.array([values[:, 0] for values in trace])
    return out


def compute_median_distances(xi: FloatArray) -> FloatArray:
    """Largest distance of three successive ratios from their median.  `xi`: (K, R) joint detection
    metric, 0 where nothing is detected.  Returns (K, R) Delta Y of the window that ends at each
    epoch."""
    padded = np.concatenate([np.zeros((2, xi.shape[1])), xi])
    window = np.stack([padded[:-2], padded[1:-1], padded[2:]])
    return np.asarray(np.abs(window - np.median(window, axis=0)).max(axis=0))


def metric_part(pseudorange_sd_m: float, runs: int, seed: int) -> dict[str, Any]:
    """The joint detection metric under all six attacks, by the noise that the filter assumes.
    Returns by attack: ``xi_NAME`` (K,) of the first run, ``average_NAME`` and ``innovation_NAME``
    beside it, ``jump_NAME`` (R,) Delta Y at the first epoch after the attack, ``settled_NAME`` (R,)
    its largest value in the last 50 s of the attack, and ``ended_NAME`` (R,) bool, whether the
    joint chart ends its alarm there."""
    out: dict[str, Any] = {}
    last = 300
    for attack in TABLED:
        flown = fly(attack, [METHODS["M2"]], runs, seed, pseudorange_sd_m)
        detected = np.abs(flown.average) > flown.threshold
        ratio = flown.innovation / np.where(detected, flown.average, 1.0)
        xi = np.where(detected, ratio, 0.0)
        delta = compute_median_distances(xi)
        out[f"xi_{attack}"] = xi[:, 0]
        out[f"delta_{attack}"] = delta[:, 0]
        out[f"average_{attack}"] = flown.average[:, 0]
        out[f"innovation_{attack}"] = flown.innovation[:, 0]
        out[f"jump_{attack}"] = delta[last]
        out[f"settled_{attack}"] = delta[last - 100 : last].max(axis=0)
        joint = fly(attack, [METHODS["M3"]], runs, seed, pseudorange_sd_m).alarm[0]
        out[f"ended_{attack}"] = joint[last - 1] & ~joint[last]
    return out


def noise_part(noise_sd_m: float, runs: int, seed: int) -> dict[str, Any]:
    """The joint chart where the pseudoranges are as noisy as the filter assumes. Returns
    ``ended_NAME`` (R,) bool by attack: alarmed to the last epoch of the attack, and not at the
    first one after it; ``early_NAME`` (R,) alarms that ended within the attack; and ``others_NAME``
    (R,) other satellites that alarmed."""
    out: dict[str, Any] = {}
    for attack in TABLED:
        flown = fly(attack, [METHODS["M3"]], runs, seed, noise_sd_m, true_sd_m=noise_sd_m)
        alarm = flown.alarm[0]
        out[f"ended_{attack}"] = alarm[299] & ~alarm[300]
        out[f"early_{attack}"] = (alarm[:299] & ~alarm[1:300]).sum(axis=0)
        out[f"others_{attack}"] = flown.others[0]
    return out


def satellites_part(attack: str, runs: int, seed: int) -> dict[str, Any]:
    """M1 against an attack on each of the satellites, one after the other. Returns ``onset`` and
    ``end`` (n,) medians of the delays by satellite [s]."""
    limit = two_sided_quantile(METHODS["M1"]["false_alarm"])
    onset, end = [], []
    for satellite in SATELLITES:
        flown = fly(attack, [METHODS["M1"]], runs, seed, satellite=satellite)
        upper = flown.innovation > limit * flown.sd
        onset.append(float(np.median(onset_delay(upper))))
        end.append(float(np.median(end_delay(upper))))
    return {"onset": onset, "end": end}
