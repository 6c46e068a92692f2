"""The return of the environment ranks policies as the score does, and its best one is stealthy.

Thirty policies as they are, no amplitude fitted: constant and accelerating ramps, profiles and
feedback in several sizes, by factors of about two.  The score of a policy is its mean undetected
displacement with alarmed runs counted 0, on the same runs as the mean return.
"""

import numpy as np
import pytest
from scipy.stats import spearmanr

from spoofgym.envs import SpoofCore
from spoofgym.envs.spoofer_binding import spoofer_context
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.spoofers import make_spoofer

RUNS = 256
SHAPE = (0.0, 0.4, 0.5, 0.6, 0.8, 1.0, 1.5)
POLICIES = [
    *({"name": "ramp", "rate_mps": r} for r in np.geomspace(0.02, 2.0, 9).tolist()),
    *(
        {"name": "accelerating-ramp", "acceleration_mps2": a}
        for a in np.geomspace(2e-4, 0.02, 9).tolist()
    ),
    *(
        {"name": "profile", "rates_mps": [r * part for part in SHAPE]}
        for r in np.geomspace(0.05, 1.5, 6).tolist()
    ),
    *({"name": "feedback", "rate_mps": r} for r in np.geomspace(0.03, 1.2, 6).tolist()),
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
@pytest.mark.usefixtures("default_rate")
@pytest.mark.parametrize("detector", ["ewma", "snapshot-chi2"])
def test_by_default_the_return_ranks_as_the_score_and_its_best_is_stealthy(detector):
    rows, clean = played(detector)
    assert len(rows) == 30
    assert 0.001 < clean < 0.03
    returns, silent, alarmed = rows.T
    assert spearmanr(returns, silent)[0] >= 0.9
    assert alarmed[returns.argmax()] <= 0.05


@pytest.mark.nightly
def test_at_its_nominal_threshold_the_default_ranks_as_the_score():
    """Every fifth clean run alarms: what is best by the score is over the budget there."""
    rows, clean = played("ewma")
    assert 0.1 < clean < 0.3
    assert spearmanr(rows[:, 0], rows[:, 1])[0] >= 0.9
