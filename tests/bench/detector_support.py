"""A task for detectors that takes seconds: short episodes of T3's flight, an alert limit of 2 m."""

from dataclasses import dataclass

import numpy as np

from spoofgym.bench.runs.record import compute_displacement
from spoofgym.tasks import AttackFamily, DetectorTask, get_detector_task, get_task

TIMELINE = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 4.0}
NOMINAL = {"thresholds": "nominal"}


@dataclass(frozen=True)
class SmallTask(DetectorTask):
    alert_limit_m = 2.0

    @property
    def world_kwargs(self):
        drawn = {"start_s": [0.0, None], "turned_deg": [0.0, 360.0], "worlds": 8}
        drawn["constellation_time_s"] = [0.0, 86_400.0]
        world = {"scenario": "trolley", "receiver": "matched"}
        return {**world, "timeline": dict(TIMELINE), "domain": drawn}


def small_task(of="v1/D1"):
    families = get_detector_task(of).families
    # its own timeline has onsets of all kinds
    kept = (AttackFamily(**{**vars(each), "timeline": None}) for each in families)
    return SmallTask("small", "short episodes", get_task("T3"), tuple(kept))


def displace(panel, attack):
    """(D, R') undetected displacement under an attack, before each of a panel's detectors [m]."""
    played = panel.play([(attack, k) for k in range(len(panel.judges))])
    pairs = zip(played, panel.clean, strict=True)
    moved = [compute_displacement(panel.setup, x, twin.first(attack.runs)) for x, twin in pairs]
    return np.round(moved, 6)
