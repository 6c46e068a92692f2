"""Judgement of one epoch of 64 receivers, with the check of the verdict, and the whole step."""

import numpy as np
import pytest

from spoofgym.detectors import DETECTORS
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.engine import Engine

RECEIVERS = 64
NAMES = [name for name, kind in DETECTORS.items() if kind.measures != "position"]


@pytest.fixture(scope="module", params=NAMES)
def engine(request):
    kind = DETECTORS[request.param]
    spec = {"name": request.param}
    if kind.calibrates:  # no calibration has this world
        spec["thresholds"] = "nominal"
    if kind.oracle:
        spec["onset_s"] = 200.0
    scenario = {"name": "zhong2025", "epoch_interval_s": 1.0}
    made = Engine(RECEIVERS, TightlyCoupledSetup(scenario=scenario, detector=spec), threads=1)
    made.reset([np.random.default_rng(seed) for seed in range(RECEIVERS)])
    made.step(None)
    yield made
    made.close()


def test_judge(benchmark, engine):
    benchmark(engine.judge)


def test_step(benchmark, engine):
    rounds = engine.setup.steps - 2
    benchmark.pedantic(engine.step, (None,), rounds=rounds)
