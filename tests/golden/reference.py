"""Golden runs of the reference software, read into the project's own terms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from spoofgym.receiver import NavState, Recording

RUNS = {
    "aviation": "golden_aviation_profile1_1Hz.mat",
    "tactical": "golden_tactical_profile3_first120s_1Hz.mat",
}


def load(folder: Path, grade: str) -> dict[str, Any]:
    return dict(scipy.io.loadmat(str(folder / "groves_reference" / RUNS[grade])))


def recording(run: dict[str, Any]) -> Recording:
    rows = run["gnss_meas"]
    epochs = np.unique(rows[:, 9])[1:]  # the first one is the least-squares fix at time zero
    groups = [rows[rows[:, 9] == epoch] for epoch in epochs]
    n = max(len(group) for group in groups)
    table = np.full((len(groups), n, 8), np.nan)
    for k, group in enumerate(groups):
        table[k, : len(group)] = group[:, 1:9]
    measured = run["imu_true_meas"][:, 6:]
    return Recording(
        imu_time=run["profile_used"][1:, 0],
        specific_force_b=measured[:, :3],
        angular_rate_b=measured[:, 3:],
        gnss_time=[group[0, 0] for group in groups],
        pseudorange=table[:, :, 0],
        range_rate=table[:, :, 1],
        satellite_position_e=table[:, :, 2:5],
        satellite_velocity_e=table[:, :, 5:8],
    )


def initial(run: dict[str, Any]) -> NavState:
    fix = run["ls0"][0]
    return NavState(
        position_e=fix[:3],
        velocity_e=fix[3:6],
        C_eb=run["init_C"],
        clock_bias_m=fix[6],
        clock_drift_mps=fix[7],
    )
