"""Zero-alarm bounds of a detector over the worlds that a setup draws.

Two for each: of a *free* attack, which may do anything to the measurements, and of an attack within
the limits of the setup's own, a false position along one heading.  Both are means over worlds, as
what they bound is a mean: the displacement of any spoofer, feedback included, averaged over runs.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..detectors import Calibrated, Detector, SolutionSeparation
from ..detectors.base import FloatArray
from ..simulation.setup import generators_of, seeds_of_runs
from ..simulation.tight import TightlyCoupledSetup
from .floor import check_linear_victim
from .linear import (
    Commands,
    LinearRun,
    observer,
    record,
    respond,
    unit_commands,
    unused_seed,
)
from .no_alarm import Timing
from .restricted import Attacker, zero_alarm_of
from .zero_alarm import Bound

Tick = Callable[[float], None]
HATS = 24
"""Hat functions of the rate of a restricted attack."""
ASSUMPTIONS = (
    "a zero-alarm bound is of the mean displacement over runs, in one direction, of any spoofer, "
    "feedback included; of no quantile and no single run",
    "the gains of the filter stay as they are, to first order around a clean run; an alarm that "
    "noise raises counts against nobody",
    "a free attack may do anything to the measurements; a restricted one is a false position along "
    "one heading, within the limits of the world's own attack",
)
"""Under which a zero-alarm bound holds, printed with every figure."""


class Case(NamedTuple):
    """One drawn world: the victim's filter, its response to commands, its seed."""

    run: LinearRun
    attacker: Attacker | None
    seed: np.random.SeedSequence


class ZeroAlarm(NamedTuple):
    """Bounds of one detector.

    - `free_m`, `restricted_m`: means over the worlds [m]; infinite where there is none; None where
      nothing is known;
    - `kind`: of the restricted one, or of the free one where there is no other: ``"exact"``,
      ``"upper"`` or ``"unbounded"``;
    - `why`: why nothing is known, and what holds instead, or why it is an upper bound; or "";
    - `rates_mps`: (W, Q) rates of the restricted attacks at equally spaced times.
    """

    free_m: float | None
    restricted_m: float | None
    kind: str
    why: str
    rates_mps: list[FloatArray]

    def as_json(self) -> dict[str, Any]:
        """JSON-able; infinities as the word "unbounded"."""
        sizes = {"free_m": self.free_m, "restricted_m": self.restricted_m}
        words = {key: "unbounded" if value == math.inf else value for key, value in sizes.items()}
        return {**words, "kind": self.kind, "why": self.why}


def cases_of(
    setup: TightlyCoupledSetup, worlds: int, entropy: int = 0, tick: Tick | None = None
) -> list[Case]:
    """Worlds of a setup, drawn as by `frontier_of`."""
    check_linear_victim(setup)
    advance = tick or (lambda part: None)
    seeds = seeds_of_runs(entropy, "selection", setup.name, range(worlds))
    cases = []
    for seed in seeds:
        run = record(setup, generators_of([unused_seed(seed)]))[0]
        commands = unit_commands(setup, run.onset).in_hats(HATS)
        cases.append(Case(run, along(commands, run, heading_of(setup)), seed))
        advance(1.0 / worlds)
    return cases


def heading_of(setup: TightlyCoupledSetup) -> float:
    """Where scripted spoofers push: the target direction, or east where that is drawn [rad]."""
    fixed = setup.target_heading_deg
    return math.pi / 2.0 if isinstance(fixed, str) else math.radians(fixed)


def along(commands: Commands, run: LinearRun, heading: float) -> Attacker | None:
    """An attack along one heading, within its limits; None where it moves no position."""
    if commands.heading is None or np.any(commands.idle):
        return None
    aim = commands.heading @ np.array([math.cos(heading), math.sin(heading)])
    each = commands.offsets.reshape(*commands.offsets.shape[:2], -1, commands.axes)
    hats = np.eye(commands.decisions) if commands.hats is None else commands.hats
    limits = commands.rate_limit_mps, commands.change_limit_mps
    return Attacker(respond(run, each @ aim), hats[:, None, :], *limits)


def zero_alarm_bounds(
    setup: TightlyCoupledSetup,
    detector: Detector,
    cases: Sequence[Case],
    tick: Tick | None = None,
) -> ZeroAlarm:
    """Bounds of a detector whose factors are known; why there are none is in the result."""
    advance = tick or (lambda part: None)
    inner = detector.detector if isinstance(detector, Calibrated) else detector
    if isinstance(inner, SolutionSeparation):
        return _separation(setup, detector, inner, cases)
    timing, last = Timing.of(setup), setup.steps - 1
    heading = heading_of(setup)
    direction = (math.cos(heading), math.sin(heading))
    free, restricted = Bounds([]), Bounds([])
    try:
        for run, attacker, _ in cases:
            bound = partial(zero_alarm_of, detector, run, timing, epoch=last, direction=direction)
            free.add(bound)
            if attacker is not None:
                restricted.add(partial(bound, attacker=attacker))
            advance(1.0 / len(cases))
    except (ValueError, ImportError) as error:
        return ZeroAlarm(None, None, "", str(error), [])
    of = {"free": free, "restricted": restricted}
    why = "; ".join(f"{name}: {note}" for name, each in of.items() for note in each.notes)
    rates = [each.commands for each in restricted.known if each.commands is not None]
    return ZeroAlarm(free.mean_m, restricted.mean_m, restricted.kind or free.kind, why, rates)


class Bounds(NamedTuple):
    """Bounds of one attack by world, or what the solver said where it found none."""

    found: list[Bound | str]

    def add(self, bound: Callable[[], Bound]) -> None:
        try:
            self.found.append(bound())
        except RuntimeError as error:
            self.found.append(str(error))

    @property
    def known(self) -> list[Bound]:
        return [each for each in self.found if isinstance(each, Bound)]

    @property
    def mean_m(self) -> float | None:
        """Mean over the worlds [m]; None where one of them has none, or there is none."""
        if not self.found or len(self.known) < len(self.found):
            return None
        return float(np.mean([each.value_m for each in self.known]))

    @property
    def kind(self) -> str:
        """The weakest kind of the worlds; "" where there is no mean."""
        kinds = {each.kind for each in self.known} if self.mean_m is not None else set()
        return next((kind for kind in ("unbounded", "upper", "exact") if kind in kinds), "")

    @property
    def notes(self) -> list[str]:
        """Notes on any of the worlds, each once."""
        every = [each.note if isinstance(each, Bound) else each for each in self.found]
        return [note for note in dict.fromkeys(every) if note]


def _separation(
    setup: TightlyCoupledSetup,
    detector: Detector,
    inner: SolutionSeparation,
    cases: Sequence[Case],
) -> ZeroAlarm:
    """Bound of solution separation: its threshold in metres, at the end of the command phase. It
    shifts by the induced error of any attack, so that the bound is the same for a free one; it is
    an upper one, since a bank has other solutions, too."""
    scale = detector.scale if isinstance(detector, Calibrated) else 1.0
    if scale is None:
        raise ValueError("the factor on the thresholds is not known yet")
    bounds = []
    for case in cases:
        simulator = observer(setup, 1, inner.needs)
        simulator.begin(generators_of([unused_seed(case.seed)]))
        bank = copy.deepcopy(inner)
        simulator.bind_detector(bank)
        simulator.quiet_epochs(setup.quiet)
        for _ in range(setup.live + setup.steps):
            bank.judge(simulator.advance())
            simulator.update(None)
        attack_s = setup.steps * setup.interval_s
        bounds.append(math.sqrt(scale) * float(bank.bound_m(attack_s)[0]))
    mean = float(np.mean(bounds))
    return ZeroAlarm(mean, mean, "upper" if math.isfinite(mean) else "unbounded", "", [])
