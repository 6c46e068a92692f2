"""Alarms by chance: drawn from the first epoch, at a constant hazard."""

import numpy as np
import scipy.stats

from spoofgym.detectors import Lottery
from spoofgym.detectors.controls import hash_rows, unit_exponential

from .support import belief, context, epoch

RECEIVERS = 4000


def judged(innovations, mean_wait_s=10.0, epochs=60):
    """Alarms (K, B) of a lottery whose later epochs have other innovations."""
    detector = Lottery(mean_wait_s)
    detector.bind(context(len(innovations), 4))
    rng = np.random.default_rng(1)
    believed = belief(rng, len(innovations), 4)
    alarms = [detector.judge(epoch(innovations, believed)).alarm[:, 0]]
    for _ in range(epochs - 1):
        other = rng.normal(size=innovations.shape)
        alarms.append(detector.judge(epoch(other, believed)).alarm[:, 0])
    return np.array(alarms)


def test_the_waiting_times_are_exponential():
    rows = np.random.default_rng(0).normal(size=(RECEIVERS, 16))
    waits = unit_exponential(hash_rows(rows))
    assert scipy.stats.kstest(waits, "expon").pvalue > 0.01
    assert (waits > 0.0).all()
    # one bit of one innovation makes another draw
    other = rows.copy()
    other[:, 7] = np.nextafter(rows[:, 7], np.inf)
    pairs = np.corrcoef(waits, unit_exponential(hash_rows(other)))[0, 1]
    assert abs(pairs) < 5.0 / np.sqrt(RECEIVERS)


def test_zeros_of_either_sign_are_the_same_draw():
    assert (hash_rows(np.array([[0.0, 1.0]])) == hash_rows(np.array([[-0.0, 1.0]]))).all()


def test_what_comes_after_the_first_epoch_changes_nothing():
    rng = np.random.default_rng(3)
    first = rng.normal(size=(50, 8))
    detector = Lottery(10.0)
    detector.bind(context(50, 4))
    believed = belief(rng, 50, 4)
    detector.judge(epoch(first, believed))
    for _ in range(59):
        quiet = detector.judge(epoch(np.zeros((50, 8)), believed))
    assert (quiet.alarm[:, 0] == judged(first)[-1]).all()


def test_the_hazard_is_the_same_at_any_time():
    interval = 0.5
    alarms = judged(np.random.default_rng(2).normal(size=(RECEIVERS, 8)))
    assert not alarms[0].any()
    assert (np.diff(alarms.astype(int), axis=0) >= 0).all()  # it stays alarmed
    promised = -np.expm1(-interval / 10.0)
    for start, end in ((0, 20), (20, 40), (40, 59)):
        at_risk = (~alarms[start:end]).sum()
        events = (alarms[start + 1 : end + 1] & ~alarms[start:end]).sum()
        test = scipy.stats.binomtest(int(events), int(at_risk), promised)
        assert test.pvalue > 0.01
