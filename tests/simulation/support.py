"""Short episodes of every victim, and a detector in the loop for those that take positions."""

import numpy as np

from spoofgym.detectors import Detector, Verdict
from spoofgym.simulation import (
    LooselyCoupledSetup,
    SnapshotSetup,
    TightlyCoupledSetup,
    WheeledRobotSetup,
)
from spoofgym.simulation.simulator import run_serially

SHORT = {
    "tightly-coupled": {
        "timeline": {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 5.0}
    },
    "loose": {
        "timeline": {"warmup_s": 4.0, "live_s": 3.0, "attack_s": 2.0, "time_to_alert_s": 1.0},
        "receiver": {"self_tuning": {"window": 20, "process": "clamped"}},
        "detector": {"name": "windowed-chi2", "window": 2},
    },
    "snapshot": {
        "timeline": {"warmup_s": 5.0, "live_s": 3.0, "attack_s": 20.0, "time_to_alert_s": 4.0},
        "detector": {"name": "traversal-raim", "exclude": True},
    },
    "robot": {
        "timeline": {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 40.0, "time_to_alert_s": 5.0}
    },
}
"""Settings of a short episode by victim, as JSON has them."""
DOMAINS = {
    "tightly-coupled": {"start_s": (5.0, 40.0), "constellation_time_s": (0.0, 9e3), "worlds": 2},
    "loose": {"start_s": (1.0, 30.0)},
    "snapshot": {"turned_deg": (0.0, 360.0), "constellation_time_s": (0.0, 2e3), "worlds": 3},
    "robot": {"start_s": (3.0, None)},
}
"""Something to be drawn for every episode."""
SETUPS = {
    "tightly-coupled": TightlyCoupledSetup,
    "loose": LooselyCoupledSetup,
    "snapshot": SnapshotSetup,
    "robot": WheeledRobotSetup,
}


def setup_of(kind, **settings):
    if kind == "loose":  # no detector of the registry gives weights to its positions
        settings = {"detector": Weigher(), **settings}
    return SETUPS[kind](**{**SHORT[kind], **settings})


def rngs(receivers, first=100):
    return [np.random.default_rng(first + row) for row in range(receivers)]


def warm(setup, receivers, first=100, **given):
    simulator = setup.simulator(receivers, run_serially)
    simulator.warm_up(rngs(receivers, first), given=given or None)
    return simulator


def step(simulator, command=None):
    """One epoch with the detector in the loop; (B,) bool alarms."""
    if command is not None:
        shape = (simulator.receivers, len(simulator.setup.action_names))
        command = np.broadcast_to(np.asarray(command, dtype=np.float64), shape).copy()
    simulator.predict(command)
    verdict = simulator.judge()
    simulator.update(verdict.weights)
    return np.asarray(verdict.alarm.any(axis=1))


class Weigher(Detector):
    paper = "shadmehri2025"
    measures = "position"

    def bind(self, context):
        super().bind(context)
        self.memory.declare("worst", np.zeros(context.receivers))

    def judge(self, epoch):
        size = np.abs(epoch.innovation).max(axis=1, keepdims=True)
        self.memory["worst"] = np.maximum(self.memory["worst"], size[:, 0])
        weights = 1.0 / (1.0 + 0.1 * np.abs(epoch.innovation))
        return Verdict(size, np.full_like(size, 6.0), size > 6.0, weights)
