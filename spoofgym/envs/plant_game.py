"""The game over any plant: the rules are those of `game`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .._registry import check_choice
from .books import Books
from .observations import KNOWLEDGE
from .plant import Plant
from .played import Stepwise, Turn, check_end_at_alarm, check_heading
from .rewards import Outcome, default_rewards, named_terms, reward_of
from .terms import RewardSpec, make_terms

FloatArray = NDArray[np.float64]
STEP_NAMES = (
    "time_s",
    "alarm",
    "detected",
    "warmup_alarm",
    "displacement_m",
    "undetected_displacement_m",
    "cost",
)
"""Keys of the information of a step, without the parts of the reward."""


class PlantGame(Stepwise):
    """Episodes of the B receivers of a plant; scored as in `Game`.

    Parameters
    ----------
    plant : Plant
        The receivers, not begun yet.
    knowledge : {"tracking", "blind", "oracle"}
        What the spoofer observes.
    reward : sequence of RewardTerm, str or mapping, optional
        Terms of the reward, as `make_terms` takes them.
    alarm_penalty_m : float
        Price of an alarm, where `reward` does not say it.
    end_at_alarm : bool
        Whether an alarm ends the episode.  If not, it goes on without further reward.
    target_heading_deg : float
        Direction in which displacement counts, clockwise from north.

    Attributes
    ----------
    plant : Plant
        The receivers.
    books : Books
        What counts of the running episodes.
    knowledge : str
        As it was given.
    observation_names : tuple of str
        Name of every element of an observation.
    bounds : tuple of ndarray
        Least and largest observation, (o,) float32 each.
    warmup_alarm : ndarray
        (B,) bool, false alarms before the attack.
    begin_names : tuple of str
        Keys of `begin_info`.
    """

    begin_names: ClassVar[tuple[str, ...]] = ("time_s", "warmup_alarm")

    def __init__(
        self,
        plant: Plant,
        *,
        knowledge: str = "tracking",
        reward: RewardSpec | None = None,
        alarm_penalty_m: float = 10.0,
        end_at_alarm: bool = True,
        target_heading_deg: float = 90.0,
    ) -> None:
        check_choice("knowledge", knowledge, KNOWLEDGE)
        check_end_at_alarm(end_at_alarm)
        check_heading(target_heading_deg)
        self.plant, self.knowledge, self.end_at_alarm = plant, knowledge, end_at_alarm
        names, low, high = plant.observation(knowledge)
        self.observation_names = names
        self.bounds = low.astype(np.float32), high.astype(np.float32)
        _check_observation(plant.kind, names, *self.bounds)
        terms = default_rewards(alarm_penalty_m) if reward is None else make_terms("reward", reward)
        self._reward_parts = named_terms(terms)
        self.target_heading_deg = target_heading_deg
        heading = np.radians(target_heading_deg)
        self._north, self._east = float(np.cos(heading)), float(np.sin(heading))
        self._rows = np.arange(plant.receivers)
        self.books = Books(plant.receivers, plant.steps, plant.hold)
        self._origin = np.zeros(plant.receivers)
        self.warmup_alarm = np.zeros(plant.receivers, dtype=np.bool_)

    @property
    def receivers(self) -> int:
        """B."""
        return self.plant.receivers

    @property
    def action_names(self) -> tuple[str, ...]:
        """Name of every element of an action."""
        return self.plant.action_names

    @property
    def step_count(self) -> NDArray[np.int64]:
        """(B,) commands given in the running episodes."""
        return self.books.step_count

    def close(self) -> None:
        """Nothing runs beside; environments call this of every game."""

    @property
    def info_names(self) -> tuple[str, ...]:
        """Keys of the information of a step."""
        return (*STEP_NAMES, *(key for key, _ in self._reward_parts))

    def observe(self) -> NDArray[np.float32]:
        """Observe all receivers.

        Returns
        -------
        ndarray
            (B, o) a new array within the bounds.
        """
        out = np.empty((self.receivers, len(self.observation_names)), dtype=np.float32)
        self.plant.observe(self.knowledge, out)
        low, high = self.bounds
        np.maximum(out, low, out=out)
        np.minimum(out, high, out=out)
        return out

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        rows: NDArray[np.intp] | None = None,
        given: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin new episodes, and run their warm-up up to the onset.

        Parameters
        ----------
        rngs : sequence of Generator
            One per row.
        rows : ndarray, optional
            Which receivers; all by default.
        given : mapping, optional
            There is nothing that could be told of them.

        Raises
        ------
        ValueError
            When something is told nevertheless.
        """
        if given:
            raise ValueError(
                f"a reset of {self.plant.kind!r} can't be told {', '.join(map(repr, given))}"
            )
        where = self._rows if rows is None else rows
        if len(where) == self.receivers:
            self.warmup_alarm[where] = self.plant.begin(rngs)
        else:
            fresh = self.plant.spawn(len(where))
            self.warmup_alarm[where] = fresh.begin(rngs)
            self.plant.copy_rows(where, fresh, np.arange(len(where)))
        self.books.reset(where)
        self._origin[where] = self._projection()[where]

    def _projection(self) -> FloatArray:
        error = self.plant.error_ne()
        result: FloatArray = error[:, 0] * self._north + error[:, 1] * self._east
        return result

    def _hold(self, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Let some receivers run the time to alert; (hold, b) alarms by epoch."""
        everyone = len(rows) == self.receivers
        part = self.plant if everyone else self.plant.spawn(len(rows))
        here = np.arange(len(rows))
        if not everyone:
            part.copy_rows(here, self.plant, rows)
        alarms = np.array([part.advance(None) for _ in range(self.plant.hold)])
        if not everyone:
            self.plant.copy_rows(rows, part, here)
        return alarms

    def step(self, action: FloatArray) -> Turn:
        """One command of all receivers, and one epoch.

        Parameters
        ----------
        action : ndarray
            (B, a) float64, C-contiguous, in [-1, 1].

        Returns
        -------
        Turn
            Rewards, ends and information.
        """
        alarms = self.plant.advance(action)
        displacement = self._projection() - self._origin
        score = self.books.score(displacement, alarms[:, None], self._hold)
        info: dict[str, NDArray[Any]] = {
            "time_s": self.plant.time_s().copy(),
            "alarm": score.alarm,
            "detected": self.books.detected.copy(),
            "warmup_alarm": self.warmup_alarm.copy(),
            "displacement_m": displacement,
            "undetected_displacement_m": self.books.credited.copy(),
            "cost": score.first.astype(np.float64),
        }
        over = self.books.over(score.finished, self.end_at_alarm)
        outcome = Outcome(
            score.gain,
            score.retraction,
            score.first,
            score.alarm,
            action,
            self.books.credited,
            over,
        )
        reward = reward_of(self._reward_parts, outcome, info)
        return Turn(reward, over, np.zeros_like(over), info)

    def begin_info(self) -> dict[str, NDArray[Any]]:
        """Information at the begin of an episode.

        Returns
        -------
        dict
            Arrays with a leading axis of receivers.
        """
        return {"time_s": self.plant.time_s().copy(), "warmup_alarm": self.warmup_alarm.copy()}


def _check_observation(
    kind: str, names: tuple[str, ...], low: NDArray[np.float32], high: NDArray[np.float32]
) -> None:
    """Raise unless every element has a name of its own and finite bounds in order."""
    where = f"the observation of {kind!r}"
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise ValueError(f"{where} has elements of the same name: {', '.join(twice)}")
    if not low.shape == high.shape == (len(names),):
        raise ValueError(
            f"{where} has {len(names)} names, but bounds of shapes {low.shape} and {high.shape}"
        )
    for name, least, most in zip(names, low, high, strict=True):
        if not (np.isfinite(least) and np.isfinite(most) and least < most):
            raise ValueError(f"{where} needs finite bounds of {name!r}, got {least} to {most}")
