"""Worlds and suites of the options."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from . import options as opt
from .app import progress

if TYPE_CHECKING:
    from ..bench.experiments.suite import Suite
    from ..bench.runs.players import PlayerSpec
    from ..bench.runs.world import World
    from ..bench.search.amplitude import Tuning
    from ..core.registry import Spec

LEFT_OUT = " is left out: "
"""In a note, between the label of a detector and the reason."""
Reports = dict[str, Any] | None
"""Of real input, as `RealInput` has them."""


def state_reality(options: opt.WorldOptions) -> list[str]:
    """What is real of a recorded track, where one is flown."""
    if options.track is None:
        return []
    from ..data.recorded import ONLY_TRAJECTORY

    return [ONLY_TRAJECTORY]


def make_world(options: opt.WorldOptions, task: str | None = None) -> World:
    """The world of the options, or of a task."""
    from ..bench.runs.world import World

    if task is not None:
        refuse_decided(options, "--task", opt.WORLD_OPTIONS)
        return World.of(task)
    decided = _victim(options)[0]
    decided.pop("notes", None)
    return World.of(**decided)


def build_suite(
    options: opt.SuiteOptions,
    detectors: Sequence[str] | None,
    *,
    task: str | None = None,
    nominal: bool = False,
    headline: bool = False,
    standard: bool = False,
    **settings: Any,
) -> tuple[Suite, Reports]:
    """The suite of the options or of a task, and the reports of real input; nothing is looked up.
    `nominal`: published thresholds where none are requested; `headline`: one rate of false alarms,
    and controls, unless a task or an option decides otherwise; `standard`: the standard suite,
    whose controls also play with detectors that are named; `settings`: of the suite."""
    from ..bench.experiments.suite import Suite, standard_kwargs
    from ..detectors.calibrated import STANDARD_RATE
    from ..tasks import get_task

    rate = options.false_alarms_per_hour
    if nominal and rate is not None:
        raise ValueError("--nominal and --false-alarms-per-hour can't both be given")
    settings |= {"entropy": options.seed, "allow_oracles": options.allow_oracles}
    if task is not None:
        refuse_decided(options, "--task", opt.TASK_OPTIONS)
        chosen = get_task(task)
        notes = (f"task {chosen.key} of {chosen.suite}: {chosen.title}",)
        return Suite(**chosen.suite_kwargs, notes=notes, **settings), None
    if rate is None and headline:
        rate = STANDARD_RATE
    thresholds: dict[str, Any] = {} if rate is None else {"false_alarms_per_hour": rate}
    if nominal:
        thresholds = {"thresholds": "nominal"}
    decided, reports = (standard_kwargs(), None) if standard else _victim(options)
    specs = _detectors(decided, detectors, thresholds, headline, standard)
    return Suite(**decided, detectors=specs, **settings), reports


def _detectors(
    decided: Mapping[str, Any],
    texts: Sequence[str] | None,
    thresholds: Spec,
    headline: bool,
    standard: bool,
) -> list[dict[str, Any]] | None:
    """Detectors with the thresholds that are requested; of a headline the usual ones and the
    controls by default, and `all` for all, tests with a drift term a second time, rescaled."""
    from ..bench.experiments.suite import list_standard_detectors, list_world_detectors
    from ..bench.runs.world import CONTROLS, World
    from ..detectors.build import asks

    own = {name: x for name, x in decided.items() if name not in ("notes", "alert_limit_m")}
    world, specs = World.of(**own), opt.parse_specs(texts) if texts else None
    usual: Sequence[Spec] = ()
    if specs is None:  # which flies the world
        usual = list_standard_detectors() if standard else world.default_detectors
    if standard or (headline and specs is None):
        specs = list(usual) if specs is None else specs
        names = {spec["name"] for spec in specs}
        specs = [*(spec for spec in CONTROLS if not names & {spec["name"], "all"}), *specs]
    if headline and any(spec["name"] == "all" for spec in specs or ()):
        named = [spec for spec in specs or () if spec["name"] != "all"]
        names = {spec["name"] for spec in named}
        found = list_world_detectors(world.setup, "false_alarms_per_hour" in thresholds)
        specs = [*named, *(spec for spec in found if spec["name"] not in names)]
    if not thresholds:
        return specs
    return [
        spec if asks(spec) and spec.get("thresholds") != "rescaled" else {**thresholds, **spec}
        for spec in (usual if specs is None else specs)
    ]


def refuse_decided(options: opt.WorldOptions, decider: str, names: Collection[str]) -> None:
    """Raise where an option is given that another one decides."""
    from ..core.registry import refuse_overrides

    refuse_overrides(decider, options.find_passed(names).values())


def calibrate_suite(suite: Suite, detectors: Sequence[str] | None, threads: int | None) -> Suite:
    """A suite whose detectors all have thresholds; of `all`, those that can't are left out."""
    from ..bench.experiments.calibration import calibrate_players

    given = {spec["name"] for spec in opt.parse_specs(detectors or ("all",))}
    labels = [entry.label for entry in suite.detector_players if entry.spec["name"] not in given]
    optional = labels if "all" in given else ()
    refused = calibrate_players(
        suite.world, suite.detector_players, threads=threads, progress=progress, optional=optional
    )
    if refused:
        accepted = [e.spec for e in suite.detector_players if e.label not in refused]
        notes = (*suite.notes, *(f"{label}{LEFT_OUT}{why}" for label, why in refused.items()))
        suite = replace(suite, detectors=accepted, notes=notes)
    suite.check_fit()
    return suite


def leave_uncalibrated(
    suite: Suite, expect: Callable[[PlayerSpec], str] | None
) -> tuple[Suite, str]:
    """A suite without the detectors that have no thresholds, or with what a calibration of each is
    expected to take, where there is an `expect`; and what is to be said of them, "" for none."""
    left = []
    for entry in suite.detector_players:
        try:
            suite.world.judge(entry)
        except ValueError:
            left.append(entry)
    if not left:
        return suite, ""
    if expect is not None:
        each = "; ".join(f"{entry.label}: {expect(entry)}" for entry in left)
        return suite, f"calibrated first, and stored: {each}"
    labels = [entry.label for entry in left]
    note = f"left out, as a quick audit makes no calibration: {', '.join(labels)}"
    accepted = [e.spec for e in suite.detector_players if e.label not in labels]
    return replace(suite, detectors=accepted, notes=(*suite.notes, note)), note


def make_tuning(runs: int, budget: float, **settings: Any) -> Tuning:
    """A search on so many training runs, of which a sixteenth sifts."""
    from ..bench.search.amplitude import Tuning

    try:
        return Tuning(runs=runs, sift_runs=max(runs // 16, 1), budget=budget, **settings)
    except ValueError as error:  # it knows its fields, not the options
        text = str(error).replace("`runs`", "--training-runs")
        raise ValueError(text.replace("`budget`", "--alarm-budget")) from error


def _victim(options: opt.WorldOptions) -> tuple[dict[str, Any], Reports]:
    """Environment, settings of the victim and notes, and the reports of real input."""
    from ..core.registry import parse_setting

    own: dict[str, Any] = {}
    for name, value in map(parse_setting, options.settings or ()):
        if name in own:
            raise ValueError(f"--set {name} is given twice: {own[name]!r} and {value!r}")
        own[name] = value
    decided, reports = _own_options(options, "scenario" in own)
    return {**decided, "settings": own}, reports


def _own_options(options: opt.WorldOptions, other: bool) -> tuple[dict[str, Any], Reports]:
    """Environment and settings that have options of their own, and the reports of real input;
    `other`: whether a scenario is given otherwise."""
    from ..envs.factory import choose_env_id, find_environment
    from ..simulation import TightlyCoupledSetup

    other = other or bool(options.find_passed(("scenario", "track")))
    env = options.env or choose_env_id(["scenario"] if other else [])
    kind, usual = find_environment(env)
    times = {name: x for name in opt.TIMES if (x := getattr(options, name)) is not None}
    decided: dict[str, Any] = {"env": env}
    if times:
        decided["timeline"] = {**usual.get("timeline", {}), **times}
    if kind is not TightlyCoupledSetup:
        for option in options.find_passed(opt.SCENARIO_OPTIONS).values():
            raise ValueError(
                f"{option} is an option of {opt.ENV}, not of {env}, whose settings are given with "
                "--set"
            )
        return decided, None
    if options.tuning is not None:
        decided["receiver"] = {"tuning": options.tuning}
    if options.attack is not None:
        (decided["attack"],) = opt.parse_specs([options.attack])
    scenario, lines, reports = _scenario(options, usual.get("scenario"))
    return {**decided, **scenario, "notes": lines}, reports


def _scenario(
    options: opt.WorldOptions, usual: Any
) -> tuple[dict[str, Any], tuple[str, ...], Reports]:
    """The scenario, where an option changes that of the environment, and the lines and reports of
    real input."""
    from ..truth.scenario import make_scenario

    spec = opt.parse_specs([options.scenario])[0] if options.scenario else usual
    own = {"errors": options.errors, "imu": options.imu}
    own = {key: x for key, x in own.items() if x is not None}
    own = {**({"name": spec} if isinstance(spec, str) else spec or {}), **own}
    if options.track is None and not options.ephemeris:
        of_track = ("from_s", "duration", "day", "aircraft", "altitude_unit", "interpolated")
        for option in options.find_passed(of_track).values():
            raise ValueError(f"{option} is for a recorded track, and needs --track")
        changed = options.find_passed(("scenario", "errors", "imu"))
        return ({"scenario": make_scenario(own)} if changed else {}), (), None
    if options.track is None or not options.ephemeris:
        raise ValueError("--track and --ephemeris belong together: a flight needs its satellites")
    from datetime import date

    from ..data.recorded import real_scenario

    try:
        day = None if options.day is None else date.fromisoformat(options.day)
    except ValueError as error:
        raise ValueError(f"--date must be YYYY-MM-DD, got {options.day!r}") from error
    base = make_scenario(own)
    accepted = ("errors", "imu", "epoch_interval_s", "channels", "mask_deg", "imu_rate_hz")
    real = real_scenario(
        options.track,
        options.ephemeris,
        from_s=options.from_s,
        duration_s=options.duration,
        day=day,
        altitude_unit=options.altitude_unit,
        aircraft=options.aircraft,
        interpolated=options.interpolated,
        **{name: getattr(base, name) for name in accepted},
    )
    return {"scenario": real.scenario}, real.lines, real.reports
