"""The compiled halves of an epoch on a batch of receivers, as engine and replay call them."""

from __future__ import annotations

import numpy as np

from spoofgym.receiver import _kernels
from spoofgym.receiver.kalman import COVARIANCE_UPDATES


def run(
    buffers,
    what,
    lo,
    hi,
    *,
    interval=None,
    weights=None,
    update="unweighted",
    least=4,
    orthonormal=False,
):
    interval = np.zeros(0) if interval is None else interval
    samples = np.zeros((8, len(interval)))
    samples[6] = interval
    b, n = buffers.receivers, buffers.channels
    _kernels.run_epochs(
        buffers.floats,
        buffers.flags,
        buffers.block,
        buffers.samples,
        np.ones((b, 2 * n)) if weights is None else weights,
        np.zeros(0),
        np.zeros((0, 0, 0), dtype=np.uint64),
        np.zeros(0, dtype=np.int64),
        samples,
        np.zeros(0),
        np.zeros(0, dtype=np.int64),
        np.zeros((0, 0, 0)),
        b,
        n,
        0,
        0,
        COVARIANCE_UPDATES[update],
        least,
        orthonormal,
        what,
        1,
        lo,
        hi,
    )


def predict(buffers, interval, lo=0, hi=None):
    hi = buffers.receivers if hi is None else hi
    run(buffers, _kernels.PREDICT, lo, hi, interval=interval)


def update(buffers, weights=None, lo=0, hi=None, **settings):
    hi = buffers.receivers if hi is None else hi
    run(buffers, _kernels.UPDATE, lo, hi, weights=weights, **settings)
