"""What a campaign runs: detectors and spoofers, their world, and how settings are searched for."""

from __future__ import annotations

import dataclasses
import json
import uuid
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from importlib.resources import files
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np

from ... import __version__
from ...attacks import Attack
from ...calibration.thresholds import suitable_detectors
from ...core.declared import setting, settings_record
from ...core.registry import check_choice
from ...core.settings import compute_digest, outside_sources
from ...detectors import Detector, OperatingPoint
from ...detectors.build import spec_of_judge
from ...detectors.calibrated import STANDARD_RATE
from ...policies.onnx_file import SUFFIX
from ...simulation.domain import Domain
from ...simulation.setup import SPLITS, Setup, Timeline
from ...spoofers import Spoofer
from ...tasks import (
    DEFAULT_TASK,
    DETECTOR_TASKS,
    RANGE_RATE_TESTS,
    DetectorTask,
    Task,
    get_task,
)
from ...truth.scenario import Scenario
from ..runs.players import (
    DEFAULT_SPOOFERS,
    PlayerSpec,
    add_tuned_setting,
    check_labels,
    fitting,
    oracle_labels,
    refuse_oracles,
    specify_detector,
    specify_spoofer,
)
from ..runs.world import CONTROLS, WORLD, World
from ..search import attack_suite
from ..search.amplitude import EXACT, Tuning
from ..search.bounds import DisplacementBounds
from ..search.open_loop import Optima

ALERT_LIMIT_M = 40.0
"""Horizontal alert limit of an approach with vertical guidance (`icao-annex10`)."""
ALERT_LIMITS_M = (5.0, 10.0, 20.0, ALERT_LIMIT_M, 80.0, 160.0, 320.0, 556.0)
"""Alert limits of a campaign besides its own; 556 m is that of a non-precision approach."""

FILE, DETECTOR_FILE = "task_cards.json", "detector_cards.json"
"""Stored scores of the tasks; made by `tools.task_cards` and `tools.detector_cards`."""


@settings_record(frozen=True, kw_only=True)
class Suite:
    """What a campaign runs."""

    env: str | None = setting(
        default=None,
        help="Environment; the settings below are put on top of its own. By default the default "
        "one, or with a `scenario` one of the victim's defaults.",
    )
    scenario: str | Mapping[str, Any] | Scenario | None = setting(
        default=None, help="Flight of the victim, where its environment has one to choose."
    )
    receiver: str | Mapping[str, Any] | None = setting(
        default=None, help="Receiver, as the environment takes it."
    )
    attack: str | Mapping[str, Any] | Attack | None = setting(
        default=None, help="What the spoofer can do, where the environment has it to choose."
    )
    timeline: Mapping[str, float] | Timeline | None = setting(
        default=None, help="Times of a run, as the environment takes them."
    )
    domain: Mapping[str, Any] | Domain | None = setting(
        default=None, help="What is drawn for every run, as the environment takes it."
    )
    target_heading_deg: float | str | None = setting(
        default=None,
        unit="deg",
        help="Target direction, as the environment takes it; the score counts any direction.",
    )
    decision_interval_s: float | None = setting(
        default=None, above=0.0, unit="s", help="Time between two decisions of the spoofer."
    )
    between: str | None = setting(
        default=None, help="What is commanded between decisions, as the environment takes it."
    )
    settings: Mapping[str, Any] = setting(
        default_factory=dict, help="Further settings of the victim."
    )
    detectors: Sequence[str | Mapping[str, Any] | Detector] | None = setting(
        default=None,
        help="As `specify_detector` takes them; by default those that suit the victim.",
    )
    spoofers: Sequence[str | Mapping[str, Any] | Spoofer] | None = setting(
        default=None,
        help="As `specify_spoofer` takes them; ``none`` is always among them. By default "
        "`DEFAULT_SPOOFERS` and the shipped spoofers that were made for such attacks.",
    )
    runs: int = setting(
        default=200, least=2, help="Evaluation runs of every cell, the same for all."
    )
    entropy: int = setting(default=0, least=0, help="Seed of the random number generators.")
    tuning: Tuning = setting(
        default_factory=Tuning, help='Search for the settings that are ``"tuned"``.'
    )
    alert_limit_m: float = setting(
        default=ALERT_LIMIT_M,
        above=0.0,
        unit="m",
        help="Undetected displacement of which tables show how often it is exceeded; by default "
        "the horizontal alert limit of an approach with vertical guidance.",
    )
    notes: Sequence[str] = setting(
        default=(), help="Where the scenario comes from, for the report."
    )
    allow_oracles: bool = setting(
        default=False,
        help="Whether detectors may play that know the attack; the report then says which ones do.",
    )
    selection: attack_suite.Selection | None = setting(
        default=None,
        help="Search for the worst attack of the attack suite, by which detectors are protected; "
        "None for none.",
    )
    floor_worlds: int | None = setting(
        default=None, least=1, help="Worlds of the floor; by default one under every sky."
    )
    floor: Mapping[str, Any] | None = setting(
        default=None, help="Floor of the world as `find_stored_floor` has it; None to compute it."
    )
    curves: Mapping[str, Sequence[float]] | None = setting(
        default=None,
        unit="m/s",
        help="Rates at the knots of open-loop attacks, by the labels of the detectors that they "
        "were found against; these are not searched again.",
    )

    def __post_init__(self) -> None:
        _ = self.world  # which raises where a setting is not one of the victim's
        for entries in (self.detector_players, self.spoofer_players):
            check_labels(entries)
        if not self.detector_players:
            raise ValueError("a campaign needs at least one detector")
        if not self.allow_oracles:
            refuse_oracles(self.detector_players)

    @cached_property
    def world(self) -> World:
        return World.of(**{name: getattr(self, name) for name in ("env", *WORLD, "settings")})

    @property
    def fit_runs(self) -> int:
        """Runs that an amplitude is fitted on."""
        return self.runs if self.tuning.rule == EXACT else self.tuning.runs

    @cached_property
    def detector_players(self) -> tuple[PlayerSpec, ...]:
        """Detectors in their order."""
        specs = self.world.default_detectors if self.detectors is None else self.detectors
        return tuple(specify_detector(spec) for spec in specs)

    @property
    def alert_limits_m(self) -> list[float]:
        """Alert limits by which detectors are compared."""
        return sorted({*ALERT_LIMITS_M, float(self.alert_limit_m)})

    @cached_property
    def spoofer_players(self) -> tuple[PlayerSpec, ...]:
        """Spoofers in their order, ``none`` first."""
        specs = self.spoofers
        if specs is None:
            specs = (*DEFAULT_SPOOFERS, *map(add_tuned_setting, self._fitting_spoofers[0]))
        entries = [specify_spoofer(spec) for spec in specs]
        none = specify_spoofer("none")
        return (none, *(entry for entry in entries if entry != none))

    @cached_property
    def _fitting_spoofers(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Shipped spoofers that fit, and why others do not."""
        return fitting(self.world.setup)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Which shipped spoofers do not fit, and why, by default; a line each."""
        return self._fitting_spoofers[1] if self.spoofers is None else ()

    def check_fit(self) -> None:
        """As `World.check_fit`, of all detectors and spoofers."""
        self.world.check_fit(self.detector_players, self.spoofer_players)

    def setup(self, detector: PlayerSpec, spoofers: Sequence[PlayerSpec] | None = None) -> Setup:
        """As `World.build_setup`. `spoofers`: those that play, all of the suite's by default."""
        return self.world.build_setup(
            detector, self.spoofer_players if spoofers is None else spoofers
        )

    def generators(self, split: str, runs: int, first: int = 0) -> list[np.random.Generator]:
        """Generators of the runs of a split, from `first` on."""
        return self.world.generators(self.entropy, split, runs, first)

    def build_bounds(self, **settings: int) -> DisplacementBounds:
        """Floor and zero-alarm bounds; `settings`: ``worlds`` of `Brackets`."""
        return DisplacementBounds(
            self.world,
            self.detector_players,
            self.entropy,
            self.tuning.budget,
            floor_worlds=self.floor_worlds,
            **settings,
        )

    def optima(self, threads: int | None = None) -> Optima:
        """Searches for optimized open-loop attacks."""
        players, limit = self.spoofer_players, float(self.alert_limit_m)
        bounds = self.build_bounds()
        return Optima(bounds, self.tuning, players, threads, limit, stored=self.curves)

    @cached_property
    def _points(self) -> dict[str, list[OperatingPoint]]:
        """Operating points of the detectors that request a rate."""
        found = {entry.label: self.world.points(entry) for entry in self.detector_players}
        return {label: points for label, points in found.items() if points}

    @property
    def captions(self) -> tuple[str, ...]:
        """Operating points of detectors that request a rate: per hour and per run; a line each."""
        return tuple(
            f"{label}: {'; '.join(sorted({str(point) for point in points}))}"
            for label, points in self._points.items()
        )

    @cached_property
    def config(self) -> dict[str, Any]:
        """Everything that the results depend on, JSON-able. What comes from outside of spoofgym is
        there by digests of its sources. Where one can't be read, a number of this suite alone is in
        its place, so that no other one takes up its results; this is warned of."""
        judges = [entry.build() for entry in self.detector_players]
        players = [entry.build() for entry in self.spoofer_players]
        outside = outside_sources(*judges, *players, *self.world.parts)
        unknown = [
            f"the source of {name} can't be read: its results are never taken up again"
            for name, digest in outside.items()
            if digest is None
        ]
        for line in unknown:
            warnings.warn(line, UserWarning, stacklevel=2)
        oracles = oracle_labels(self.detector_players)
        seeing = (f"{label} is an oracle: it knows the attack" for label in oracles)
        return {
            "spoofgym": __version__,
            "outside": {
                _strip_folder(name): d or f"unknown, {uuid.uuid4().hex}"
                for name, d in outside.items()
            },
            **self.world.config,
            "detectors": _without_folders(each.as_config() for each in self.detector_players),
            "spoofers": _without_folders(each.as_config() for each in self.spoofer_players),
            "calibrations": {x: [p._asdict() for p in each] for x, each in self._points.items()},
            "never_alarm": [
                player.label
                for player, judge in zip(self.detector_players, judges, strict=True)
                if not judge.calibrates
            ],
            "runs": self.runs,
            "entropy": self.entropy,
            "splits": dict(SPLITS),
            "tuning": self.tuning.as_dict(),
            "attack_suite": self._attack_suite(),
            "alert_limit_m": float(self.alert_limit_m),
            "alert_limits_m": list(ALERT_LIMITS_M),
            **({} if self.floor_worlds is None else {"floor_worlds": self.floor_worlds}),
            **({} if self.floor is None else {"floor": dict(self.floor)}),
            **({} if self.curves is None else {"curves": dict(self.curves)}),
            "notes": [*self.notes, *self.captions, *seeing, *self.left_out, *unknown],
        }

    @cached_property
    def suite_attacks(self) -> tuple[attack_suite.SuiteAttack, ...]:
        """Attacks of the attack suite that fit the victim."""
        return attack_suite.list_fitting_attacks(self.world.setup, self.world.context)

    def _attack_suite(self) -> dict[str, Any] | None:
        """Name, version and search of the attack suite; None where it is not played."""
        if self.selection is None:
            return None
        return {
            "name": attack_suite.NAME,
            "version": attack_suite.VERSION,
            "digest": attack_suite.suite_digest(self.suite_attacks),
            **dataclasses.asdict(self.selection),
        }

    @cached_property
    def digest(self) -> str:
        """Digest of `config`; ONNX files count by their content, wherever they are."""
        return compute_digest(self.config)


def _strip_folder(name: str) -> str:
    """Name of an outside source: of an ONNX file or its card without the folder."""
    path = PurePath(name)
    return path.name if path.suffix in (SUFFIX, ".json") else name


def _without_folders(value: Any) -> Any:
    """Settings with paths of ONNX files by their last part."""
    if isinstance(value, Mapping):
        return {key: _without_folders(item) for key, item in value.items()}
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_without_folders(item) for item in value]
    return PurePath(value).name if isinstance(value, str) and value.endswith(SUFFIX) else value


RATE = STANDARD_RATE
"""False alarms an hour of all detectors."""
SPOOFERS = ("ramp", "accelerating-ramp", "open-loop", "feedback")
"""Each is fitted to the alarm budget."""
RATE_TESTS = ("aime", "cumulative-bank", "sequential-chi2", "shewhart")
TESTS = ("ewma", "joint-chart", "snapshot-chi2", "raim")
"""Detectors of the standard suite, by range rates and by ranges."""


class Budget(NamedTuple):
    """How much is played: runs that are scored, that tune, and that choose the worst attack (0 for
    none), whether searches are quick, and worlds of the floor (None for one under every sky)."""

    runs: int
    training_runs: int
    selection_runs: int
    quick: bool = False
    floor_worlds: int | None = None


BUDGETS = {
    "quick": Budget(64, 64, 16, True, 2),
    "standard": Budget(256, 256, 48),
    "full": Budget(1000, 256, 192),
}


def get_budget(name: str, **sizes: int | None) -> Budget:
    """Budget by its name, with sizes that are not None in place of its own."""
    check_choice("budget", name, BUDGETS)
    given: dict[str, Any] = {key: x for key, x in sizes.items() if x is not None}
    return BUDGETS[name]._replace(**given)


def list_world_detectors(setup: Setup, rescaled: bool = False) -> list[dict[str, Any]]:
    """The controls and all classics that suit a world; `rescaled`: also with their innovations."""
    found = [dict(each) for each in CONTROLS]
    for each in suitable_detectors(setup):
        own = {"name": spec_of_judge(each)["name"]}
        if own not in found:
            found.append(own)
        if rescaled and each.drifts:
            found.append({**own, "thresholds": "rescaled"})
    return found


def stored_cards(file: str = FILE) -> dict[str, dict[str, Any]]:
    """Cards by the keys of the tasks; those that have not been played are absent."""
    found: dict[str, Any] = json.loads(files("spoofgym.bench").joinpath(file).read_bytes())
    return found


def find_task_card(task: DetectorTask) -> dict[str, Any]:
    """What is stored of the task for spoofers that has the same world; nothing of a task of your
    own."""
    return stored_cards().get(task.task.key, {}) if task.key in DETECTOR_TASKS else {}


def find_stored_floor(task: DetectorTask) -> dict[str, Any] | None:
    """Floor of a task's world, and what it assumes; None where it is not stored."""
    card = find_task_card(task)
    return {x: card[x] for x in ("floor_m", "assumptions")} if "floor_m" in card else None


def list_task_detectors(task: Task) -> list[dict[str, Any]]:
    """Controls, and all classics that suit a task's world: solution separation with the task's
    bank, also on the victim's filter, then tests of range rates, and others; tests with a drift
    term also with rescaled innovations."""
    bank = next(each for each in task.detectors if each["name"] == "solution-separation")
    bank = {key: value for key, value in bank.items() if key != "false_alarms_per_hour"}
    plain = {key: value for key, value in bank.items() if key != "filter"}
    found = [*map(dict, CONTROLS), bank, *([plain] if plain != bank else [])]
    found += map(dict, RANGE_RATE_TESTS)
    known = [{"name": each["name"]} for each in found[: -len(RANGE_RATE_TESTS)]]
    everyone = list_world_detectors(World(settings=task.world_kwargs).setup, rescaled=True)
    return [*found, *(spec for spec in everyone if spec not in known)]


def list_standard_detectors(task: Task | None = None) -> list[dict[str, Any]]:
    """Detectors of the standard suite: the controls, solution separation with the task's bank, also
    on the victim's filter, and one or two tests of each kind."""
    bank, plain, *others = list_task_detectors(task or get_task(DEFAULT_TASK))[len(CONTROLS) :]
    rates = [each for each in others if "signals" in each and each["name"] in RATE_TESTS]
    return [*map(dict, CONTROLS), bank, plain, *rates, *({"name": name} for name in TESTS)]


def standard_kwargs(task: Task | DetectorTask | None = None) -> dict[str, Any]:
    """Keyword arguments of a `Suite`, but for its detectors, by default in the default task."""
    task = task or get_task(DEFAULT_TASK)
    limit = {} if task.alert_limit_m is None else {"alert_limit_m": task.alert_limit_m}
    note = f"suite standard: the world of task {task.key} of {task.suite}"
    return {**task.world_kwargs, **limit, "notes": (note,)}
