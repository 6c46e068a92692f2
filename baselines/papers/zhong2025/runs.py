"""The simulations: one attack of the paper against its three methods and some comparators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.paper_attacks import PAPER_ATTACKS
from spoofgym.detectors import Detector, DetectorContext, Verdict, make_detector
from spoofgym.envs.context import spoofer_context
from spoofgym.receiver import TightlyCoupled
from spoofgym.receiver.epoch import Epoch
from spoofgym.receiver.tight import NoiseModel
from spoofgym.simulation import Engine, TightlyCoupledSetup
from spoofgym.spoofers import make_spoofer
from spoofgym.truth.gnss_errors import ERRORS

FloatArray = NDArray[np.float64]
Spec = Mapping[str, Any]

SATELLITE = "S15"
"""What stands for the paper's PRN1, whose place in the sky is not printed."""
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


class Several(Detector):
    """Several detectors on the same epochs: the first one in the loop, the others passive."""

    paper = "zhong2025"
    scope = "channel"

    def __init__(self, specs: Sequence[Spec]) -> None:
        self.detectors = [make_detector(spec) for spec in specs]
        self.needs = frozenset().union(*(detector.needs for detector in self.detectors))
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

    - `alarm`: (D, K, R) bool, of the spoofed satellite, or of the receiver by a test of the whole;
    - `others`: (D, R) how many other satellites a test of single satellites alarmed at least once;
    - `innovation`, `sd`: (K, R) of the spoofed satellite [m];
    - `average`, `threshold`: (K, R) of the first detector's chart [m]; 0 where it has none.
    """

    alarm: NDArray[np.bool_]
    others: NDArray[np.int64]
    innovation: FloatArray
    sd: FloatArray
    average: FloatArray
    threshold: FloatArray


def build_setup(
    attack: str,
    detector: Detector,
    pseudorange_sd_m: float = 2.5,
    satellite: str = SATELLITE,
    true_sd_m: float = 1.0,
) -> TightlyCoupledSetup:
    """The paper's receiver under one of its attacks. `pseudorange_sd_m`: what the filter takes for
    the noise of pseudoranges."""
    found = PAPER_ATTACKS[attack]
    noise = NoiseModel(pseudorange_sd=pseudorange_sd_m)
    errors = replace(ERRORS["white"], code_sd_m=true_sd_m)
    return TightlyCoupledSetup(
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
    """Run an attack against a detector in the loop, with others passive. Run r has the same noise
    whatever the attack and the detectors are."""
    setup = build_setup(attack, Several(specs), pseudorange_sd_m, satellite, true_sd_m)
    engine = Engine(runs, setup, threads=1)
    engine.reset([np.random.default_rng([seed, run]) for run in range(runs)])
    spoofer = make_spoofer(dict(PAPER_ATTACKS[attack].spoofer))
    spoofer.bind(spoofer_context(setup, runs))
    slot = setup.world.satellite_ids.index(satellite)
    several = engine.simulator.detector
    assert isinstance(several, Several)
    alarm = np.zeros((len(specs), setup.steps, runs), dtype=np.bool_)
    others = np.zeros((len(specs), runs, setup.world.channels), dtype=np.bool_)
    series = np.zeros((4, setup.steps, runs))
    for k in range(setup.steps):
        epoch = engine.predict(spoofer.act(np.zeros((runs, 0), dtype=np.float32)))
        verdict = engine.judge()
        for d, seen in enumerate(several.verdicts):
            columns = seen.alarm.shape[1]
            alarm[d, k] = seen.alarm[:, slot if columns > 1 else 0]
            if columns > 1:
                others[d] |= seen.alarm
        series[0, k] = epoch.innovation[:, slot]
        series[1, k] = np.sqrt(epoch.innovation_variance[:, slot])
        if "average" in several.detectors[0].memory:
            series[2, k] = several.detectors[0].memory["average"][:, slot]
        series[3, k] = verdict.threshold[:, slot]
        engine.update(verdict)
    others[:, :, slot] = False
    return Flown(alarm, others.sum(axis=2), *series)
