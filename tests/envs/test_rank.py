"""The return of the environment ranks policies as the score does, and its best one is stealthy.

The score is the mean undetected displacement, alarmed runs counted 0, on the runs of the return.
"""

import numpy as np
import pytest
from scipy.stats import spearmanr

from spoofgym.envs import SpoofCore
from spoofgym.envs.context import spoofer_context
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.spoofers import make_spoofer

RUNS = 256


def family(name, setting, low, high, count, shape=1.0):
    sizes = np.geomspace(low, high, count)
    return [{"name": name, setting: np.multiply(size, shape).tolist()} for size in sizes]


POLICIES = [
    *family("ramp", "rate_mps", 0.02, 2.0, 9),
    *family("accelerating-ramp", "acceleration_mps2", 2e-4, 0.02, 9),
    *family("profile", "rates_mps", 0.05, 1.5, 6, (0.0, 0.4, 0.5, 0.6, 0.8, 1.0, 1.5)),
    *family("feedback", "rate_mps", 0.03, 1.2, 6),
]


def played(detector):
    """Mean return, mean silent displacement, P(alarm | silent twin) of every policy, and clean."""
    setup = TightlyCoupledSetup(detector=detector)
    core = SpoofCore(RUNS, setup, knowledge="oracle", action="full-command")
    rows, silent_twin = [], None
    for spec in ({"name": "none"}, *POLICIES):
        spoofer = make_spoofer(spec)
        spoofer.bind(spoofer_context(setup, RUNS, core.observer))
        spoofer.reset()
        core.reset([np.random.default_rng([77, i]) for i in range(RUNS)])
        seen, total = core.observe(), np.zeros(RUNS)
        for _ in range(setup.steps):
            result, seen = core.step(spoofer.act(seen))
            total += result.reward
        detected = core.score.detected
        if silent_twin is None:
            silent_twin = ~detected
            continue
        silent = np.where(detected, 0.0, core.score.undetected)
        rows.append((total.mean(), silent.mean(), detected[silent_twin].mean()))
    core.close()
    return np.array(rows), 1.0 - silent_twin.mean()


@pytest.mark.nightly
@pytest.mark.parametrize("detector", ["ewma", "snapshot-chi2", "nominal"])
def test_the_return_ranks_as_the_score_and_its_best_is_stealthy(detector, request):
    """At its nominal threshold every fifth clean run alarms: what is best is over the budget."""
    nominal = detector == "nominal"
    if not nominal:
        request.getfixturevalue("default_rate")
    rows, clean = played("ewma" if nominal else detector)
    assert len(rows) == 30
    returns, silent, alarmed = rows.T
    assert spearmanr(returns, silent)[0] >= 0.9
    assert (0.1 < clean < 0.3) if nominal else (0.001 < clean < 0.03)
    assert nominal or alarmed[returns.argmax()] <= 0.05
