"""Epochs for detectors, of innovations or fixes and what belongs to them alone."""

import numpy as np
import scipy.stats

from spoofgym.detectors import DetectorContext, Verdict
from spoofgym.receiver.epoch import Epoch


def context(receivers, channels):
    ids = tuple(f"G{j:02d}" for j in range(channels))
    return DetectorContext(receivers, channels, 0.5, np.repeat([6.25, 0.01], channels), ids)


def epoch(innovation, innovation_cov, visible=None):
    """Epoch of which a detector of innovations needs no more; invisible slots are emptied."""
    b, m = innovation.shape
    n = m // 2
    visible = np.ones((b, n), dtype=np.bool_) if visible is None else visible
    both = np.hstack([visible, visible])
    seen = both[:, :, None] & both[:, None, :]
    S = np.where(seen, innovation_cov, np.eye(m))
    z = np.zeros((b, n))
    return Epoch(
        time=np.zeros(b),
        interval=np.full(b, 0.5),
        innovation=np.where(both, innovation, 0.0),
        innovation_variance=np.einsum("bii->bi", S).copy(),
        innovation_cov=S,
        predicted_cov=np.zeros((b, 17, 17)),
        design=np.zeros((b, m, 17)),
        transition=np.zeros((b, 17, 17)),
        imu_delta=np.zeros((b, 6)),
        pseudorange=z,
        range_rate=z,
        satellite_position=np.zeros((b, n, 3)),
        satellite_velocity=np.zeros((b, n, 3)),
        visible=visible,
        predicted_position=np.zeros((b, 3)),
        predicted_velocity=np.zeros((b, 3)),
    )


def stacked(verdicts):
    """One verdict whose arrays have an axis of epochs in front."""
    parts = zip(*verdicts, strict=True)
    return Verdict(*(None if part[0] is None else np.array(part) for part in parts))


def judge_all(detector, z, S=None, visible=True, interval=0.5):
    """Stacked verdicts on (K, B, 2n) innovations.

    `S`: their covariance, (B, 2n, 2n) of all epochs or (K, B, 2n, 2n), the identity by default;
    `visible` and `interval` of all epochs or of each.
    """
    epochs, receivers, m = z.shape
    detector.bind(context(receivers, m // 2))
    S = np.broadcast_to(np.eye(m) if S is None else S, (epochs, receivers, m, m))
    visible = np.broadcast_to(visible, (epochs, receivers, m // 2))
    intervals = np.broadcast_to(interval, epochs).astype(float)
    time, found = 0.0, []
    for k, length in enumerate(intervals):
        seen = epoch(z[k], S[k], visible[k].copy())
        when = {"time": np.full(receivers, time), "interval": np.full(receivers, length)}
        found.append(detector.judge(seen._replace(**when)))
        time += length
    return stacked(found)


def padded(ranges):
    """(K, 1, 2n) innovations of one receiver with (K, n) of pseudoranges, and range rates of 0."""
    return np.concatenate([ranges, np.zeros_like(ranges)], axis=1)[:, None]


def belief(rng, channels, *shape):
    """(*shape, 2n, 2n) covariances with correlated rows."""
    m = 2 * channels
    root = rng.standard_normal((*shape, m, m))
    return root @ root.swapaxes(-1, -2) / m + 0.5 * np.eye(m)


def drawn(rng, S):
    return np.einsum("...ij,...j->...i", np.linalg.cholesky(S), rng.standard_normal(S.shape[:-1]))


def normalized(z, S):
    return z / np.sqrt(np.diagonal(S, axis1=-2, axis2=-1))


def likely(count, probability):
    """Between which a binomial count lies but for two times in 10 000."""
    return scipy.stats.binom.ppf([1e-4, 1.0 - 1e-4], count, probability)


def fix_context(receivers, interval_s=1.0):
    return DetectorContext(receivers, 0, interval_s, np.full(2, 1.04), ())


def fix_epoch(fix, predicted=0.0, odometry=None, interval_s=1.0):
    """Epoch of (B, 2) fixes, NaN for a missing one; by default dead reckoning is the prediction."""
    b = len(fix)
    present = np.isfinite(fix).all(axis=1)[:, None]
    predicted = np.broadcast_to(predicted, fix.shape)
    innovation = np.where(present, fix - predicted, 0.0)
    unit, level = np.tile(np.eye(2), (b, 1, 1)), np.zeros((b, 1))
    return epoch(np.zeros((b, 0)), np.zeros((b, 0, 0)))._replace(
        interval=np.full(b, interval_s),
        innovation=innovation,
        innovation_variance=np.ones((b, 2)),
        innovation_cov=unit,
        predicted_cov=unit,
        design=unit * present[:, :, None],
        transition=unit,
        predicted_position=np.hstack([predicted, level]),
        gnss_position=np.hstack([predicted + innovation, level]),
        auxiliary_position=np.hstack([predicted if odometry is None else odometry, level]),
    )


def judge_drifts(detector, drifts, interval_s=1.0):
    """Stacked verdicts on (K,) or (K, B) drifts to the north; NaN for a missing fix."""
    drifts = np.asarray(drifts, dtype=float)
    drifts = drifts[:, None] if drifts.ndim == 1 else drifts
    detector.bind(fix_context(drifts.shape[1], interval_s))
    fixes = np.stack([drifts, np.where(np.isnan(drifts), np.nan, 0.0)], axis=-1)
    return stacked([detector.judge(fix_epoch(fix, interval_s=interval_s)) for fix in fixes])
