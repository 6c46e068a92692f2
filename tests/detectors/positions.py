"""Epochs for detectors of positions: a fix, its prediction, and dead reckoning."""

import numpy as np

from spoofgym.detectors import DetectorContext
from spoofgym.receiver.epoch import Epoch


def context(receivers, interval_s=1.0):
    return DetectorContext(receivers, 0, interval_s, np.full(2, 1.04), ())


def epoch(fix, predicted=None, odometry=None, interval_s=1.0):
    """Epoch of (B, 2) fixes; NaN for a missing one."""
    b = len(fix)
    present = np.isfinite(fix).all(axis=1)
    level = np.zeros((b, 1))
    predicted = np.zeros((b, 2)) if predicted is None else predicted
    odometry = predicted if odometry is None else odometry
    innovation = np.where(present[:, None], fix - predicted, 0.0)
    return Epoch(
        time=np.zeros(b),
        interval=np.full(b, interval_s),
        innovation=innovation,
        innovation_variance=np.ones((b, 2)),
        innovation_cov=np.tile(np.eye(2), (b, 1, 1)),
        predicted_cov=np.tile(np.eye(2), (b, 1, 1)),
        design=np.eye(2) * present[:, None, None],
        transition=np.tile(np.eye(2), (b, 1, 1)),
        imu_delta=np.zeros((b, 6)),
        pseudorange=np.zeros((b, 0)),
        range_rate=np.zeros((b, 0)),
        satellite_position=np.zeros((b, 0, 3)),
        satellite_velocity=np.zeros((b, 0, 3)),
        visible=np.zeros((b, 0), dtype=np.bool_),
        predicted_position=np.hstack([predicted, level]),
        predicted_velocity=np.zeros((b, 3)),
        gnss_position=np.hstack([predicted + innovation, level]),
        auxiliary_position=np.hstack([odometry, level]),
    )


def judge_drifts(detector, drifts, interval_s=1.0):
    """Verdicts on (K, B) drifts to the north; NaN for a missing fix."""
    drifts = np.asarray(drifts, dtype=float)
    drifts = drifts[:, None] if drifts.ndim == 1 else drifts
    detector.bind(context(drifts.shape[1], interval_s))
    fixes = np.stack([drifts, np.where(np.isnan(drifts), np.nan, 0.0)], axis=-1)
    return [detector.judge(epoch(fix, interval_s=interval_s)) for fix in fixes]


def told(verdicts):
    """(K, B) statistics, alarms, and first weights."""
    return (
        np.array([v.statistic[:, 0] for v in verdicts]),
        np.array([v.alarm[:, 0] for v in verdicts]),
        np.array([v.weights[:, 0] for v in verdicts]),
    )
