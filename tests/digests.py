"""Digests of what the tightly coupled engine computes, to compare kinds of processors.

``python -m tests.digests`` plays short runs and prints one JSON object: by run, by field, the
SHA-256 of all numbers of the field over the run.  `tests.cpus` compares those of every kind.
"""

import hashlib
import json
from collections import defaultdict
from typing import Any

import numpy as np

from spoofgym.simulation import Engine, TightlyCoupledSetup

BATCHES = (1, 3, 8, 17)
STEPS = 14
TIMELINE = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 16.0, "time_to_alert_s": 4.0}
EQUIPMENT: dict[str, Any] = {
    "errors": {"bias_sd_m": 0.5},
    "tracking": {"sd_m": 1.0, "correlation_s": 5.0, "delay_s": 0.3, "bias_m": [0.5, 0.0, -0.5]},
    "spoofer_clock": {
        **{"offset_m": 3.0, "offset_sd_m": 1.0, "drift_sd_mps": 0.1},
        **{"phase_psd": 0.01, "frequency_psd": 0.04},
    },
    "capture": {"delay_s": 3.0, "alignment_m": None},
}
MEACONER = {name: each for name, each in EQUIPMENT.items() if name != "tracking"}
RUNS: dict[str, dict[str, Any]] = {
    "default": {"scenario": "zhong2025"},
    "false position, all equipment": {
        "scenario": "trolley",
        "attack": {"name": "false-position", "axes": "ned", **EQUIPMENT},
        "receiver": {"tuning": "matched", "conventions": "orthonormal"},
    },
    "per channel, all equipment": {
        "scenario": "trolley-consumer",
        "attack": {"name": "per-channel", **EQUIPMENT},
        "receiver": {"covariance_update": "general"},
    },
    "offsets, all equipment": {
        "scenario": "trolley",
        "attack": {"name": "offsets", "basis": "rotated", **EQUIPMENT},
    },
    "meaconer, all equipment": {
        "scenario": "trolley-tactical",
        "attack": {"name": "meaconer", "antenna_m": [0.0, 20.0, -5.0], **MEACONER},
        "receiver": {"covariance_update": "plain"},
    },
    "code alone": {"scenario": "groves", "attack": "pseudorange-only"},
    "one of two constellations": {
        "scenario": "trolley-two-constellations",
        "attack": "partial-constellation",
    },
    "another flight": {"scenario": "ke2022", "attack": "tracking-1m"},
    "airborne signals": {
        "scenario": {"name": "aviation-actual", "imu_rate_hz": 20},
        "attack": {"name": "false-position", "errors": "quiet"},
        "receiver": "matched",
        "domain": {"events": {"clock_step": 1.0, "satellite_loss": 1.0, "front": 1.0}},
    },
    "drawn worlds": {
        "scenario": "trolley",
        "attack": "tracking-1m",
        "domain": {
            "start_s": [0.0, 60.0],
            "turned_deg": [0.0, 360.0],
            "constellation_time_s": [0.0, 3600.0],
            "worlds": 3,
            "imu": ["aviation", "tactical", "consumer"],
            "errors": ["trolley", "zhong2025", "white"],
        },
        "target_heading_deg": "random",
    },
}
"""Settings of `TightlyCoupledSetup` by run."""
DETECTOR = {"name": "ewma", "thresholds": "nominal"}
"""In the loop: nothing that others computed may have a part in what is compared."""


class Digests:
    def __init__(self) -> None:
        self._digests: dict[str, Any] = defaultdict(hashlib.sha256)

    def add(self, **fields: Any) -> None:
        """More numbers of some fields; without values, as optional fields of an epoch are, none."""
        for name, values in fields.items():
            if values is not None:
                self._digests[name].update(np.ascontiguousarray(values).tobytes())

    def hex(self) -> dict[str, str]:
        return {name: digest.hexdigest() for name, digest in self._digests.items()}


def world_digests(setup: TightlyCoupledSetup) -> dict[str, str]:
    """Of the truth that all receivers share, which is computed before any of them moves."""
    digests = Digests()
    world = setup.world
    digests.add(satellites=world.satellites, position_e=world.position_e, C_en=world.C_en)
    return digests.hex()


def run_digests(setup: TightlyCoupledSetup, receivers: int) -> dict[str, str]:
    """Of warm-up and attack: by turns in two halves, as the duel plays them, and in one."""
    digests = Digests()
    engine = Engine(receivers, setup, threads=1)
    engine.reset([np.random.default_rng(100 + row) for row in range(receivers)])
    rng = np.random.default_rng(1)
    commands = rng.uniform(-1.0, 1.0, (STEPS, 32, len(setup.attack.action_names(setup.world))))
    for k, command in enumerate(commands):
        if k % 2:
            epoch = engine.predict(command[:receivers])
            digests.add(**{f"epoch.{name}": each for name, each in epoch._asdict().items()})
            verdict = engine.judge()
            engine.update(verdict)
        else:
            verdict = engine.step(command[:receivers])
        digests.add(**{f"verdict.{name}": each for name, each in verdict._asdict().items()})
        simulator = engine.simulator
        digests.add(
            position=simulator.position,
            error_n=simulator.error_n(),
            commanded_displacement=simulator.commanded_displacement,
            **simulator.get_record_columns(),
        )
    engine.close()
    return digests.hex()


def setup_of(name: str) -> TightlyCoupledSetup:
    return TightlyCoupledSetup(timeline=TIMELINE, detector=DETECTOR, **RUNS[name])


def all_digests() -> dict[str, dict[str, str]]:
    found = {}
    for name in RUNS:
        setup = setup_of(name)
        found[f"{name}: world"] = world_digests(setup)
        for receivers in BATCHES:
            found[f"{name}: B={receivers}"] = run_digests(setup, receivers)
    return found


if __name__ == "__main__":
    print(json.dumps(all_digests()))
