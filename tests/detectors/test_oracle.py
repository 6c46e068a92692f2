"""The oracles alarm at what they are told, whether it is there or not."""

import numpy as np
import pytest

from spoofgym.detectors import InnovationRate, OracleRamp, OracleStep

from .support import context, epoch

CHANNELS, EPOCHS, ONSET = 4, 300, 150


def run(detector, innovations):
    """(K, n) statistics and alarms of one receiver whose belief is 4 m^2."""
    detector.bind(context(1, CHANNELS))
    S = 4.0 * np.eye(2 * CHANNELS)[None]
    verdicts = []
    for k, row in enumerate(innovations):
        seen = epoch(np.concatenate([row, np.zeros(CHANNELS)])[None], S)
        verdicts.append(
            detector.judge(seen._replace(time=np.array([float(k)]), interval=np.array([1.0])))
        )
    return np.array([v.statistic[0] for v in verdicts]), np.array([v.alarm[0] for v in verdicts])


def clean():
    return 2.0 * np.random.default_rng(0).standard_normal((EPOCHS, CHANNELS))


def offset(kind):
    since = np.arange(EPOCHS) - float(ONSET)
    return np.where(since >= 0.0, 20.0 if kind is OracleStep else 0.3 * since, 0.0)


def told(kind, **settings):
    size = {"size_m": 20.0} if kind is OracleStep else {"rate_mps": 0.3}
    return kind(onset_s=float(ONSET), channels=("G01",), **size, **settings)


@pytest.mark.parametrize("kind", [OracleStep, OracleRamp])
def test_what_it_is_told_is_added_once_more(kind):
    z = clean()
    z[:, 1] += offset(kind)
    twice = z.copy()
    twice[:, 1] += offset(kind)
    free = {"max_exclusion_s": None, "min_satellites": 0}
    mine = run(told(kind, **free), z)
    other = run(InnovationRate(weight_scale=1.0, **free), twice)
    np.testing.assert_allclose(mine[0], other[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(mine[1], other[1])


@pytest.mark.nojit
@pytest.mark.parametrize("kind", [OracleStep, OracleRamp])
def test_it_alarms_without_an_attack(kind):
    _, alarms = run(told(kind), clean())
    assert not alarms[:ONSET].any()
    assert alarms[ONSET:, 1].any()
    assert not alarms[:, [0, 2, 3]].any()
    assert not run(InnovationRate(weight_scale=1.0), clean())[1].any()


@pytest.mark.parametrize("kind", [OracleStep, OracleRamp])
def test_without_names_every_channel_is_attacked_and_unknown_names_are_refused(kind):
    _, alarms = run(OracleStep(size_m=20.0, onset_s=150.0), clean())
    assert alarms.any(axis=0).all()
    with pytest.raises(ValueError, match="`channels` names S99; the receiver has G00, G01"):
        kind(channels=("S99",)).bind(context(1, CHANNELS))
