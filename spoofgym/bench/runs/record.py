"""What a detector and a spoofer did in every run of a split; scores follow from that alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...envs import _kernels
from ...simulation.setup import Setup
from .play import FloatArray, Runs, compute_induced_offset, horizontal, induced_error, off_truth

Mask = NDArray[np.bool_]
PERCENTILES = (5, 50, 95)


@dataclass(frozen=True)
class RunRecord:
    """What a detector and a spoofer did in the runs of a split: `head`, labels, settings and
    lengths, as JSON; `series` by epoch: ``time_s`` since the onset, ``alarmed`` part of the runs,
    ``error_m`` percentiles; and `records` (R,):

    - ``warmup_alarm`` bool; ``first_alarm``, and ``twin_alarm`` of the clean twin, epoch from 1 on,
      0 for none; ``alarm_epochs``; ``crossing``, first epoch beyond the alert limit, 0 for none;
    - ``undetected_displacement_m``, the same ``vertical``, ``along`` the target direction, and of
      the ``total`` error, as far as there are these axes; ``largest_error_m`` and ``final_error_m``
      of the command phase, alarmed or not; ``navigation_rms_m`` distance from the truth;
    - ``coasting_epochs``, and the largest distance from the truth in them; ``blamed`` channels,
      summed; ``sky`` it flew under; ``peak_ratio``; of clean runs of a detector with a protection
      level its median, and epochs by the Stanford diagram (`count_stanford`).
    """

    head: dict[str, Any]
    records: dict[str, NDArray[Any]]
    series: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, values in self.records.items():
            if np.isinf(values).any():
                run = int(np.argmax(np.isinf(values).reshape(len(values), -1).any(axis=1)))
                who = " against ".join(str(self.head.get(x)) for x in ("spoofer", "detector"))
                raise ArithmeticError(f"{who}: {name} of run {run} is infinite")

    @property
    def detector(self) -> str:
        return str(self.head["detector"])

    @property
    def spoofer(self) -> str:
        return str(self.head["spoofer"])

    @property
    def runs(self) -> int:
        return len(self.records["first_alarm"])

    @property
    def window(self) -> int:
        """Epochs from the onset to the end of the hold, K."""
        return int(self.head["steps"]) + int(self.head["hold"])

    @property
    def interval_s(self) -> float:
        return float(self.head["interval_s"])

    @property
    def counts(self) -> NDArray[np.bool_]:
        """(R,) which runs count for a score."""
        return mask_valid_runs(self.records["warmup_alarm"], self.records["twin_alarm"])

    @property
    def sky(self) -> NDArray[np.int64]:
        """(R,) under which sky each run flew."""
        return np.asarray(self.records["sky"])

    @property
    def displacement_m(self) -> FloatArray:
        """(R,) undetected displacement [m]."""
        return np.asarray(self.records["undetected_displacement_m"], dtype=np.float64)

    @property
    def alarmed(self) -> NDArray[np.bool_]:
        """(R,) whether there was an alarm in the window."""
        return np.asarray(self.records["first_alarm"] > 0)

    def parts(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays, and all else as JSON."""
        return self.records, {"head": self.head, "series": self.series}

    @classmethod
    def from_parts(cls, arrays: Mapping[str, NDArray[Any]], record: Mapping[str, Any]) -> RunRecord:
        return cls(record["head"], dict(arrays), record["series"])


MEASURES = (
    "undetected_displacement_m",
    "undetected_vertical_m",
    "undetected_total_m",
    "undetected_total_vertical_m",
)
"""Induced and total error, horizontal and vertical; a victim in the plane has no vertical ones."""


def measure_displacement(
    setup: Setup, attacked: Runs, twin: Runs, measures: Sequence[str] = MEASURES
) -> dict[str, FloatArray]:
    """Undetected displacement of every run by some measures, as far as a victim has them."""
    moved, off = compute_induced_offset(setup, attacked, twin), off_truth(setup, attacked)
    sizes = [horizontal(moved), None, horizontal(off), None]
    if moved.shape[2] == 3:
        sizes[1], sizes[3] = np.abs(moved[..., 2]), np.abs(off[..., 2])
    return {
        name: np.round(
            undetected_displacement(size[: setup.steps], attacked.first_alarm, setup.hold), 6
        )
        for name, size in zip(MEASURES, sizes, strict=True)
        if size is not None and name in measures
    }


def record_runs(
    setup: Setup,
    head: dict[str, Any],
    warmup_alarm: NDArray[np.bool_],
    attacked: Runs,
    twin: Runs,
    alert_limit_m: float,
) -> RunRecord:
    """Record of some runs.  `warmup_alarm` (R,) bool, alarms before the onset."""
    moved, off = compute_induced_offset(setup, attacked, twin), off_truth(setup, attacked)
    error, total = horizontal(moved), horizontal(off)
    commanded, first = error[: setup.steps], attacked.first_alarm
    above = commanded > alert_limit_m

    numbers = {
        "largest_error_m": commanded.max(axis=0),
        "final_error_m": commanded[-1],
        "navigation_rms_m": np.sqrt((total * total).mean(axis=0)),
        "coasting_error_m": np.where(attacked.coasting, total, 0.0).max(axis=0),
        "peak_ratio": attacked.peak,
    }
    if setup.target_heading_deg != "worst":
        north, east = np.cos(attacked.heading), np.sin(attacked.heading)
        along = (moved[..., 0] * north + moved[..., 1] * east)[: setup.steps]
        numbers["undetected_along_m"] = undetected_displacement(along, first, setup.hold)
    records: dict[str, NDArray[Any]] = {
        "warmup_alarm": warmup_alarm,
        "first_alarm": first,
        "twin_alarm": twin.first_alarm,
        "alarm_epochs": attacked.alarm.sum(axis=0),
        "coasting_epochs": attacked.coasting.sum(axis=0),
        "blamed": attacked.blamed,
        "crossing": np.where(above.any(axis=0), above.argmax(axis=0) + 1, 0),
        "sky": attacked.onset // setup.epochs_each,
    }
    records |= {name: np.round(x, 6) for name, x in numbers.items()}
    records |= measure_displacement(setup, attacked, twin)
    if attacked.protection is not None:
        records["protection_level_m"] = np.round(np.median(attacked.protection, axis=0), 6)
        records |= count_stanford(total, attacked.protection, attacked.alarm, alert_limit_m)
    epochs = np.arange(1, len(error) + 1)
    bands = np.percentile(error, PERCENTILES, axis=1)
    series = {
        "time_s": (epochs * setup.interval_s).round(6).tolist(),
        "alarmed": ((first > 0) & (first <= epochs[:, None])).mean(axis=1).round(6).tolist(),
        "error_m": {
            f"p{p:02d}": band.round(4).tolist() for p, band in zip(PERCENTILES, bands, strict=True)
        },
    }
    lengths = {"interval_s": setup.interval_s, "steps": setup.steps, "hold": setup.hold}
    return RunRecord({**head, **lengths}, records, series)


STANFORD = ("nominal", "misleading", "hazardous", "unavailable")  # parts of the Stanford diagram


def count_stanford(
    error: FloatArray, level: FloatArray, alarm: Mask, alert_limit_m: float
) -> dict[str, NDArray[np.int64]]:
    """(R,) epochs by the parts of the Stanford diagram (`tossaint2007`): unavailable where the
    protection `level` (K, R) exceeds the alert limit, or at an `alarm` (K, R); else nominal where
    the position `error` (K, R) [m] is within the level, misleading beyond it, hazardous beyond the
    limit, too."""
    available = (level <= alert_limit_m) & ~alarm
    beyond = available & (error > level)
    parts = (
        available & ~beyond,
        beyond & (error <= alert_limit_m),
        beyond & (error > alert_limit_m),
        ~available,
    )
    names = (f"{name}_epochs" for name in STANFORD)
    return {name: part.sum(axis=0) for name, part in zip(names, parts, strict=True)}


class Aim(NamedTuple):
    """What an attack is chosen by: one of `MEASURES`, to be large in a `share` of the runs, or to
    exceed an alert limit often; `skies`: whether only the worst tenth of them counts."""

    measure: str
    share: float | None = None
    limit_m: float | None = None
    skies: bool = False

    def score_displacement(self, displacement: FloatArray) -> float:
        """What is exceeded in the share of the runs that count, or how often the limit is."""
        if not len(displacement):
            return 0.0
        if self.share is not None:
            return compute_upper_quantile(displacement, self.share)
        assert self.limit_m is not None  # one of the two is given
        return float((displacement > self.limit_m).mean())

    def worth(self, displacement: FloatArray) -> float:
        """How good a displacement of the runs that count is, to choose by. Of attacks that exceed a
        limit equally often, the best is the one whose weakest such run exceeds it most: it most
        surely exceeds it again. Of those that never do, the one that comes nearest."""
        reached = self.score_displacement(displacement)
        if self.limit_m is None or not len(displacement):
            return reached
        weakest = self.weakest(displacement)
        return reached + 1e-9 * weakest / (1.0 + weakest)

    def weakest(self, displacement: FloatArray) -> float:
        """Smallest displacement beyond the limit, or, where none is, the largest [m]."""
        above = displacement > (self.limit_m or 0.0)
        return float(displacement[above].min() if above.any() else displacement.max(initial=0.0))


@dataclass(frozen=True)
class Winner:
    """An attack that is the worst one for some aims; `displacement` by measure (R,) of the
    evaluation runs [m]."""

    letter: str
    spoofer: str
    setting: str
    value: float
    spec: dict[str, Any]
    aims: tuple[Aim, ...]
    displacement: dict[str, FloatArray]


@dataclass(frozen=True)
class Protection:
    """What the worst attacks of the suite achieve on the evaluation runs against one detector;
    `counts`, `sky` (R,) of these; `skies`: the worst tenth, None where there are too few."""

    head: dict[str, Any]
    winners: tuple[Winner, ...]
    counts: NDArray[np.bool_]
    sky: NDArray[np.int64]
    skies: NDArray[np.int64] | None

    @property
    def detector(self) -> str:
        return str(self.head["detector"])

    def winner(self, aim: Aim) -> Winner | None:
        """The worst attack for an aim; None if none was searched for."""
        return next((each for each in self.winners if aim in each.aims), None)

    def worst(self, aim: Aim) -> Winner:
        """Worst attack on the evaluation runs; of equal ones that which was chosen for the aim."""
        chosen, rows = self.winner(aim), self.rows(aim)
        several = (*([] if chosen is None else [chosen]), *self.winners)
        return max(
            several, key=lambda each: aim.score_displacement(each.displacement[aim.measure][rows])
        )

    def score_worst(self, aim: Aim) -> float:
        """What the worst attack on the evaluation runs achieves of an aim."""
        return aim.score_displacement(self.worst(aim).displacement[aim.measure][self.rows(aim)])

    def rows(self, aim: Aim) -> NDArray[np.bool_]:
        """(R,) which runs an aim is about."""
        if not aim.skies or self.skies is None:
            return self.counts
        return self.counts & np.isin(self.sky, self.skies)

    def parts(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays, and all else as JSON."""
        arrays: dict[str, NDArray[Any]] = {"counts": self.counts, "sky": self.sky}
        arrays |= {} if self.skies is None else {"skies": self.skies}
        winners = []
        for n, each in enumerate(self.winners):
            named = {name: value for name, value in vars(each).items() if name != "displacement"}
            winners.append({**named, "aims": [aim._asdict() for aim in each.aims]})
            arrays |= {f"{n}/{measure}": x for measure, x in each.displacement.items()}
        return arrays, {"head": self.head, "winners": winners}

    @classmethod
    def from_parts(
        cls, arrays: Mapping[str, NDArray[Any]], record: Mapping[str, Any]
    ) -> Protection:
        winners = []
        for n, each in enumerate(record["winners"]):
            aims = tuple(Aim(**aim) for aim in each["aims"])
            names = [f"{n}/{measure}" for measure in MEASURES]
            own = {name.partition("/")[2]: arrays[name] for name in names if name in arrays}
            winners.append(Winner(**{**each, "aims": aims, "displacement": own}))
        runs = arrays["counts"], arrays["sky"], arrays.get("skies")
        return cls(record["head"], tuple(winners), *runs)


def compute_displacement(setup: Setup, attacked: Runs, twin: Runs) -> FloatArray:
    """Undetected displacement of every run: (R,) [m]."""
    error = induced_error(setup, attacked, twin)[: setup.steps]
    return undetected_displacement(error, attacked.first_alarm, setup.hold)


def undetected_displacement(
    error: ArrayLike, first_alarm: ArrayLike, time_to_alert: int
) -> FloatArray:
    r"""Largest error with no alarm up to the time to alert after it, (R,) [m].

    .. math:: D_u = \max_{0 \le k < a - h} e_k, \qquad e_0 = 0

    with the first alarm at epoch a and h epochs to alert. `error` (K, R) [m] from the first epoch
    after the onset on, which may be NaN after the alarm; `first_alarm` (R,), 0 for none.
    """
    e = np.asarray(error, dtype=np.float64)
    largest = np.maximum.accumulate(np.concatenate([np.zeros((1, e.shape[1])), e]))
    return np.asarray(_kernels.select_undetected(largest, np.asarray(first_alarm), time_to_alert))


def mask_valid_runs(warmup_alarm: ArrayLike, twin_alarm: ArrayLike) -> Mask:
    """Which runs count: silent before the onset, with a silent twin. (R,) bool each. `twin_alarm`:
    whether the clean twin alarms in the judged window, or the epoch at which it does."""
    return ~(np.asarray(warmup_alarm, dtype=np.bool_) | np.asarray(twin_alarm, dtype=np.bool_))


def compute_upper_quantile(displacement: ArrayLike, share: float) -> float:
    """Largest displacement that is reached in at least such a share of the runs; NaN without runs.
    `displacement` (R,) [m]; `share` in (0, 1]."""
    x = np.sort(np.asarray(displacement, dtype=np.float64))[::-1]
    if not len(x):
        return math.nan
    return float(x[max(math.ceil(share * len(x) - 1e-9), 1) - 1])
