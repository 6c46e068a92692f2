r"""Thresholds from clean runs: order statistics of the run maxima, in a small file.

A clean run is one number: the largest ratio of statistic to threshold over all channels and the
epochs of the judged window, which lasts from the start of an attack to its end plus the time to
alert.  A rate of r false alarms an hour is a probability for a run, and that a rank,

.. math:: p = 1 - e^{-r W}, \qquad k = \lceil (1 - p)(n + 1) \rceil

With the n maxima in order, :math:`x_{(k)}` is the factor on the thresholds that a new run exceeds
with probability p at most, whatever the distribution.  Ranks are counted from the top here, as
:math:`n + 1 - k`, 1 being the largest.  Beyond the largest maximum a generalised Pareto
distribution goes on, fitted to the uppermost maxima as in `coles2001`, and only down to
:math:`p = 1 / (10 n)`.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import platformdirs

from ..core.declared import check_number
from ..core.files import write_file
from ..core.reading import read_json
from ..core.registry import require
from ..core.settings import compute_digest, describe, diff_settings
from .base import FloatArray

FORMAT = 1
SHIPPED_FOLDER = Path(__file__).parents[1] / "calibrations"
FOLDER_VARIABLE = "SPOOFGYM_CALIBRATIONS"
STANDARD_RATES = (0.2, 0.002)
"""False alarms an hour that a file always has exactly: of research, and of aviation's order."""
WITNESSES = 16
"""Run maxima that a file keeps with their seeds, to be replayed."""
TOLERANCE = 1e-6  # of a replayed maximum, relative
EXACT_RANKS, RANK_RATIO = 200, 1.01
"""Uppermost order statistics that a file has one by one; below, their ranks grow by a ratio."""
EXTRAPOLATION = 10.0
"""How far a fitted tail reaches: down to a probability of one in so many times the runs."""
FEWEST_EXCEEDANCES = 50
DIGITS = 12  # significant ones of what is written


@dataclass(frozen=True)
class Conditions:
    """World of a calibration: its resolved `settings` that a clean run depends on, JSON-able;
    judged window [s]; name, for messages and seeds; `options` of a command line, or ""."""

    settings: dict[str, Any]
    window_s: float
    label: str
    options: str

    @cached_property
    def digest(self) -> str:
        return compute_digest(self.settings)


class OperatingPoint(NamedTuple):
    """Where a calibrated detector works.

    Attributes
    ----------
    false_alarms_per_hour : float
        Requested rate.
    per_run : float
        Probability of an alarm in a clean run.
    scale : float
        Factor on the thresholds.
    runs, rank : int
        Clean runs, and the rank from the top that the scale is; 0 beyond the largest.
    window_s : float
        Judged window of a run [s].
    extrapolated : bool
        Whether the scale is that of a fitted tail.
    warmup_alarms : float
        Share of the clean runs that alarm before the attack, at this scale.
    """

    false_alarms_per_hour: float
    per_run: float
    scale: float
    runs: int
    rank: int
    window_s: float
    extrapolated: bool
    warmup_alarms: float

    def __str__(self) -> str:
        tail = ", by a fitted tail" if self.extrapolated else ""
        return (
            f"{self.false_alarms_per_hour:g} false alarms an hour, {100.0 * self.per_run:.3g} % of "
            f"runs of {self.window_s:g} s ({self.runs} clean runs{tail})"
        )


def check_rate(rate: Any) -> float:
    check_number("false_alarms_per_hour", rate, above=0.0)
    return float(rate)


def run_probability(false_alarms_per_hour: float, window_s: float) -> float:
    return -math.expm1(-check_rate(false_alarms_per_hour) * window_s / 3600.0)


def hourly_rate(per_run: float, window_s: float) -> float:
    return math.inf if per_run >= 1.0 else -math.log1p(-per_run) * 3600.0 / window_s


def compute_min_runs(per_run: float) -> int:
    return max(math.ceil(1.0 / per_run - 1e-9) - 1, 1)


def compute_rank(per_run: float, runs: int) -> int:
    """Rank from the top of the order statistic that a new run exceeds with a probability; 0 where
    even the largest is exceeded more often."""
    return runs + 1 - math.ceil((1.0 - per_run) * (runs + 1) - 1e-9)


def tail_exceedances(runs: int) -> int:
    return min(EXACT_RANKS - 1, runs // 10)


def check_runs(rate: float, runs: int, window_s: float, *, tail: bool) -> None:
    """Raise unless so many runs are enough for a rate; `tail`: whether one may be fitted."""
    p = run_probability(rate, window_s)
    if p > (runs + 1e-9) / (runs + 1.0):
        most = hourly_rate(runs / (runs + 1.0), window_s)
        raise ValueError(
            f"`false_alarms_per_hour` must be at most {most:.4g} for {runs} runs of "
            f"{window_s:g} s: a run has one alarm or none; got {rate:g}"
        )
    if compute_rank(p, runs) >= 1:
        return
    far = p * EXTRAPOLATION * runs < 1.0 or tail_exceedances(runs) < FEWEST_EXCEEDANCES
    if far or not tail:
        needed = f"at least {compute_min_runs(p)}"
        if tail:
            fitted = max(10 * FEWEST_EXCEEDANCES, math.ceil(1.0 / (EXTRAPOLATION * p)))
            needed += f", or {fitted} for a fitted tail"
        raise ValueError(
            f"{rate:g} false alarms an hour are {p:.3g} a run of {window_s:g} s, for which {runs} "
            f"clean runs are too few: it takes {needed}"
        )


def list_stored_ranks(
    runs: int, window_s: float, rates: Sequence[float] = STANDARD_RATES
) -> list[int]:
    """Ranks from the top that a file stores: the uppermost ones, thinned below, and those of rates.
    A rank between two of them counts as the next smaller one, so that no rate is exceeded."""
    ranks = {*range(1, min(EXACT_RANKS, runs) + 1), runs}
    rank = float(EXACT_RANKS)
    while (rank := rank * RANK_RATIO) < runs:
        ranks.add(int(rank))
    wanted = (compute_rank(run_probability(rate, window_s), runs) for rate in rates)
    return sorted(ranks.union(r for r in wanted if r >= 1))


def round_digits(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def round_digits_up(values: FloatArray) -> FloatArray:
    """Values with `DIGITS` digits, never below what they were, so that none alarms."""
    sizes = np.floor(np.log10(np.maximum(np.abs(values), np.finfo(np.float64).tiny)))
    unit = 10.0 ** (sizes - (DIGITS - 1))
    up = np.ceil(values / unit * (1.0 + 1e-15)) * unit
    return np.array([round_digits(value) for value in np.maximum(up, values)])


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Clean runs of one detector in one world.

    Attributes
    ----------
    world, detector : dict
        Resolved settings, JSON-able.
    window_s : float
        Judged window of a run [s].
    runs : int
        How many, n.
    entropy : int
        Of the seeds of these runs.
    ranks : tuple of int
        Ranks from the top, increasing.
    largest : tuple of float
        Factor on the thresholds at each rank: the order statistic of the run maxima or, where the
        alarm is a state, what a bisection has found.
    before : tuple of (int, float)
        Ranks from the top of the largest ratios before the attack, with their values.
    witnesses : tuple of (int, float, float)
        First runs: number, and largest ratios before the attack and in the judged window.
    rescale : tuple of float or None
        Factors on the innovations, of the variant `rescaled`: common mode and complement of the
        pseudoranges, then of the range rates.
    bisected : bool
        Whether the alarm is a state, and `largest` has only the requested ranks.
    seed_name : str
        Name of the world in the seeds.
    path : Path or None
        File that it was read from or written to.
    """

    world: Mapping[str, Any]
    detector: Mapping[str, Any]
    window_s: float
    runs: int
    entropy: int
    seed_name: str
    ranks: tuple[int, ...] = field(repr=False)
    largest: tuple[float, ...] = field(repr=False)
    before: tuple[tuple[int, float], ...] = field(repr=False)
    witnesses: tuple[tuple[int, float, float], ...] = field(repr=False)
    rescale: tuple[float, ...] | None = None
    bisected: bool = False
    path: Path | None = field(default=None, compare=False)

    @classmethod
    def from_maxima(
        cls,
        before: FloatArray,
        judged: FloatArray,
        *,
        ranks: Sequence[int],
        largest: FloatArray | None = None,
        **identity: Any,
    ) -> Calibration:
        """Calibration from the largest ratios of clean runs, (n,) `before` the attack and in the
        `judged` window; `largest`: factors at the ranks, where they are no order statistics."""
        n, early = len(judged), np.sort(before)[::-1]
        if largest is None:
            largest = round_digits_up(np.sort(judged)[::-1][np.array(ranks) - 1])
        sparse = sorted({min(int(1.1**power), n) for power in range(400)})
        return cls(
            runs=n,
            ranks=tuple(ranks),
            largest=tuple(largest.tolist()),
            before=tuple((rank, round_digits(early[rank - 1])) for rank in sparse),
            witnesses=tuple(
                (run, round_digits(before[run]), round_digits(judged[run]))
                for run in range(min(WITNESSES, n))
            ),
            **identity,
        )

    def point(
        self, false_alarms_per_hour: float | None = None, *, per_run: float | None = None
    ) -> OperatingPoint:
        """Where the detector works at a rate of false alarms, by the hour or by the run."""
        n = self.runs
        if None not in (false_alarms_per_hour, per_run):
            raise ValueError(
                "a rate is given by the hour or by the run, got "
                f"false_alarms_per_hour={false_alarms_per_hour!r} and per_run={per_run!r}"
            )
        if per_run is None:
            rate = check_rate(false_alarms_per_hour)
            p = run_probability(rate, self.window_s)
        else:
            check_number("per_run", per_run, above=0.0, below=1.0)
            p, rate = per_run, hourly_rate(per_run, self.window_s)
        check_runs(rate, n, self.window_s, tail=not self.bisected)
        exact = compute_rank(p, n)
        if self.bisected and exact not in self.ranks:
            raise ValueError(
                f"the alarm of {self.detector['name']} is a state: its scale comes from a "
                f"bisection, and none was made for {rate:g} false alarms an hour"
            )
        # the largest rank that the file has, at most the exact one; 0 beyond the largest maximum
        rank = max((each for each in self.ranks if each <= exact), default=0)
        scale = self.largest[self.ranks.index(rank)] if rank else self._tail(p, rate)
        if scale <= 0.0:
            raise ValueError(self._degenerate(p, rate))
        early = max((rank for rank, value in self.before if value > scale), default=0)
        return OperatingPoint(rate, p, scale, n, rank, self.window_s, rank == 0, early / n)

    def has(self, false_alarms_per_hour: float) -> bool:
        """Whether its runs are enough for a rate, if only to find the statistic degenerate."""
        try:
            check_runs(false_alarms_per_hour, self.runs, self.window_s, tail=not self.bisected)
        except ValueError:
            return False
        p = run_probability(false_alarms_per_hour, self.window_s)
        return not self.bisected or compute_rank(p, self.runs) in self.ranks

    def interval(self, per_run: float, confidence: float = 0.95) -> tuple[float, float]:
        """Confidence interval of the factor that a clean run exceeds with a probability: order
        statistics whose ranks are quantiles of a binomial distribution; the next stored ranks
        outwards, 0 and infinity beyond them."""
        from scipy.stats import binom

        check_number("per_run", per_run, above=0.0, below=1.0)
        check_number("confidence", confidence, above=0.0, below=1.0)
        tail = 0.5 * (1.0 - confidence)
        fewest, most = binom.ppf([tail, 1.0 - tail], self.runs, per_run)
        stored = dict(zip(self.ranks, self.largest, strict=True))
        above = max((rank for rank in self.ranks if rank <= fewest), default=None)
        below = min((rank for rank in self.ranks if rank >= most + 1), default=None)
        return 0.0 if below is None else stored[below], math.inf if above is None else stored[above]

    def draw_factors(
        self, point: OperatingPoint, draws: int, rng: np.random.Generator
    ) -> FloatArray:
        r"""Scales that as many other clean runs would have given, as parts of that of a point.

        With its rank r from the top, the share of all clean runs above the scale is distributed as
        :math:`B(r, n + 1 - r)`; its quantile is interpolated between the stored ranks, and is that
        of the last one beyond them.  Returns (draws,).
        """
        rank, known = max(point.rank, 1), np.array(self.largest) > 0.0
        share = rng.beta(rank, self.runs + 1 - rank, draws)
        ranks = np.log(np.array(self.ranks)[known])
        scales = np.log(np.array(self.largest)[known])
        drawn = np.interp(np.log(share * (self.runs + 1)), ranks, scales)
        return np.asarray(np.exp(drawn - np.interp(math.log(rank), ranks, scales)))

    def _tail(self, p: float, rate: float) -> float:
        n, count = self.runs, tail_exceedances(self.runs)
        from scipy.stats import genpareto

        top = np.array(self.largest[: count + 1])
        start = float(top[count])
        if not top[0] > start:
            raise ValueError(self._degenerate(p, rate))
        shape, _, size = genpareto.fit(top[:count] - start, floc=0.0)
        beyond = float(genpareto.isf(p * n / count, shape, scale=size))
        return max(start + beyond, float(top[0]))

    def _degenerate(self, p: float, rate: float) -> str:
        positive = max(
            (r for r, x in zip(self.ranks, self.largest, strict=True) if x > 0.0), default=0
        )
        share = 100.0 * (1.0 - positive / self.runs)
        return (
            f"the statistic of {self.detector['name']} is degenerate: its largest value is 0 in "
            f"{share:.4g} % of the clean runs, so that no factor on its threshold makes {rate:g} "
            f"false alarms an hour ({p:.3g} a run); where it has a drift term, `thresholds` "
            "'rescaled' may mend it; else there is `thresholds` 'nominal'"
        )

    def diff_settings(self, world: Mapping[str, Any], detector: Mapping[str, Any]) -> list[str]:
        found = [("world", *each) for each in diff_settings(self.world, world)]
        found += [("detector", *each) for each in diff_settings(self.detector, detector)]
        return [f"{what} {name}: {a!r} there, {b!r} here" for what, name, a, b in found]

    def save(self, path: Path) -> Calibration:
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        del fields["path"]
        content = {"format": FORMAT, **fields}
        text = _write_json({**content, "checksum": _compute_checksum(content)})
        write_file(path, (text + "\n").encode())
        return dataclasses.replace(self, path=path)

    def check_matches(
        self, world: Mapping[str, Any], detector: Mapping[str, Any], label: str, rescaled: bool
    ) -> None:
        """Raise a ValueError that names all differences where it is that of another detector or
        world, whatever its file is called; `label`: name of the world, for the message."""
        unlike = self.diff_settings(world, detector)
        if (self.rescale is not None) != rescaled:
            unlike.append(f"rescaled: {self.rescale is not None} there, {rescaled} here")
        if unlike:
            raise ValueError(
                f"{self.path} is a calibration for something else than {detector['name']} in "
                f"{label}: {'; '.join(unlike)}"
            )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Calibration:
        return _load(os.fspath(path), os.stat(path).st_mtime_ns)


@lru_cache(maxsize=256)
def _load(path: str, modified: int) -> Calibration:
    try:
        found = read_json(path)
        checksum = found.pop("checksum", None)  # not in files of before it
        damaged = checksum not in (None, _compute_checksum(found))
        version = found.pop("format")
        if version != FORMAT:
            raise ValueError(f"its format is {version!r}, this version reads {FORMAT}")
        for name in ("ranks", "largest", "rescale"):
            found[name] = None if found[name] is None else tuple(found[name])
        for name in ("before", "witnesses"):
            found[name] = tuple(map(tuple, found[name]))
        made = Calibration(**found, path=Path(path))
        _check_content(made)
        require(not damaged, "its checksum is not that of its content")
        return made
    except KeyError as error:
        raise ValueError(f"{path} is no calibration: it has no {error}") from error
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path} is no calibration: {error}") from error


def _write_json(content: Mapping[str, Any]) -> str:
    return json.dumps(content, separators=(",", ":"), allow_nan=False)


def _compute_checksum(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(_write_json(content).encode()).hexdigest()[:16]


def _check_content(made: Calibration) -> None:
    """Raise a ValueError unless types, ranges and order are those of clean runs, and the runs that
    are stored one by one fit the order statistics."""
    for field_name, given in (("world", made.world), ("detector", made.detector)):
        require(
            isinstance(given, Mapping), f"`{field_name}` must be settings by name, got {given!r}"
        )
    texts = (("detector.name", made.detector.get("name")), ("seed_name", made.seed_name))
    for field_name, text in texts:
        require(isinstance(text, str), f"`{field_name}` must be a text, got {text!r}")
    require(type(made.bisected) is bool, f"`bisected` must be a bool, got {made.bisected!r}")
    check_number("window_s", made.window_s, above=0.0)
    check_number("runs", made.runs, least=1, whole=True)
    check_number("entropy", made.entropy, least=0, whole=True)
    if made.rescale is not None:
        require(len(made.rescale) == 4, f"`rescale` must be four factors, got {made.rescale}")
        for factor in made.rescale:
            check_number("rescale", factor, above=0.0)
    early = _check_order("before", made.before, made.runs)
    judged = _check_order("largest", zip(made.ranks, made.largest, strict=True), made.runs)
    whole = made.bisected or (judged[0, 0], judged[-1, 0]) == (1, made.runs)
    require(whole, "its order statistics must reach from rank 1 to that of all runs")
    require(made.witnesses, "`witnesses` must be runs, got none")
    for k, (run, *ratios) in enumerate(made.witnesses):
        require(type(run) is int and run == k < made.runs, f"`witnesses` must be runs, got {run!r}")
        for ratio in ratios:
            check_number("witnesses", ratio)
    stored = np.array([ratios for _, *ratios in made.witnesses])
    for column, order in ((0, early), (1, judged)):
        above = (stored[:, column] > order[:, 1, None] * (1.0 + 1e-9)).sum(axis=1)
        fit = (above < order[:, 0]).all()
        if order[-1, 0] == made.runs:
            fit &= stored[:, column].min() >= order[-1, 1] * (1.0 - 1e-9)
        require(fit or (column == 1 and made.bisected), "its runs do not fit its order statistics")


def _check_order(name: str, pairs: Iterable[tuple[Any, Any]], runs: int) -> FloatArray:
    """(r, 2) ranks, which rise up to `runs`, and values, which fall."""
    listed = list(pairs)
    for rank, value in listed:
        sound = type(rank) is int and type(value) in (int, float)
        require(sound, f"`{name}` must be numbers at whole ranks, got {value!r} at {rank!r}")
    found = np.array(listed, dtype=np.float64).reshape(-1, 2)
    valid = np.isfinite(found).all() and (found >= [1.0, 0.0]).all() and (found[:, 0] <= runs).all()
    require(valid, f"its order statistics are not in order (`{name}`)")
    steps = np.diff(found, axis=0)
    ordered = len(found) and (steps[:, 0] > 0.0).all() and (steps[:, 1] <= 0.0).all()
    require(ordered, f"its order statistics are not in order (`{name}`)")
    return found


def user_folder() -> Path:
    cache = Path(platformdirs.user_cache_dir("spoofgym")) / "calibrations"
    return Path(os.environ.get(FOLDER_VARIABLE) or cache)


def folders() -> tuple[Path, ...]:
    return SHIPPED_FOLDER, user_folder()


def file_name(world: str, detector: Mapping[str, Any], rescaled: bool) -> Path:
    """Path of a calibration within a folder.  `world`: digest of its conditions."""
    word = "-rescaled" if rescaled else ""
    return Path(world) / f"{_kind(detector)}-{compute_digest(detector)}{word}.json"


def _kind(detector: Mapping[str, Any]) -> str:
    return str(detector["name"]).rpartition(":")[2]


def load_stored(
    conditions: Conditions, detector: Mapping[str, Any], rescaled: bool, folder: Path | None = None
) -> Iterator[Calibration]:
    """Calibrations of a detector in a world: the shipped one, then one's own; or of a folder."""
    name = file_name(conditions.digest, detector, rescaled)
    for place in folders() if folder is None else (folder,):
        if (place / name).is_file():
            found = Calibration.load(place / name)
            found.check_matches(conditions.settings, detector, conditions.label, rescaled)
            require(
                found.window_s == conditions.window_s,
                f"{found.path} must have a window of {conditions.window_s} s, got {found.window_s}",
            )
            yield found


def nearest(
    conditions: Conditions, detector: Mapping[str, Any], rescaled: bool
) -> tuple[Path, list[str]] | None:
    """The stored calibration with the fewest differences, and these; None if none is stored."""
    paths = [p for each in folders() for p in sorted(each.glob(f"*/{_kind(detector)}-*.json"))]
    found = [
        (path, Calibration.load(path).diff_settings(conditions.settings, detector))
        for path in paths
        if path.stem.endswith("-rescaled") == rescaled
    ]
    return min(found, key=lambda each: len(each[1]), default=None)


def describe_as_json(thing: Any) -> Any:
    """Settings as JSON, numbers in one form, so that 5 and 5.0 have one digest."""
    return json.loads(json.dumps(_plain(describe(thing)), allow_nan=False))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < 2.0**53:
        return int(value)
    return value
