"""Controls: no detector at all, and alarms by chance at a constant hazard."""

import numpy as np
import scipy.stats

from spoofgym.detectors import Lottery, Never
from spoofgym.detectors.controls import hash_rows, unit_exponential

from .support import judge_all

RECEIVERS = 4000


def test_without_a_defence_nothing_alarms():
    found = judge_all(Never(), np.full((1, 3, 8), 1e9))
    assert not found.alarm.any()
    assert not found.statistic.any()
    assert found.weights is None


def test_the_waiting_times_are_exponential_and_every_bit_makes_another_draw():
    rows = np.random.default_rng(0).normal(size=(RECEIVERS, 16))
    waits = unit_exponential(hash_rows(rows))
    assert scipy.stats.kstest(waits, "expon").pvalue > 0.01
    assert (waits > 0.0).all()
    other = rows.copy()
    other[:, 7] = np.nextafter(rows[:, 7], np.inf)
    pairs = np.corrcoef(waits, unit_exponential(hash_rows(other)))[0, 1]
    assert abs(pairs) < 5.0 / np.sqrt(RECEIVERS)
    # but for the sign of zeros
    assert (hash_rows(np.array([[0.0, 1.0]])) == hash_rows(np.array([[-0.0, 1.0]]))).all()


def test_the_hazard_is_the_same_at_any_time_and_set_by_the_first_epoch():
    z = np.random.default_rng(2).normal(size=(60, RECEIVERS, 8))
    alarms = judge_all(Lottery(10.0), z).alarm[..., 0]
    assert not alarms[0].any()
    assert (np.diff(alarms.astype(int), axis=0) >= 0).all()  # it stays alarmed
    promised = -np.expm1(-0.5 / 10.0)
    for start, end in ((0, 20), (20, 40), (40, 59)):
        at_risk = (~alarms[start:end]).sum()
        events = (alarms[start + 1 : end + 1] & ~alarms[start:end]).sum()
        assert scipy.stats.binomtest(int(events), int(at_risk), promised).pvalue > 0.01
    z[1:] = 0.0
    np.testing.assert_array_equal(judge_all(Lottery(10.0), z[:, :50]).alarm[..., 0], alarms[:, :50])
