"""Tightly coupled GNSS/INS receivers: 17 states, pseudoranges and range rates, any attack."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from .._registry import build_record, check_choice
from .._simd import LANES
from ..attacks import Attack, AttackContext, make_attack
from ..attacks.false_position import FalsePosition
from ..attacks.per_channel import PerChannel
from ..detectors import Detector, DetectorContext, Verdict
from ..detectors.ewma import Ewma
from ..detectors.never import Never
from ..detectors.verdicts import checked
from ..receiver import TightlyCoupled
from ..receiver import _kernels as _kernels_of_receiver
from ..receiver.epoch import Epoch, epoch_view
from ..receiver.state import ReceiverBuffers, kernel_table
from ..sim.noise import padded
from ..sim.scenario import Scenario, make_scenario
from ..sim.sensors import SensorBuffers
from ..sim.world import World
from . import _kernels
from ._kernels import displace
from .base import Rngs, Rows, Simulator
from .combinations import Combinations, worlds_of
from .domain import Choice, Domain
from .frame import SkyData
from .setup import Run, Setup, Timeline

FloatArray = NDArray[np.float64]
DEFAULT_ATTACK = "false-position"
DEFAULT_DETECTOR: dict[str, Any] = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3}
RECEIVERS: dict[str, dict[str, Any]] = {each: {"tuning": each} for each in ("paper", "matched")}
"""Victims by name: the noise that they assume as the papers print it, or as the world has it."""
FIRST_FIX = 4
"""Satellites that a first fix takes."""
AXES = ("north", "east", "down")
AFTER_ONSET = ("imu", "clock", "gnss", "spoofer", "correlated")
"""Sources whose noise goes on after the onset."""
MEASURE, UPDATE, SHOW = (
    _kernels_of_receiver.MEASURE,
    _kernels_of_receiver.UPDATE,
    _kernels_of_receiver.SHOW,
)
JUDGE = _kernels.JUDGE
ADVANCE = MEASURE + _kernels_of_receiver.PREDICT
ATTACK_FORMS: dict[type, int] = {
    FalsePosition: _kernels.FALSE_POSITION,
    PerChannel: _kernels.PER_CHANNEL,
}
"""Attacks that the kernel makes itself, if their equipment is perfect."""


class TightlyCoupledSetup(Setup):
    """World, victim, attack and detector of tightly coupled receivers.

    The settings are those of `spoofgym.envs.SpoofEnv`; all fit into JSON, or are objects.

    Attributes
    ----------
    world : World
        All worlds of the domain, one after the other.
    combinations : Combinations
        Of world, sensors and errors.

    Raises
    ------
    ValueError
        When a setting is unknown or out of range, or the run is shorter than the episode.
    """

    kind: ClassVar[str] = "tightly-coupled"
    whose: ClassVar[str] = "a tightly coupled receiver"
    domain_names: ClassVar[frozenset[str]] = frozenset(vars(Domain()))
    threaded: ClassVar[bool] = True
    ratio_is_largest: ClassVar[bool] = False
    motion_names = tuple(f"{what}_{axis}" for what in ("position", "velocity") for axis in AXES)
    error_names = AXES
    world: World

    def __init__(
        self,
        *,
        scenario: str | Mapping[str, Any] | Scenario = "zhong2025",
        detector: str | Mapping[str, Any] | Detector | None = None,
        attack: str | Mapping[str, Any] | Attack = DEFAULT_ATTACK,
        receiver: str | Mapping[str, Any] | TightlyCoupled | None = None,
        timeline: Mapping[str, float] | Timeline | None = None,
        domain: Mapping[str, Any] | Domain | None = None,
        target_heading_deg: float | str = 90.0,
        decision_interval_s: float | None = None,
        between: str = "hold",
        imu_rate_hz: float | None = None,
    ) -> None:
        self.scenario = make_scenario(scenario)
        if imu_rate_hz is not None:
            self.scenario = replace(self.scenario, imu_rate_hz=imu_rate_hz)
        self.imu_rate_hz, self.name = self.scenario.imu_rate_hz, self.scenario.label
        self._aim(target_heading_deg, domain)
        self.receiver = _victim(receiver, self.scenario, self.domain)
        self.attack = make_attack(attack)
        detector = DEFAULT_DETECTOR if detector is None else detector
        timeline = build_record("timeline", Timeline, timeline)
        interval_s = self.scenario.epoch_interval_s
        self._phase(detector, timeline, interval_s, decision_interval_s, between)
        worlds = worlds_of(self.scenario, self.domain)
        first, last = self._starts(worlds[0].epochs, worlds[0].name)
        self.combinations = Combinations(
            worlds, self.scenario, self.receiver, self.domain, self.length, last + self.length
        )
        self.world = self.combinations.world
        self.epoch_time = self.world.epoch_time
        self.true_position, self.C_en = self.world.position_e, self.world.C_en
        cases = self.combinations
        self.bounds = self._bounds(cases.worlds, cases.grades, cases.errors, first, last)
        self.epochs_each = self.world.epochs // self.bounds.worlds
        slots = [f"slot{s:02d}" for s in range(self.world.channels)]
        self.weight_names = tuple(slots)
        self.geometry_names = (
            *(f"sight_{axis}_{slot}" for slot in slots for axis in AXES),
            *(f"visible_{slot}" for slot in slots),
        )
        self._check_first_fixes()

    @property
    def title(self) -> str:
        """Scenario and attack."""
        return f"{self.name}: {self.attack.label}"

    @property
    def combination_names(self) -> Mapping[str, Sequence[str]]:
        """Names of the grades and errors of the domain."""
        return self.combinations.names

    @property
    def onsets(self) -> NDArray[np.int64] | None:
        """(K,) onset of the episodes that each epoch is part of; None where the start is drawn."""
        if self.bounds.first != self.bounds.last:
            return None
        epochs = np.arange(self.world.epochs)
        starts: NDArray[np.int64] = epochs - epochs % self.epochs_each
        return starts + self.bounds.first + self.onset

    def motion_table(self, per_position: float, per_velocity: float) -> NDArray[np.float32] | None:
        """(K, 6) motion of the target at every epoch, where each belongs to one onset."""
        if self.onsets is None:
            return None
        table = np.empty((self.world.epochs, 6), dtype=np.float32)
        epochs = np.arange(self.world.epochs)
        self.local_motion(epochs, self.onsets, per_position, per_velocity, table)
        return table

    def geometry_table(self) -> FloatArray:
        """(K, 4n) unit vectors to the satellites in local axes, then 1 or 0 for visible or not."""
        world = self.world
        sight = world.satellites[:, :, :3] - world.position_e[:, None, :]
        sight = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
        sight = np.einsum("kji,knj->kni", world.C_en, sight) * world.visible[:, :, None]
        return np.hstack([sight.reshape(world.epochs, -1), world.visible])

    def simulator(self, receivers: int, run: Run) -> TightlyCoupledSimulator:
        """B receivers, not begun yet."""
        return TightlyCoupledSimulator(self, receivers, run)

    def _check_first_fixes(self) -> None:
        bounds, each = self.bounds, self.epochs_each
        seen = self.world.visible.sum(axis=1).reshape(bounds.worlds, each)
        few = np.argwhere(seen[:, bounds.first : bounds.last + 1] < FIRST_FIX)
        if len(few):
            world, epoch = few[0]
            time = self.world.epoch_time[bounds.first + epoch]
            raise ValueError(
                f"a first fix needs {FIRST_FIX} satellites; world {world} of the domain has fewer "
                f"at {time:g} s"
            )


def _victim(given: Any, scenario: Scenario, domain: Domain) -> TightlyCoupled:
    """Victim by name or settings."""
    if isinstance(given, str):
        check_choice("receiver", given, RECEIVERS)
        given = RECEIVERS[given]
    victim = build_record("receiver", TightlyCoupled, given, {"grade": scenario.imu})
    fixed = isinstance(given, Mapping) and "grade" in given
    if fixed and {victim.grade} < {victim.grade, *domain.imu}:
        raise ValueError(
            f"`receiver` has the grade {victim.grade!r}, but is tuned for the grade that it draws "
            f"from the domain's `imu` {', '.join(domain.imu)}: leave out one"
        )
    return victim


class TightlyCoupledSimulator(Simulator):
    """B tightly coupled receivers; kernels work on slices of them, possibly in threads.

    `buffers` has the estimates and measurements, `sensors` their errors; `attack` is bound.
    """

    setup: TightlyCoupledSetup

    def _allocate(self) -> None:
        world, receivers = self.setup.world, self.receivers
        self.buffers = ReceiverBuffers(receivers, world.channels, self.fields)
        self.sensors = SensorBuffers(receivers, world.channels)
        self.epoch = epoch_view(self.buffers)
        self._is_sound = True
        self._everyone = np.arange(receivers)
        self._serial = receivers <= LANES
        self.memory.declare("combination", np.zeros(receivers, dtype=np.int64))
        self.attack = copy.deepcopy(self.setup.attack)
        self.attack.bind(AttackContext(receivers, world))
        self._hold_arguments()

    def _hold_arguments(self) -> None:
        """Collect what the kernel takes: what stays the same, and what stands for nothing."""
        world, receiver = self.setup.world, self.setup.receiver
        buffers, sensors, one = self.buffers, self.sensors, np.zeros((1, 1))
        sizes = padded(6 * world.most_samples), padded(2 * world.channels)
        rules = (receiver.covariance_code, receiver.min_satellites, receiver.orthonormalize, *sizes)
        self._work_rows = _kernels_of_receiver.work_rows(world.channels, *sizes)
        self._spare: list[FloatArray] = []
        attack = self.attack
        self._table = kernel_table(
            buffers,
            sensors,
            world.run,
            world.epoch_time,
            world.epoch_end,
            world.satellites,
            np.array(rules, dtype=np.int64),
            world.position_e,
            world.velocity_e,
            attack.mask,
            attack.slots,
            attack.kernel_settings,
        )
        nothing = _kernels.NO_FORM
        self._no_attack = nothing, True, one, one, one, np.zeros((1, 1, 3)), one
        self._no_detector = nothing, np.zeros(3), one, one, one, one

    def _context(self) -> DetectorContext:
        setup = self.setup
        world, variance = setup.world, setup.combinations.largest_variance
        sizes = self.receivers, world.channels
        return DetectorContext(*sizes, setup.interval_s, variance, world.satellite_ids)

    def __getstate__(self) -> dict[str, Any]:
        """State without views of the buffers, which a copy makes of its own."""
        views = ("epoch", "_table", "_spare")
        return {name: value for name, value in self.__dict__.items() if name not in views}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the state, and view the epoch."""
        self.__dict__.update(state)
        self.epoch = epoch_view(self.buffers)
        self._hold_arguments()

    @property
    def epochs(self) -> NDArray[np.int64]:
        """(B,) the epoch of the world that each receiver is at."""
        return self.sensors.epoch

    @property
    def position(self) -> FloatArray:
        """(B, 3) estimated antenna, ECEF [m]."""
        return self.buffers.position_e

    @property
    def coasting(self) -> NDArray[np.bool_]:
        """(B,) bool, whether the last epoch had too few satellites for an update."""
        return self.buffers.coasting

    @property
    def commands(self) -> Memory:
        """Memory of the attack."""
        memory: Memory = self.attack.memory
        return memory

    def step_arrays(self) -> tuple[NDArray[np.int64], NDArray[np.bool_], FloatArray, FloatArray]:
        """Epochs, coasting, commanded displacement and rate, for kernels."""
        memory = self.attack.memory
        coasting = self.buffers.coasting
        return self.sensors.epoch, coasting, memory["displacement"], memory["rate"]

    def _draw(self, rngs: Rngs) -> NDArray[np.uint64]:
        self.sensors.draw_keys(self._everyone, rngs)
        keys: NDArray[np.uint64] = self.sensors.words["domain"]
        return keys

    def _renew(self, rows: Rows, episodes: Sequence[np.random.SeedSequence]) -> None:
        self.sensors.put_keys(rows, episodes, AFTER_ONSET)
        self.attack.begin(rows, self.sensors.words.get("spoofer", rows), self.onset[rows])

    def _start(self, choice: Choice) -> None:
        """Draw the errors; first fix, attitude, empty memories."""
        setup, b, first = self.setup, self.receivers, self.memory["first"]
        combinations = setup.combinations
        self.sensors.epoch[:] = first
        self.memory["combination"][:] = combinations.index(choice.world, choice.grade, choice.error)
        self.attack.memory.reset()
        self.attack.begin(self._everyone, self.sensors.words["spoofer"], self.onset)
        self._start_combinations()
        self._epochs(MEASURE, 0, b)
        world, fields = setup.world, self.buffers.fields
        position_e, velocity_e, clock = np.empty((b, 3)), np.empty((b, 3)), np.empty((b, 2))
        guess_e, now = world.position_e[first], (fields["measured"], world.satellites, first)
        _kernels_of_receiver.first_fix(*now, guess_e, position_e, velocity_e, clock)
        fields["position_e"], fields["velocity_e"], fields["clock"] = position_e, velocity_e, clock
        fields["C_eb"] = combinations.first_C_eb(choice.grade, first)
        fields["accel_bias_b"] = fields["gyro_bias_b"] = 0.0
        self.buffers.position_e[:], self.buffers.velocity_e[:] = position_e, velocity_e

    def _start_combinations(self) -> None:
        """Draw the errors, and give the victims what they assume."""
        indices = self.memory["combination"]
        fields = self.buffers.fields
        for index in np.unique(indices).tolist():
            its, rows = self.setup.combinations[index], np.flatnonzero(indices == index)
            self.sensors.begin(rows, its.grade, its.errors, its.bias_sd)
            fields.put("noise_variance", rows, its.noise_variance)
            fields.put("noise_psd", rows, its.noise_psd)
            self.buffers.put_covariance(rows, its.covariance)

    def _epochs(
        self,
        what: int,
        lo: int,
        hi: int,
        *,
        count: int = 1,
        attack: tuple[Any, ...] | None = None,
        detector: tuple[Any, ...] | None = None,
    ) -> None:
        """Call the kernel for a slice, with scratch memory that no other thread has."""
        try:
            work = self._spare.pop()
        except IndexError:
            work = self.buffers.fields.scratch(self._work_rows)
        attack_form, hold, *moved = self._no_attack if attack is None else attack
        detector_form, *judged = self._no_detector if detector is None else detector
        arrays = self._table.entries, *moved, *judged, self.weights, work
        rest = attack_form, hold, detector_form, what, count, lo, hi
        given: tuple[Any, ...] = (*arrays, *rest)
        sound = _kernels.run_epochs(*given)
        self._spare.append(work)
        if not sound:
            self._is_sound = False

    def _compiled_attack(self, command: FloatArray | None) -> tuple[Any, ...] | None:
        """Arguments of an attack that the kernel itself makes, else None."""
        attack = self.attack
        form = ATTACK_FORMS.get(type(attack), _kernels.NO_FORM)
        if form == _kernels.NO_FORM or self.clean is not None or not attack.is_perfect:
            return None
        memory = attack.memory
        hold = command is None
        if command is None or command.dtype != np.float64 or not command.flags.carray:
            command = attack.idle if command is None else np.array(command, dtype=np.float64)
        return (
            form,
            hold,
            command,
            memory["displacement"],
            memory["rate"],
            memory.get("to_ecef", self._no_attack[5]),
            memory["target_error"],
        )

    def _attack(self, command: FloatArray | None, lo: int, hi: int) -> None:
        """Let an attack without a compiled form write what it adds to the measurements."""
        sensors = self.sensors
        self.attack.command(
            command, sensors.epoch, sensors.range_offset, sensors.rate_offset, lo, hi
        )
        if self.attack.replaces_errors:
            sensors.authentic[lo:hi] = self.attack.memory["authentic"][lo:hi]
        if self.clean is not None:
            spared = lo + np.flatnonzero(self.clean[lo:hi])
            sensors.range_offset[spared] = sensors.rate_offset[spared] = 0.0
            sensors.authentic[spared] = 1.0

    def _measure(self, command: FloatArray | None) -> None:
        self.predict(command)

    def _form_epoch(self) -> Epoch:
        return self.epoch

    def _correct(self, weights: FloatArray | None) -> None:
        if self._serial:
            self._epochs(UPDATE, 0, self.receivers)
        else:
            self._run(partial(self._epochs, UPDATE), self.receivers)

    def _first_half(
        self,
        what: int,
        command: FloatArray | None,
        attacked: bool,
        detector: tuple[Any, ...] | None = None,
    ) -> None:
        """Run kernels that begin with an attack, or none."""
        attack = self._compiled_attack(command) if attacked else None
        if attack is not None:
            what += _kernels.ATTACK
        in_python = attacked and attack is None

        def work(lo: int, hi: int) -> None:
            """Attack in Python first, where it has no compiled form."""
            if in_python:
                self._attack(command, lo, hi)
            self._epochs(what, lo, hi, attack=attack, detector=detector)

        if self._serial and not in_python:
            self._epochs(what, 0, self.receivers, attack=attack, detector=detector)
        elif self._serial:
            work(0, self.receivers)
        else:
            self._run(work, self.receivers)

    def predict(self, command: FloatArray | None) -> Epoch:
        """First half of an epoch under attack; the epoch's arrays follow the buffers."""
        self._first_half(ADVANCE + SHOW, command, True)
        return self.epoch

    def advance(self) -> Epoch:
        """First half of an epoch without attack: measure, mechanize, predict."""
        self._first_half(ADVANCE + SHOW, None, False)
        return self.epoch

    def step(self, command: FloatArray | None = None, *, attacked: bool = True) -> Verdict:
        """Both halves of an epoch, in one kernel where nothing in Python comes between."""
        judge = self._compiled_detector()
        if judge is None:
            return super().step(command, attacked=attacked)
        self._is_sound = True
        self._first_half(ADVANCE + SHOW + JUDGE + UPDATE, command, attacked, detector=judge)
        statistic, threshold, detector = judge[4], judge[5], self.detector
        in_loop = self.weights if judge[0] == _kernels.EWMA else None
        verdict = Verdict(statistic, threshold, statistic > threshold, in_loop)
        self.verdict = verdict if self._is_sound else checked(verdict, detector, self.epoch)
        return self.verdict

    def _compiled_detector(self) -> tuple[Any, ...] | None:
        """Arguments of a detector that the kernel itself asks, else None; sets the weights."""
        detector = self.detector
        if self.monitors:
            return None
        if type(detector) is Never:
            self.weights, (_, settings, one, *_) = self.ones, self._no_detector
            shape = self.receivers, 1
            return _kernels.NEVER, settings, one, one, np.zeros(shape), np.ones(shape)
        if type(detector) is not Ewma or detector.limits_exclusions:
            return None
        memory, shape = detector.memory, self.buffers.visible.shape
        self.weights = np.empty(self.ones.shape)
        form = _kernels.PASSIVE_EWMA if detector.weight_scale is None else _kernels.EWMA
        charts = detector.kernel_settings, memory["average"], memory["decay"]
        return form, *charts, np.empty(shape), np.empty(shape)

    def quiet_epochs(self, count: int) -> None:
        """Run clean epochs without a detector, in one kernel call."""
        self.weights = self.ones
        part = partial(self._epochs, ADVANCE + UPDATE + SHOW, count=count)
        self._run(part, self.receivers)

    def error_n(self) -> FloatArray:
        """(B, 3) error of the estimate in the local axes at the onset: north, east, down [m]."""
        world = self.setup.world
        error_e = self.buffers.position_e - world.position_e[self.epochs]
        # a sum of products, since the bits of a matrix product depend on the size of the batch
        result: FloatArray = (error_e[:, :, None] * world.C_en[self.onset]).sum(axis=1)
        return result

    def displacement(self, origin: FloatArray, twin: Self | None, out: FloatArray) -> None:
        """Write the displacement that counts, in one kernel."""
        setup, memory = self.setup, self.memory
        reference = (setup.true_position, self.sensors.epoch)
        if twin is not None:
            reference = (twin.buffers.position_e, self._everyone)
        aim = memory["onset"], memory["direction"], setup.target_heading_deg == "worst"
        displace(self.buffers.position_e, *reference, setup.C_en, *aim, origin, out)

    def copy_rows(self, to: Rows, other: Self, rows: Rows) -> None:
        """Take over receivers of another simulator, with all that they remember."""
        self.buffers.copy_rows(to, other.buffers, rows)
        self.sensors.copy_rows(to, other.sensors, rows)
        self.attack.memory.copy_rows(to, other.attack.memory, rows)
        super().copy_rows(to, other, rows)

    def captured_channels(self) -> NDArray[np.int64]:
        """(B,) channels that follow the counterfeit signals."""
        captured: NDArray[np.int64] = self.attack.memory["captured"].sum(axis=1)
        return captured

    def _sky(self) -> SkyData:
        world, epoch, offsets = self.setup.world, int(self.epochs[0]), self.sensors
        return SkyData(
            names=world.satellite_ids,
            azimuth=world.azimuth[epoch],
            elevation=world.elevation[epoch],
            visible=world.visible[epoch],
            spoofed=(offsets.range_offset[0] != 0.0) | (offsets.rate_offset[0] != 0.0),
            weight=self.weights[0, : world.channels].copy(),
        )

    def recorded(self) -> dict[str, NDArray[Any]]:
        """What the attack adds to the measurements."""
        offsets = self.sensors
        return {"range_offset_m": offsets.range_offset, "rate_offset_mps": offsets.rate_offset}


def tightly_coupled(simulator: object, word: str) -> TightlyCoupledSimulator:
    """The same, where it is of tightly coupled receivers; a ValueError that names what needs it."""
    if not isinstance(simulator, TightlyCoupledSimulator):
        whose = getattr(getattr(simulator, "setup", None), "whose", repr(simulator))
        raise ValueError(
            f"{word} needs the filter of a tightly coupled receiver, which {whose} does not have"
        )
    return simulator
