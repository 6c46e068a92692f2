"""Epochs for detectors, of innovations and their covariance alone."""

import math

import numpy as np

from spoofgym.detectors import DetectorContext
from spoofgym.receiver.epoch import Epoch


def run_length(drift, threshold):
    """Mean epochs until a cumulative sum exceeds its threshold without a change, siegmund1985."""
    exponent = 2.0 * drift * (threshold + 1.166)
    return (math.exp(exponent) - exponent - 1.0) / (2.0 * drift * drift)


def context(receivers, channels):
    return DetectorContext(
        receivers,
        channels,
        0.5,
        np.repeat([6.25, 0.01], channels),
        tuple(f"G{j:02d}" for j in range(channels)),
    )


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
        transition=np.tile(np.eye(17), (b, 1, 1)),
        imu_delta=np.zeros((b, 6)),
        pseudorange=z,
        range_rate=z,
        satellite_position=np.zeros((b, n, 3)),
        satellite_velocity=np.zeros((b, n, 3)),
        visible=visible,
        predicted_position=np.zeros((b, 3)),
        predicted_velocity=np.zeros((b, 3)),
    )


def belief(rng, receivers, channels):
    """(B, 2n, 2n) covariances with correlated rows."""
    m = 2 * channels
    root = rng.standard_normal((receivers, m, m))
    return root @ root.transpose(0, 2, 1) / m + 0.5 * np.eye(m)


def drawn(rng, S):
    """Innovations of just this covariance."""
    return np.einsum("bij,bj->bi", np.linalg.cholesky(S), rng.standard_normal(S.shape[:2]))
