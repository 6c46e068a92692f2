r"""The innovations at which a detector raises no alarm, as convex constraints.

Every test here compares linear functions y of the innovations, or sums of their squares, with
limits that the innovations do not change, so that the shifts without an alarm are a convex set that
is symmetric about 0.  The limits are those of the detector's own verdicts on epochs of zero
innovations: with its calibration, its warm-up and the satellites in view.  `Judged.hold` writes the
set down with the memory that the detector has after `Timing.live` epochs without a shift.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..detectors import Calibrated, Detector, DetectorContext
from ..receiver.epoch import Epoch
from ..simulation.setup import Setup
from .convex import IntArray, Program
from .linear import LinearRun
from .zero_alarm import Bound, Sensitivity

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


class Timing(NamedTuple):
    """When a detector was switched on. `interval_s`: time between epochs [s]; `live`: epochs
    without attack for which the detector has been live at the first epoch of the run; the
    satellites in view are taken to be those of that epoch; `onset_s`: time of that first epoch,
    which tests with a start of their own go by [s]."""

    interval_s: float
    live: int = 0
    onset_s: float = 0.0

    @classmethod
    def of(cls, setup: Setup) -> Timing:
        """Timing of a world's setup, for a run from the onset on."""
        return cls(setup.interval_s, setup.live, float(setup.epoch_time[setup.onset + 1]))


class Verdicts(NamedTuple):
    """(K, c) statistics and limits of a detector over a run, and (K,) whether it can alarm."""

    statistic: FloatArray
    threshold: FloatArray
    armed: BoolArray


class Judged(NamedTuple):
    """What a detector compares, and the set in which it raises no alarm.

    - `matrix`: (K, r, m), y_k = matrix_k (r_k - mean), of the innovations r_k;
    - `learning`: (K, m) what share of an innovation goes into the mean that is taken away;
    - `hold`: writes the set for variables y (K, r), -1 where a row is not judged;
    - `rotates`: whether the set depends on the norms of the y_k alone;
    - `smoothing`: of the exponential average of y that is held instead of y itself;
    - `closed`: the bound of free innovations, where it has a formula.
    """

    matrix: FloatArray
    learning: FloatArray
    hold: Callable[[Program, IntArray], None]
    rotates: bool = False
    smoothing: float = 1.0
    closed: Callable[[Sensitivity], Bound] | None = None

    def seen(self, innovation: FloatArray) -> FloatArray:
        """(K, r, J) y of (K, m, J) innovations, or its average."""
        mean = np.einsum("km,kmj->mj", self.learning, innovation)
        y = np.asarray(self.matrix @ (innovation - mean))
        judged = np.asarray(self.matrix.any(axis=2))[:, :, None]
        for k in range(len(y) if self.smoothing < 1.0 else 0):
            before = y[k - 1] if k else np.zeros_like(y[k])
            y[k] = judged[k] * (self.smoothing * y[k] + (1.0 - self.smoothing) * before)
        return y


def judge_run(
    detector: Detector, run: LinearRun, timing: Timing, innovation: FloatArray | None = None
) -> Verdicts:
    """What a detector says to noise-free epochs with a shift of the innovations. `detector`: a copy
    is bound and judges; `run`: covariances and satellites of K epochs; `innovation`: (K, m) shift,
    0 where a slot is not visible; none by default; returns without the epochs before the run."""
    judge = copy.deepcopy(detector)
    epochs, n = run.visible.shape
    ids = tuple(f"slot {j}" for j in range(n))
    judge.bind(DetectorContext(1, n, timing.interval_s, np.ones(2 * n), ids))
    found = []
    for k in range(-timing.live, epochs):
        shift = None if innovation is None or k < 0 else innovation[k]
        epoch = _epoch(run, max(k, 0), timing.onset_s + k * timing.interval_s, timing, shift)
        verdict, armed = judge.judge(epoch), judge.armed(epoch)
        if k >= 0:
            on = True if armed is None else bool(armed[0])
            found.append((verdict.statistic[0].copy(), verdict.threshold[0].copy(), on))
    statistic, threshold, on_at = zip(*found, strict=True)
    return Verdicts(np.array(statistic), np.array(threshold), np.array(on_at))


def _epoch(
    run: LinearRun, k: int, time: float, timing: Timing, innovation: FloatArray | None
) -> Epoch:
    """Epoch of one receiver with what tests of innovations read."""
    S, visible = run.innovation_cov[k : k + 1], run.visible[k : k + 1]
    shift = np.zeros(S.shape[1]) if innovation is None else innovation
    return Epoch(
        time=np.array([time]),
        interval=np.array([timing.interval_s]),
        innovation=np.ascontiguousarray(shift[None]),
        innovation_variance=np.ascontiguousarray(np.einsum("bii->bi", S)),
        visible=np.ascontiguousarray(visible),
        predicted_position=np.zeros((1, 3)),
        predicted_velocity=np.zeros((1, 3)),
        innovation_cov=np.ascontiguousarray(S),
        design=np.ascontiguousarray(run.design[k : k + 1]),
    )


def limits_of(detector: Detector, run: LinearRun, timing: Timing) -> FloatArray:
    """(K, c) limits of a detector, infinite where it cannot alarm."""
    clean = judge_run(detector, run, timing)
    return np.where(clean.armed[:, None], clean.threshold, np.inf)


def counts(visible: BoolArray, live: int) -> IntArray:
    """(K, n) epochs in a row, before each, in which a satellite was in view."""
    known = np.zeros(visible.shape, dtype=np.int64)
    last = np.where(visible[0], live, 0)
    for k in range(len(visible)):
        known[k] = np.where(visible[k], last, 0)
        last = np.where(visible[k], last + 1, 0)
    return known


class Rows(NamedTuple):
    """Rows that a test looks at.

    - `judged`: (K, n) satellites to judge;
    - `before`: (K, m, m) what the innovations are multiplied by before they are judged;
    - `learning`: as in `Judged`.
    """

    judged: BoolArray
    before: FloatArray
    learning: FloatArray

    def whitened(self, run: LinearRun, first: int, last: int) -> FloatArray:
        """(K, r, m) rows of the inverse of Cholesky's factor of the covariance of the rows."""
        taken = np.hstack([self.judged, self.judged])[:, first:last]
        both = taken[:, :, None] & taken[:, None, :]
        S = np.where(both, run.innovation_cov[:, first:last, first:last], np.eye(last - first))
        inverse = np.linalg.inv(np.linalg.cholesky(S)) * taken[:, :, None]
        return np.asarray(inverse @ self.before[:, first:last])

    def normalized(self, run: LinearRun, first: int, last: int) -> FloatArray:
        """(K, r, m) rows over the standard deviation of each."""
        taken = np.hstack([self.judged, self.judged])[:, first:last]
        variance = np.einsum("kii->ki", run.innovation_cov)[:, first:last]
        return np.asarray((taken / np.sqrt(variance))[:, :, None] * self.before[:, first:last])


def rows_judged(detector: Detector, run: LinearRun, timing: Timing, bias_window: int = 0) -> Rows:
    """Satellites that are judged, and what becomes of their innovations before it. With a first
    window whose mean is taken away, a satellite that is not calibrated at the onset learns it from
    attacked epochs; what it has learnt before is 0."""
    epochs, n = run.visible.shape
    before = np.tile(np.eye(2 * n), (epochs, 1, 1))
    learning = np.zeros((epochs, 2 * n))
    judged = run.visible.copy()
    if bias_window > 0:
        live = np.where(run.visible[0], timing.live, 0)
        so_far = live + np.cumsum(run.visible, axis=0) - run.visible
        judged &= so_far >= bias_window
        share = (run.visible & ~judged) / bias_window
        learning = np.hstack([share, share])
        before = before / np.sqrt(1.0 + 1.0 / bias_window)
    if isinstance(detector, Calibrated) and detector.rescaled:
        assert detector.rescale is not None  # as `bind` has made sure of
        factors = np.array(detector.rescale)
        scaling = np.array([_rescaling(seen, factors) for seen in run.visible])
        if learning.any():
            raise ValueError(
                "rescaled innovations with a bias window that is still open in the run have no "
                "zero-alarm bound here: give the timeline a longer `live_s`"
            )
        before = before @ scaling
    return Rows(judged, before, learning)


def _rescaling(visible: BoolArray, factors: FloatArray) -> FloatArray:
    """(m, m) matrix of `detectors.calibrated.rescale_innovations`."""
    n = len(visible)
    mean = np.outer(visible, visible) / max(int(visible.sum()), 1)
    own = np.diag(visible.astype(np.float64))
    out = np.zeros((2 * n, 2 * n))
    for signal, part in enumerate((slice(0, n), slice(n, 2 * n))):
        common, rest = factors[2 * signal : 2 * signal + 2]
        out[part, part] = common * mean + rest * (own - mean)
    return out
