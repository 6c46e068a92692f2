"""Runs of the paper's flight under attack: who alarms when, and how far the position is off.

Detectors that weigh are in the loop of a run of their own.  All others watch one run of the plain
filter together.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofgym.attacks import PerChannel
from spoofgym.detectors import (
    Detector,
    DetectorContext,
    GlrRamp,
    GlrStep,
    InnovationRate,
    LagCusum,
    Never,
    OracleRamp,
    OracleStep,
    SnapshotChi2,
)
from spoofgym.receiver import TightlyCoupled
from spoofgym.simulation import Engine, TightlyCoupledSetup, Timeline
from spoofgym.truth.scenario import SCENARIOS

FIRST, LAST = 350, 550
"""First and last spoofed epoch [s]."""
THRESHOLD = 0.0029517
FALSE_ALARM = 4e-6
RATE_LIMIT = 50.0
SEEN_FROM = 300
"""Begin of what figures show [s]."""
PAPER: dict[str, Any] = {
    "threshold": THRESHOLD,
    "false_alarm": FALSE_ALARM,
    "start_s": 20.0,
    "settled_s": 200.0,
    "max_exclusion_s": None,
    "min_satellites": 0,
}
"""Settings of the paper's methods, as far as they are told or come closest."""
WATCHERS: dict[str, Detector] = {
    "M1": InnovationRate(**PAPER),
    "M1 adaptive": InnovationRate(false_alarm=FALSE_ALARM),
    "glr-step": GlrStep(false_alarm=FALSE_ALARM),
    "glr-ramp": GlrRamp(false_alarm=FALSE_ALARM),
    "lag-cusum": LagCusum(),
    "snapshot-chi2": SnapshotChi2(false_alarm=FALSE_ALARM, signals="pseudorange"),
}
"""Detectors without weights, by name."""


def detector_in_loop(
    method: str, kind: str, size: float, channels: Sequence[str] | None
) -> Detector:
    """Detector with weights, by the paper's name. `method`: ``M2``, ``M2 adaptive``, ``oracle``:
    the paper's M2; the same with the adaptive threshold and the guard; M3 or M4; `kind`: ``step``,
    ``ramp``: of the attack that an oracle is told; `size`: its size [m] or slope [m/s]."""
    if method == "M2":
        return InnovationRate(weight_scale=1.0, **PAPER)
    if method == "M2 adaptive":
        return InnovationRate(weight_scale=1.0, false_alarm=FALSE_ALARM)
    named = None if channels is None else tuple(channels)
    if kind == "step":
        return OracleStep(size_m=size, channels=named, onset_s=float(FIRST), **PAPER)
    return OracleRamp(rate_mps=size, channels=named, onset_s=float(FIRST), **PAPER)


class Recorder:
    """What one detector said of the runs."""

    def __init__(self, epochs: int, runs: int, channels: int) -> None:
        self.alarm = np.zeros((epochs, runs, channels), dtype=np.bool_)
        self.first_run = np.zeros((epochs, channels))

    def take(self, k: int, statistic: NDArray[Any], alarm: NDArray[Any]) -> None:
        """Keep the verdict of an epoch; a test of the whole receiver stands for every channel."""
        self.alarm[k] = alarm
        self.first_run[k] = statistic[0]

    def summary(self, slots: Sequence[int], seen: int, onset: int) -> dict[str, Any]:
        """Delays of the attacked slots [s], -1 for none, and alarms of all of them."""
        during = self.alarm[onset:]
        hit = during[:, :, list(slots)]
        delay = np.where(hit.any(axis=0), hit.argmax(axis=0), -1)
        return {
            "delay_s": delay.T,
            "alarmed": during[:, :, :seen].any(axis=0).T,
            "alarmed_before": self.alarm[:onset, :, :seen].any(axis=0).T,
            "trace": self.first_run[:, :seen],
        }


def commands(kind: str, size: float, count: int) -> NDArray[np.float64]:
    """Rates [m/s] that make a step at `FIRST`, or a ramp that is zero then."""
    rates = np.zeros(count)
    if kind == "step":
        rates[0] = size
    else:
        rates[1:] = size
    return rates


def fly(
    kind: str,
    size: float,
    satellites: Sequence[str],
    in_loop: Detector,
    watchers: dict[str, Detector],
    *,
    name: str,
    scenario: str,
    update: str,
    runs: int,
    seed: int,
) -> dict[str, Any]:
    """Runs of one attack.  `name`: what the first one is called; empty to leave it out; `scenario`,
    `update`: world, and form of the covariance update.  Returns by name what `Recorder` tells, and
    ``"position"``: largest errors north, east, down of every run (runs, 3) and those of the first
    run (K, 3) [m]."""
    count = LAST - FIRST + 1
    begun = FIRST - 1
    setup = TightlyCoupledSetup(
        scenario=SCENARIOS[scenario](),
        receiver=TightlyCoupled(tuning="paper", covariance_update=update),
        attack=PerChannel(
            control="rate", rate_limit_mps=RATE_LIMIT, coherent=False, channels=tuple(satellites)
        ),
        detector=in_loop,
        timeline=Timeline(warmup_s=begun, live_s=begun, attack_s=count, time_to_alert_s=0.0),
    )
    setup.fields = frozenset().union(*(watcher.needs for watcher in watchers.values()))
    world = setup.world
    engine = Engine(runs, setup, threads=1)
    simulator = engine.simulator
    context = DetectorContext(
        runs, world.channels, 1.0, setup.combinations.largest_variance, world.satellite_ids
    )
    others = {key: copy.deepcopy(watcher) for key, watcher in watchers.items()}
    for other in others.values():
        other.bind(context)
    epochs = begun + count
    records = {key: Recorder(epochs, runs, world.channels) for key in (name, *others) if key}
    error = np.zeros((epochs, runs, 3))
    rates = commands(kind, size, count) / RATE_LIMIT
    simulator.start_episodes([np.random.default_rng([seed, run]) for run in range(runs)])
    for k in range(epochs):
        if k < begun:
            epoch = simulator.advance()
        else:
            action = np.full((runs, len(satellites)), rates[k - begun])
            epoch = simulator.predict(action)
        verdict = simulator.judge()
        if name:
            records[name].take(k, verdict.statistic, verdict.alarm)
        for key, other in others.items():
            said = other.judge(epoch)
            records[key].take(k, said.statistic, said.alarm)
        simulator.update(verdict.weights)
        off = simulator.position - world.position_e[k + 1]
        error[k] = off @ world.C_en[k + 1]
    engine.close()
    slots = [world.satellite_ids.index(satellite) for satellite in satellites]
    seen = sum(map(bool, world.satellite_ids))
    told = {key: record.summary(slots, seen, begun) for key, record in records.items()}
    for summary in told.values():
        summary["trace"] = summary["trace"][SEEN_FROM - 1 :]
    told["position"] = {
        "largest": np.abs(error[begun:]).max(axis=0),
        "trace": error[SEEN_FROM - 1 :, 0],
    }
    return told


def attack(
    kind: str,
    size: float,
    satellites: list[str],
    methods: list[str],
    runs: int,
    seed: int,
    scenario: str = "ke2022",
    update: str = "unweighted",
    told_size: float | None = None,
    told_satellites: list[str] | None = None,
) -> dict[str, Any]:
    """Runs of one attack for several methods.  `kind`: ``step``, ``ramp``: of the attack; `size`:
    size [m] or slope [m/s]; 0 for no attack; `methods`: names of `detector_in_loop`; ``"watchers"``
    for all `WATCHERS`; `scenario`, `update`: world, and form of the covariance update; `told_size`,
    `told_satellites`: what an oracle is told; the truth by default.  Returns arrays, named
    ``"<method>/<what>"``."""
    found: dict[str, Any] = {}
    same: Any = {"scenario": scenario, "update": update, "runs": runs, "seed": seed}
    for method in methods:
        if method == "watchers":
            loop, watchers, name = Never(), WATCHERS, ""
        else:
            told = size if told_size is None else told_size
            loop = detector_in_loop(method, kind, told, told_satellites or satellites)
            watchers, name = {}, method
        flown = fly(kind, size, satellites, loop, watchers, name=name, **same)
        position = flown.pop("position")
        for key, summary in flown.items():
            found |= {f"{key}/{what}": value for what, value in summary.items()}
        plain = "M1" if method == "watchers" else method
        found |= {f"{plain}/position_{what}": value for what, value in position.items()}
    return found


def misses_by_satellite(
    kind: str, size: float, satellites: list[str], runs: int, seed: int, scenario: str
) -> dict[str, Any]:
    """Runs of one attack on each of several satellites in turn, with M2 in the loop. Returns
    ``missed``: (n,) share of runs without an alarm by satellite [%]; ``cases``: all runs."""
    missed = []
    for satellite in satellites:
        flown = attack(kind, size, [satellite], ["M2"], runs, seed, scenario)
        missed.append(100.0 * float((flown["M2/delay_s"] < 0).mean()))
    return {"missed": missed, "cases": runs * len(satellites)}
