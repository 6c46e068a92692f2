"""The divergence of an attack, by the filter's belief, is that of a clean twin."""

import numpy as np
import pytest

from spoofgym.simulation import Engine, TightlyCoupledSetup
from spoofgym.simulation.divergence import Divergence

from ..envs.support import SHORT


def memory(engine):
    return engine.simulator.monitor(Divergence).memory


def test_it_is_that_of_the_difference_to_a_clean_twin():
    setup = TightlyCoupledSetup(timeline=SHORT, detector="never")
    setup = setup.copy_with(monitors=[Divergence()])
    attacked, clean = (Engine(2, setup) for _ in range(2))
    total = np.zeros(2)
    for engine in (attacked, clean):
        engine.reset([np.random.default_rng(5), np.random.default_rng(6)])
    for _ in range(24):
        attacked.step(np.tile([0.7, -0.5], (2, 1)))
        clean.step(np.zeros((2, 2)))
        epoch = attacked.simulator.epoch
        shift = epoch.innovation - clean.simulator.epoch.innovation
        pairs = zip(shift, epoch.innovation_cov, strict=True)
        total += [0.5 * rho @ np.linalg.solve(cov, rho) for rho, cov in pairs]
    assert total.min() > 0.5
    for name in ("divergence", "shift"):
        np.testing.assert_array_equal(memory(clean)[name], 0.0)
    np.testing.assert_allclose(memory(attacked)["divergence"], total, rtol=0.01)
    moved = attacked.simulator.position - clean.simulator.position
    found = memory(attacked)["shift"][:, 6:9]
    np.testing.assert_allclose(found, moved, atol=0.01 * np.abs(moved).max())


def by_hand(simulator, shift, weights):
    """Shift after an epoch, and what it adds to the divergence: the module's equations in NumPy."""
    epoch, sensors = simulator.epoch, simulator.sensors
    seen = np.tile(epoch.visible[0], 2)
    H, P = epoch.design[0][seen], epoch.predicted_cov[0]
    S = epoch.innovation_cov[0][np.ix_(seen, seen)]
    a = np.r_[sensors.range_offset[0], sensors.rate_offset[0]][seen]
    predicted = epoch.transition[0] @ shift
    rho = a + H @ predicted
    if epoch.visible[0].sum() < simulator.setup.receiver.min_satellites:
        after = predicted
    else:
        after = predicted - P @ H.T @ np.linalg.inv(S) @ np.diag(weights[0][seen]) @ rho
    return after, divergence_of_normals(rho, S, np.zeros_like(rho), S)


def divergence_of_normals(mean, cov, mean_0, cov_0):
    """Of N(mean, cov) from N(mean_0, cov_0) [nats], for any covariances."""
    inverse, apart = np.linalg.inv(cov_0), mean - mean_0
    ratio = np.linalg.slogdet(cov_0)[1] - np.linalg.slogdet(cov)[1]
    return 0.5 * (np.trace(inverse @ cov) + apart @ inverse @ apart - len(apart) + ratio)


@pytest.mark.parametrize(
    ("detector", "attack", "min_satellites"),
    [
        ("never", "false-position", 13),
        ("ewma", {"name": "per-channel", "channels": ["S05", "S09"]}, 4),
        ("never", "tracking-1m", 4),
        ("snapshot-chi2", "pseudorange-only", 4),
    ],
)
def test_it_is_the_sum_of_the_divergences_of_normal_distributions(detector, attack, min_satellites):
    setup = TightlyCoupledSetup(
        timeline=SHORT,
        detector=detector,
        attack=attack,
        receiver={"min_satellites": min_satellites},
        domain={"start_s": (0.0, 60.0)},
    ).copy_with(monitors=[Divergence()])
    engine = Engine(1, setup)
    engine.reset([np.random.default_rng(3)])
    axes = len(setup.action_names)
    rng, shift, total, weighed = np.random.default_rng(4), np.zeros(17), 0.0, False
    for _ in range(24):
        engine.predict(rng.uniform(-1.0, 1.0, (1, axes)))
        verdict = engine.judge()
        weights = np.ones((1, 24)) if verdict.weights is None else verdict.weights
        weighed |= bool((weights != 1.0).any())
        shift, added = by_hand(engine.simulator, shift, weights)
        total += added
        engine.update(verdict)
        np.testing.assert_allclose(memory(engine)["shift"][0], shift, rtol=1e-6, atol=1e-9)
        assert memory(engine)["divergence"][0] == pytest.approx(total, rel=1e-6, abs=1e-9)
    assert total > 0.01
    assert weighed == (detector == "ewma")
