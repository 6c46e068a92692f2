"""A record of each class that has settings without defaults, for the tests of their bounds."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.bench.experiments.dataset import Plan
from spoofgym.bench.runs.world import World
from spoofgym.data.ephemerides import BroadcastConstellation, Ephemerides
from spoofgym.detectors import Calibrated, LearnedDetector, SnapshotChi2
from spoofgym.detectors.isolated import Isolated
from spoofgym.detectors.learned import PolicyDetector
from spoofgym.envs.terms.action import Channels, Residual
from spoofgym.envs.terms.termination import AtDisplacement, AtStealthBudget, AtSteps
from spoofgym.policies.contract import FunctionPolicy
from spoofgym.spoofers.learned import OnnxPolicy
from spoofgym.truth.gnss_errors import GnssErrors
from spoofgym.truth.manoeuvres import Accelerate, Climb, Steer, Straight, Turn, Until
from spoofgym.truth.satellites import TWO_CONSTELLATIONS, CombinedConstellation

from ..detectors.learned.files import write_guard


def one_record() -> Ephemerides:
    """A healthy record of the beginning of GPS time."""
    values = {each.name: np.zeros(1) for each in dataclasses.fields(Ephemerides)}
    values |= {"satellite_id": np.array(["G01"]), "root_semi_major_axis": np.array([5153.7])}
    return Ephemerides(**values)


def one_file() -> LearnedDetector:
    """Of a small network, read into memory."""
    with tempfile.TemporaryDirectory() as folder:
        return LearnedDetector(str(write_guard(Path(folder))))


EXAMPLES: dict[type, Callable[[], Any]] = {
    Accelerate: lambda: Accelerate(10.0),
    BroadcastConstellation: lambda: BroadcastConstellation(one_record(), 1.0),
    Climb: lambda: Climb(100.0),
    CombinedConstellation: lambda: TWO_CONSTELLATIONS,
    GnssErrors: lambda: GnssErrors(
        code_sd_m=1.0,
        range_rate_sd_mps=0.02,
        signal_in_space_sd_m=1.0,
        zenith_iono_sd_m=2.0,
        zenith_tropo_sd_m=0.2,
    ),
    Steer: lambda: Steer(45.0),
    Straight: lambda: Straight(1.0),
    Turn: lambda: Turn(45.0),
    Until: lambda: Until(1.0),
    OnnxPolicy: lambda: OnnxPolicy("ewma-ppo"),
    Calibrated: lambda: Calibrated(SnapshotChi2(), scale=1.0),
    Isolated: lambda: Isolated("snapshot-chi2"),
    LearnedDetector: one_file,
    PolicyDetector: lambda: PolicyDetector(policy=FunctionPolicy(abs)),
    Channels: lambda: Channels(("north",)),
    Residual: lambda: Residual({"name": "ramp", "rate_mps": 0.3}),
    AtDisplacement: lambda: AtDisplacement(50.0),
    AtStealthBudget: lambda: AtStealthBudget(2.0),
    AtSteps: lambda: AtSteps(7),
    Plan: lambda: Plan(World().setup, 40.0),
}
