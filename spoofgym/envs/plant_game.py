"""The game over any plant: the rules are those of `game`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from .._registry import check_choice
from ..detectors import Detector
from ._kernels import ALARM, DISPLACEMENT, FIRST, GAIN, RETRACTION, TRUNCATED
from .actions import Actor, FullCommand
from .books import Books
from .ends import AtAlarm, Ends, Standing
from .observations import KNOWLEDGE
from .plant import Plant
from .plant_terms import PlantSnapshot, check_aims, check_ends, setup_of
from .played import Stepwise, Turn, check_end_at_alarm, check_heading
from .presets import WatchSpec, make_watch
from .rewards import Outcome, default_rewards, named_terms, reward_of
from .tally import Heads, Tally
from .terms import ActionSpec, EndSpec, RewardSpec, make_terms
from .watched import WatchedDetector
from .watching import WatchBooks

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
BEGIN_NAMES = ("time_s", "warmup_alarm")
"""Keys of the information at the begin of an episode, without what watches."""


class PlantGame(Stepwise):
    """Episodes of the B receivers of a plant; scored as in `Game`.

    - `plant`: the receivers, not begun yet;
    - `action`: terms of the action, as `make_terms` takes them; every element of the plant by
      default.  What they add up to is cut to what the plant takes;
    - `reward`: terms of the reward, as `make_terms` takes them;
    - `end`: terms of the end, as `make_terms` takes them; by `end_at_alarm` if there are none
      given;
    - `watch`: detectors that judge every epoch beside the one in the loop, as `make_watch` takes
      them;
    - `alarm_penalty_m`: price of an alarm, where `reward` does not say it;
    - `end_at_alarm`: whether an alarm ends the episode, where `end` does not say it.  If not, it
      goes on without further reward;
    - `target_heading_deg`: direction in which displacement counts, clockwise from north;
    - `books`: what counts of the running episodes;
    - `observation_names`: name of every element of an observation;
    - `bounds`: least and largest observation, (o,) float32 each;
    - `warmup_alarm` (B,) bool, false alarms before the attack;
    - `settings`: arguments as terms and detectors, for `altered`.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        knowledge: str = "tracking",
        action: ActionSpec | None = None,
        reward: RewardSpec | None = None,
        end: EndSpec | None = None,
        watch: WatchSpec = (),
        alarm_penalty_m: float = 10.0,
        end_at_alarm: bool = True,
        target_heading_deg: float = 90.0,
    ) -> None:
        check_choice("knowledge", knowledge, KNOWLEDGE)
        check_end_at_alarm(end_at_alarm)
        check_heading(target_heading_deg)
        self.settings: dict[str, Any] = {
            "knowledge": knowledge,
            "action": None if action is None else make_terms("action", action),
            "reward": reward,
            "end": None if end is None else make_terms("end", end),
            "watch": make_watch(watch),
            "alarm_penalty_m": alarm_penalty_m,
            "end_at_alarm": end_at_alarm,
            "target_heading_deg": target_heading_deg,
        }
        self.detector = plant.unbound
        if self.settings["watch"]:
            plant = plant.altered(WatchedDetector(self.detector, self.settings["watch"]))
        self.plant, self.knowledge = plant, knowledge
        self._watch = self._watch_books()
        self._compose(target_heading_deg)
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
        self._heads = Heads(plant.receivers)
        self._origin = np.zeros(plant.receivers)
        self.warmup_alarm = np.zeros(plant.receivers, dtype=np.bool_)

    def _watch_books(self) -> WatchBooks | None:
        """What is told of the detectors that watch, if there are any."""
        detector = self.plant.detector
        if not isinstance(detector, WatchedDetector):
            return None
        return WatchBooks(detector.watch.names, self.plant.receivers)

    def _compose(self, target_heading_deg: float) -> None:
        """Take the terms of action and end."""
        plant, action, end = self.plant, self.settings["action"], self.settings["end"]
        if end is None:
            end = (AtAlarm(),) if self.settings["end_at_alarm"] else ()
        check_ends(end, plant)
        self._ends = Ends(end)
        self.end_at_alarm = self._ends.at_alarm
        self._setup = setup_of(plant, target_heading_deg)
        terms = (FullCommand(),) if action is None else action
        check_aims(terms, plant)
        self._actor = Actor(terms, cast("Any", self._setup))
        self._actor.aim(np.full(plant.receivers, np.radians(target_heading_deg)))

    def altered(self, detector: Detector | None = None, **changes: Any) -> PlantGame:
        """A new game, not begun yet, with some settings changed."""
        plant = self.plant.altered(self.detector if detector is None else detector)
        return PlantGame(plant, **{**self.settings, **changes})

    @property
    def receivers(self) -> int:
        """B."""
        return self.plant.receivers

    @property
    def action_names(self) -> tuple[str, ...]:
        """Name of every element of an action."""
        return self._actor.names

    @property
    def episode_steps(self) -> int:
        """Epochs of the attack window."""
        return self.plant.steps

    @property
    def step_count(self) -> NDArray[np.int64]:
        """(B,) commands given in the running episodes."""
        return self.books.step_count

    def close(self) -> None:
        """Nothing runs beside; environments call this of every game."""

    @property
    def begin_names(self) -> tuple[str, ...]:
        """Keys of `begin_info`."""
        return BEGIN_NAMES if self._watch is None else (*BEGIN_NAMES, *self._watch.begin_names)

    @property
    def info_names(self) -> tuple[str, ...]:
        """Keys of the information of a step."""
        rewards = (key for key, _ in self._reward_parts)
        watched = () if self._watch is None else self._watch.step_names
        return (*STEP_NAMES, *rewards, *self._ends.info_names, *watched)

    @property
    def _watched(self) -> Memory:
        """What the detectors beside the one in the loop have seen."""
        return cast("WatchedDetector", self.plant.detector).watch.memory

    def observe(self) -> NDArray[np.float32]:
        """Observe all receivers: (B, o) a new array within the bounds."""
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
        """Begin new episodes, and run their warm-up up to the onset."""
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
        if self._watch is not None:
            self._watch.reset(where, self._watched)

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

        `action` (B, a) float64, C-contiguous, in [-1, 1].
        """
        if self._watch is not None:
            self._watch.forget(self._watched)
        alarms = self.plant.advance(self._command(action))
        tally = self._count(self._projection() - self._origin, alarms)
        values, marks = tally.values, tally.marks
        info: dict[str, NDArray[Any]] = {
            "time_s": self.plant.time_s().copy(),
            "alarm": marks[ALARM],
            "detected": self.books.detected.copy(),
            "warmup_alarm": self.warmup_alarm.copy(),
            "displacement_m": values[DISPLACEMENT],
            "undetected_displacement_m": self.books.credited.copy(),
            "cost": marks[FIRST].astype(np.float64),
            **tally.more,
        }
        outcome = Outcome(
            values[GAIN],
            values[RETRACTION],
            marks[FIRST],
            marks[ALARM],
            action,
            self.books.credited,
            tally.terminated | tally.truncated,
        )
        reward = reward_of(self._reward_parts, outcome, info)
        if self._watch is not None:
            info.update(self._watch.step_info(self._watched))
        return Turn(reward, tally.terminated, tally.truncated, info)

    def _command(self, action: FloatArray) -> FloatArray:
        """Command of an action, cut to what the plant takes; (B, a), C-contiguous."""
        if self.settings["action"] is None:
            return action
        return np.clip(self._actor.command(action), -1.0, 1.0)

    def _count(self, displacement: FloatArray, alarms: NDArray[np.bool_]) -> Tally:
        """Keep the books of an epoch, and run the time to alert of those who are to."""
        books = self.books
        tally = Tally(self._heads)
        tally.values[DISPLACEMENT] = displacement
        early = books.nobody
        if self._ends:
            snapshot = PlantSnapshot(self._setup, self.plant, self.step_count + 1)
            standing = Standing(cast("Any", snapshot), displacement)
            early, tally.marks[TRUNCATED] = self._ends.judge(standing, tally.more)
        books.count(tally, alarms[:, None], early, self.end_at_alarm, self._hold)
        if self._ends:
            # one that was ended early must not be held to again, before it begins anew
            books.ended |= tally.terminated | tally.truncated
        return tally

    def begin_info(self) -> dict[str, NDArray[Any]]:
        """Information at the start of an episode."""
        watched = {} if self._watch is None else self._watch.begin_info()
        return {
            "time_s": self.plant.time_s().copy(),
            "warmup_alarm": self.warmup_alarm.copy(),
            **watched,
        }


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
