"""Loosely coupled victim."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number
from ..core.registry import build_record
from ..core.settings import describe
from ..detectors import Detector, DetectorContext
from ..receiver.epoch import Epoch
from ..receiver.loose import LooselyCoupled, LooseReceivers
from ..truth._kernels import first_errors, measure_loose
from ..truth.gnss_errors import PositionErrors
from ..truth.noise import pad_count
from ..truth.run import SOURCES, InertialErrors, flown_world
from ..truth.scenario import at_rate
from .domain import Choice, Domain, FloatArray
from .setup import RateCommands, Run, Setup, Timeline
from .simulator import Rngs, Rows, Simulator, domain_keys, episode_seeds


class RateSimulator(Simulator):
    """B receivers under `RateCommands`; all that they remember lies in `memory`. ``epoch`` (B,),
    ``displacement`` and ``rate`` (B, a), in the order of `Setup.action_names`."""

    def _allocate(self) -> None:
        none = np.zeros((self.receivers, len(self.setup.action_names)))
        epoch = np.zeros(self.receivers, dtype=np.int64)
        self.memory.declare_all(epoch=epoch, displacement=none, rate=none)

    def _draw(self, rngs: Rngs) -> NDArray[np.uint64]:
        self.memory.reset()
        episodes = episode_seeds(rngs)
        for row, episode in enumerate(episodes):
            self._seed(row, episode)
        return domain_keys(episodes)

    @abstractmethod
    def _keys(self, episode: np.random.SeedSequence) -> NDArray[np.uint64]:
        """Keys of an episode's noise, as ``keys`` of the memory has them."""

    def _seed(self, row: int, episode: np.random.SeedSequence) -> None:
        """Draw the keys of a receiver's noise, and what else is drawn once per episode."""
        self.memory["keys"][row] = self._keys(episode)

    def _renew(self, rows: Rows, episodes: Sequence[np.random.SeedSequence]) -> None:
        self.memory["keys"][rows] = [self._keys(episode) for episode in episodes]

    def _start(self, choice: Choice) -> None:
        self.memory["epoch"][:] = self.memory["first"]
        self._observe()

    def _measure(self, command: FloatArray | None) -> None:
        self._move(command)
        self.memory["epoch"] = self.memory["epoch"] + 1
        self._observe()

    def _observe(self) -> None:
        """Measure the epoch, where nothing has to be measured on the way to it."""

    @property
    def position(self) -> FloatArray:
        return self.memory["position_e"]

    @property
    def epochs(self) -> NDArray[np.int64]:
        return self.memory["epoch"]

    def _move(self, command: FloatArray | None) -> None:
        memory, length = self.memory, self.setup.length
        late = np.flatnonzero(memory["epoch"] - memory["first"] >= length)
        if len(late):
            raise RuntimeError(
                f"an episode has at most {length} epochs, and receivers {late.tolist()} are at its "
                "end; start a new one"
            )
        command = self.command_with(command)
        if command is not None:
            memory["rate"] = command * self.setup.attack.limits
        memory["displacement"] = memory["displacement"] + memory["rate"] * self.setup.interval_s


INTERVAL_S = 0.1
DEFAULT_WINDOW = 100
DEFAULT_DETECTOR: dict[str, Any] = {
    "name": "windowed-chi2",
    "window": 1,
    "covariance": "estimated",
    "covariance_window": DEFAULT_WINDOW,
}


class LooselyCoupledSetup(Setup):
    """World, victim and detector of loosely coupled receivers, at 10 epochs a second.

    Parameters
    ----------
    detector, timeline, domain, target_heading_deg, decision_interval_s, between : optional
        As in `SpoofEnv`; by default a chi-square test of one epoch, with the threshold for an
        estimated covariance, and 20 s in which all windows fill, 5 s and 5 s.  A domain has
        `start_s` alone.
    flight : str
        A name in `FLIGHTS`, whose inertial sensors run at a multiple of 10 Hz.
    errors : mapping or PositionErrors, optional
        GNSS position errors.
    inertial : mapping or InertialErrors, optional
        Errors of the inertial sensors and of the alignment.
    receiver : mapping or LooselyCoupled, optional
        Settings of the victim; by default R adapts, over 100 epochs.
    imu_rate_hz : float, optional
        Samples of the inertial sensors per second, as in `Scenario`; by default the flight's.
    rate_limit_mps : float
        Rate of the displacement to the north and to the east that a command of 1 means.

    Notes
    -----
    World, filter and phases are those of `shadmehri2025`.  What the paper leaves open is chosen so
    that the monitor works: correlated position errors, and only R adapts.
    """

    kind: ClassVar[str] = "loose"
    env_id: ClassVar[str] = "spoofgym/LooselyCoupled-v0"
    whose: ClassVar[str] = "a loosely coupled receiver"
    has: ClassVar[frozenset[str]] = Setup.has | {"gnss_position"}
    domain_names: ClassVar[frozenset[str]] = frozenset({"start_s"})
    usual_detector = DEFAULT_DETECTOR
    usual_timeline: ClassVar[Mapping[str, float] | None] = {
        "warmup_s": 20.0,
        "live_s": 20.0,
        "attack_s": 5.0,
        "time_to_alert_s": 5.0,
    }
    motion_names = tuple(
        f"{what}_{axis}" for what in ("position", "velocity") for axis in ("north", "east", "down")
    )
    weight_names = ("east", "north", "up")
    scales: Mapping[str, float] = {**Setup.scales, "length_m": 25.0}

    def __init__(
        self,
        *,
        detector: str | Mapping[str, Any] | Detector | None = None,
        timeline: Mapping[str, float] | Timeline | None = None,
        flight: str = "shadmehri2025",
        errors: Mapping[str, Any] | PositionErrors | None = None,
        inertial: Mapping[str, Any] | InertialErrors | None = None,
        receiver: Mapping[str, Any] | LooselyCoupled | None = None,
        rate_limit_mps: float = 5.0,
        domain: Mapping[str, Any] | Domain | None = None,
        target_heading_deg: float | str = 90.0,
        decision_interval_s: float | None = None,
        between: str = "hold",
        imu_rate_hz: float | None = None,
    ) -> None:
        check_number("rate_limit_mps", rate_limit_mps, above=0.0)
        self.attack = RateCommands(
            self.kind, ("north_rate", "east_rate"), (float(rate_limit_mps),) * 2
        )
        self.world = flown_world(flight, INTERVAL_S, imu_rate_hz)
        self.name = at_rate(flight, imu_rate_hz)
        self.errors = build_record("errors", PositionErrors, errors)
        self.inertial = build_record("inertial", InertialErrors, inertial)
        self.receiver = build_record(
            "receiver",
            LooselyCoupled,
            {"self_tuning": {"window": DEFAULT_WINDOW}} if receiver is None else receiver,
        )
        self._aim(target_heading_deg, domain)
        self._phase(detector, timeline, INTERVAL_S, decision_interval_s, between)
        self.epochs_each = self.world.epochs
        self.bounds = self._bounds(1, 1, 1, *self._starts(self.epochs_each, self.name))
        self.epoch_time = np.arange(self.epochs_each, dtype=np.float64) * INTERVAL_S
        self.true_position = self.world.position_e
        # to ECEF from local north, east, down axes
        self.C_en = np.ascontiguousarray(self.world.C_el[:, :, [1, 0, 2]] * [1.0, 1.0, -1.0])

    def world_settings(self) -> dict[str, Any]:
        names = ("errors", "inertial", "receiver", "domain")
        return {"flight": self.name} | {name: describe(getattr(self, name)) for name in names}

    def simulator(self, receivers: int, run: Run) -> LooselyCoupledSimulator:
        return LooselyCoupledSimulator(self, receivers, run)


class LooselyCoupledSimulator(RateSimulator):
    """B loosely coupled receivers; `victims` are their filters."""

    setup: LooselyCoupledSetup

    def _allocate(self) -> None:
        super()._allocate()
        b, memory, world = self.receivers, self.memory, self.setup.world
        self.victims = LooseReceivers(
            self.setup.receiver, memory, world.samples, world.imu_interval_s, self.fields
        )
        keys = np.zeros((b, SOURCES, 2), dtype=np.uint64)
        errors = {"first_error": np.zeros((b, 15)), "position_error": np.zeros((b, 3))}
        memory.declare_all(keys=keys, **errors)
        self._offset = np.zeros((b, 3))  # east, north, up
        self._deviates = np.empty(pad_count(6 * world.samples))

    def _context(self) -> DetectorContext:
        variance = self.setup.receiver.noise_variance()
        return DetectorContext(self.receivers, 0, INTERVAL_S, variance, ())

    def _keys(self, episode: np.random.SeedSequence) -> NDArray[np.uint64]:
        state = episode.generate_state(2 * SOURCES, np.uint64)
        return np.asarray(state, dtype=np.uint64).reshape(-1, 2)

    def _start(self, choice: Choice) -> None:
        super()._start(choice)
        memory, setup, first = self.memory, self.setup, self.memory["first"]
        written = memory["first_error"], memory["position_error"]
        sizes = setup.inertial.initial_sd, setup.errors.sd
        first_errors(memory["keys"], *sizes, self._deviates, *written)
        world = setup.world
        truth = world.position_e[first], world.velocity_e[first], world.C_eb[first]
        self.victims.start_episodes(*truth, memory["first_error"])

    def _measure(self, command: FloatArray | None) -> None:
        self._move(command)
        memory, setup, world = self.memory, self.setup, self.setup.world
        self._offset[:, :2] = memory["displacement"][:, ::-1]
        flight = world.run, world.position_e, world.C_el, world.imu_interval_s
        inertial = setup.inertial.noise, memory["first_error"][:, 9:].copy()
        errors = setup.errors.decay, setup.errors.sd
        written = memory["position_error"], self.victims.samples, self.victims.fix_e
        drawn = memory["keys"], memory["epoch"]
        measure_loose(*drawn, *flight, *inertial, *errors, self._offset, self._deviates, *written)
        self.victims.predict()

    def _form_epoch(self) -> Epoch:
        return self.victims.epoch(self.time_s())

    def _correct(self, weights: FloatArray | None) -> None:
        self.victims.update(weights)

    def error_n(self) -> FloatArray:
        epochs = self.epochs
        apart = self.memory["position_e"] - self.setup.world.position_e[epochs]
        return np.asarray((apart[:, :, None] * self.setup.C_en[epochs, :, :2]).sum(axis=1))
