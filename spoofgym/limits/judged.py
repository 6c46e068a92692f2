"""Which no-alarm set belongs to which detector, and which detectors have none that is convex."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..detectors import (
    Acna,
    Aime,
    Calibrated,
    ClockDrift,
    CumulativeBank,
    Cusum,
    Detector,
    Ewma,
    FiniteMovingAverage,
    GlrRamp,
    GlrStep,
    InnovationRate,
    JointChart,
    LagCusum,
    Lottery,
    Never,
    OracleRamp,
    OracleStep,
    PooledDetector,
    Raim,
    Rio,
    SequentialChi2,
    Shewhart,
    SnapshotChi2,
    SrvRaim,
    TraversalRaim,
    WindowedChi2,
)
from ..detectors.cusum import BASELINE_SDS
from ..detectors.innovation import rows_of
from ..truth.noise import exponential
from . import charts
from .convex import IntArray, Program
from .linear import LinearRun
from .no_alarm import Judged, Rows, Timing, counts, limits_of, rows_judged
from .zero_alarm import ewma_bound, sequential_bound, snapshot_bound

FloatArray = NDArray[np.float64]
EXCLUDES = "it excludes satellites or fixes, and its statistic is none of the filter's innovations"
BLIND = "the blind optimum on the engine is a lower bound"
REFUSED: dict[type[Detector], tuple[str, str]] = {
    Acna: (EXCLUDES, BLIND),
    Lottery: ("its alarm comes by chance, whatever the innovations are", "that of `never` holds"),
    OracleRamp: ("it is given the attack, so that its set is not symmetric", BLIND),
    OracleStep: ("it is given the attack, so that its set is not symmetric", BLIND),
    PooledDetector: (
        "another member is drawn for every episode",
        "that of each member holds for its episodes",
    ),
    Raim: (EXCLUDES, BLIND),
    Rio: (EXCLUDES, BLIND),
    SrvRaim: (EXCLUDES, BLIND),
    TraversalRaim: (EXCLUDES, BLIND),
}
"""Why a detector has no zero-alarm bound, and what holds instead."""


class Case:
    """A detector over a run: what its test is built from."""

    def __init__(self, detector: Detector, run: LinearRun, timing: Timing) -> None:
        self.run, self.timing = run, timing
        inner = detector.detector if isinstance(detector, Calibrated) else detector
        self.test: Any = inner
        self.limits = limits_of(detector, run, timing)
        self.n = run.visible.shape[1]
        bias_s = getattr(inner, "bias_window_s", 0.0)
        self.bias = max(1, self.epochs(bias_s)) if bias_s > 0.0 else 0
        self.rows: Rows = rows_judged(detector, run, timing, self.bias)
        self.span = rows_of(getattr(inner, "signals", "pseudorange"), self.n)
        self.known = counts(run.visible, timing.live)

    def epochs(self, length_s: float) -> int:
        """Epochs in a length of time, as tests round it."""
        return max(1, round(length_s / self.timing.interval_s))

    def per_row(self, of_channels: NDArray[Any]) -> NDArray[Any]:
        """(K, r) of (K, n), for both signals where both are judged."""
        signals = (self.span[1] - self.span[0]) // self.n
        return np.hstack([of_channels] * signals)

    @property
    def inflation(self) -> float:
        """Of the squared innovations that a limit allows, where a mean is taken away."""
        return 1.0 + 1.0 / self.bias if self.bias else 1.0

    @property
    def judged_before(self) -> int:
        """Epochs before the onset in which satellites in view were judged."""
        return max(self.timing.live - self.bias, 0)

    @property
    def judged_so_far(self) -> NDArray[np.bool_]:
        """(L + K, n) satellites judged, with the L epochs before the onset in which any were."""
        return np.vstack([np.tile(self.run.visible[:1], (self.judged_before, 1)), self.rows.judged])

    def normalized(self, hold: Callable[[Program, IntArray], None]) -> Judged:
        """Test of innovations over their own standard deviations."""
        return Judged(self.rows.normalized(self.run, *self.span), self.rows.learning, hold)

    def white(self, hold: Callable[[Program, IntArray], None], rotates: bool = False) -> Judged:
        """Test of whitened innovations."""
        matrix = self.rows.whitened(self.run, *self.span)
        return Judged(matrix, self.rows.learning, hold, rotates)


def judged_by(detector: Detector, run: LinearRun, timing: Timing) -> Judged:
    """What a detector compares over a run, and where it raises no alarm. `detector`: one that is
    calibrated takes its factors along; `timing`: how long the detector has been live; returns
    exactly its own statistic on noise-free epochs."""
    inner = detector.detector if isinstance(detector, Calibrated) else detector
    check_convex(inner)
    return SETS[type(inner)](Case(copy.deepcopy(detector), run, timing))


def check_convex(detector: Detector) -> None:
    """Raise unless the no-alarm set of a detector is convex and its gains stay as they are."""
    name, settings = type(detector).__name__, vars(detector)
    if type(detector) in REFUSED:
        why, instead = REFUSED[type(detector)]
    elif type(detector) not in SETS:
        why, instead = "nothing is known of its statistic", BLIND
    elif settings.get("weight_scale") is not None:
        why, instead = "its weights change the gains", BLIND
    elif settings.get("two_sided"):
        why = "it alarms at innovations that are too small, too, so that its set is not convex"
        instead = (
            "that with `two_sided` False and each side's false alarms holds for its upper side"
        )
    elif settings.get("covariance", "known") != "known":
        why, instead = "an estimated covariance lets the attack set its own limits", BLIND
    else:
        return
    raise ValueError(f"no zero-alarm bound for {name}: {why}; {instead}")


def _never(case: Case) -> Judged:
    epochs, m = case.run.design.shape[:2]
    return Judged(np.zeros((epochs, 1, m)), case.rows.learning, lambda program, y: None)


def _snapshot(case: Case) -> Judged:
    limits = case.limits[:, 0]
    test = case.white(lambda p, y: charts.hold_norm(p, y, limits))
    return test._replace(closed=lambda of: snapshot_bound(of, limits * case.inflation))


def _windowed(case: Case) -> Judged:
    window, limits = case.test.window, case.limits[:, 0].copy()
    limits[: max(window - 1 - case.timing.live, 0)] = np.inf  # no verdict before it is full
    return case.white(lambda p, y: charts.hold_energy(p, y, limits, window), rotates=True)


def _sequential(case: Case) -> Judged:
    length_s, limits = case.test.window_s, case.limits[:, 0]
    window = len(limits) if length_s is None else case.epochs(length_s)
    test = case.white(lambda p, y: charts.hold_energy(p, y, limits, window), rotates=True)
    if length_s is not None:
        return test
    return test._replace(closed=lambda of: sequential_bound(of, limits * case.inflation))


def _bank(case: Case) -> Judged:
    windows = np.array([case.epochs(length_s) for length_s in case.test.windows_s])
    rows = case.per_row(case.judged_so_far).sum(axis=1)
    ends = slice(case.judged_before, len(rows))
    degrees = np.column_stack([np.convolve(rows, np.ones(w, np.int64))[ends] for w in windows])
    thresholds = case.test.thresholds_to(int(degrees.max()))
    limits = case.limits[:, :1] * thresholds[degrees]
    hold = charts.hold_energies
    return case.white(lambda p, y: hold(p, y, limits, windows), rotates=True)


def _moving_average(case: Case) -> Judged:
    shape = case.test.weights_of(case.epochs(case.test.window_s))
    judged, limits = case.per_row(case.judged_so_far), case.per_row(case.limits)
    hold = charts.hold_moving_sum
    return case.normalized(lambda p, y: hold(p, y, limits, judged, shape))


def _aime(case: Case) -> Judged:
    windows = np.array([case.epochs(length_s) for length_s in case.test.windows_s])
    past = case.judged_before * case.per_row(case.run.visible)[0]
    hold = charts.hold_averages
    return case.white(lambda p, y: hold(p, y, case.limits[:, 0], past, windows))


def _ewma(case: Case) -> Judged:
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


def _shewhart(case: Case) -> Judged:
    return case.normalized(lambda p, y: charts.hold_size(p, y, case.limits[:, :1]))


def _cusum(case: Case) -> Judged:
    def hold(program: Program, y: IntArray) -> None:
        charts.hold_cusum(program, y, case.limits[:, :1], np.full(y.shape, case.test.allowance))

    return case.normalized(hold)


def _lag_cusum(case: Case) -> Judged:
    test, known, limits = case.test, case.per_row(case.known), case.limits[:, :1]

    def hold(program: Program, y: IntArray) -> None:
        settings = test.lag, test.baseline, test.drift, BASELINE_SDS
        charts.hold_lag_cusum(program, y, limits, known, *settings)

    return case.normalized(hold)


def _clock(case: Case) -> Judged:
    whitened = case.rows.whitened(case.run, *case.span)
    signals = (case.span[1] - case.span[0]) // case.n
    ones = np.zeros((2 * case.n, signals))
    for signal in range(signals):
        start = case.span[0] + signal * case.n
        ones[start : start + case.n, signal] = 1.0
    plain = Rows(case.rows.judged, np.tile(np.eye(2 * case.n), (len(whitened), 1, 1)), ones)
    common = plain.whitened(case.run, *case.span) @ ones  # the columns of A, whitened
    directions = np.zeros_like(common)
    for k in np.flatnonzero(case.rows.judged.any(axis=1)):
        orthonormal, upper = np.linalg.qr(common[k])
        directions[k] = orthonormal * np.sign(np.diag(upper))
    matrix = directions.transpose(0, 2, 1) @ whitened
    past = case.judged_before if case.run.visible[0].any() else 0
    window = case.epochs(case.test.window_s)
    limits = case.limits[:, 0]
    hold = charts.hold_common
    return Judged(matrix, case.rows.learning, lambda p, y: hold(p, y, limits, past, window))


def _scan(case: Case) -> Judged:
    test, known, limits = case.test, case.per_row(case.known), case.per_row(case.limits)

    def hold(program: Program, y: IntArray) -> None:
        charts.hold_scan(program, y, limits, known, test.window, test.baseline, test.ramp)

    return case.normalized(hold)


def _rate(case: Case) -> Judged:
    test, timing = case.test, case.timing
    memory_s = math.inf if test.memory_s is None else test.memory_s
    growth = 1.0 / exponential(-timing.interval_s / memory_s)
    filtered = charts.RateFilter(test.correlation_per_s, test.noise, growth, timing.interval_s)
    times = timing.onset_s + timing.interval_s * np.arange(-timing.live, len(case.limits))
    started = times >= test.start_s
    live = started[: timing.live, None] & case.run.visible[0]

    def hold(program: Program, y: IntArray) -> None:
        charts.hold_rate(program, y, case.limits, live, started[timing.live :], filtered)

    return case.normalized(hold)


SETS: dict[type[Detector], Callable[[Case], Judged]] = {
    Aime: _aime,
    ClockDrift: _clock,
    CumulativeBank: _bank,
    Cusum: _cusum,
    Ewma: _ewma,
    FiniteMovingAverage: _moving_average,
    GlrRamp: _scan,
    GlrStep: _scan,
    InnovationRate: _rate,
    JointChart: _ewma,  # up to its first alarm it is the passive EWMA chart
    LagCusum: _lag_cusum,
    Never: _never,
    SequentialChi2: _sequential,
    Shewhart: _shewhart,
    SnapshotChi2: _snapshot,
    WindowedChi2: _windowed,
}
"""Tests whose no-alarm sets are convex, where they take no weight off measurements."""
