r"""Attacks on the windows of a log, by the linear response of its own filter.

A window is an attack and the time to alert.  Before each, the detector is live for as long as a
window, or for as long as it is silent after a reset.  The log's noise is that of its receiver; the
attack moves a false position along one heading, and the measurements with it by the design matrix,

.. math:: a_k = -H_k^{p} C_k d_k - H_k^{v} C_k \dot d_k

so that an estimate that has followed by d sees nothing.  Where an innovation is said to be shifted
by -H e (a filter that estimates the state itself), north is south.
"""

from __future__ import annotations

import copy
import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..calibration.log import bind_to_log, check_statistic, label_spec
from ..core.declared import check_number
from ..core.registry import require
from ..detectors.base import FloatArray, check_needs, judge_epoch
from ..receiver.epoch import ALWAYS
from ..receiver.log import FIRST_ORDER, InnovationLog, missing_matrices
from ..simulation.engine import available_threads
from .bounds import HATS as BOUND_HATS
from .bounds import Attacker, ZeroAlarm, bound_displacement
from .linear import LinearRun, hat_functions, mechanize_transition, respond
from .no_alarm import Timing
from .response import HATS, LinearReplay, check_replayable, shorten

FEWEST_WINDOWS = 8
"""From which on attacks are played: with fewer, half of them are too few to choose on."""
GAP = 1.9  # intervals from one epoch to the next, by which one is missing
BOUND_WINDOWS = 4  # over which a zero-alarm bound is taken
RATE_LIMIT_MPS = 5.0


class LogReplay(LinearReplay):
    """Windows of a log in front of one detector.

    - `starts` (N,) rows of the log at which the attacks begin; `live` epochs before each for which
      the detector is live; `threshold` (N,) its mean then.
    """

    judge = staticmethod(judge_epoch)  # what would take weight off only looks, as of a log

    def __init__(
        self,
        log: InnovationLog,
        detector: Any,
        factor: float = 1.0,
        *,
        attack_s: float = 150.0,
        time_to_alert_s: float = 10.0,
        live_s: float | None = None,
        heading_deg: float = 90.0,
        rate_limit_mps: float = RATE_LIMIT_MPS,
        starts: NDArray[np.intp] | None = None,
        threads: int | None = None,
    ) -> None:
        label = label_spec(detector)
        missing = missing_matrices(log)
        require(not missing, f"attacks on a log need {', '.join(missing)}, which it does not have")
        check_number("attack_s", attack_s, above=0.0)
        check_number("time_to_alert_s", time_to_alert_s, least=0.0)
        check_number("rate_limit_mps", rate_limit_mps, above=0.0)
        check_number("heading_deg", heading_deg)
        self.log, self.interval_s = log, log.interval_s
        self.steps = self.attack_epochs = max(round(attack_s / self.interval_s), 2)
        self.epochs = self.steps + round(time_to_alert_s / self.interval_s)
        self.limits = rate_limit_mps, math.inf
        judge, _ = bind_to_log(detector, log)
        check_replayable(judge)
        live = self.epochs if live_s is None else round(live_s / self.interval_s)
        self.live = max(live, judge.silent_epochs) if starts is None else live
        self.starts = self.find_starts(self.live) if starts is None else starts
        self.runs = len(self.starts)
        require(
            self.runs >= FEWEST_WINDOWS,
            f"attacks need {FEWEST_WINDOWS} windows of {self.epochs * self.interval_s:g} s after "
            f"{self.live * self.interval_s:g} s in which {label} is live, and the log has "
            f"{self.runs}: take a longer log, or shorter attacks",
        )
        self.needs, self._banks = check_needs(judge), {}
        self.threads = available_threads(10**9) if threads is None else threads
        self.heading = np.full(self.runs, math.radians(heading_deg))
        judge, self._context = bind_to_log(detector, log, self.runs, factor)
        alarmed = np.zeros(self.runs, dtype=np.bool_)
        self.threshold, spent, moves = np.ones(self.runs), 0.0, False
        for k in range(-self.live, 0):
            epoch = log.gather_epoch(self.starts + k)
            now = time.process_time()
            verdict = self.judge(judge, epoch)
            spent += time.process_time() - now
            alarmed |= verdict.alarm.any(axis=1)
            moves |= bool(verdict.statistic.any())
            self.threshold = verdict.threshold.mean(axis=1)
        check_statistic(label, log, moves)
        self.cost_us = 1e6 * spent / (self.live * self.runs)
        self.detectors, self.warmup_alarm = [judge], alarmed[None]
        stored: dict[str, list[NDArray[Any]]] = {name: [] for name in ALWAYS | self.needs}
        for k in range(self.epochs):
            epoch = log.gather_epoch(self.starts + k)
            for name, arrays in stored.items():
                arrays.append(shorten(name, getattr(epoch, name)))
        self._epochs, self.group = stored, np.arange(self.runs)
        self._set_hats(hat_functions(self.steps, HATS))

    def find_starts(self, live: int) -> NDArray[np.intp]:
        """(N,) rows of the windows that follow one another after `live` epochs of a segment, none
        of them with a gap."""
        found = []
        ends = np.flatnonzero(np.diff(self.log.segment, append=self.log.segment[-1] + 1)) + 1
        first = 0
        for end in ends.tolist():
            found += list(range(first + live, end - self.epochs + 1, self.epochs))
            first = end
        starts = np.array(found, dtype=np.intp)
        gaps = np.concatenate([[0], np.cumsum(self.log.steps_s > GAP * self.interval_s)])
        whole = gaps[starts + self.epochs] == gaps[starts - live + 1]
        return np.asarray(starts[whole])

    @property
    def known_s(self) -> FloatArray:
        """(N,) time from the begin of the segment to each attack [s]."""
        begins = np.flatnonzero(np.diff(self.log.segment, prepend=self.log.segment[0] - 1))
        first = begins[np.searchsorted(begins, self.starts, side="right") - 1]
        return np.asarray((self.starts - first) * self.interval_s)

    def _set_hats(self, hats: FloatArray, steps: bool = False) -> None:
        """Respond to (steps, Q) functions of the rate; `steps`: jumps of the position alone."""
        self.hats, self._units = hats, []
        for k in range(self.runs):
            run = self.linear_run(k)
            self._add_unit(run, self._build_offsets(run, hats, steps))

    def copy_with_steps(self) -> LogReplay:
        """The same windows under jumps of the position at the onset, with honest velocities; a
        rate of 1 m/s in the first decision stands for its length in that time."""
        other = copy.copy(self)
        other._banks = {}
        other._set_hats(np.eye(self.steps)[:, :1], steps=True)
        return other

    def _build_offsets(self, run: LinearRun, hats: FloatArray, steps: bool = False) -> FloatArray:
        """(K, m, 2 Q) offsets of the measurements by function of the rate, those north first."""
        rate = hats[np.minimum(np.arange(self.epochs), self.steps - 1)]
        moved = np.cumsum(rate, axis=0) * self.interval_s
        horizontal = run.axes[:, :, :2]
        by_position = -run.design[:, :, 6:9] @ horizontal  # (K, m, 2)
        by_velocity = -run.design[:, :, 3:6] @ horizontal * (not steps)
        parts = by_position[..., None] * moved[:, None, None]
        parts = parts + by_velocity[..., None] * rate[:, None, None]
        return np.asarray(parts.reshape(*parts.shape[:2], -1))

    def linear_run(self, number: int) -> LinearRun:
        """Filter of a window, with the velocity in states 3 to 5 and the position in 6 to 8."""
        log, rows = self.log, slice(self.starts[number], self.starts[number] + self.epochs)
        seen, S = log.judged[rows], np.asarray(log.gather_epoch(rows).innovation_cov)
        design = log.more["design"][rows] * seen[:, :, None]
        transition = log.more["transition"][rows]
        if log.about.get("transition") == FIRST_ORDER:
            transition = transition.copy()
            mechanize_transition(transition)
        if "gain" in log.more:
            gain = log.more["gain"][rows] * seen[:, None]
        else:
            gain = np.linalg.solve(S, design @ log.more["predicted_cov"][rows]).transpose(0, 2, 1)
        none = design.shape[2]  # a state that nothing has to do with, where a filter has too few
        velocity = log.velocity or (none,) * 3
        rest = [k for k in range(none) if k not in (*log.velocity, *log.position)]
        rest = [*rest[:3], *[none] * (3 - len(rest[:3])), *rest[3:]]
        order = np.array([*rest[:3], *velocity, *log.position, *rest[3:]])
        design = np.pad(design, ((0, 0), (0, 0), (0, 1)))[:, :, order]
        transition = np.pad(transition, ((0, 0), (0, 1), (0, 1)))[:, order[:, None], order]
        gain = np.pad(gain, ((0, 0), (0, 1), (0, 0)))[:, order]
        axes = log.more.get("axes", np.broadcast_to(np.eye(3), (len(log.time), 3, 3)))[rows]
        return LinearRun(transition, design, gain, S, log.visible[rows], axes)

    def bound_zero_alarm(self) -> ZeroAlarm:
        """What no attack exceeds in the mean without raising an alarm itself, over some windows,
        were the clean innovations those of mean zero; restricted: within the limit of the rate."""
        heading = float(self.heading[0])
        direction = math.cos(heading), math.sin(heading)
        hats, cases = hat_functions(self.steps, BOUND_HATS), []
        for k in np.linspace(0, self.runs - 1, BOUND_WINDOWS).astype(int).tolist():
            run = self.linear_run(k)
            both = self._build_offsets(run, hats).reshape(self.epochs, -1, 2, hats.shape[1])
            response = respond(run, np.einsum("kmaq,a->kmq", both, direction))
            cases.append((run, Attacker(response, hats, *self.limits)))
        timing = Timing(self.interval_s, self.live, self.interval_s * (self.live + 1))
        return bound_displacement(self.detectors[0], cases, timing, self.steps - 1, direction)
