"""Logs of innovations: what any filter, of whatever receiver, left of its measurements.

Two forms. A *table* (CSV or Parquet) has a row for each innovation, and can be written from C,
MATLAB or a spreadsheet: ``time_s, channel, signal, innovation, variance``, and ``segment`` where a
filter restarted. *Matrices* (``.npz``, without pickled objects) hold the whole covariance S, and
what else an epoch has.

Channels are satellites, or north, east and down of a receiver that measures its position. Signals
come in pairs, a length and its rate: ``pseudorange`` and ``range_rate``, ``position`` and
``velocity``. A log may have one of a pair.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.extras import name_extra
from ..core.files import whole_file
from ..core.reading import check_arrays, parse_json, read_file, read_npz, read_table
from ..core.registry import check_choice, require
from ..earth.wgs84 import dcm_e_from_n, ecef_to_geodetic
from .epoch import FILTER, OPTIONAL, Epoch

if TYPE_CHECKING:
    import pandas

    from .recording import Recording
    from .replay import Solution

FloatArray = NDArray[np.float64]
PAIRS = (("pseudorange", "range_rate"), ("position", "velocity"))
"""Signals of satellites and of positions, a length [m] and its rate [m/s]."""
COLUMNS = ("time_s", "channel", "signal", "innovation", "variance")
MATRICES = ("time", "innovation", "innovation_cov", "channels", "signals")
"""What a file of matrices must hold; `segment`, `about`, `MORE` and `STATES` may be there, too."""
MORE = {
    "predicted_cov": "ss",
    "design": "ms",
    "transition": "ss",
    "imu_delta": "6",
    "gain": "sm",
    "axes": "33",
    "pseudorange": "n",
    "satellite_position": "n3",
    "predicted_position": "3",
}
"""What else an epoch may have, with the sizes of its axes: m innovations, s states, n channels."""
RANGES = "pseudorange", "satellite_position", "predicted_position"
"""What a test of ranges needs, 0 where a channel is absent; a place may be there alone."""
PLACED = frozenset({"transition", "imu_delta", "gnss_position", *RANGES})
"""Fields of an epoch whose detectors look at the predicted position, too."""
STATES = "position", "velocity"  # names of what says which states are the position's error, ...
AXES = "east", "north", "up"  # channels of a loosely coupled receiver
EAST_NORTH_UP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # from N, E, D
SECONDS_PER_WEEK = 604800.0
FIRST_ORDER = "first order"
"""What `about` has for ``transition`` where a filter propagates so, but its errors do not."""
MOST_CHANNELS = 128
COVARIANCE_ERROR = 1e-3  # by which a covariance may be off, as numbers in files are rounded
MOST_ELEMENTS = 2**27  # of all covariances, 1 GiB


class SignalCheck(NamedTuple):
    """How innovations of one signal fit their variances.

    - `innovations`: how many; `nis` mean square of the innovations over their variances, 1 where
      they fit, with a 95 % interval (`low`, `high`) from blocks of epochs; `median` over epochs of
      the mean of an epoch, 0.79 where three channels fit;
    - `sd_factor` by which the standard deviations would fit, the root of `nis`;
    - `lag1` correlation of one epoch with the next; `constant` root mean square of the means of the
      channels, in standard deviations; `beyond_3` share beyond three of them; `largest` of all.
    """

    signal: str
    innovations: int
    nis: float
    low: float
    high: float
    sd_factor: float
    lag1: float
    constant: float
    beyond_3: float
    largest: float
    median: float


@dataclass(frozen=True, kw_only=True)
class InnovationLog:
    """Innovations of one receiver and what its filter believed of them.

    Parameters
    ----------
    time : ndarray
        (K,) of the epochs [s], rising within a segment.
    innovation : ndarray
        (K, 2n) lengths of all channels first, then rates [m], [m/s]; NaN where absent.
    innovation_cov : ndarray
        (K, 2n, 2n) S; rows of what is absent do not count.
    channels : tuple of str
        (n,) names.
    signals : tuple of str
        The pair of `PAIRS`.
    segment : ndarray
        (K,) int, a number for every stretch that one filter ran through.
    more : mapping
        Matrices of the filter by name, `MORE`: ``design`` (K, 2n, s) H, by which an error of the
        estimate shifts the innovations; ``transition`` (K, s, s) from the epoch before;
        ``predicted_cov`` (K, s, s) or ``gain`` (K, s, 2n); ``axes`` (K, 3, 3) from north, east,
        down to those of the position, by default as they are; ``imu_delta`` (K, 6); for tests of
        ranges ``pseudorange`` (K, n) without the satellites' clocks, ``satellite_position``
        (K, n, 3) and ``predicted_position`` (K, 3), ECEF [m].
    position, velocity : tuple of int
        (3,) which of the states are errors of these; empty where that is not known.
    about : mapping
        Where it comes from, JSON-able.

    Raises
    ------
    ValueError
        When shapes disagree, times run backwards within a segment, or a variance is not positive.
    """

    time: FloatArray
    innovation: FloatArray
    innovation_cov: FloatArray
    channels: tuple[str, ...]
    signals: tuple[str, ...] = PAIRS[0]
    segment: NDArray[np.int64]
    more: Mapping[str, FloatArray] = field(default_factory=dict)
    about: Mapping[str, Any] = field(default_factory=dict)
    position: tuple[int, ...] = ()
    velocity: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        count, m = len(self.time), 2 * len(self.channels)
        shapes = {
            "time": (count,),
            "segment": (count,),
            "innovation": (count, m),
            "innovation_cov": (count, m, m),
        }
        for name, shape in shapes.items():
            found = np.shape(getattr(self, name))
            require(found == shape, f"`{name}` must have shape {shape}, got {found}")
        require(count > 1 and m > 0, f"a log needs two epochs and a channel, got {count}, {m // 2}")
        require(np.isfinite(self.time).all(), "`time` must be finite")
        require(not np.isinf(self.innovation).any(), "`innovation` must be finite; absent is NaN")
        _check_pair(self.signals)
        back = (np.diff(self.time) <= 0.0) & (np.diff(self.segment) == 0)
        if back.any():
            k = int(back.argmax())
            raise ValueError(
                f"`time` must rise within a segment, got {self.time[k]:g} s and then "
                f"{self.time[k + 1]:g} s in row {k + 2}; begin a new segment where a filter was "
                "reset or its time jumped"
            )
        variance, present = self.variance, np.isfinite(self.innovation)
        bad = present & ~((variance > 0.0) & np.isfinite(variance))
        if bad.any():
            k, row = np.argwhere(bad)[0]
            raise ValueError(
                f"variances must be positive, got {variance[k, row]:g} at {self.time[k]:g} s of "
                f"{self.channels[row % len(self.channels)]}"
            )
        _check_covariance("innovation_cov", self.innovation_cov, present)
        sizes = {"m": m, "n": m // 2}
        there = [name for name in RANGES if name in self.more]
        require(
            there in ([], list(RANGES), [RANGES[2]]),
            f"ranges need {', '.join(RANGES)}, got {', '.join(there)} alone",
        )
        for name, array in self.more.items():
            check_choice("matrix of a filter", name, MORE)
            if "s" in MORE[name] and array.ndim == 3:
                sizes.setdefault("s", array.shape[1 + MORE[name].index("s")])
            shape = (count, *(sizes[x] if x in sizes else int(x) for x in MORE[name]))
            require(array.shape == shape, f"`{name}` must have shape {shape}, got {array.shape}")
            require(np.isfinite(array).all(), f"`{name}` must be finite")
        if "predicted_cov" in self.more:
            P = self.more["predicted_cov"]
            _check_covariance("predicted_cov", P, np.ones(P.shape[:2], dtype=np.bool_))
        for name in STATES:
            rows = getattr(self, name)
            require(
                not rows
                or (len(set(rows)) == 3 and all(0 <= k < sizes.get("s", math.inf) for k in rows)),
                f"`{name}` must be three different states of the filter, got {rows}",
            )

    @property
    def variance(self) -> FloatArray:
        """(K, 2n) diagonal of S."""
        return np.diagonal(self.innovation_cov, axis1=1, axis2=2)

    @property
    def states(self) -> int:
        """Error states of the log's filter, 0 where they are not known."""
        return self.more["transition"].shape[1] if "transition" in self.more else 0

    @property
    def present_signals(self) -> tuple[str, ...]:
        """Which of the pair the log has."""
        halves = np.split(np.isfinite(self.innovation), 2, axis=1)
        return tuple(name for name, x in zip(self.signals, halves, strict=True) if x.any())

    @cached_property
    def visible(self) -> NDArray[np.bool_]:
        """(K, n) channels that have all signals of the log at an epoch."""
        length, rate = np.split(np.isfinite(self.innovation), 2, axis=1)
        has = [name in self.present_signals for name in self.signals]
        return np.asarray((length | (not has[0])) & (rate | (not has[1])))

    @property
    def interval_s(self) -> float:
        """Median time between epochs of a segment [s]."""
        steps = np.diff(self.time)[np.diff(self.segment) == 0]
        require(steps.size > 0, "a log needs a segment with two epochs")
        return float(np.median(steps))

    @property
    def duration_s(self) -> float:
        """Time in all segments [s]."""
        return float(np.diff(self.time)[np.diff(self.segment) == 0].sum())

    @cached_property
    def steps_s(self) -> FloatArray:
        """(K,) time since the epoch before [s]."""
        steps = np.diff(self.time, prepend=self.time[0] - self.interval_s)
        steps[np.diff(self.segment, prepend=self.segment[0]) != 0] = self.interval_s
        return steps

    @cached_property
    def judged(self) -> NDArray[np.bool_]:
        """(K, 2n) innovations of visible channels."""
        return np.tile(self.visible, 2) & np.isfinite(self.innovation)

    def epochs(self) -> Iterator[Epoch]:
        """Every epoch as a detector takes it, of one receiver; absent channels are invisible."""
        return (self.gather_epoch(slice(k, k + 1)) for k in range(len(self.time)))

    def gather_epoch(self, rows: slice | NDArray[np.intp]) -> Epoch:
        """Epoch of as many receivers as there are rows, each at its own."""
        here, identity = self.judged[rows], np.eye(self.innovation.shape[1])
        S = np.where(here[:, :, None] & here[:, None], self.innovation_cov[rows], identity)
        nowhere, shown = np.zeros((len(here), 3)), {*FILTER, *RANGES}
        more = {name: array[rows] for name, array in self.more.items() if name in shown}
        return Epoch(
            time=self.time[rows],
            interval=self.steps_s[rows],
            innovation=np.where(here, self.innovation[rows], 0.0),
            innovation_variance=np.diagonal(S, axis1=1, axis2=2).copy(),
            visible=self.visible[rows],
            predicted_velocity=nowhere,
            innovation_cov=S,
            **{"predicted_position": nowhere, **more},
        )

    def check_signals(self) -> list[SignalCheck]:
        """How the innovations of every signal fit their variances."""
        with np.errstate(invalid="ignore", divide="ignore"):
            z = self.innovation / np.sqrt(self.variance)
        halves = dict(zip(self.signals, np.split(z, 2, axis=1), strict=True))
        follows = (np.diff(self.segment) == 0)[:, None]
        return [_check_signal(name, halves[name], follows) for name in self.present_signals]

    def list_remarks(self) -> list[str]:
        """What is unusual about the innovations; a line each."""
        lines = [line for each in self.check_signals() for line in _remark_on(each)]
        if not SHORTEST_STEP_S <= self.interval_s <= LONGEST_STEP_S:
            lines.append(
                f"an epoch every {self.interval_s:g} s, where {SHORTEST_STEP_S:g} to "
                f"{LONGEST_STEP_S:g} s are usual: are times in s?"
            )
        off = self.innovation_cov * (1.0 - np.eye(self.innovation.shape[1]))
        rate = PAIRS[0][1]
        if rate in self.present_signals and not off.any():
            lines.append(
                f"{rate}: the log has no correlations, as any table; the receiver's clock is in "
                "all channels, and tests see a fiftieth to a fifth of what they see in matrices"
            )
        return lines

    @classmethod
    def load(cls, path: str | Path) -> InnovationLog:
        """Log of a file: a table as .csv or .parquet, or matrices as .npz or MATLAB's .mat."""
        path = Path(path)
        kind = path.suffix.lower()
        check_choice("ending of a log", kind, (".csv", ".parquet", ".npz", ".mat"))
        if not path.is_file():
            raise FileNotFoundError(f"there is no file {path}")
        try:
            if kind in (".npz", ".mat"):
                return _build_log(read_npz(path, WANTED) if kind == ".npz" else _read_mat(path))
            return cls.from_table(read_table(path, (*COLUMNS, "segment")))
        except (ValueError, KeyError, zipfile.BadZipFile, EOFError) as error:
            raise ValueError(f"{path}: {error}") from error

    @classmethod
    def from_table(
        cls, table: pandas.DataFrame, about: Mapping[str, Any] | None = None
    ) -> InnovationLog:
        """Log of a table with `COLUMNS`, a row for each innovation; S is diagonal."""
        table = table.rename(columns=lambda name: str(name).strip())
        missing = [name for name in COLUMNS if name not in table]
        require(
            not missing,
            f"a log needs the columns {', '.join(COLUMNS)}; missing: {', '.join(missing)}",
        )
        require(len(table) > 0, "a log needs rows")
        names = {str(name) for name in table["signal"].unique()}
        pair = next((each for each in PAIRS if names <= set(each)), None)
        if pair is None:
            raise ValueError(
                "`signal` must be pseudorange and range_rate, or position and velocity, got "
                f"{', '.join(sorted(names))}"
            )
        segment = table["segment"] if "segment" in table else np.zeros(len(table), dtype=np.int64)
        time = np.asarray(table["time_s"], float).copy()
        for _, rows in table.groupby(["channel", "signal"]).indices.items():
            time[rows] = unroll_weeks(time[rows])
        keys = np.stack([np.asarray(segment, float), time], axis=1)
        epochs, epoch = np.unique(keys, axis=0, return_inverse=True)
        epoch = epoch.ravel()
        channels = tuple(sorted({str(name) for name in table["channel"]}))
        n = len(channels)
        require(n <= MOST_CHANNELS, f"a log has at most {MOST_CHANNELS} channels, got {n}")
        place = {name: k for k, name in enumerate(channels)}
        row = np.array([place[str(name)] for name in table["channel"]])
        row += n * (table["signal"].to_numpy() == pair[1])
        shape = len(epochs), 2 * n
        require(
            math.prod(shape) * 2 * n <= MOST_ELEMENTS,
            f"covariances have at most {MOST_ELEMENTS:,} elements, got {shape[0]} epochs of "
            f"{n} channels: cut it into parts",
        )
        innovation, variance = np.full(shape, np.nan), np.ones(shape)
        taken = np.bincount(epoch * 2 * n + row, minlength=innovation.size)
        if taken.max() > 1:
            k, twice = divmod(int(taken.argmax()), 2 * n)
            raise ValueError(
                f"{pair[twice // n]} of {channels[twice % n]} is there twice at {epochs[k, 1]:g} s"
            )
        _check_order(keys, row, channels)
        innovation[epoch, row] = table["innovation"]
        variance[epoch, row] = table["variance"]
        return cls(
            time=epochs[:, 1],
            innovation=innovation,
            innovation_cov=variance[:, :, None] * np.eye(2 * n),
            channels=channels,
            signals=pair,
            segment=epochs[:, 0].astype(np.int64),
            about=about or {},
        )

    @classmethod
    def from_replay(cls, solution: Solution, recording: Recording | None = None) -> InnovationLog:
        """Log of a replayed receiver; with the ranges of the `recording` of the same epochs, where
        it is there, for tests of ranges."""
        count, n = solution.visible.shape
        channels, about = tuple(f"C{k + 1:02d}" for k in range(n)), {"from": "replay"}
        if loose := bool(np.isnan(solution.clock_bias_m).all()):
            channels, axes = AXES, np.tile(EAST_NORTH_UP, (count, 1, 1))
        else:
            latitude, longitude, _ = ecef_to_geodetic(solution.position_e)
            axes, about["transition"] = dcm_e_from_n(latitude, longitude), FIRST_ORDER
        more = {**solution.filter_fields, "axes": axes}
        if not loose:
            more[RANGES[2]] = solution.position_e
        if recording is not None:
            names = "pseudorange", "satellite_position_e"
            ranges = (np.nan_to_num(getattr(recording, name)) for name in names)
            more |= dict(zip(RANGES, ranges, strict=False))
        return cls(
            time=solution.time,
            innovation=np.where(solution.measured, solution.innovation, np.nan),
            innovation_cov=solution.innovation_cov,
            channels=channels,
            signals=PAIRS[loose],
            segment=np.zeros(count, dtype=np.int64),
            more=more,
            about=about,
            position=(6, 7, 8),
            velocity=(3, 4, 5),
        )

    def save(self, path: str | Path) -> Path:
        """Write matrices (.npz), or a table (.csv), which loses what is off S's diagonal."""
        path = check_written(path)
        with whole_file(path) as part, part.open("wb") as file:
            if path.suffix.lower() == ".csv":
                file.write(self._table().to_csv(index=False).encode())
            else:
                arrays: dict[str, Any] = {
                    **{name: getattr(self, name) for name in (*MATRICES[:3], "segment")},
                    **{name: np.array(getattr(self, name)) for name in MATRICES[3:]},
                    "about": np.array(json.dumps(dict(self.about))),
                    **{name: np.array(getattr(self, name), dtype=np.int64) for name in STATES},
                    **self.more,
                }
                np.savez_compressed(file, **arrays)
        return path

    def _table(self) -> pandas.DataFrame:
        try:
            import pandas
        except ImportError as error:
            raise name_extra("a table", error, "flights") from error
        epoch, row = np.nonzero(np.isfinite(self.innovation))
        n = len(self.channels)
        return pandas.DataFrame(
            {
                "time_s": self.time[epoch],
                "channel": np.array(self.channels)[row % n],
                "signal": np.array(self.signals)[row // n],
                "innovation": self.innovation[epoch, row],
                "variance": self.variance[epoch, row],
                "segment": self.segment[epoch],
            }
        )


BLOCKS = 20  # of epochs, from whose spread the interval of a mean follows
T_975 = 2.093  # 97.5 % point of Student's t with 19 degrees of freedom


def _check_signal(name: str, z: FloatArray, follows: NDArray[np.bool_]) -> SignalCheck:
    square = z * z
    nis = float(np.nanmean(square))
    found = [
        np.nanmean(block) for block in np.array_split(square, BLOCKS) if np.isfinite(block).any()
    ]
    spread = T_975 * float(np.std(found, ddof=1)) / math.sqrt(len(found)) if len(found) > 2 else nis
    pairs = follows & np.isfinite(z[:-1]) & np.isfinite(z[1:])
    before, after = z[:-1][pairs], z[1:][pairs]
    size = math.sqrt(float(np.sum(before**2) * np.sum(after**2)))
    with np.errstate(invalid="ignore"):
        means = np.array([np.mean(c[np.isfinite(c)]) for c in z.T if np.isfinite(c).any()])
    return SignalCheck(
        signal=name,
        innovations=int(np.isfinite(z).sum()),
        nis=nis,
        low=max(nis - spread, 0.0),
        high=nis + spread,
        sd_factor=math.sqrt(nis),
        lag1=float(np.sum(before * after)) / size if size > 0.0 else 0.0,
        constant=float(np.sqrt(np.mean(means**2))),
        beyond_3=float(np.nanmean(np.where(np.isfinite(z), np.abs(z) > 3.0, np.nan))),
        largest=float(np.nanmax(np.abs(z))),
        median=float(np.median(np.nanmean(square[np.isfinite(square).any(axis=1)], axis=1))),
    )


WIDE, NARROW = 30.0, 0.05
"""Mean squares over variances beyond which something is wrong, and below which the receiver
assumes far more noise than it meets."""
SHORTEST_STEP_S, LONGEST_STEP_S = 1e-3, 60.0  # from one epoch to the next
UNIT = 1e-5  # below which it is rather a unit
CONSTANT = 3.0  # standard deviations of constant parts that are most of all, and rather a datum
PERSISTENT = 0.5  # correlation of successive innovations from which tests with memory suffer


def _remark_on(signal: SignalCheck) -> list[str]:
    name, nis, factor = signal.signal, signal.nis, signal.sd_factor
    lines = []
    if signal.constant > max(CONSTANT, 0.7 * factor):
        lines.append(
            f"{name}: constant parts of {signal.constant:.3g} standard deviations, where below 1 "
            "fits: do datums and heights agree (above sea level, above the ellipsoid)?"
        )
    elif nis > WIDE:
        lines.append(
            f"{name}: {factor:.3g} times its standard deviation, where 1 fits: are units, time "
            "base and satellite clocks right (deg/s for rad/s, leap seconds)?"
        )
    elif nis < NARROW:
        lines.append(
            f"{name}: the receiver assumes {1.0 / max(factor, 1e-9):.3g} times the noise that it "
            "meets, where 1 fits; "
            + (
                "are innovations and variances in m and m/s (not km)?"
                if nis < UNIT
                else "tests with thresholds of their own see little"
            )
        )
    if signal.lag1 > PERSISTENT:
        lines.append(
            f"{name}: innovations persist (correlation {signal.lag1:.2f}); give tests with memory "
            "a bias_window_s, or thresholds of this log"
        )
    return lines


def _check_order(keys: FloatArray, row: NDArray[np.int64], channels: tuple[str, ...]) -> None:
    """Raise where time runs backwards in the rows of a channel; `keys` (r, 2): segment and time."""
    by_row = np.argsort(row, kind="stable")
    same = np.diff(row[by_row]) == 0
    segment, time = np.diff(keys[by_row], axis=0).T
    if (back := same & (segment == 0.0) & (time <= 0.0)).any():
        k = by_row[int(back.argmax()) + 1]
        raise ValueError(
            f"`time` must rise within a segment, got {keys[k, 1]:g} s after a later time in row "
            f"{k + 1}, of {channels[row[k] % len(channels)]}; begin a new segment where a filter "
            "was reset or its time jumped"
        )


def _check_pair(signals: tuple[str, ...]) -> None:
    require(
        signals in PAIRS,
        f"`signals` must be {' or '.join(' and '.join(pair) for pair in PAIRS)}, got "
        f"{', '.join(signals)}",
    )


def _check_covariance(name: str, S: FloatArray, there: NDArray[np.bool_]) -> None:
    """It is symmetric, and no covariance is larger than its variances allow."""
    variance = np.where(there, np.diagonal(S, axis1=1, axis2=2), 0.0)
    require((variance >= 0.0).all(), f"`{name}` must have variances of at least 0")
    sd = np.sqrt(variance)
    size = sd[:, :, None] * sd[:, None, :]
    sound = (np.abs(S) <= (1.0 + COVARIANCE_ERROR) * size) & (
        np.abs(S - S.transpose(0, 2, 1)) <= COVARIANCE_ERROR * size
    )
    for k, i, j in np.argwhere(there[:, :, None] & there[:, None, :] & ~sound)[:1]:
        raise ValueError(
            f"`{name}` must be a covariance, got {S[k, i, j]:g} and {S[k, j, i]:g} in row {k + 1} "
            f"between {i} and {j}, whose variances are {variance[k, i]:g} and {variance[k, j]:g}"
        )


def unroll_weeks(time: FloatArray) -> FloatArray:
    """Times that go on where seconds of a GPS week begin again [s]."""
    weeks = np.cumsum(np.diff(time, prepend=time[:1]) < -0.99 * SECONDS_PER_WEEK)
    return np.asarray(time + SECONDS_PER_WEEK * weeks)


WANTED = {
    **{"time": ("number", "1"), "innovation": ("number", "2"), "innovation_cov": ("number", "3")},
    **dict.fromkeys(("channels", "signals"), ("text", "01")),
    **{name: ("number", str(1 + len(axes))) for name, axes in MORE.items()},
    **dict.fromkeys((*STATES, "segment"), ("whole number", "01")),
    "about": ("text", "01"),
}


def _read_mat(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays that MATLAB wrote up to version 7: vectors have two axes, texts are cells or rows of
    letters, and epochs may be the last axis."""
    from scipy.io import loadmat, whosmat

    content = read_file(path)
    try:
        sizes = {name: math.prod(shape) for name, shape, _ in whosmat(io.BytesIO(content))}
        require(sum(sizes.values()) <= MOST_ELEMENTS, "its arrays are too large")
        found = loadmat(io.BytesIO(content), variable_names=[*WANTED])
    except NotImplementedError as error:
        raise ValueError("it is of version 7.3: save it with '-v7'") from error
    except Exception as error:  # of any kind, as damage has it
        raise ValueError(f"scipy can't read it: {error}") from error
    arrays = {name: found[name] for name in WANTED if name in found}
    for name in ("channels", "signals"):
        texts = np.ravel(arrays.get(name, []))
        arrays[name] = np.array(["".join(map(str, np.ravel(x))).strip() for x in texts])
    for name in ("time", "segment", *STATES, "about"):
        if name in arrays:
            arrays[name] = arrays[name].ravel()
    if "about" in arrays:
        arrays["about"] = np.array("".join(map(str, arrays["about"])))
    count = arrays["time"].size if "time" in arrays else 0
    for name, array in arrays.items():
        if array.ndim == 3 and array.shape[0] != count == array.shape[2]:
            arrays[name] = np.moveaxis(array, 2, 0)
    return check_arrays({name: array for name, array in arrays.items() if array.size}, WANTED)


def _build_log(found: Mapping[str, NDArray[Any]]) -> InnovationLog:
    missing = [name for name in MATRICES if name not in found]
    require(not missing, f"missing arrays: {', '.join(missing)}; needed: {', '.join(MATRICES)}")
    channels = tuple(map(str, np.atleast_1d(found["channels"])))
    signals = tuple(map(str, np.atleast_1d(found["signals"])))
    require(len(channels) <= MOST_CHANNELS, f"at most {MOST_CHANNELS} channels are valid")
    _check_pair(signals)
    numbers = {
        name: np.ascontiguousarray(found[name], dtype=np.float64)
        for name in (*MATRICES[:3], *MORE)
        if name in found
    }
    time = unroll_weeks(numbers.pop("time"))
    segment = found["segment"] if "segment" in found else np.zeros(time.shape)
    return InnovationLog(
        time=time,
        innovation=numbers.pop("innovation"),
        innovation_cov=numbers.pop("innovation_cov"),
        channels=channels,
        signals=signals,
        segment=segment.astype(np.int64),
        more=numbers,
        about=parse_json(str(found["about"]), "`about`") if "about" in found else {},
        **{
            name: tuple(np.ravel(found[name]).astype(int).tolist())
            for name in {*STATES} & found.keys()
        },
    )


def check_written(path: str | Path) -> Path:
    """Path whose ending says that a log can be written there."""
    check_choice("ending of a log to write", Path(path).suffix.lower(), (".npz", ".csv"))
    return Path(path)


def missing_fields(log: InnovationLog, needs: frozenset[str]) -> list[str]:
    """Fields of an epoch that a detector needs and a log does not have."""
    has = {"innovation_cov", *log.more}
    place = {RANGES[2]} if needs & PLACED else set()
    return sorted((needs & set(OPTIONAL) | place) - has)


def missing_matrices(log: InnovationLog) -> list[str]:
    """What an attack on a log needs and the log does not have."""
    names = ["design", "transition", "position"]
    names += ["velocity"] if log.signals[1] in log.present_signals else []
    names += ["axes"] if log.signals == PAIRS[0] else []
    has = {*log.more, *(name for name in STATES if getattr(log, name))}
    absent = [name for name in names if name not in has]
    return absent + ([] if {"gain", "predicted_cov"} & has else ["gain or predicted_cov"])
