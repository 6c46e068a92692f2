"""Undetected displacement, an epoch that is scored in one kernel, and what a step has brought."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..core.simd import ArrayTable
from ..detectors import Verdict
from ..simulation.domain import FloatArray
from ..simulation.simulator import Simulator
from ..simulation.tight import SequelKernel, TightlyCoupledSimulator
from . import _kernels

Mask = NDArray[np.bool_]
Info = dict[str, NDArray[Any]]
VALUE_NAMES = (
    "time_s",
    "displacement_m",
    "undetected_displacement_m",
    "cost",
    "statistic",
    "threshold",
)
"""Numbers in the information of every step, in the order of the rows."""
MARK_NAMES = ("alarm", "detected", "warmup_alarm", "coasting")
"""Flags in the information of every step, in the order of the rows."""
MARKS = 8  # rows of flags that the kernels know of


class InfoLayout:
    """Keys of the information of a step, one for each row of a `StepResult`.

    - `names`: `VALUE_NAMES` and the parts of the reward that kernels write, then `MARK_NAMES`;
    - `masked`: the same, then all of them with ``_`` before it, for the masks of a vector env;
    - `numbers`: how many of `names` are numbers;
    - `blank` ((8 + t) B,) bool, initial `StepResult.flags`.
    """

    def __init__(self, receivers: int, parts: Sequence[str] = ()) -> None:
        self.names = (*VALUE_NAMES, *parts, *MARK_NAMES)
        self.masked = (*self.names, *("_" + name for name in self.names))
        self.numbers = len(VALUE_NAMES) + len(parts)
        self.receivers = receivers
        self.blank: Mask = np.ones((MARKS + len(self.names)) * receivers, dtype=np.bool_)
        self.blank[: MARKS * receivers] = False


def first_row(array: NDArray[Any]) -> Any:
    """What an array (B, ...) has of the first receiver; a number where it has one of each."""
    return array[0] if array.ndim > 1 or array.dtype == object else array[0].item()


class PlainResult(NamedTuple):
    """Rewards and ends (B,), and information by key, of a step; `extra` is None."""

    reward: FloatArray
    terminated: Mask
    truncated: Mask
    info: Info
    extra: None = None

    def single(self) -> tuple[float, bool, bool, dict[str, Any]]:
        info = {name: array.item() for name, array in self.info.items()}
        return self.reward.item(), self.terminated.item(), self.truncated.item(), info


class StepResult:
    """Rewards, ends and information of a step, in arrays that are new for every step.

    The kernels write the rows, and nothing is read out of them before it is requested: with a
    batch of one, making the arrays would cost more than the kernels do.

    - `numbers` ((k + 3) B,) `values` in one row;
    - `flags` ((8 + t) B,) bool, `marks` in one row: those that the kernels name, then, for every
      key, that all receivers have it;
    - `displacement` (B,) row of `values`;
    - `extra`: information that kernels do not write, by key.
    """

    def __init__(self, layout: InfoLayout) -> None:
        self._layout = layout
        self.flags: Mask = layout.blank.copy()
        self.numbers: FloatArray = np.empty((layout.numbers + 3) * layout.receivers)
        self.extra: Info = {}
        b = layout.receivers
        self.displacement = self.numbers[
            _kernels.DISPLACEMENT * b : (_kernels.DISPLACEMENT + 1) * b
        ]

    def __reduce__(self) -> tuple[type[StepResult], tuple[InfoLayout]]:
        """A copy is blank: its rows are views of its own arrays."""
        return StepResult, (self._layout,)

    @property
    def values(self) -> FloatArray:
        """(k + 3, B) the numbers of the layout's names, then gain, retraction [m] and reward."""
        return self.numbers.reshape(-1, self._layout.receivers)

    @property
    def marks(self) -> Mask:
        """(8 + t, B) bool: a row for each of `MARK_NAMES`, then those that `_kernels` numbers."""
        return self.flags.reshape(-1, self._layout.receivers)

    @property
    def reward(self) -> FloatArray:
        return cast("FloatArray", self.values[_kernels.REWARD])

    @property
    def terminated(self) -> Mask:
        return cast("Mask", self.marks[_kernels.TERMINATED])

    @property
    def truncated(self) -> Mask:
        return cast("Mask", self.marks[_kernels.TRUNCATED])

    @property
    def info(self) -> Info:
        rows = [*self.values[: _kernels.GAIN], *self.marks[: len(MARK_NAMES)]]
        info: Info = dict(zip(self._layout.names, rows, strict=True))
        info.update(self.extra)
        return info

    def report(self, verdict: Verdict | None) -> None:
        """Write the statistic and the threshold of the channel with a verdict's largest ratio."""
        assert verdict is not None  # there is one in every epoch
        statistic = np.ascontiguousarray(verdict.statistic)
        threshold = np.ascontiguousarray(verdict.threshold)
        _kernels.report_loudest(statistic, threshold, self.numbers)

    def unpack_with_masks(self) -> tuple[FloatArray, Mask, Mask, Info]:
        """Rewards, ends and information, with masks that every receiver has it; no `extra`."""
        layout, values, marks = self._layout, list(self.values), list(self.marks)
        rows = values[: _kernels.GAIN] + marks[: len(MARK_NAMES)] + marks[MARKS:]
        return (
            values[_kernels.REWARD],
            marks[_kernels.TERMINATED],
            marks[_kernels.TRUNCATED],
            dict(zip(layout.masked, rows, strict=True)),
        )

    def single(self) -> tuple[float, bool, bool, dict[str, Any]]:
        """Reward, ends and information of a batch of one, as plain numbers."""
        values: list[Any] = self.numbers.tolist()
        marks: list[Any] = self.flags.tolist()
        row = values[: _kernels.GAIN] + marks[: len(MARK_NAMES)]
        info: dict[str, Any] = dict(zip(self._layout.names, row))  # noqa: B905  (costs 1 us)
        if self.extra:
            info.update([(name, first_row(array)) for name, array in self.extra.items()])
        return (
            values[_kernels.REWARD],
            marks[_kernels.TERMINATED],
            marks[_kernels.TRUNCATED],
            info,
        )

    def add(self, earlier: StepResult, over: Mask) -> None:
        """Count the earlier epochs of the same decision; all there is of (B,) episodes `over`."""
        parts = slice(len(VALUE_NAMES), self._layout.numbers)
        for row in (_kernels.GAIN, _kernels.RETRACTION, _kernels.COST, parts):
            self.values[row] = earlier.values[row] + self.values[row]
        for row in (_kernels.ALARM, _kernels.FIRST, _kernels.FINISHED):
            self.marks[row] |= earlier.marks[row]
        for name, array in self.extra.items():
            before = earlier.extra[name]
            both = array | before if array.dtype == np.bool_ else before + array
            self.extra[name] = np.where(over, before, both)
        # the sum of the parts of the reward, in the order of the information
        own = [part for name, part in self.extra.items() if name.startswith("reward_")]
        reward = np.zeros(len(over))
        for part in (*self.values[parts], *own):
            reward += part
        self.values[_kernels.REWARD] = reward
        self.values[:, over] = earlier.values[:, over]
        self.marks[:, over] = earlier.marks[:, over]


def select_loudest(verdict: Verdict) -> tuple[FloatArray, FloatArray]:
    """(B,) statistic and threshold of the channel whose ratio of them is largest."""
    rows = np.arange(len(verdict.statistic))
    with np.errstate(divide="ignore", invalid="ignore"):
        column = (verdict.statistic / verdict.threshold).argmax(axis=1)
    return verdict.statistic[rows, column], verdict.threshold[rows, column]


def report_verdict(simulator: Simulator) -> Info:
    """(B,) ``statistic`` and ``threshold`` of the last epoch that the detector in the loop judged;
    NaN before the first."""
    verdict = simulator.verdict
    nothing = np.full(simulator.receivers, np.nan)
    both = (nothing, nothing.copy()) if verdict is None else select_loudest(verdict)
    return dict(zip(("statistic", "threshold"), both, strict=True))


Hold = Callable[[NDArray[np.intp]], tuple[Mask, Mask | None]]
"""Lets receivers run the time to alert; (hold, b) alarms by epoch, and of their clean twins."""
_VIEWS = ("step_count", "undetected", "largest", "detected", "ended", "no_rows", "twin_alarmed")


class DisplacementScore:
    """Undetected displacement of B receivers; `_kernels.score` has the rule.

    - `raw` uint8, all of the following one after the other, as `unpack_score` names them;
    - `step_count` (B,) epochs under attack in the running episodes;
    - `undetected` (B,) undetected displacement so far [m];
    - `largest` (steps + 1, B) largest displacement so far after each epoch [m];
    - `detected` (B,) bool, whether the attack has raised an alarm;
    - `ended` (B,) bool, whether the episode is over, so that nothing more counts;
    - `no_rows` (B,) bool, False;
    - `twin_alarmed` (B,) bool, whether the clean twin has alarmed since the onset; False without.
    """

    step_count: NDArray[np.int64]
    undetected: FloatArray
    largest: FloatArray
    detected: Mask
    ended: Mask
    no_rows: Mask
    twin_alarmed: Mask

    def __init__(self, receivers: int, steps: int, hold: int) -> None:
        self.receivers, self.steps, self.hold = receivers, steps, hold
        self.raw = np.zeros(receivers * (8 * (steps + 3) + 4), dtype=np.uint8)
        self._name_arrays()

    def _name_arrays(self) -> None:
        # as plain Python, since to compile it takes longer than all calls together
        unpack = getattr(_kernels.unpack_score, "py_func", _kernels.unpack_score)
        views = unpack(self.raw, self.receivers, self.steps)
        for name, view in zip(_VIEWS, views, strict=True):
            setattr(self, name, view)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in _VIEWS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._name_arrays()

    def reset(self, rows: NDArray[np.intp]) -> None:
        self.step_count[rows] = 0
        self.detected[rows] = self.twin_alarmed[rows] = False
        self.undetected[rows] = 0.0
        self.largest[:, rows] = 0.0
        self.ended[rows] = False

    def score_hold(self, result: StepResult, hold: Hold) -> None:
        values, marks = result.values, result.marks
        rows = np.flatnonzero(marks[_kernels.FINISHED] & ~self.detected)
        late, of_twin = hold(rows)
        alarmed = late.any(axis=0)
        if of_twin is not None:
            by_then = np.where(alarmed, late.argmax(axis=0), len(late) - 1)
            so_far = np.logical_or.accumulate(of_twin, axis=0)
            self.twin_alarmed[rows] |= so_far[by_then, np.arange(len(rows))]
        first = np.where(alarmed, 1 + late.argmax(axis=0), 0)
        lengths, memory = (self.hold, self.steps), (self.step_count, self.detected, self.undetected)
        given = *lengths, *memory, self.largest, values, marks
        _kernels.score_late_alarms(first, rows, *given)


class FusedStep:
    """An epoch's score, information, reward and simple observation in one kernel. `worst` says that
    displacement counts in any direction; `parts` are the keys of the rewards that `shares` (r, 4)
    give as in `reward.compute_shares`; `table`, `command` and `per_rate` are those of `Observer`;
    an episode ends after `window` epochs."""

    def __init__(
        self,
        score: DisplacementScore,
        epoch_time: FloatArray,
        *,
        at_alarm: bool,
        worst: bool = False,
        window: int | None = None,
        parts: tuple[str, ...] = (),
        shares: FloatArray | None = None,
        table: NDArray[np.float32] | None = None,
        command: tuple[float, ...] = (-1.0, 0.0, 0.0, 0.0, -1.0, -1.0),
        per_rate: FloatArray | None = None,
    ) -> None:
        self.score = score
        self.layout = InfoLayout(score.receivers, parts)
        shares = np.zeros((0, 4)) if shares is None else shares
        table = np.zeros((1, 0), dtype=np.float32) if table is None else table
        per_rate = np.zeros(0) if per_rate is None else per_rate
        window = score.steps if window is None else window
        lengths = (score.steps, score.hold, window, at_alarm, len(shares), worst, *command)
        rules = np.concatenate([np.array(lengths, dtype=np.float64), shares.ravel(), epoch_time])
        self._fixed = (score.raw, rules, per_rate, table)

    def arrays(self) -> tuple[NDArray[Any], ...]:
        """What `_kernels.play_epoch` needs of it, in the order of its table."""
        score, (_, *rest) = self.score, self._fixed
        now = score.step_count, score.undetected, score.largest, score.detected, score.ended
        return *now, score.no_rows, *rest

    def __call__(
        self,
        simulator: Simulator,
        alarm: Mask,
        early: Mask,
        warmup_alarm: Mask,
        result: StepResult,
        seen: NDArray[np.float32],
        hold: Hold,
    ) -> None:
        """Score an epoch whose displacement is in `result`, and write all that is reported of it.
        `alarm` (B, c) of the verdict; `early` (B,) bool, whether this was the last command before
        the end of the window; `seen` (B o,) is observed, unless it has no element; `hold` runs the
        time to alert of receivers that have had the last command without an alarm."""
        given = (
            *self._fixed,
            np.ascontiguousarray(alarm),
            early,
            warmup_alarm,
            *simulator.step_arrays(),
            result.numbers,
            result.flags,
            seen,
        )
        if _kernels.finish(False, *given):
            self.hold(simulator, alarm, warmup_alarm, result, seen, hold)

    def hold(
        self,
        simulator: Simulator,
        alarm: Mask,
        warmup_alarm: Mask,
        result: StepResult,
        seen: NDArray[np.float32],
        hold: Hold,
    ) -> None:
        self.score.score_hold(result, hold)
        no_rows, written = self.score.no_rows, (result.numbers, result.flags, seen)
        # the time to alert has moved the receivers, and with them their arrays
        arrays = alarm, no_rows, warmup_alarm, *simulator.step_arrays()
        _kernels.finish(True, *self._fixed, *arrays, *written)


TightlyCoupledSimulator.kernel = SequelKernel(
    _kernels.play_epoch,
    (
        np.zeros(0, dtype=np.int64),
        np.zeros(0),
        np.zeros(0, dtype=np.bool_),
        np.zeros(0, dtype=np.float32),
    ),
)
"""Kernel of a tightly coupled simulator whose epochs may be scored."""


class ScoredStep:
    """`FusedStep` as the sequel of an epoch, in one kernel with it where the simulator can.
    `origin` (B, 2) where displacement is counted from [m]; `run_hold` runs the time to alert;
    `result`, `seen` (B o,), set before every step: what it is written to."""

    result: StepResult
    seen: NDArray[np.float32]

    def __init__(self, fused: FusedStep, origin: FloatArray, run_hold: Hold) -> None:
        self._fused, self._origin, self._run_hold = fused, origin, run_hold
        self._table: ArrayTable | None = None
        self._known = 0, 0

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_table": None}

    def arrays(self, simulator: TightlyCoupledSimulator) -> tuple[NDArray[Any], ...]:
        """First arguments of the kernel."""
        known = simulator.memory.stamp, simulator.attack.memory.stamp
        if self._table is None or known != self._known:
            warmup_alarm, self._known = simulator.memory["warmup_alarm"], known
            arrays = *self._fused.arrays(), self._origin, warmup_alarm, *simulator.scored_arrays()
            self._table = ArrayTable(arrays)
        return self._table.entries, self.result.numbers, self.result.flags, self.seen

    def hold(self, simulator: Simulator, verdict: Verdict) -> None:
        given = simulator, verdict.alarm, simulator.memory["warmup_alarm"], self.result, self.seen
        self._fused.hold(*given, self._run_hold)

    def __call__(self, simulator: Simulator, verdict: Verdict) -> None:
        result, no_rows = self.result, self._fused.score.no_rows
        simulator.displacement(self._origin, None, result.displacement)
        given = simulator, verdict.alarm, no_rows, simulator.memory["warmup_alarm"]
        self._fused(*given, result, self.seen, self._run_hold)
