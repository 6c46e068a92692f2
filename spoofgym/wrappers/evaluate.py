"""Check and score of a detector that is a Gymnasium wrapper, and knows nothing of this library."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bench.runs.players import specify_policy
from ..bench.runs.record import undetected_displacement
from ..bench.scores.statistics import (
    Estimate,
    bootstrap_mean,
    clopper_pearson,
    draw_resamples,
    interval,
    wilson,
)
from ..core.progress import ProgressBar, ProgressCallback, show_on_terminal
from ..core.registry import whole_number
from ..detectors.calibrated import STANDARD_RATE
from ..detectors.calibration_file import (
    check_rate,
    check_runs,
    compute_rank,
    hourly_rate,
    run_probability,
)
from ..duel.opponents import label_opponent
from ..spoofers import Spoofer
from ..spoofers.build import SpooferSpec
from .streams import (
    BLOCK,
    FloatArray,
    Reading,
    Recorder,
    Stream,
    play_streams,
    read_info,
    replaced_bottom,
    step_streams,
)

RUNS = 200
RATES_MPS = (0.1, 0.3, 1.0)
CALIBRATION, EVALUATION = 0, 1  # splits of the runs


class AttackOutcome(NamedTuple):
    """What a detector made of one attack, with 95 % intervals.

    Attributes
    ----------
    spoofer : str
        Its name and settings.
    undetected_displacement_m : Estimate
        Mean over the runs [m].
    never_m : float
        The same without a detector [m].
    detected : Estimate
        Part of the runs.
    delay_s : Estimate
        Mean time from the onset to the alarm, where it counts [s].
    """

    spoofer: str
    undetected_displacement_m: Estimate
    never_m: float
    detected: Estimate
    delay_s: Estimate


class WrappedScore(NamedTuple):
    """Score of a detector in a wrapper, by `evaluate_wrapped`.

    Attributes
    ----------
    runs : int
        Clean runs, and runs of each attack.
    scale : float or None
        Factor on its threshold that calibrates it; None where it gives alarms alone, and plays
        uncalibrated.
    false_alarms_per_hour : Estimate
        On clean runs that decide nothing.
    requested_per_hour : float or None
        Rate that it is calibrated to; None where it plays uncalibrated.
    attacks : tuple of AttackOutcome
        One each.
    """

    runs: int
    scale: float | None
    false_alarms_per_hour: Estimate
    requested_per_hour: float | None
    attacks: tuple[AttackOutcome, ...]

    @property
    def worst(self) -> AttackOutcome:
        """Attack that gets farthest without an alarm."""
        return max(self.attacks, key=lambda each: each.undetected_displacement_m.value)

    def __str__(self) -> str:
        mark = "uncalibrated" if self.scale is None else f"threshold x {self.scale:.4g}"
        rate = interval(self.false_alarms_per_hour.as_json())
        lines = [f"{mark}: {rate} false alarms an hour, {self.runs} runs"]
        if self.requested_per_hour and self.false_alarms_per_hour.low > self.requested_per_hour:
            lines.append(f"false alarms above the requested {self.requested_per_hour:g} an hour")
        for each in self.attacks:
            moved, found, delay = (
                interval(part.as_json())
                for part in (each.undetected_displacement_m, each.detected, each.delay_s)
            )
            lines.append(
                f"{each.spoofer}: {moved} m undetected (never: {each.never_m:.1f} m), "
                f"detected {found}, delay {delay} s"
            )
        return "\n".join(lines)


def evaluate_wrapped(
    env: Any,
    runs: int = RUNS,
    *,
    spoofers: Sequence[Any] | None = None,
    false_alarms_per_hour: float = STANDARD_RATE,
    entropy: int = 0,
    threads: int | None = None,
    progress: ProgressBar | None = None,
) -> WrappedScore:
    """Score the detector that the wrappers of an environment make.

    The runs are recorded without it.  Their epochs are then played through the wrappers, without
    the environment: an epoch a step, and nothing else in the information.  An episode begins at a
    drawn moment of the monitored start, the attack some time later, as with ``onset="within"`` in
    the duel, so that it is of no use to count steps.  A wrapper that gives ``statistic`` and
    ``threshold`` is calibrated on as many separate clean runs: it alarms where the ratio of the two
    exceeds a factor.  One that gives ``alarm`` alone keeps its own rate.

    Wrappers play in this process, which holds the truth: score only those that you trust.

    An alarm counts where no alarm was before the onset, and none at all in the same run without the
    attack; else the run counts as one without a detector.

    Parameters
    ----------
    env : Env or VectorEnv
        Wrappers around an environment whose information has the epochs, and in whose loop is
        ``never``.
    runs : int
        Clean runs, and runs of each attack.
    spoofers : sequence, optional
        Each as `make_spoofer` takes it, or a model as `evaluate` does, trained in an environment
        with the same settings but for the detector; by default ramps of 0.1, 0.3 and 1 m/s.
    false_alarms_per_hour : float
        Rate to calibrate to.
    entropy : int
        Seed of all runs.
    threads : int, optional
        Threads of the engine.
    progress : callable, optional
        Opens a bar, such as `spoofgym.core.progress.show_progress`; by default that one where
        stderr is a terminal.

    Returns
    -------
    WrappedScore
        Its text is a line an attack.

    Raises
    ------
    ValueError
        When the epochs are missing, a detector that alarms is in the loop, the wrapper sets
        neither ``statistic`` nor ``alarm``, or something else than they are, or the runs are too
        few for the rate.
    """
    runs, rate = whole_number("`runs`", runs, 2), check_rate(false_alarms_per_hour)
    if spoofers is None:
        spoofers = [{"name": "ramp", "rate_mps": each} for each in RATES_MPS]
    spoofers = [_as_spoofer(each) for each in spoofers]
    recorder = Recorder(env, whole_number("`entropy`", entropy), threads)
    for each in spoofers:
        recorder.attach(each)
    work = runs * (2.0 + len(spoofers))
    with replaced_bottom(env) as bottom, (progress or show_on_terminal)(work) as bar:
        judge = _Judge(env, bottom, bar)
        blocks = [range(first, min(first + BLOCK, runs)) for first in range(0, runs, BLOCK)]
        scale = _calibrate(judge, recorder, blocks, rate)
        clean, seconds, played = [], [], [[] for _ in spoofers]  # type: ignore[var-annotated]
        for block in blocks:
            streams = recorder.record_clean(EVALUATION, block)
            clean.append(judge.find_alarms(streams, scale))
            seconds += [len(each.epochs) * recorder.interval_s for each in streams]
            for mine, spoofer in zip(played, spoofers, strict=True):
                streams, moved = recorder.record_attack(spoofer, EVALUATION, block)
                onset = np.array([each.before for each in streams])
                mine.append((judge.find_alarms(streams, scale) - onset, moved))
    alarms = np.concatenate(clean)
    share = clopper_pearson(int((alarms > 0).sum()), runs)
    hourly = Estimate(*(hourly_rate(p, float(np.mean(seconds))) for p in share))
    outcomes = []
    for spoofer, parts in zip(spoofers, played, strict=True):
        since, moved = np.concatenate([p for p, _ in parts]), np.hstack([m for _, m in parts])
        counted = np.where((since > 0) & (alarms == 0), since, 0)
        outcomes.append(_score_attack(label_opponent(spoofer), counted, moved, recorder))
    requested = None if scale is None else rate
    return WrappedScore(runs, scale, hourly, requested, tuple(outcomes))


def _as_spoofer(given: Any) -> SpooferSpec:
    """A model as a spoofer; every other one as it is."""
    if isinstance(given, str | Mapping | Spoofer):
        return given
    made: Spoofer = specify_policy(given).thing
    return made


def _score_attack(
    name: str, first_alarm: NDArray[np.int64], moved: FloatArray, recorder: Recorder
) -> AttackOutcome:
    """`first_alarm` (R,) that counts, in epochs after the onset, 0 for none; `moved` (K, R) [m]."""
    runs, hold = len(first_alarm), recorder.hold
    reached = undetected_displacement(moved, first_alarm, hold)
    delays = first_alarm[first_alarm > 0] * recorder.interval_s
    return AttackOutcome(
        name,
        bootstrap_mean(reached, draw_resamples(np.arange(runs))),
        float(undetected_displacement(moved, np.zeros_like(first_alarm), hold).mean()),
        wilson(len(delays), runs),
        bootstrap_mean(delays, draw_resamples(np.arange(len(delays)))),
    )


def _calibrate(
    judge: _Judge, recorder: Recorder, blocks: Sequence[range], rate: float
) -> float | None:
    """Factor on the threshold for a rate of false alarms; None where there is no statistic."""
    first = recorder.record_clean(CALIBRATION, blocks[0])
    if not judge.gives_statistic(first[0]):
        return None
    largest, seconds = [], []
    for block in blocks:
        streams = first if block == blocks[0] else recorder.record_clean(CALIBRATION, block)
        largest.append(judge.find_largest(streams))
        seconds += [len(each.epochs) * recorder.interval_s for each in streams]
    maxima, mean_s = np.concatenate(largest), float(np.mean(seconds))
    check_runs(rate, len(maxima), mean_s, tail=False)
    rank = compute_rank(run_probability(rate, mean_s), len(maxima))
    scale = float(np.sort(maxima)[::-1][rank - 1])
    if scale <= 0.0:
        raise ValueError(
            "the statistic is 0 in nearly every clean run, so that no factor on its threshold "
            f"makes {rate:g} false alarms an hour"
        )
    return scale


class _Judge:
    """Plays streams through the wrappers of an environment."""

    def __init__(self, env: Any, bottom: Any, bar: ProgressCallback) -> None:
        self.env, self.bottom, self.bar = env, bottom, bar
        self.size = getattr(bottom, "num_envs", 1)

    def gives_statistic(self, stream: Stream) -> bool:
        """Whether the wrapper gives a statistic; a ValueError where it gives no alarm, either."""
        played = play_streams(self.env, self.bottom, [stream] * self.size)
        *_, found = islice(played, 2)  # what is set at a reset may be less
        if found.ratio is None and found.alarm is None:
            raise ValueError(
                "the wrapper sets neither info['alarm'] nor info['statistic'] and "
                "info['threshold']: it is no detector"
            )
        return found.ratio is not None

    def find_largest(self, streams: Sequence[Stream]) -> FloatArray:
        """(R,) largest ratio of statistic to threshold in each stream."""
        largest = np.zeros(len(streams))
        for rows, played in self._play(streams):
            for now in played:
                if now.ratio is not None:
                    np.maximum.at(largest, rows, now.ratio[: len(rows)])
        return largest

    def find_alarms(self, streams: Sequence[Stream], scale: float | None) -> NDArray[np.int64]:
        """(R,) epoch of the first alarm in each stream, from 1 on; 0 for none."""
        first = np.zeros(len(streams), dtype=np.int64)
        for rows, played in self._play(streams):
            for number, now in enumerate(played, start=1):
                alarm = now.alarm
                if scale is not None:
                    alarm = None if now.ratio is None else now.ratio > scale
                if alarm is not None:
                    first[rows[alarm[: len(rows)] & (first[rows] == 0)]] = number
                if (first[rows] > 0).all():
                    break
        ends = np.array([len(each.epochs) for each in streams])
        return np.where(first > ends, 0, first)

    def _play(
        self, streams: Sequence[Stream]
    ) -> Iterator[tuple[NDArray[np.intp], Iterator[Reading]]]:
        """Streams by their numbers, as many at once as there are receivers, and what is set at
        their epochs."""
        for first in range(0, len(streams), self.size):
            chosen = list(streams[first : first + self.size])
            rows = np.arange(first, first + len(chosen))
            chosen += chosen[-1:] * (self.size - len(chosen))
            yield rows, play_streams(self.env, self.bottom, chosen)
            self.bar.advance(len(rows), "runs through the wrappers")


CHECKED_RUNS = 3


def check_wrapper(env: Any, *, entropy: int = 0) -> None:
    """Check that the wrappers of a single environment make a detector that can be scored.

    They are played on some clean runs, and have to show that

    - ``alarm``, or ``statistic`` and ``threshold``, are in the information of every step, an alarm
      boolean, the others finite numbers, a threshold above 0;
    - nothing is left of an episode after a reset;
    - observations come through as they are, since a policy from a card knows no others;
    - an episode does not end without an alarm;
    - alarms do not come a number of steps after the reset, whatever is seen.

    Parameters
    ----------
    env : Env
        As `evaluate_wrapped` takes it, not a vector environment.
    entropy : int
        Seed of the runs.

    Raises
    ------
    ValueError
        With a line for each thing that is wrong.
    """
    if not hasattr(env, "env") or hasattr(env, "num_envs"):
        raise ValueError("`env` must be a single environment with a wrapper around it")
    streams = Recorder(env, entropy).record_clean(0, range(CHECKED_RUNS))
    with replaced_bottom(env) as bottom:
        trial = _Trial(env, bottom)
        first = [trial.play(stream) for stream in streams]
        again = trial.play(streams[0])
    if first[0] != again:
        trial.add("the same run gives other alarms or statistics after a reset")
    alarms = [[k for k, each in enumerate(run) if each[0]] for run in first]
    if all(alarms) and len({run[0] for run in alarms}) == 1:
        trial.add(
            f"the first alarm comes {alarms[0][0]} steps after the reset in every clean run: what "
            "counts steps scores no better than `never`, since attacks begin at a drawn moment"
        )
    if trial.problems:
        raise ValueError("this wrapper is no detector yet:\n  " + "\n  ".join(trial.problems))


class _Trial:
    """Plays streams, and gathers what is wrong, each once."""

    def __init__(self, env: Any, bottom: Any) -> None:
        self.env, self.bottom, self.problems = env, bottom, list[str]()

    def add(self, problem: str) -> None:
        if problem not in self.problems:
            self.problems.append(problem)

    def play(self, stream: Stream) -> list[tuple[bool, float]]:
        """Alarm and ratio of every epoch."""
        found: list[tuple[bool, float]] = []
        steps = step_streams(self.env, self.bottom, [stream])
        for number, (observation, over, info) in enumerate(steps):
            reading = self._read(info, number)
            found.append(
                (
                    reading.alarm is not None and bool(reading.alarm[0]),
                    0.0 if reading.ratio is None else float(reading.ratio[0]),
                )
            )
            if over and not (found[-1][0] or self.bottom.feed.over[0] or reading.alarm is None):
                self.add("an episode ends without an alarm")
            if not np.array_equal(observation, self.bottom.observed):
                self.add(
                    "it changes the observation: a policy from a card would observe something else "
                    "than it was trained with"
                )
        return found

    def _read(self, info: dict[str, Any], number: int) -> Reading:
        try:
            reading = read_info(info, None)
        except ValueError as error:
            self.add(str(error))
            return Reading(None, None)
        if number and reading.alarm is None and reading.ratio is None:
            self.add("info['alarm'] is missing, and so is info['statistic'] with its threshold")
        return reading
