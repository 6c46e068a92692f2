"""Tries a detector that is a Gymnasium wrapper, and names what is wrong with it."""

from __future__ import annotations

from typing import Any

import numpy as np

from .streams import Reading, Recorder, Stream, read_info, replaced_bottom

RUNS = 3


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
    streams = Recorder(env, entropy).record_clean(0, range(RUNS))
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
        self.bottom.feed.streams = [stream]
        found: list[tuple[bool, float]] = []
        observation, info = self.env.reset()
        for number in range(len(stream.epochs)):
            over = False
            if number:
                observation, _, over, _, info = self.env.step(self._idle)
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

    @property
    def _idle(self) -> Any:
        return np.zeros(self.bottom.action_space.shape, dtype=np.float32)

    def _read(self, info: dict[str, Any], number: int) -> Reading:
        try:
            reading = read_info(info, None)
        except ValueError as error:
            self.add(str(error))
            return Reading(None, None)
        if number and reading.alarm is None and reading.ratio is None:
            self.add("info['alarm'] is missing, and so is info['statistic'] with its threshold")
        return reading
