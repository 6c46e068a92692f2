"""What a step of the duel pays, and the threshold that the statistic is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number, setting, settings_record
from ..core.registry import build, is_number
from ..detectors.calibration_file import Calibration

FloatArray = NDArray[np.float64]
LEAST_THRESHOLD = 1e-3
RUNNING = "running"


class DuelOutcome(NamedTuple):
    """What a step has brought (B,): `gain` and `retraction` as in `reward.Outcome`; whether it
    brought the `first` alarm; whether an attack is on, and whether none has alarmed yet."""

    gain: FloatArray
    retraction: FloatArray
    first: NDArray[np.bool_]
    attacked: NDArray[np.bool_]
    undetected: NDArray[np.bool_]
    interval_s: float


@settings_record(frozen=True)
class NeymanPearson:
    """Undetected displacement D_u, to the spoofer from the detector; clean episodes pay nothing.

    False alarms have no price: their rate is fixed by the threshold, which is calibrated on clean
    episodes.  Nor has one before the onset, which ends the episode for nothing.  A payoff returns
    the rewards (B,) of the spoofer, 0 in clean episodes, and of the detector.
    """

    def __call__(self, outcome: DuelOutcome) -> tuple[FloatArray, FloatArray]:
        won = np.where(outcome.attacked, outcome.gain + outcome.retraction, 0.0)
        return won, 0.0 - won


@settings_record(frozen=True)
class Weighted:
    """Weighted sum of false alarms, delay and error, from the detector."""

    false_alarm: float = setting(
        default=100.0, least=0.0, help="Price of an alarm in a clean episode, or before the onset."
    )
    delay_per_s: float = setting(
        default=0.1, least=0.0, unit="1/s", help="Price of a second under attack without an alarm."
    )
    error_per_m: float = setting(
        default=1.0,
        least=0.0,
        unit="1/m",
        help="Price of a metre of undetected displacement; in a clean episode of any displacement, "
        "where an alarm takes nothing back.",
    )

    def __call__(self, outcome: DuelOutcome) -> tuple[FloatArray, FloatArray]:
        """Rewards of the spoofer and of the detector; they add up to 0 under attack only."""
        moved = self.error_per_m * (outcome.gain + outcome.retraction)
        late = self.delay_per_s * outcome.interval_s * outcome.undetected
        strayed = self.error_per_m * outcome.gain + self.false_alarm * outcome.first
        won = np.where(outcome.attacked, moved + late, 0.0)
        return won, 0.0 - np.where(outcome.attacked, won, strayed)


PAYOFFS: dict[str, type[Any]] = {"neyman-pearson": NeymanPearson, "weighted": Weighted}


def make_payoff(spec: str | Mapping[str, Any]) -> NeymanPearson | Weighted:
    if isinstance(spec, NeymanPearson | Weighted):
        return spec
    return cast("NeymanPearson | Weighted", build("payoff", PAYOFFS, Weighted, spec))


class FixedThreshold:
    """The same threshold for ever. `value`: in (0, 1]; infinite where no alarm is wanted; `values`
    (B,) of every receiver."""

    def __init__(self, value: float, receivers: int) -> None:
        self.values = np.full(receivers, float(value))

    def restart(self, rows: NDArray[np.intp]) -> None:
        """Nothing has been learned."""

    def learn(self, false_alarm: NDArray[np.bool_], ended: NDArray[np.bool_]) -> None:
        """There is nothing to learn."""


class RunningThreshold:
    r"""Threshold (B,) that follows the false alarms of the clean episodes, each as a whole
    (`gibbs2021`, eq. 2, with their bound); an attacked one moves nothing, not even by an alarm
    before its onset.

    .. math:: h \leftarrow h + g\,(a - \alpha)

    where a is 1 if a clean episode had an alarm.  The mean of a over n of them is then below
    :math:`\alpha + (1 + g - h_0) / (g n)`, whatever the detector does, and however it changes.
    Every receiver has its own, which starts again with its seed, at 1, where nothing alarms, so
    that an agent that has learned nothing plays whole episodes.  It stays above 0.001, where
    statistics below that never alarm, and may exceed 1 for a while.
    """

    FIRST, GAIN = 1.0, 0.1

    def __init__(self, false_alarm: float, receivers: int) -> None:
        self.false_alarm = false_alarm
        self.values = np.full(receivers, self.FIRST)

    def restart(self, rows: NDArray[np.intp]) -> None:
        self.values[rows] = self.FIRST

    def learn(self, false_alarm: NDArray[np.bool_], ended: NDArray[np.bool_]) -> None:
        """Follow the clean episodes that have ended. `false_alarm` (B,) bool, which had an alarm;
        `ended` (B,) bool, which clean episodes have ended in this step."""
        moved = self.values + np.where(ended, self.GAIN * (false_alarm - self.false_alarm), 0.0)
        self.values = np.maximum(moved, LEAST_THRESHOLD)


def make_threshold(
    threshold: float | str | Calibration, false_alarm: float, receivers: int
) -> FixedThreshold | RunningThreshold:
    check_number("false_alarm", false_alarm, above=0.0, below=1.0)
    if isinstance(threshold, Calibration):
        threshold = threshold.point(per_run=false_alarm).scale
    if isinstance(threshold, str) and threshold == RUNNING:
        return RunningThreshold(false_alarm, receivers)
    if isinstance(threshold, str) or not (is_number(threshold) and 0.0 < threshold <= 1.0):
        raise ValueError(
            "`threshold` must be 'running', a number above 0 and at most 1, or a calibration, got "
            f"{threshold!r}"
        )
    return FixedThreshold(float(threshold), receivers)
