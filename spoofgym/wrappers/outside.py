"""Detectors that judge the logged epochs of B receivers, outside of their environment."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..detectors import Calibrated, Detector, Verdict, detector_in_world
from ..detectors.base import judge_epoch
from ..detectors.build import DetectorSpec
from ..detectors.calibrated import STANDARD_RATE, UncalibratedWarning, calibration_command
from ..envs.core import SETTLING
from ..envs.factory import brings_detector, composable, compose
from ..envs.scoring import Info, Mask, select_loudest
from ..receiver.epoch import Epoch, stack_receivers
from ..simulation.simulator import weighs


class OutsideDetector:
    """A detector outside of the loop of an environment that has not been reset yet.

    The environment logs the epochs that it needs. Where a detector in the loop is that of the id,
    it is replaced by one that never alarms. `detector` is bound to as many receivers.
    """

    def __init__(
        self, env: Any, detector: DetectorSpec, false_alarms_per_hour: float | None
    ) -> None:
        inner = composable(env)
        made, setup = detector_in_world(detector, false_alarms_per_hour), inner.core.setup
        if made.judges:
            raise ValueError("a pool draws its members only in the loop: take `DetectorWrapper`")
        if weighs(setup, made):
            raise ValueError(
                f"{detector!r} de-weights measurements, which needs the loop: take "
                "`DetectorWrapper`"
            )
        warn_uncalibrated(detector, made, false_alarms_per_hour, setup)
        never = "never" if brings_detector(inner) else None
        compose(env, detector=never, epoch=(*sorted(made.needs), *made.from_start * [SETTLING]))
        self.detector = copy.deepcopy(made)
        inner.core.engine.simulator.bind_detector(self.detector)
        inner.outside_detector = made  # as a card names it
        self._idle = copy.deepcopy(self.detector)
        self._all = np.arange(inner.core.receivers)

    def judge(self, info: Mapping[str, Any], fresh: Mask) -> Info:
        """What a wrapper sets, by information with (B,) ``epochs``; `fresh` (B,) start again."""
        if fresh.any():
            self.detector.reset(fresh)
        self._play(info.get("settling_epochs", ()), self.detector.watch)
        receivers = len(self._all)
        found: Info = {
            "statistic": np.zeros(receivers),
            "threshold": np.ones(receivers),
            "alarm": np.zeros(receivers, dtype=np.bool_),
            "alarm_time_s": np.full(receivers, np.nan),
        }
        largest = np.full(receivers, -np.inf)

        def look(epoch: Epoch) -> Verdict:
            verdict = judge_epoch(self.detector, epoch)
            statistic, threshold = select_loudest(verdict)
            alarm, ratio = verdict.alarm.any(axis=1), statistic / threshold
            louder = self._having & (ratio > largest)
            largest[louder] = ratio[louder]
            found["statistic"][louder] = statistic[louder]
            found["threshold"][louder] = threshold[louder]
            first = self._having & alarm & ~found["alarm"]
            found["alarm"] |= first
            found["alarm_time_s"][first] = epoch.time[first]
            return verdict

        self._play(info["epochs"], look)
        return found

    def _play(self, epochs: Any, work: Callable[[Epoch], Any]) -> None:
        """Show epochs of (B,) receivers one after the other; those without one stay as they are."""
        counts = np.array([len(each) for each in epochs], dtype=np.int64)
        for k in range(counts.max(initial=0)):
            self._having = counts > k
            idle = np.flatnonzero(~self._having)
            some = epochs[int(np.argmax(self._having))][k]
            batch = stack_receivers(
                [
                    each[k] if there else some
                    for each, there in zip(epochs, self._having, strict=True)
                ]
            )
            if len(idle):
                self._idle.memory.copy_rows(self._all, self.detector.memory, self._all)
            work(batch)
            if len(idle):
                self.detector.memory.copy_rows(idle, self._idle.memory, idle)


def warn_uncalibrated(spec: Any, made: Detector, rate: float | None, setup: Any) -> None:
    """Warn of an object that plays with thresholds of its own, and name what calibrates it."""
    if not isinstance(spec, Detector) or rate is not None or made.judges:
        return
    if isinstance(made, Calibrated) or not made.calibrates:
        return
    warnings.warn(
        f"{type(made).__name__} plays uncalibrated, with its own thresholds, so that its rate of "
        f"false alarms is unknown. With `false_alarms_per_hour={STANDARD_RATE}` it plays "
        f"calibrated, after {calibration_command(made, setup.conditions, STANDARD_RATE)}",
        UncalibratedWarning,
        stacklevel=3,
    )
