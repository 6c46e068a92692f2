"""Detectors in front of a log: their verdicts, and thresholds from the log's own windows.

The windows are so long that one in 113 may alarm where 0.2 false alarms an hour are wanted, as in
the benchmark. They do not overlap, and a detector is reset before each, so that they count as runs
of their own as far as the receiver's errors do not last from one to the next. The threshold's
factor is an order statistic of their largest ratios, as in a calibration of a world; a rate that
needs more windows than there are is refused, with the rate that they support.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number
from ..core.registry import require
from ..detectors import Calibrated, Detector, DetectorContext, make_detector
from ..detectors.base import judge_epoch
from ..detectors.calibrated import unwrap
from ..detectors.calibration_file import (
    compute_min_runs,
    compute_rank,
    hourly_rate,
    run_probability,
)
from ..receiver.log import PAIRS, InnovationLog, missing_fields
from ..receiver.raw_measurements import ODD_SD_M
from ..receiver.states import STATES

__all__ = ["LogJudgement", "judge_log"]

FloatArray = NDArray[np.float64]
WINDOW_S = 160.0
"""Length of a window, an attack of 150 s and the time to alert."""


class LogJudgement(NamedTuple):
    """What a detector makes of a log.

    Attributes
    ----------
    detector : str
        Its name.
    ratio : ndarray
        (K,) largest statistic over threshold at every epoch, by the detector's own thresholds.
    factor : float
        On these thresholds, by which it alarms; 1 where they are its own.
    windows : ndarray
        (W,) largest ratio of every window.
    window_s : float
        Their length [s].
    false_alarms_per_hour : float or None
        Rate that the factor is for; None of a detector's own thresholds.
    """

    detector: str
    ratio: FloatArray
    factor: float
    windows: FloatArray
    window_s: float
    false_alarms_per_hour: float | None

    def as_json(self) -> dict[str, Any]:
        """Counts of alarms and largest ratios, by the factor."""
        over = self.ratio / self.factor
        return {
            "detector": self.detector,
            "epochs": len(over),
            "alarms": int((over > 1.0).sum()),
            "largest_ratio": round(float(over.max()), 6),
            "median_ratio": round(float(np.median(over)), 6),
            "windows": len(self.windows),
            "windows_with_alarm": int((self.windows / self.factor > 1.0).sum()),
            "window_s": self.window_s,
            "threshold_factor": round(self.factor, 6),
            "false_alarms_per_hour": self.false_alarms_per_hour,
        }


def label_spec(spec: Any) -> str:
    """Name of a detector in messages."""
    named = spec.get("name") if isinstance(spec, Mapping) else spec
    return named if isinstance(named, str) else type(spec).__name__


def bind_to_log(
    spec: Any, log: InnovationLog, receivers: int = 1, factor: float = 1.0
) -> tuple[Detector, DetectorContext]:
    """Detector in front of a log's receiver, or of copies of it; `factor` on its own thresholds.
    Raises a ValueError where it reads a signal or a field that the log does not have."""
    detector = make_detector(spec)
    detector = unwrap(detector)  # without a world's thresholds
    label = label_spec(spec)
    require(
        not detector.needs_model,
        f"{label} needs a model of all errors for a filter of its own, which no log has; take the "
        "filter of the log (filter=victim)",
    )
    lacking = missing_fields(log, detector.needs)
    require(
        not lacking,
        f"{label} needs {', '.join(lacking)} of every epoch, which the log does not have",
    )
    standard = log.signals == PAIRS[0] and (log.velocity, log.position) == ((3, 4, 5), (6, 7, 8))
    require(
        "transition" not in detector.needs or (standard and log.states >= STATES),
        f"{label} needs the {STATES} states of a tightly coupled receiver, in its order; the log's "
        f"filter has {log.states} in another one, or measures no ranges",
    )
    absent = [name for name in log.signals if name not in log.present_signals]
    reads = getattr(detector, "signals", None)
    if (
        absent
        and reads is not None
        and (reads == "both" or log.signals[reads == "range_rate"] in absent)
    ):
        other = ("pseudorange", "range_rate")[log.signals.index(absent[0]) == 0]
        raise ValueError(
            f"{label} tests {absent[0]}, which the log does not have: give it signals={other}"
        )
    columns = zip(log.variance.T, np.isfinite(log.innovation).T, strict=True)
    scale = np.array([np.median(x[has]) if has.any() else 1.0 for x, has in columns])
    n = len(log.channels)
    for half in np.split(scale, 2):  # what the log's filter does not use is no noise of a test
        half[half >= ODD_SD_M**2] = np.median(half)
    context = DetectorContext(
        receivers=receivers,
        channels=n,
        epoch_interval_s=log.interval_s,
        noise_variance=scale,
        satellite_ids=log.channels,
        states=log.states or STATES,
    )
    detector = detector if factor == 1.0 else Calibrated(detector, factor)
    detector.bind(context)
    return detector, context


def check_statistic(label: str, log: InnovationLog, moves: bool) -> None:
    """Raise where a statistic is always 0 since the log has only one signal of the pair."""
    absent = [name for name in log.signals if name not in log.present_signals]
    require(
        moves or not absent,
        f"{label} has a statistic of 0 at every epoch: it does not read {log.present_signals[0]}, "
        f"and the log has no {''.join(absent)}",
    )


def _play(detector: Detector, log: InnovationLog, starts: NDArray[np.bool_]) -> FloatArray:
    """(K,) largest ratio at every epoch; the detector is reset before those of `starts`."""
    ratio = np.zeros(len(log.time))
    for k, epoch in enumerate(log.epochs()):
        if starts[k]:
            detector.reset()
        verdict = judge_epoch(detector, epoch)
        ratio[k] = float((verdict.statistic / verdict.threshold).max())
    return ratio


def cut_windows(log: InnovationLog, window_s: float = WINDOW_S) -> NDArray[np.int64]:
    """(K,) number of the window that an epoch is in, -1 outside of whole ones."""
    check_number("window_s", window_s, above=0.0)
    number, count = np.full(len(log.time), -1), 0
    for segment in np.unique(log.segment):
        rows = np.flatnonzero(log.segment == segment)
        elapsed = log.time[rows] - log.time[rows[0]]
        own = (elapsed // window_s).astype(np.int64)
        whole = int((elapsed[-1] + log.interval_s) // window_s)
        number[rows] = np.where(own < whole, own + count, -1)
        count += whole
    return number


def judge_log(
    log: InnovationLog,
    detectors: Sequence[Any],
    false_alarms_per_hour: float | None = None,
    window_s: float = WINDOW_S,
) -> list[LogJudgement]:
    """Play detectors over a log.

    Parameters
    ----------
    log : InnovationLog
        Of any receiver.
    detectors : sequence
        As `make_detector` takes them. Those that take weight off measurements only look: the log's
        filter has had its own weights.
    false_alarms_per_hour : float, optional
        Rate for which thresholds come from the log's own windows, in which no attack may be; by
        default they are those that a detector has by itself.
    window_s : float
        Length of a window [s].

    Returns
    -------
    list of LogJudgement
        In the order of the detectors.

    Raises
    ------
    ValueError
        Where a detector needs what the log does not have, or the log is too short for the rate.
    """
    bound = [bind_to_log(spec, log)[0] for spec in detectors]
    number = cut_windows(log, window_s)
    count = int(number.max()) + 1
    rank = 0
    if false_alarms_per_hour is not None:
        p = run_probability(false_alarms_per_hour, window_s)
        if count < (least := compute_min_runs(p)):
            best = hourly_rate(1.0 / (count + 1), window_s)
            raise ValueError(
                f"{false_alarms_per_hour:g} false alarms an hour need {least} windows of "
                f"{window_s:g} s ({least * window_s / 3600.0:.1f} h), and the log has {count}; it "
                + (f"supports {best:.2g} an hour" if count else "supports no rate")
            )
        rank = compute_rank(p, count)
    segments = np.diff(log.segment, prepend=log.segment[0] - 1) != 0
    starts = segments | (np.diff(number, prepend=-2) != 0)
    found = []
    for spec, detector in zip(detectors, bound, strict=True):
        label, ratio = label_spec(spec), _play(detector, log, segments)
        check_statistic(label, log, bool(ratio.any()))
        apart = _play(detector, log, starts) if count else ratio
        windows = np.array([apart[number == k].max() for k in range(count)])
        factor = 1.0
        if rank:
            factor = float(np.sort(windows)[count - rank])
            require(
                factor > 0.0,
                f"{label} has a statistic of 0 in nearly all windows: they give no threshold",
            )
        found.append(LogJudgement(label, ratio, factor, windows, window_s, false_alarms_per_hour))
    return found
