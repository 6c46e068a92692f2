"""The divergence of an attack, by the filter's belief, is that of a clean twin."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.envs import Engine, make_setup
from spoofgym.envs.divergence import Divergence

from .support import SHORT


def engines(detector, **settings):
    setup = make_setup(timeline=SHORT, detector=detector, **settings)
    setup = setup.altered(witnesses=[Divergence()])
    made = [Engine(2, setup), Engine(2, setup)]
    for engine in made:
        engine.reset([np.random.default_rng(5), np.random.default_rng(6)])
    return made


def memory(engine):
    return engine.batch.witness(Divergence).memory


@pytest.mark.parametrize(
    ("attack", "command"),
    [
        ("false-position", [0.7, -0.5]),
        ({"name": "false-position", "coherent": False}, [0.4, 0.3]),
        ({"name": "per-channel", "channels": ["S05", "S09"]}, [0.1, -0.2]),
    ],
)
def test_it_is_that_of_the_difference_to_a_clean_twin(attack, command):
    attacked, clean = engines("never", attack=attack)
    total = run(attacked, clean, command)
    assert total.min() > 0.5
    np.testing.assert_allclose(memory(attacked)["divergence"], total, rtol=0.01)
    moved = attacked.batch.buffers.state.position_e - clean.batch.buffers.state.position_e
    found = memory(attacked)["shift"][:, 6:9]
    np.testing.assert_allclose(found, moved, atol=0.01 * np.abs(moved).max())


def test_weights_of_the_run_count():
    """Nearly that of a twin, whose own weights are other ones."""
    attacked, clean = engines("ewma")
    total = run(attacked, clean, [0.7, -0.5])
    np.testing.assert_allclose(memory(attacked)["divergence"], total, rtol=0.05)


def run(attacked, clean, command):
    """Divergence by the difference of two engines."""
    total = np.zeros(2)
    for _ in range(24):
        attacked.step(np.tile(command, (2, 1)))
        clean.step(np.zeros((2, 2)))
        shift = attacked.batch.epoch.innovation - clean.batch.epoch.innovation
        S = attacked.batch.epoch.innovation_cov
        total += 0.5 * np.array(
            [rho @ np.linalg.solve(cov, rho) for rho, cov in zip(shift, S, strict=True)]
        )
    return total


def test_without_an_attack_there_is_none():
    _, clean = engines("ewma")
    for _ in range(5):
        clean.step(np.zeros((2, 2)))
    np.testing.assert_array_equal(memory(clean)["divergence"], 0.0)
    np.testing.assert_array_equal(memory(clean)["shift"], 0.0)


def test_an_engine_without_one_says_so():
    engine = Engine(1, make_setup(timeline=SHORT))
    with pytest.raises(LookupError, match="no Divergence looks at these epochs"):
        engine.batch.witness(Divergence)
