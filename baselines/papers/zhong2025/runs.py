"""The simulations: one attack of the paper against its three methods and some comparators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofgym.detectors import Detector, DetectorContext, Verdict, make_detector
from spoofgym.detectors.thresholds import two_sided_quantile
from spoofgym.envs import Engine, Setup
from spoofgym.envs.attach import spoofer_context
from spoofgym.envs.presets import make_setup
from spoofgym.receiver import TightlyCoupled
from spoofgym.receiver.epoch import Epoch
from spoofgym.receiver.tight import NoiseModel
from spoofgym.sim.gnss import ERRORS
from spoofgym.spoofers import PAPER_ATTACKS, make_spoofer

FloatArray = NDArray[np.float64]
Spec = Mapping[str, Any]

SATELLITE = "S15"
"""What stands for the paper's PRN1: nearest to the notes' satellite in redundancy."""
SATELLITES = ("S05", "S06", "S09", "S10", "S11", "S14", "S15", "S30")
EPOCH_S = 0.5
AFTER_S = 30.0
"""How long the run goes on after the attack."""
FIRST_S = 0.01
"""The paper's epochs are at 0.01 s + 0.5 s k, so that its smallest delay is 0.01 s."""

PAPER_CHART = {"smoothing": 0.1, "false_alarm": 1e-5, "weight_scale": 0.1}
METHODS: dict[str, Spec] = {
    "M1": {"name": "shewhart", "false_alarm": 1e-5},
    "M2": {"name": "ewma", **PAPER_CHART},
    "M3": {"name": "joint-chart", **PAPER_CHART, "max_exclusion_s": None, "min_satellites": 0},
}
COMPARATORS: dict[str, Spec] = {
    "snapshot chi-square": {"name": "snapshot-chi2", "signals": "pseudorange"},
    "sequential, all history": {"name": "sequential-chi2"},
    "sequential, 15 s": {"name": "sequential-chi2", "window_s": 15.0},
    "AIME, 5 s": {"name": "aime", "windows_s": [5.0]},
    "AIME, 25 s": {"name": "aime", "windows_s": [25.0]},
    "AIME, 75 s": {"name": "aime", "windows_s": [75.0]},
    "CUSUM 0.5, 12.4": {"name": "cusum", "allowance": 0.5, "limit": 12.4},
}
PRODUCTION: Spec = {"name": "joint-chart"}
"""The joint chart with the defaults of this project: m = 0.3, exclusion limited."""


class Beside(Detector):
    """Several detectors on the same epochs; the first one is in the loop, the others watch.

    Parameters
    ----------
    specs : sequence of dict
        As `make_detector` takes them.
    """

    paper = "zhong2025"
    scope = "channel"

    def __init__(self, specs: Sequence[Spec]) -> None:
        self.detectors = [make_detector(spec) for spec in specs]
        self.verdicts: list[Verdict] = []

    def bind(self, context: DetectorContext) -> None:
        """Bind all."""
        super().bind(context)
        for detector in self.detectors:
            detector.bind(context)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Reset all."""
        for detector in self.detectors:
            detector.reset(mask)

    def judge(self, epoch: Epoch) -> Verdict:
        """Verdict of the first one; `verdicts` has all of them."""
        self.verdicts = [detector.judge(epoch) for detector in self.detectors]
        return self.verdicts[0]


class Flown(NamedTuple):
    """What R runs did over K epochs from the onset on.

    Attributes
    ----------
    alarm : ndarray
        (D, K, R) bool, of the spoofed satellite, or of the receiver by a test of the whole.
    others : ndarray
        (D, R) how many other satellites a test of single satellites alarmed at least once.
    innovation, sd : ndarray
        (K, R) of the spoofed satellite [m].
    average, threshold : ndarray
        (K, R) of the first detector's chart [m]; 0 where it has none.
    """

    alarm: NDArray[np.bool_]
    others: NDArray[np.int64]
    innovation: FloatArray
    sd: FloatArray
    average: FloatArray
    threshold: FloatArray


def setup_of(
    attack: str,
    detector: Detector,
    pseudorange_sd_m: float = 2.5,
    satellite: str = SATELLITE,
    true_sd_m: float = 1.0,
) -> Setup:
    """The paper's receiver under one of its attacks.

    Parameters
    ----------
    attack : str
        A name in `PAPER_ATTACKS`.
    detector : Detector
        In the loop.
    pseudorange_sd_m : float
        What the filter takes for the noise of pseudoranges.
    satellite : str
        Which one is spoofed.
    true_sd_m : float
        Noise of the pseudoranges.

    Returns
    -------
    Setup
        For an engine.
    """
    found = PAPER_ATTACKS[attack]
    noise = NoiseModel(pseudorange_sd=pseudorange_sd_m)
    errors = replace(ERRORS["white"], code_sd_m=true_sd_m)
    return make_setup(
        scenario={"name": "zhong2025-white", "errors": errors},
        receiver=TightlyCoupled(tuning="paper", covariance_update="unweighted", noise=noise),
        attack=found.attack((satellite,)),
        detector=detector,
        timeline={
            "warmup_s": found.onset_s,
            "live_s": found.onset_s - 1.0,
            "attack_s": found.duration_s + AFTER_S,
            "time_to_alert_s": 0.0,
        },
    )


def fly(
    attack: str,
    specs: Sequence[Spec],
    runs: int,
    seed: int,
    pseudorange_sd_m: float = 2.5,
    satellite: str = SATELLITE,
    true_sd_m: float = 1.0,
) -> Flown:
    """Run an attack against a detector in the loop, with others watching.

    Parameters
    ----------
    attack : str
        A name in `PAPER_ATTACKS`.
    specs : sequence of dict
        Detectors, the first one in the loop.
    runs : int
        R; run r has the same noise whatever the attack and the detectors are.
    seed : int
        Of the noise.
    pseudorange_sd_m, satellite, true_sd_m : optional
        As in `setup_of`.

    Returns
    -------
    Flown
        From the onset to `AFTER_S` after the end.
    """
    setup = setup_of(attack, Beside(specs), pseudorange_sd_m, satellite, true_sd_m)
    engine = Engine(runs, setup, threads=1)
    engine.reset([np.random.default_rng([seed, run]) for run in range(runs)])
    spoofer = make_spoofer(dict(PAPER_ATTACKS[attack].spoofer))
    spoofer.bind(spoofer_context(setup, runs))
    slot = setup.world.satellite_ids.index(satellite)
    beside = engine.batch.detector
    assert isinstance(beside, Beside)
    alarm = np.zeros((len(specs), setup.steps, runs), dtype=np.bool_)
    others = np.zeros((len(specs), runs, setup.world.channels), dtype=np.bool_)
    series = np.zeros((4, setup.steps, runs))
    for k in range(setup.steps):
        epoch = engine.predict(spoofer.act(np.zeros((runs, 0), dtype=np.float32)))
        verdict = engine.judge()
        for d, seen in enumerate(beside.verdicts):
            columns = seen.alarm.shape[1]
            alarm[d, k] = seen.alarm[:, slot if columns > 1 else 0]
            if columns > 1:
                others[d] |= seen.alarm
        series[0, k] = epoch.innovation[:, slot]
        series[1, k] = np.sqrt(epoch.innovation_cov[:, slot, slot])
        if "average" in beside.detectors[0].memory:
            series[2, k] = beside.detectors[0].memory["average"][:, slot]
        series[3, k] = verdict.threshold[:, slot]
        engine.update(verdict)
    others[:, :, slot] = False
    return Flown(alarm, others.sum(axis=2), *series)


def table_part(attack: str, runs: int, seed: int) -> dict[str, Any]:
    """The three methods and the comparators against one attack.

    Parameters
    ----------
    attack : str
        A name in `PAPER_ATTACKS`.
    runs : int
        How many.
    seed : int
        Of the noise.

    Returns
    -------
    dict
        ``alarm_NAME`` (K, R) and ``others_NAME`` (R,) for every method and comparator, of M1 also
        ``upper_M1`` (K, R), its alarms above the upper limit alone, and ``trace_M`` (4, K),
        innovation, its standard deviation, average and threshold of the first run of a method.
    """
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


def differences(xi: FloatArray) -> FloatArray:
    """Largest distance of three successive ratios from their median.

    Parameters
    ----------
    xi : ndarray
        (K, R) joint detection metric, 0 where nothing is detected.

    Returns
    -------
    ndarray
        (K, R) Delta Y of the window that ends at each epoch.
    """
    padded = np.concatenate([np.zeros((2, xi.shape[1])), xi])
    window = np.stack([padded[:-2], padded[1:-1], padded[2:]])
    return np.asarray(np.abs(window - np.median(window, axis=0)).max(axis=0))


def metric_part(pseudorange_sd_m: float, runs: int, seed: int) -> dict[str, Any]:
    """The joint detection metric under all six attacks, by the noise that the filter assumes.

    Parameters
    ----------
    pseudorange_sd_m : float
        As in `setup_of`.
    runs : int
        How many.
    seed : int
        Of the noise.

    Returns
    -------
    dict
        By attack: ``xi_NAME`` (K,) of the first run, ``average_NAME`` and ``innovation_NAME``
        beside it, ``jump_NAME`` (R,) Delta Y at the first epoch after the attack,
        ``settled_NAME`` (R,) its largest value in the last 50 s of the attack, and ``ended_NAME``
        (R,) bool, whether the joint chart ends its alarm there.
    """
    out: dict[str, Any] = {}
    last = 300
    for attack in TABLED:
        flown = fly(attack, [METHODS["M2"]], runs, seed, pseudorange_sd_m)
        detected = np.abs(flown.average) > flown.threshold
        ratio = flown.innovation / np.where(detected, flown.average, 1.0)
        xi = np.where(detected, ratio, 0.0)
        delta = differences(xi)
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
    """The joint chart where the pseudoranges are as noisy as the filter assumes.

    Parameters
    ----------
    noise_sd_m : float
        Both.
    runs : int
        How many.
    seed : int
        Of the noise.

    Returns
    -------
    dict
        ``ended_NAME`` (R,) bool by attack: alarmed to the last epoch of the attack, and not at the
        first one after it; ``early_NAME`` (R,) alarms that ended within the attack; and
        ``others_NAME`` (R,) other satellites that alarmed.
    """
    out: dict[str, Any] = {}
    for attack in TABLED:
        flown = fly(attack, [METHODS["M3"]], runs, seed, noise_sd_m, true_sd_m=noise_sd_m)
        alarm = flown.alarm[0]
        out[f"ended_{attack}"] = alarm[299] & ~alarm[300]
        out[f"early_{attack}"] = (alarm[:299] & ~alarm[1:300]).sum(axis=0)
        out[f"others_{attack}"] = flown.others[0]
    return out


def satellites_part(attack: str, runs: int, seed: int) -> dict[str, Any]:
    """M1 against an attack on each of the satellites, one after the other.

    Parameters
    ----------
    attack : str
        A name in `PAPER_ATTACKS`.
    runs : int
        How many.
    seed : int
        Of the noise.

    Returns
    -------
    dict
        ``onset`` and ``end`` (n,) medians of the delays by satellite [s].
    """
    limit = two_sided_quantile(METHODS["M1"]["false_alarm"])
    onset, end = [], []
    for satellite in SATELLITES:
        flown = fly(attack, [METHODS["M1"]], runs, seed, satellite=satellite)
        upper = flown.innovation > limit * flown.sd
        onset.append(float(np.median(onset_delay(upper))))
        end.append(float(np.median(end_delay(upper))))
    return {"onset": onset, "end": end}


TABLED = (
    "zhong2025-step-15m",
    "zhong2025-step-25m",
    "zhong2025-step-35m",
    "zhong2025-ramp-0.2mps",
    "zhong2025-ramp-0.5mps",
    "zhong2025-ramp-0.7mps",
)
"""Attacks of tables 4 and 5."""
INTERMITTENT = "zhong2025-intermittent"
"""Attack of experiment 8."""


def onset_delay(alarm: NDArray[np.bool_], first: int = 0, last: int = 300) -> FloatArray:
    """Delay of the first alarm within an attack, as the paper counts it.

    Parameters
    ----------
    alarm : ndarray
        (K, R) bool.
    first, last : int
        Epochs of the attack, `last` excluded.

    Returns
    -------
    ndarray
        (R,) [s]; infinite where there is none.
    """
    inside = alarm[first:last]
    return np.where(inside.any(axis=0), inside.argmax(axis=0) * EPOCH_S + FIRST_S, np.inf)


def end_delay(
    alarm: NDArray[np.bool_], first: int = 0, last: int = 300, until: int | None = None
) -> FloatArray:
    """Delay of the first epoch without an alarm after an attack, as the paper counts it.

    Parameters
    ----------
    alarm : ndarray
        (K, R) bool.
    first, last : int
        Epochs of the attack, `last` excluded.
    until : int, optional
        Epoch of the next attack; the end of the record by default.

    Returns
    -------
    ndarray
        (R,) [s]; negative where the last alarm of the attack was over before its end, and infinite
        where there was none, or no end of it.
    """
    inside, after = alarm[first:last], alarm[last:until]
    late = np.where(after.all(axis=0), np.inf, (~after).argmax(axis=0) * EPOCH_S)
    early = np.where(inside.any(axis=0), -inside[::-1].argmax(axis=0) * EPOCH_S, np.inf)
    return np.asarray(np.where(inside[-1], late, early) + FIRST_S)
