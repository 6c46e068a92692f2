"""What there is to see of a game, beside its clean twin; nothing is drawn here."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ...detectors import DETECTORS, Detector
from ..engine import Batch, run_serially
from ..game import Game
from ..plant import Plant
from ..plant_game import PlantGame
from ..sight import FloatArray, Sight, Sky, Stage

FIRST = np.zeros(1, dtype=np.intp)
"""The receiver that is shown."""
AXES = ("north", "east", "down")


class Recorder(Protocol):
    """Looks at the first receiver of a game, and at its clean twin.

    The twin is a copy taken at the onset that goes on without an attack, with the same noise and
    the same detector in the loop.
    """

    @property
    def interval_s(self) -> float:
        """Time between two looks [s]."""

    def begin(self) -> Stage:
        """Take the twin; called at the onset of every episode."""

    def look(self) -> tuple[Sight, Sight]:
        """Let the twin follow, and look at the attacked receiver and at the twin."""


@runtime_checkable
class Seen(Protocol):
    """A plant whose first receiver can be looked at."""

    def route_ne(self) -> FloatArray:
        """(K, 2) true way from the onset to the end of the time to alert [m]."""

    def sight(self) -> Sight:
        """The first receiver as it stands."""


def detector_name(detector: Detector) -> str:
    """Registered name of a detector, else that of its class."""
    found = (name for name, kind in DETECTORS.items() if kind is type(detector))
    return next(found, type(detector).__name__)


class GameRecorder:
    """Recorder of a tightly coupled receiver.

    Parameters
    ----------
    game : Game
        Its first receiver is looked at.
    """

    def __init__(self, game: Game) -> None:
        self._game = game
        self._twin: Batch | None = None
        self._onset = 0
        commands = game.setup.attack.action_names(game.setup.world)
        names = [name.rsplit("_", 1)[0] for name in commands]
        self._axes = names if set(names) <= set(AXES) else None

    @property
    def interval_s(self) -> float:
        """Time between two looks [s]."""
        setup = self._game.setup
        return setup.repeat * setup.scenario.epoch_interval_s

    def begin(self) -> Stage:
        """Take the twin."""
        setup, batch = self._game.setup, self._game.engine.batch
        if self._twin is None:
            self._twin = Batch(setup, 1, run_serially)
        self._twin.copy_rows(FIRST, batch, FIRST)
        self._onset = int(batch.onset[0])
        interval = setup.scenario.epoch_interval_s
        route = slice(self._onset, self._onset + setup.steps + setup.hold + 1)
        return Stage(
            title=f"{setup.scenario.name}: {setup.attack.label} against "
            f"{detector_name(setup.detector)}",
            route_ne=self._local(setup.world.position_e[route] - self._origin()),
            interval_s=interval,
            steps=setup.steps,
            attack_s=setup.steps * interval,
            hold_s=setup.hold * interval,
            onset_s=float(setup.world.epoch_time[self._onset]),
            commands_position=self._axes is not None,
            has_sky=True,
        )

    def _origin(self) -> FloatArray:
        """(3,) true position at the onset, ECEF [m]."""
        origin: FloatArray = self._game.setup.world.position_e[self._onset]
        return origin

    def _local(self, vector_e: FloatArray) -> FloatArray:
        """North and east parts, in the axes at the onset, of (..., 3) in ECEF."""
        local: FloatArray = (vector_e @ self._game.setup.world.C_en[self._onset])[..., :2]
        return local

    def look(self) -> tuple[Sight, Sight]:
        """Let the twin follow, and look at both."""
        batch, twin = self._game.engine.batch, self._twin
        if twin is None:
            raise RuntimeError("no episode has begun: call begin() before look()")
        while twin.epochs[0] < batch.epochs[0]:
            twin.advance()
            twin.update(twin.judge().weights)
        return self._sight(batch), self._sight(twin)

    def _sight(self, batch: Batch) -> Sight:
        epoch = int(batch.epochs[0])
        truth = self._game.setup.world.position_e[epoch]
        ratio = np.nan
        if batch.verdict is not None:
            ratio = float((batch.verdict.statistic[0] / batch.verdict.threshold[0]).max())
        return Sight(
            position_ne=self._local(truth - self._origin()),
            error_ne=self._local(batch.buffers.state.position_e[0] - truth),
            displacement_ne=self._displacement(batch),
            ratio=ratio,
            sky=self._sky(batch, epoch),
        )

    def _displacement(self, batch: Batch) -> FloatArray | None:
        if self._axes is None:
            return None
        moved = dict(zip(self._axes, batch.attack.memory["displacement"][0], strict=True))
        return np.array([moved.get("north", 0.0), moved.get("east", 0.0)])

    def _sky(self, batch: Batch, epoch: int) -> Sky:
        world, offsets = self._game.setup.world, batch.sensors.state
        spoofed: NDArray[np.bool_] = (offsets.range_offset[0] != 0.0) | (
            offsets.rate_offset[0] != 0.0
        )
        return Sky(
            names=world.satellite_ids,
            azimuth=world.azimuth[epoch],
            elevation=world.elevation[epoch],
            visible=world.visible[epoch],
            spoofed=spoofed,
            weight=batch.weights[0, : world.channels].copy(),
        )


class PlantRecorder:
    """Recorder of any plant that can be looked at.

    Parameters
    ----------
    game : PlantGame
        Its first receiver is looked at; its plant is `Seen`.
    """

    def __init__(self, game: PlantGame) -> None:
        self._game = game
        self._twin: Plant | None = None

    @property
    def interval_s(self) -> float:
        """Time between two looks [s]."""
        return self._game.plant.interval_s

    def begin(self) -> Stage:
        """Take the twin."""
        plant = self._game.plant
        if self._twin is None:
            self._twin = plant.spawn(1)
        self._twin.copy_rows(FIRST, plant, FIRST)
        seen = _seen(plant)
        now = seen.sight()
        return Stage(
            title=f"{plant.kind} receiver against {detector_name(self._game.detector)}",
            route_ne=seen.route_ne(),
            interval_s=plant.interval_s,
            steps=plant.steps,
            attack_s=plant.steps * plant.interval_s,
            hold_s=plant.hold * plant.interval_s,
            onset_s=float(plant.time_s()[0]),
            commands_position=now.displacement_ne is not None,
            has_sky=now.sky is not None,
        )

    def look(self) -> tuple[Sight, Sight]:
        """Let the twin follow, and look at both."""
        plant, twin = self._game.plant, self._twin
        if twin is None:
            raise RuntimeError("no episode has begun: call begin() before look()")
        half = 0.5 * plant.interval_s
        while twin.time_s()[0] < plant.time_s()[0] - half:
            twin.advance(None)
        return _seen(plant).sight(), _seen(twin).sight()


def _seen(plant: Plant) -> Seen:
    if not isinstance(plant, Seen):
        raise TypeError(f"{type(plant).__name__} has no `sight`")
    return plant
