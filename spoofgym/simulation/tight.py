"""Tightly coupled GNSS/INS receivers: 17 states, pseudoranges and range rates, any attack."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, Self, cast

import numpy as np
from numpy.typing import NDArray

from ..attacks import Attack, AttackContext, as_offsets, make_attack
from ..attacks.commands import FalsePosition, PerChannel
from ..core.memory import Memory
from ..core.registry import build_record, check_choice, require
from ..core.settings import describe
from ..core.simd import LANES, ArrayTable
from ..detectors import Calibrated, Detector, DetectorContext, Verdict
from ..detectors.base import check_verdict
from ..detectors.charts import Ewma
from ..detectors.controls import Never
from ..receiver import TightlyCoupled
from ..receiver._kernels import MEASURE, PREDICT, SHOW, UPDATE, first_fix, work_rows
from ..receiver.augmented import AugmentedFilter, Predicted
from ..receiver.epoch import Epoch, ReceiverBuffers, epoch_view, kernel_table
from ..receiver.states import STATES
from ..receiver.tight import TUNINGS
from ..truth.events import BenignEvents, EventWindow, draw_events
from ..truth.noise import pad_count
from ..truth.run import GroundTruth, look_along, see_geometry
from ..truth.scenario import Scenario, make_scenario
from ..truth.sensors import SensorBuffers
from ..truth.signal_errors import MAPPINGS, OBLIQUITIES, compute_mappings, stack_obliquities
from . import _kernels
from ._kernels import JUDGE, REMEMBER, displace, local_error, local_motion
from .domain import Choice, Combinations, Domain, FloatArray, build_worlds, share_worlds
from .monitors import PastPositions
from .setup import Run, Setup, Timeline
from .simulator import Rngs, Rows, Sequel, Simulator, SkyData

# Victims by name: the noise that they assume as the papers print it, or as the world has it.
RECEIVERS: dict[str, dict[str, Any]] = {each: {"tuning": each} for each in TUNINGS}
# fields of an epoch that an augmented filter works on, and those that it has itself
AUGMENTED_NEEDS = frozenset({"transition", "imu_delta", "design", "innovation_cov"})
AUGMENTED_SHOWS = frozenset({"transition", "design", "predicted_cov"})  # with all its states
FIRST_FIX = 4  # satellites that a first fix takes
AXES = ("north", "east", "down")
AFTER_ONSET = ("imu", "clock", "gnss", "spoofer", "correlated")  # noise that goes on
ADVANCE = MEASURE + PREDICT
TRUTH = "run", "epoch_time", "epoch_end", "satellites", "position_e", "velocity_e"
TABLED = (
    *(*TRUTH[:4], "rules", "signals", "mappings", *TRUTH[4:]),
    *("captured", "slots", "attack_settings"),
)  # in the order of the kernels' table
ATTACK_FORMS: dict[type, int] = {
    FalsePosition: _kernels.FALSE_POSITION,
    PerChannel: _kernels.PER_CHANNEL,
}  # attacks that the kernel makes itself, if their equipment is perfect


class TightlyCoupledSetup(Setup):
    """World, victim, attack and detector of tightly coupled receivers.

    The settings are those of `spoofgym.envs.SpoofEnv`; all fit into JSON, or are objects.

    Its attribute `world` holds all worlds of the domain, one after the other on the axis of epochs;
    `combinations`, the cases of world, grade of sensors and errors that an episode can draw.
    """

    kind: ClassVar[str] = "tightly-coupled"
    env_id: ClassVar[str] = "spoofgym/Zhong2025-v0"
    whose: ClassVar[str] = "a tightly coupled receiver"
    has: ClassVar[frozenset[str]] = Setup.has | {"weights"}
    domain_names: ClassVar[frozenset[str]] = frozenset(vars(Domain()))
    usual_detector: ClassVar[Mapping[str, Any]] = {
        "name": "ewma",
        "smoothing": 0.1,
        "weight_scale": 0.3,
    }
    threaded: ClassVar[bool] = True
    follows_setpoint: ClassVar[bool] = True
    ratio_is_largest: ClassVar[bool] = False
    motion_names = tuple(f"{what}_{axis}" for what in ("position", "velocity") for axis in AXES)
    error_names = AXES
    world: GroundTruth

    def __init__(
        self,
        *,
        scenario: str | Mapping[str, Any] | Scenario = "zhong2025",
        detector: str | Mapping[str, Any] | Detector | None = None,
        attack: str | Mapping[str, Any] | Attack = "false-position",
        receiver: str | Mapping[str, Any] | TightlyCoupled | None = None,
        timeline: Mapping[str, float] | Timeline | None = None,
        domain: Mapping[str, Any] | Domain | None = None,
        target_heading_deg: float | str = 90.0,
        decision_interval_s: float | None = None,
        between: str = "hold",
        imu_rate_hz: float | None = None,
        control: str | None = None,
        basis: str | None = None,
        channels: str | Sequence[str] | None = None,
    ) -> None:
        self.scenario = make_scenario(scenario)
        if imu_rate_hz is not None:
            self.scenario = replace(self.scenario, imu_rate_hz=imu_rate_hz)
        self.imu_rate_hz, self.name = self.scenario.imu_rate_hz, self.scenario.label
        self._aim(target_heading_deg, domain)
        self.receiver = _victim(receiver, self.scenario, self.domain)
        self.attack = _commanded(make_attack(attack), control, basis, channels)
        interval_s = self.scenario.epoch_interval_s
        self._phase(detector, timeline, interval_s, decision_interval_s, between)
        self.world, worlds = build_worlds(self.scenario, self.domain)
        first, last = self._starts(self.world.epochs // worlds, self.world.name)
        given = self.world, worlds, self.scenario, self.receiver, self.domain
        self.combinations = Combinations(*given, self.length, last + self.length)
        self.epoch_time = self.world.epoch_time
        cases = self.combinations
        self.bounds = self._bounds(cases.worlds, cases.grades, cases.errors, first, last)
        self.epochs_each = self.world.epochs // self.bounds.worlds
        self._hold_tables()
        slots = [f"slot{s:02d}" for s in range(self.world.channels)]
        self.weight_names = tuple(slots)
        self.geometry_names = (
            *(f"sight_{axis}_{slot}" for slot in slots for axis in AXES),
            *(f"visible_{slot}" for slot in slots),
        )
        self._check_first_fixes()

    def _hold_tables(self) -> None:
        """Hold what simulators read: of worlds that have not been built, there may be anything."""
        world = self.world.at_hand
        self.true_position, self.C_en = world.position_e, world.C_en
        self.mappings = np.zeros((0, world.channels, OBLIQUITIES))
        if self.combinations.with_signals:
            shape = world.channels, OBLIQUITIES
            self.mappings = world.tabulate(
                "obliquities", shape, lambda part: stack_obliquities(part.elevation)
            )

    def __getstate__(self) -> dict[str, Any]:
        tables = ("true_position", "C_en", "mappings")
        return {name: value for name, value in self.__dict__.items() if name not in tables}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        share_worlds(self.scenario, self.domain, self.world)
        self._hold_tables()

    def world_settings(self) -> dict[str, Any]:
        scenario = describe(self.scenario)
        del scenario["name"]
        domain = self.domain
        # what a domain says that the scenario has anyway is no other world
        if domain.turn_on == self.scenario.turn_on:
            domain = replace(domain, turn_on=None)
        if domain.events is not None and domain.events == (self.scenario.events or BenignEvents()):
            domain = replace(domain, events=None)
        parts = {"receiver": self.receiver, "domain": domain}
        return {"scenario": scenario, **{name: describe(part) for name, part in parts.items()}}

    @property
    def title(self) -> str:
        return f"{self.name}: {self.attack.label}"

    @property
    def combination_names(self) -> Mapping[str, Sequence[str]]:
        return self.combinations.names

    @property
    def onsets(self) -> NDArray[np.int64] | None:
        if self.bounds.first != self.bounds.last or self.youngest != self.onset:
            return None
        epochs = np.arange(self.world.epochs)
        starts: NDArray[np.int64] = epochs - epochs % self.epochs_each
        return starts + self.bounds.first + self.onset

    def motion_table(self, per_position: float, per_velocity: float) -> NDArray[np.float32] | None:
        if self.onsets is None:
            return None
        table = np.empty((self.world.epochs, 6), dtype=np.float32)
        self.world.build(range(self.bounds.worlds))
        epochs = np.arange(self.world.epochs)
        self.local_motion(epochs, self.onsets, per_position, per_velocity, table)
        return table

    def local_motion(self, *epochs_to_out: Any) -> None:
        velocity_e = self.world.at_hand.velocity_e
        local_motion(self.true_position, velocity_e, self.C_en, *epochs_to_out)

    def geometry_table(self) -> FloatArray:
        return see_geometry(self.world)

    def probe_geometry(self) -> FloatArray | None:
        epochs, geometry = self.world.probe()
        inside = (epochs >= self.bounds.first + self.youngest) & (
            epochs <= self.bounds.last + self.onset + self.steps + self.hold
        )
        return geometry[:, inside].reshape(-1, len(self.geometry_names)) if inside.any() else None

    def simulator(self, receivers: int, run: Run) -> TightlyCoupledSimulator:
        return TightlyCoupledSimulator(self, receivers, run)

    def _check_first_fixes(self) -> None:
        bounds, each = self.bounds, self.epochs_each
        seen = self.world.in_view.reshape(bounds.worlds, each)
        few = np.argwhere(seen[:, bounds.first : bounds.last + 1] < FIRST_FIX)
        if len(few):
            world, epoch = few[0]
            raise ValueError(
                f"a first fix needs {FIRST_FIX} satellites; world {world} of the domain has fewer "
                f"at {self.world.epoch_time[bounds.first + epoch]:g} s"
            )


def _commanded(
    attack: Attack, control: str | None, basis: str | None, channels: str | Sequence[str] | None
) -> Attack:
    """The attack by offsets where a control or a basis of them is chosen; on some channels."""
    given = {"control": control, "basis": basis, "channels": channels}
    chosen: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if {"control", "basis"} & {*chosen}:
        return as_offsets(attack, **chosen)
    return replace(attack, threat="", **chosen) if chosen else attack


def _victim(given: Any, scenario: Scenario, domain: Domain) -> TightlyCoupled:
    if isinstance(given, str):
        check_choice("receiver", given, RECEIVERS)
        given = RECEIVERS[given]
    victim = build_record("receiver", TightlyCoupled, given, {"grade": scenario.imu})
    fixed = isinstance(given, Mapping) and "grade" in given
    require(
        not (fixed and {victim.grade} < {victim.grade, *domain.imu}),
        f"`receiver` has the grade {victim.grade!r}, but is tuned for the grade that it draws "
        f"from the domain's `imu` {', '.join(domain.imu)}: leave out one",
    )
    return victim


def split_scale(detector: Detector) -> tuple[Detector, float]:
    if type(detector) is Calibrated and detector.scale is not None and not detector.rescaled:
        return detector.detector, detector.scale
    return detector, 1.0


class SequelKernel(NamedTuple):
    """Kernel that begins with a simulator's own, and what it is given where nothing follows.

    Every simulator runs it for everything, so that its own is compiled as a part of it alone.
    """

    function: Callable[..., int]
    nothing: tuple[NDArray[Any], ...]


class TightlyCoupledSimulator(Simulator):
    """B tightly coupled receivers; kernels work on slices of them, possibly in threads. `buffers`
    has the estimates and measurements, `sensors` their errors; `attack` is bound; `augmented` is
    the filter with more states, or None; `kernel` is that of the environments where they are
    imported."""

    setup: TightlyCoupledSetup
    kernel: ClassVar[SequelKernel] = SequelKernel(_kernels.run_epochs, ())

    def _allocate(self) -> None:
        world, receivers = self.setup.world, self.receivers
        augmented = self.setup.receiver.tuning == "augmented"
        wanted = self.fields - AUGMENTED_SHOWS | AUGMENTED_NEEDS if augmented else self.fields
        alike = self.setup.combinations.assume_alike
        self.buffers = ReceiverBuffers(receivers, world.channels, wanted, alike=alike)
        self.sensors = SensorBuffers(
            receivers,
            world.channels,
            with_signals=self.setup.combinations.with_signals,
            with_authentic=self.setup.attack.replaces_errors,
            with_in_run=self.setup.combinations.wandering,
            alike=self.setup.combinations.sense_alike,
        )
        self._all_rows = np.arange(receivers)
        self._serial = receivers <= LANES
        self._verdicts: dict[int, Verdict] = {}
        self.memory.declare("combination", np.zeros(receivers, dtype=np.int64))
        self.augmented: AugmentedFilter | None = None
        if augmented:
            model = self.setup.combinations.signal_model(self.setup.interval_s)
            known = self.memory, model, self.setup.interval_s, world.channels
            self.augmented = AugmentedFilter(*known, self.fields)
        self._predicted: Predicted | None = None
        self.epoch = self._view()
        self.attack: Attack = copy.deepcopy(self.setup.attack)
        self.attack.bind(AttackContext(receivers, world))
        self._hold_arguments()

    def _view(self) -> Epoch:
        return epoch_view(self.buffers, self.augmented.shown if self.augmented else None)

    def _hold_arguments(self) -> None:
        shared, sensors = self.shared_arrays(), self.sensors
        self.work_rows = work_rows(self.setup.world.channels, *shared["rules"][3:].tolist())
        self._spare: list[FloatArray] = []
        shared["signals"] = sensors.signals.data
        self._table = kernel_table(self.buffers, sensors, *(shared[name] for name in TABLED))
        self._no_axes, self._no_action = np.zeros(0), _kernels.ONE
        self._history = np.zeros((0, self.receivers), dtype=np.bool_)
        self._no_memories = ArrayTable(_kernels.NOTHING_REMEMBERED)
        self._memories, self._known = self._no_memories, (_kernels.NO_FORM, 0, None, None)
        self._outcomes: set[int] = set()

    def shared_arrays(self) -> dict[str, NDArray[Any]]:
        """What kernels read that is the same for all receivers, by name."""
        world, attack, rules = self.setup.world.at_hand, self.attack, self.setup.receiver
        sizes = pad_count(6 * world.most_samples), pad_count(2 * world.channels)
        whether = rules.covariance_code, rules.min_satellites, rules.orthonormalize
        return {
            **{name: getattr(world, name) for name in TRUTH},
            "rules": np.array((*whether, *sizes), dtype=np.int64),
            "mappings": self.setup.mappings,
            "captured": attack.mask,
            "slots": attack.slots,
            "attack_settings": attack.kernel_settings,
        }

    def lasting_arrays(self) -> dict[str, NDArray[Any]]:
        """What there is of receivers that have just started, (B, ...) by name."""
        buffers, sensors, attack = self.buffers, self.sensors, self.attack.memory
        pasts = [each.memory for each in self.monitors if isinstance(each, PastPositions)]
        return {
            "x": buffers.fields.gather(),
            "assumed": buffers.assumed.gather(),
            "sensors": sensors.fields.gather(),
            "constants": sensors.constants.gather(),
            "keys": sensors.words.gather(),
            "epochs": sensors.epoch,
            "in_run": sensors.in_run.gather(),
            "signals": sensors.signals.gather(),
            **{name: attack[name] for name in ("displacement", "rate", "target_error")},
            **(pasts[0] if pasts else PastPositions.empty(self.receivers, 0, 3)),
        }

    def _context(self) -> DetectorContext:
        setup = self.setup
        world, cases = setup.world, setup.combinations
        sizes, variance = (self.receivers, world.channels), cases.largest_variance
        single = np.sqrt(cases.largest_epoch_variance)
        known = *sizes, setup.interval_s, variance, world.satellite_ids, single
        context = DetectorContext(
            *known, min_satellites=setup.receiver.min_satellites, model=cases.filter_model
        )
        if self.augmented is None:
            return context
        filter_ = self.augmented
        return context._replace(states=filter_.states, inertial_states=filter_.inertial)

    def __getstate__(self) -> dict[str, Any]:
        views = ("epoch", "_table", "_memories", "_no_memories", "_known", "_spare", "_history")
        return {name: value for name, value in self.__dict__.items() if name not in views}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._build_epochs()
        self.epoch = self._view()
        self._hold_arguments()

    def _build_epochs(self) -> None:
        """Build what there is to see in the episodes, unless it is there."""
        last = self.onset + self.setup.steps + self.setup.hold
        self.setup.world.build_epochs(self.memory["first"], last)

    @property
    def epochs(self) -> NDArray[np.int64]:
        return self.sensors.epoch

    @property
    def position(self) -> FloatArray:
        return self.buffers.position_e

    @property
    def coasting(self) -> NDArray[np.bool_]:
        return self.buffers.coasting

    @property
    def commands(self) -> Memory:
        return self.attack.memory

    def _draw(self, rngs: Rngs) -> NDArray[np.uint64]:
        self.sensors.draw_keys(self._all_rows, rngs)
        return self.sensors.words["domain"]

    def _renew(self, rows: Rows, episodes: Sequence[np.random.SeedSequence]) -> None:
        self.sensors.put_keys(rows, episodes, AFTER_ONSET)
        self._begin_attack(rows)

    def _begin_attack(self, rows: Rows) -> None:
        self.attack.start_episodes(rows, self.sensors.words.get("spoofer", rows), self.onset[rows])

    def _start(self, choice: Choice) -> None:
        setup, b, first = self.setup, self.receivers, self.memory["first"]
        self._build_epochs()
        combinations = setup.combinations
        self.sensors.epoch[:] = first
        self.memory["combination"][:] = combinations.index(choice.world, choice.grade, choice.error)
        self.attack.memory.reset()
        self._begin_attack(self._all_rows)
        self._start_combinations()
        self._epochs(MEASURE, 0, b)
        world, fields = setup.world.at_hand, self.buffers.fields
        position_e, velocity_e, clock = np.empty((b, 3)), np.empty((b, 3)), np.empty((b, 2))
        measured = fields["innovation"].reshape(b, 2, world.channels)
        guess_e, now = world.position_e[first], (measured, world.satellites, first)
        first_fix(*now, guess_e, position_e, velocity_e, clock)
        fields["position_e"], fields["velocity_e"], fields["clock"] = position_e, velocity_e, clock
        fields["C_eb"] = combinations.first_C_eb(choice.grade, first)
        fields["accel_bias_b"] = fields["gyro_bias_b"] = 0.0
        self.buffers.position_e[:], self.buffers.velocity_e[:] = position_e, velocity_e

    def _start_combinations(self) -> None:
        indices, combinations = self.memory["combination"], self.setup.combinations
        assumed = self.buffers.assumed
        for index in np.unique(indices).tolist():
            its, rows = combinations[index], np.flatnonzero(indices == index)
            drawn, interval_s = combinations.drawn, self.setup.interval_s
            self.sensors.start_episodes(
                rows, its.grade, its.errors, its.bias_sd, interval_s=interval_s, drawn=drawn
            )
            assumed.put("noise_variance", rows, its.noise_variance)
            assumed.put("noise_psd", rows, its.noise_psd)
            self.buffers.put_covariance(rows, its.covariance)
            if self.augmented is not None:
                self.augmented.start_episodes(rows, its.covariance, its.assumed_grade)
        if combinations.events is not None:
            self._draw_events(combinations.events)

    def _draw_events(self, events: BenignEvents) -> None:
        setup, world, signals = self.setup, self.setup.world.at_hand, self.sensors.signals
        sky = setup.interval_s, world.visible, world.look
        lasts = self.onset + setup.steps + setup.hold
        for row, start in enumerate(self.memory["first"].tolist()):
            window = EventWindow(start + setup.filter_only + 1, int(lasts[row]), *sky)
            found = draw_events(events, self.memory["key"][row], window)
            for name, value in found.items():
                signals.put(name, [row], value)

    def _epochs(self, what: int, lo: int, hi: int, *, count: int = 1) -> None:
        """Run a slice without an attack and a detector of the kernel's own."""
        tables = self._table.entries, self._no_memories.entries
        rest = _kernels.NO_FORM, True, _kernels.NO_FORM, what, count
        self._call((*self.kernel.nothing, *tables, self._no_action, self.weights), rest, lo, hi)

    def _call(self, arrays: tuple[Any, ...], rest: tuple[int, ...], lo: int, hi: int) -> None:
        """Call the kernel for a slice, with scratch memory that no other thread has."""
        try:
            work = self._spare.pop()
        except IndexError:
            work = self.buffers.fields.scratch(self.work_rows)
        found = self.kernel.function(*arrays, work, *rest, lo, hi)
        self._spare.append(work)
        if found:
            self._outcomes.add(found)

    def _compiled_attack(self) -> int:
        attack = self.attack
        if self.clean is not None or not attack.is_perfect:
            return _kernels.NO_FORM
        return ATTACK_FORMS.get(type(attack), _kernels.NO_FORM)

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
            if self.attack.replaces_errors:
                sensors.authentic[spared] = 1.0

    def _measure(self, command: FloatArray | None) -> None:
        self._first_half(ADVANCE + SHOW, command, True, self._compiled_attack())
        self._augment()

    def _augment(self) -> None:
        if self.augmented is None:
            return
        buffers, setup, n = self.buffers, self.setup, self.setup.world.channels
        seen, assumed = buffers.seen, buffers.assumed
        mapping = np.zeros((1, n, MAPPINGS))
        if setup.mappings.size:
            mapping = compute_mappings(setup.mappings, setup.epoch_time, self.epochs)
        inertial = seen["transition"], seen["imu_delta"], assumed["noise_psd"], buffers.interval
        model = seen["design"], mapping, buffers.visible
        measured = seen["innovation"], assumed["noise_variance"], setup.receiver.min_satellites
        predicted = self.augmented.predict(*inertial, *model, *measured)
        self._predicted = predicted
        seen["innovation"][:] = predicted.innovation
        seen["innovation_cov"][:] = predicted.S
        seen["innovation_variance"][:] = np.einsum("bii->bi", predicted.S)

    def _correct_augmented(self, weights: FloatArray | None) -> None:
        if self.augmented is None or self._predicted is None:
            raise RuntimeError("an augmented filter is updated after it has predicted")
        predicted, fields = self._predicted, self.buffers.fields
        dx = self.augmented.update(predicted, weights)
        C, x = fields["C_eb"], dx[:, :3, None]
        turned = (x[:, i] * C[:, j] - x[:, j] * C[:, i] for i, j in ((1, 2), (2, 0), (0, 1)))
        C = C - np.stack(list(turned), axis=1)
        if self.setup.receiver.orthonormalize:  # one step towards the nearest rotation
            C = 0.5 * (C @ (3.0 * np.eye(3) - C.transpose(0, 2, 1) @ C))
        fields["C_eb"] = C
        fields["velocity_e"] = fields["velocity_e"] - dx[:, 3:6]
        fields["position_e"] = fields["position_e"] - dx[:, 6:9]
        fields["accel_bias_b"] = fields["accel_bias_b"] + dx[:, 9:12]
        fields["gyro_bias_b"] = fields["gyro_bias_b"] + dx[:, 12:15]
        fields["clock"] = fields["clock"] + dx[:, 15:]
        self.buffers.position_e[:] = fields["position_e"]
        self.buffers.velocity_e[:] = fields["velocity_e"]
        self.buffers.coasting[:] = ~predicted.enough
        P = self.memory["augmented_covariance"]
        self.buffers.put_covariance(self._all_rows, P[:, :STATES, :STATES])

    def _correct(self, weights: FloatArray | None) -> None:
        if self.augmented is not None:
            self._correct_augmented(weights)
        elif self._serial:
            self._epochs(UPDATE, 0, self.receivers)
        else:
            self._run(partial(self._epochs, UPDATE), self.receivers)

    def _first_half(
        self,
        what: int,
        command: FloatArray | None,
        attacked: bool,
        form: int,
        detector: int = _kernels.NO_FORM,
        sequel: Sequel | None = None,
        count: int = 1,
    ) -> None:
        """Run kernels that begin with an attack of some form, or none, as `step` does."""
        if "weights" in self.fields:
            self.buffers.seen["weights"][:] = self.weights
        action, in_python = self._no_action, attacked and form == _kernels.NO_FORM
        if form != _kernels.NO_FORM:
            what, action = what + _kernels.ATTACK, self.attack.idle if command is None else command
            if action.dtype != np.float64 or not action.flags.carray:
                action = np.array(action, dtype=np.float64, order="C")
        # memories that the table does not hold may have changed
        attacks = None if form == _kernels.NO_FORM else self.attack.memory.stamp
        judges = None if detector == _kernels.NO_FORM else self.detector.memory.stamp
        known = form, detector, attacks, judges
        if known != self._known:
            self._memories, self._known = self._memory_table(form, detector), known
        first = self.kernel.nothing
        if sequel is not None:
            what, first = what + _kernels.SCORE, sequel.arrays(self)
        tables = self._table.entries, self._memories.entries
        arrays: tuple[Any, ...] = *first, *tables, action, self.weights
        rest = form, command is None, detector, what, count
        if self._serial and not in_python:
            self._call(arrays, rest, 0, self.receivers)
            return

        def work(lo: int, hi: int) -> None:
            if in_python:
                self._attack(command, lo, hi)
            self._call(arrays, rest, lo, hi)

        if self._serial:
            work(0, self.receivers)
        else:
            self._run(work, self.receivers)

    def _memory_table(self, form: int, detector: int) -> ArrayTable:
        arrays: list[NDArray[Any]] = list(self._no_memories.arrays)
        if form != _kernels.NO_FORM:
            memory = self.attack.memory
            arrays[:2] = memory["displacement"], memory["rate"]
            arrays[2:4] = getattr(self.attack, "axes_e", self._no_axes), memory["target_error"]
        if detector in (_kernels.EWMA, _kernels.PASSIVE_EWMA):
            chart, scale = split_scale(self.detector)
            memory, settings = chart.memory, cast("Ewma", chart).kernel_settings
            arrays[4:7] = np.append(settings, scale), memory["average"], memory["decay"]
        if detector != _kernels.NO_FORM:
            arrays[7:] = *self._compiled_verdict(detector)[:3], self._history
        return ArrayTable(arrays)

    def _compiled_verdict(self, detector: int) -> Verdict:
        if detector not in self._verdicts:
            never = detector == _kernels.NEVER
            shape = (self.receivers, 1) if never else self.buffers.visible.shape
            alarm = np.zeros(shape, dtype=np.bool_)
            weights = np.ones(self.ones.shape) if detector == _kernels.EWMA else None
            threshold = np.full(shape, split_scale(self.detector)[1])
            self._verdicts[detector] = Verdict(np.zeros(shape), threshold, alarm, weights)
        return self._verdicts[detector]

    def advance(self) -> Epoch:
        self._first_half(ADVANCE + SHOW, None, False, _kernels.NO_FORM)
        self._augment()
        return self.epoch

    def step(
        self,
        command: FloatArray | None = None,
        *,
        attacked: bool = True,
        sequel: Sequel | None = None,
    ) -> Verdict:
        """Both halves of an epoch, in one kernel where nothing in Python comes between. The
        `sequel` is part of it where nothing in Python comes before it, either."""
        detector = self._compiled_detector()
        if detector == _kernels.NO_FORM:
            return super().step(command, attacked=attacked, sequel=sequel)
        form = self._compiled_attack() if attacked else _kernels.NO_FORM
        within = sequel
        if form == _kernels.NO_FORM:
            within = None
        verdict = self._run_compiled(detector, command, attacked, form, sequel=within)
        if within is None and sequel is not None:
            sequel(self, verdict)
        elif within is not None and _kernels.HOLDS in self._outcomes:
            within.hold(self, verdict)
        return verdict

    @property
    def judges_compiled(self) -> bool:
        return self._compiled_detector() != _kernels.NO_FORM

    def live_epochs(self, count: int, *, holding: bool = False) -> NDArray[np.bool_]:
        detector = self._compiled_detector()
        form = self._compiled_attack() if holding else _kernels.NO_FORM
        if not count or (holding and form == _kernels.NO_FORM) or detector == _kernels.NO_FORM:
            return super().live_epochs(count, holding=holding)
        if len(self._history) < count:
            self._history = np.zeros((count, self.receivers), dtype=np.bool_)
            self._known = _kernels.NO_FORM, 0, None, None
        self._run_compiled(detector, None, holding, form, REMEMBER, count=count)
        return self._history[:count].copy()

    def _run_compiled(
        self,
        detector: int,
        command: FloatArray | None,
        attacked: bool,
        form: int,
        also: int = 0,
        *,
        sequel: Sequel | None = None,
        count: int = 1,
    ) -> Verdict:
        verdict = self._compiled_verdict(detector)
        self.weights = self.ones if verdict.weights is None else verdict.weights
        what = ADVANCE + SHOW + JUDGE + UPDATE + also
        self._outcomes.clear()
        self._first_half(what, command, attacked, form, detector, sequel, count)
        if _kernels.UNSOUND in self._outcomes:
            self.check_converged()
            check_verdict(verdict, self.detector, self.epoch)
        self.check_converged()
        self.verdict = verdict
        return verdict

    def _compiled_detector(self) -> int:
        if self.monitors or self.augmented is not None or "weights" in self.fields:
            return _kernels.NO_FORM
        detector, _ = split_scale(self.detector)
        if type(detector) is Never:
            return _kernels.NEVER
        if type(detector) is not Ewma or detector.limits_exclusions:
            return _kernels.NO_FORM
        return _kernels.PASSIVE_EWMA if detector.weight_scale is None else _kernels.EWMA

    def _run_unseen(self, count: int) -> None:
        if self.augmented is not None:
            for _ in range(count):
                self.advance()
                self._correct(None)
            return
        self._run(partial(self._epochs, ADVANCE + UPDATE + SHOW, count=count), self.receivers)

    def error_n(self) -> FloatArray:
        world, error_n = self.setup.world.at_hand, np.empty((self.receivers, 3))
        truth = world.position_e, world.C_en, self.epochs
        local_error(self.buffers.position_e, *truth, error_n)
        return error_n

    def displacement(self, origin: FloatArray, twin: Self | None, out: FloatArray) -> None:
        setup, memory = self.setup, self.memory
        reference = (setup.true_position, self.sensors.epoch)
        if twin is not None:
            reference = (twin.buffers.position_e, self._all_rows)
        aim = self.sensors.epoch, memory["direction"], setup.target_heading_deg == "worst"
        between = 0, self.receivers
        displace(self.buffers.position_e, *reference, setup.C_en, *aim, origin, out, *between)

    def scored_arrays(self) -> tuple[NDArray[Any], ...]:
        """`step_arrays`, and what `displace` needs to know, for kernels."""
        *now, direction = self.step_arrays()
        return *now, self.buffers.position_e, self.setup.true_position, self.setup.C_en, direction

    def copy_rows(self, to: Rows, other: Self, rows: Rows) -> None:
        self.buffers.copy_rows(to, other.buffers, rows)
        self.sensors.copy_rows(to, other.sensors, rows)
        if self.augmented is not None and other.augmented is not None:
            self.augmented.copy_rows(to, other.augmented, rows)
        super().copy_rows(to, other, rows)
        if self.setup.attack == other.setup.attack:
            self.attack.memory.copy_rows(to, other.attack.memory, rows)
        else:  # begins in these rows; nothing before the onset depends on it
            self.attack.memory.reset(np.isin(self._all_rows, to))
            self._begin_attack(to)

    def report_attack(self) -> dict[str, NDArray[Any]]:
        return self.attack.report(self.sensors.epoch)

    def captured_channels(self) -> NDArray[np.int64]:
        return np.asarray(self.attack.memory["captured"].sum(axis=1))

    def _sky(self) -> SkyData:
        world, epoch, offsets = self.setup.world.at_hand, int(self.epochs[0]), self.sensors
        elevation, azimuth = world.look(self.epochs[:1])
        return SkyData(
            names=world.satellite_ids,
            azimuth=azimuth[0],
            elevation=elevation[0],
            visible=world.visible[epoch],
            spoofed=(offsets.range_offset[0] != 0.0) | (offsets.rate_offset[0] != 0.0),
            weight=self.weights[0, : world.channels].copy(),
        )

    def geometry(self, out: NDArray[np.float32]) -> None:
        world, at = self.setup.world.at_hand, self.epochs
        places = world.satellites[at, :, :3]
        out[:] = look_along(places, world.position_e[at], world.C_en[at], world.visible[at])

    def get_record_columns(self) -> dict[str, NDArray[Any]]:
        offsets = self.sensors
        return {"range_offset_m": offsets.range_offset, "rate_offset_mps": offsets.rate_offset}
