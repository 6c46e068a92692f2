"""The innovations at which a detector raises no alarm, as convex constraints.

Every test here compares linear functions y of the innovations, or sums of their squares, with
limits that the innovations do not change, so that the shifts without an alarm are a convex set that
is symmetric about 0 (`SETS`; `REFUSED` says why others have none).  The limits are those of the
detector's own verdicts on epochs of zero innovations: with its calibration, its warm-up and the
satellites in view.  `Judged.hold` writes the set down with the memory that the detector has after
`Timing.live` epochs without a shift.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import detectors
from ..detectors import Calibrated, Detector, DetectorContext
from ..detectors.base import BoolArray, FloatArray, IntArray
from ..detectors.cusum import BASELINE_SDS
from ..detectors.innovation import select_rows
from ..receiver.epoch import Epoch
from ..simulation.setup import Setup
from ..truth.noise import exponential
from . import charts
from .convex import Program
from .linear import LinearRun
from .zero_alarm import Bound, Sensitivity, ewma_bound, sequential_bound, snapshot_bound

EXCLUDES = "it excludes satellites or fixes, and tests other values than the filter's innovations"
OPEN_LOOP_NOTE = "the optimized open-loop attack on the engine is a lower bound"
GIVEN = "it is given the attack, so that its set is not symmetric"
REFUSED: dict[type[Detector], tuple[str, str]] = {
    **dict.fromkeys(
        (
            *(detectors.Acna, detectors.Raim, detectors.Rio),
            *(detectors.SrvRaim, detectors.TraversalRaim),
        ),
        (EXCLUDES, OPEN_LOOP_NOTE),
    ),
    **dict.fromkeys((detectors.OracleRamp, detectors.OracleStep), (GIVEN, OPEN_LOOP_NOTE)),
    detectors.Lottery: (
        "its alarm comes by chance, whatever the innovations are",
        "that of `never` holds",
    ),
    detectors.PooledDetector: (
        "another member is drawn for every episode",
        "that of each member holds for its episodes",
    ),
}
"""Why a detector has no zero-alarm bound, and what holds in its place."""


class NoBoundError(ValueError):
    """A detector has no zero-alarm bound, for a `reason`; what holds `instead`."""

    def __init__(self, name: str, reason: str, instead: str) -> None:
        super().__init__(f"no zero-alarm bound for {name}: {reason}; {instead}")
        self.reason, self.instead = reason, instead


class Timing(NamedTuple):
    """When a detector was switched on. `interval_s`: time between epochs [s]; `live`: epochs
    without attack, with the satellites in view of the first epoch of the run, for which it has been
    live then; `onset_s`: time of that first epoch, for tests with a start of their own [s]."""

    interval_s: float
    live: int = 0
    onset_s: float = 0.0

    @classmethod
    def of(cls, setup: Setup) -> Timing:
        setup.require_one_age("this zero-alarm bound")
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

    def transform(self, innovation: FloatArray) -> FloatArray:
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
    """Verdicts of a copy of a detector on noise-free epochs with a shift of the innovations (K, m),
    0 where a slot is not visible; none by default."""
    judge = copy.deepcopy(detector)
    epochs, n = run.visible.shape
    ids = tuple(f"slot {j}" for j in range(n))
    judge.bind(DetectorContext(1, n, timing.interval_s, np.ones(2 * n), ids))
    found = []
    for k in range(-timing.live, epochs):
        at = slice(max(k, 0), max(k, 0) + 1)
        S, visible, design = run.innovation_cov[at], run.visible[at], run.design[at]
        shift = np.zeros(S.shape[1]) if innovation is None or k < 0 else innovation[k]
        epoch = Epoch(
            time=np.array([timing.onset_s + k * timing.interval_s]),
            interval=np.array([timing.interval_s]),
            innovation=np.ascontiguousarray(shift[None]),
            innovation_variance=np.ascontiguousarray(np.einsum("bii->bi", S)),
            visible=np.ascontiguousarray(visible),
            predicted_position=np.zeros((1, 3)),
            predicted_velocity=np.zeros((1, 3)),
            innovation_cov=np.ascontiguousarray(S),
            design=np.ascontiguousarray(design),
        )
        verdict, armed = judge.judge(epoch), judge.is_armed(epoch)
        if k >= 0:
            on = True if armed is None else bool(armed[0])
            found.append((verdict.statistic[0].copy(), verdict.threshold[0].copy(), on))
    statistic, threshold, on_at = zip(*found, strict=True)
    return Verdicts(np.array(statistic), np.array(threshold), np.array(on_at))


def counts(visible: BoolArray, live: int) -> IntArray:
    """(K, n) epochs in a row, before each, in which a satellite was in view."""
    known = np.zeros(visible.shape, dtype=np.int64)
    last = np.where(visible[0], live, 0)
    for k in range(len(visible)):
        known[k] = np.where(visible[k], last, 0)
        last = np.where(visible[k], last + 1, 0)
    return known


class TestRows(NamedTuple):
    """Rows that a test looks at.

    - `judged`: (K, n) satellites to judge;
    - `before`: (K, m, m) what the innovations are multiplied by before they are judged;
    - `learning`: as in `Judged`.
    """

    judged: BoolArray
    before: FloatArray
    learning: FloatArray

    def whiten(self, run: LinearRun, first: int, last: int) -> FloatArray:
        """(K, r, m) rows of the inverse of Cholesky's factor of the covariance of the rows."""
        taken = np.hstack([self.judged, self.judged])[:, first:last]
        both = taken[:, :, None] & taken[:, None, :]
        S = np.where(both, run.innovation_cov[:, first:last, first:last], np.eye(last - first))
        inverse = np.linalg.inv(np.linalg.cholesky(S)) * taken[:, :, None]
        return np.asarray(inverse @ self.before[:, first:last])

    def normalize(self, run: LinearRun, first: int, last: int) -> FloatArray:
        """(K, r, m) rows over the standard deviation of each."""
        taken = np.hstack([self.judged, self.judged])[:, first:last]
        variance = np.einsum("kii->ki", run.innovation_cov)[:, first:last]
        return np.asarray((taken / np.sqrt(variance))[:, :, None] * self.before[:, first:last])


def select_test_rows(
    detector: Detector, run: LinearRun, timing: Timing, bias_window: int = 0
) -> TestRows:
    """Satellites that are judged, and what is done with their innovations before. With a first
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
    return TestRows(judged, before, learning)


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


class DetectorRun:
    """A detector over a run, from which its test is built."""

    def __init__(self, detector: Detector, run: LinearRun, timing: Timing) -> None:
        self.run, self.timing = run, timing
        inner = detector.detector if isinstance(detector, Calibrated) else detector
        self.test: Any = inner
        clean = judge_run(detector, run, timing)
        self.limits = np.where(clean.armed[:, None], clean.threshold, np.inf)  # (K, c)
        self.n = run.visible.shape[1]
        bias_s = getattr(inner, "bias_window_s", 0.0)
        self.bias = max(1, self.epochs(bias_s)) if bias_s > 0.0 else 0
        self.rows: TestRows = select_test_rows(detector, run, timing, self.bias)
        self.span = select_rows(getattr(inner, "signals", "pseudorange"), self.n)
        self.known = counts(run.visible, timing.live)
        # of the squared innovations that a limit allows, where a mean is taken away
        self.inflation = 1.0 + 1.0 / self.bias if self.bias else 1.0
        # epochs before the onset in which satellites in view were judged, and (L + K, n) all
        self.judged_before = max(timing.live - self.bias, 0)
        earlier = np.tile(run.visible[:1], (self.judged_before, 1))
        self.judged_so_far = np.vstack([earlier, self.rows.judged])

    def epochs(self, length_s: float) -> int:
        return max(1, round(length_s / self.timing.interval_s))

    def per_row(self, of_channels: NDArray[Any]) -> NDArray[Any]:
        """(K, r) of (K, n), for both signals where both are judged."""
        signals = (self.span[1] - self.span[0]) // self.n
        return np.hstack([of_channels] * signals)

    def normalize(self, hold: Callable[[Program, IntArray], None]) -> Judged:
        return Judged(self.rows.normalize(self.run, *self.span), self.rows.learning, hold)

    def white(self, hold: Callable[[Program, IntArray], None], rotates: bool = False) -> Judged:
        matrix = self.rows.whiten(self.run, *self.span)
        return Judged(matrix, self.rows.learning, hold, rotates)


def judged_by(detector: Detector, run: LinearRun, timing: Timing) -> Judged:
    """What a detector, with its factors if calibrated, compares over a run, and where it raises no
    alarm: exactly its own statistic on noise-free epochs."""
    inner = detector.detector if isinstance(detector, Calibrated) else detector
    check_convex(inner)
    return SETS[type(inner)](DetectorRun(copy.deepcopy(detector), run, timing))


def check_convex(detector: Detector) -> None:
    name, settings = type(detector).__name__, vars(detector)
    if type(detector) in REFUSED:
        why, instead = REFUSED[type(detector)]
    elif type(detector) not in SETS:
        why, instead = "nothing is known of its statistic", OPEN_LOOP_NOTE
    elif settings.get("filter") == "augmented":
        why = "it judges the innovations of a filter beside the victim's"
        instead = "that of `limits` holds for every detector"
    elif settings.get("weight_scale") is not None:
        why, instead = "its weights change the gains", OPEN_LOOP_NOTE
    elif settings.get("two_sided"):
        why = "it alarms at innovations that are too small, too, so that its set is not convex"
        instead = (
            "that with `two_sided` False and each side's false alarms holds for its upper side"
        )
    elif settings.get("covariance", "known") != "known":
        why, instead = "an estimated covariance lets the attack set its own limits", OPEN_LOOP_NOTE
    else:
        return
    raise NoBoundError(name, why, instead)


def _never(case: DetectorRun) -> Judged:
    epochs, m = case.run.design.shape[:2]
    return Judged(np.zeros((epochs, 1, m)), case.rows.learning, lambda program, y: None)


def _snapshot(case: DetectorRun) -> Judged:
    limits = case.limits[:, 0]
    test = case.white(lambda p, y: charts.hold_norm(p, y, limits))
    return test._replace(closed=lambda of: snapshot_bound(of, limits * case.inflation))


def _windowed_chi2(case: DetectorRun) -> Judged:
    windows, limits = np.array([case.test.window]), case.limits.copy()
    limits[: max(case.test.window - 1 - case.timing.live, 0)] = np.inf  # no verdict: it is not full
    return case.white(lambda p, y: charts.hold_energies(p, y, limits, windows), rotates=True)


def _sequential(case: DetectorRun) -> Judged:
    length_s, limits = case.test.window_s, case.limits[:, 0]
    window = len(limits) if length_s is None else case.epochs(length_s)
    windows = np.array([window])
    test = case.white(
        lambda p, y: charts.hold_energies(p, y, limits[:, None], windows), rotates=True
    )
    if length_s is not None:
        return test
    return test._replace(closed=lambda of: sequential_bound(of, limits * case.inflation))


def _bank(case: DetectorRun) -> Judged:
    windows = np.array([case.epochs(length_s) for length_s in case.test.windows_s])
    rows = case.per_row(case.judged_so_far).sum(axis=1)
    ends = slice(case.judged_before, len(rows))
    degrees = np.column_stack([np.convolve(rows, np.ones(w, np.int64))[ends] for w in windows])
    thresholds = case.test.thresholds_to(int(degrees.max()))
    limits = case.limits[:, :1] * thresholds[degrees]
    return case.white(lambda p, y: charts.hold_energies(p, y, limits, windows), rotates=True)


def _moving_average(case: DetectorRun) -> Judged:
    shape = case.test.compute_weights(case.epochs(case.test.window_s))
    judged, limits = case.per_row(case.judged_so_far), case.per_row(case.limits)
    return case.normalize(lambda p, y: charts.hold_moving_sum(p, y, limits, judged, shape))


def _aime(case: DetectorRun) -> Judged:
    windows = np.array([case.epochs(length_s) for length_s in case.test.windows_s])
    past = case.judged_before * case.per_row(case.run.visible)[0]
    return case.white(lambda p, y: charts.hold_averages(p, y, case.limits[:, 0], past, windows))


def _ewma(case: DetectorRun) -> Judged:
    matrix = case.rows.judged[:, :, None] * case.rows.before[:, : case.n]
    limits, smoothing = case.limits, case.test.smoothing
    every = np.hstack([limits * case.run.visible, np.zeros_like(limits)])
    return Judged(
        matrix,
        case.rows.learning,
        lambda p, y: charts.hold_size(p, y, limits),
        smoothing=smoothing,
        closed=lambda of: ewma_bound(of, smoothing, every),
    )


def _shewhart(case: DetectorRun) -> Judged:
    return case.normalize(lambda p, y: charts.hold_size(p, y, case.limits[:, :1]))


def _cusum(case: DetectorRun) -> Judged:
    def hold(program: Program, y: IntArray) -> None:
        charts.hold_cusum(program, y, case.limits[:, :1], np.full(y.shape, case.test.allowance))

    return case.normalize(hold)


def _lag_cusum(case: DetectorRun) -> Judged:
    test, known, limits = case.test, case.per_row(case.known), case.limits[:, :1]

    def hold(program: Program, y: IntArray) -> None:
        settings = test.lag, test.baseline, test.drift, BASELINE_SDS
        charts.hold_lag_cusum(program, y, limits, known, *settings)

    return case.normalize(hold)


def _clock(case: DetectorRun) -> Judged:
    whitened = case.rows.whiten(case.run, *case.span)
    signals = (case.span[1] - case.span[0]) // case.n
    ones = np.zeros((2 * case.n, signals))
    for signal in range(signals):
        start = case.span[0] + signal * case.n
        ones[start : start + case.n, signal] = 1.0
    plain = TestRows(case.rows.judged, np.tile(np.eye(2 * case.n), (len(whitened), 1, 1)), ones)
    common = plain.whiten(case.run, *case.span) @ ones  # the columns of A, whitened
    directions = np.zeros_like(common)
    for k in np.flatnonzero(case.rows.judged.any(axis=1)):
        orthonormal, upper = np.linalg.qr(common[k])
        directions[k] = orthonormal * np.sign(np.diag(upper))
    matrix = directions.transpose(0, 2, 1) @ whitened
    past = case.judged_before if case.run.visible[0].any() else 0
    window = case.epochs(case.test.window_s)
    limits = case.limits[:, 0]
    return Judged(
        matrix, case.rows.learning, lambda p, y: charts.hold_common(p, y, limits, past, window)
    )


def _scan(case: DetectorRun) -> Judged:
    test, known, limits = case.test, case.per_row(case.known), case.per_row(case.limits)

    def hold(program: Program, y: IntArray) -> None:
        charts.hold_scan(program, y, limits, known, test.window, test.baseline, test.ramp)

    return case.normalize(hold)


def _rate(case: DetectorRun) -> Judged:
    test, timing = case.test, case.timing
    memory_s = math.inf if test.memory_s is None else test.memory_s
    growth = 1.0 / exponential(-timing.interval_s / memory_s)
    filtered = charts.RateFilter(timing.interval_s, test.correlation_per_s, test.noise, growth)
    times = timing.onset_s + timing.interval_s * np.arange(-timing.live, len(case.limits))
    started = times >= test.start_s
    live = started[: timing.live, None] & case.run.visible[0]

    def hold(program: Program, y: IntArray) -> None:
        charts.hold_rate(program, y, case.limits, live, started[timing.live :], filtered)

    return case.normalize(hold)


SETS: dict[type[Detector], Callable[[DetectorRun], Judged]] = {
    detectors.Aime: _aime,
    detectors.ClockDrift: _clock,
    detectors.CumulativeBank: _bank,
    detectors.Cusum: _cusum,
    detectors.Ewma: _ewma,
    detectors.FiniteMovingAverage: _moving_average,
    detectors.GlrRamp: _scan,
    detectors.GlrStep: _scan,
    detectors.InnovationRate: _rate,
    detectors.JointChart: _ewma,  # up to its first alarm it is the passive EWMA chart
    detectors.LagCusum: _lag_cusum,
    detectors.Never: _never,
    detectors.SequentialChi2: _sequential,
    detectors.Shewhart: _shewhart,
    detectors.SnapshotChi2: _snapshot,
    detectors.WindowedChi2: _windowed_chi2,
}
