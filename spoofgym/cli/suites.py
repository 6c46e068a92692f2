"""From the options of a command to a suite of the benchmark."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from .options import ENV, SCENARIO_OPTIONS, SUITE_OPTIONS, TASK_OPTIONS, TIMES, World
from .output import progress

if TYPE_CHECKING:
    from datetime import date

    from ..bench.entries import Entry
    from ..bench.searches import Selection
    from ..bench.specs import Spec
    from ..bench.suite import Suite, Tuning
    from ..sim.scenario import Scenario

OPTIONS_OF = {
    "scenario": ("scenario", "errors", "imu", "track", "ephemeris"),
    "receiver": ("tuning",),
    "timeline": TIMES,
}
"""Options that make settings of the victim, which `--set` may give in their place."""
LEFT_OUT = " is left out: "
"""In a note, between the label of a detector and the reason."""
Reports = dict[str, Any] | None
"""Of real input, as `RealInput` has them."""


def specs_of(texts: Sequence[str]) -> list[dict[str, Any]]:
    """Names and settings; a class of the user's may lie in the working directory."""
    from ..bench.specs import parse_spec

    specs = [parse_spec(text) for text in texts]
    if any(":" in spec["name"] for spec in specs) and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    return specs


def suite_of(
    world: World,
    detectors: Sequence[str] | None,
    *,
    task: str | None = None,
    named: str | None = None,
    asked: Spec | None = None,
    threads: int | None = None,
    headline: bool = False,
    **settings: Any,
) -> tuple[Suite, Reports]:
    """The suite of the options, of a task or by name, calibrated, and the reports of real input.

    `threads`: of the calibration; all else as of `uncalibrated`.
    """
    if named is not None:
        return calibrated(standard_suite(detectors, settings), detectors, threads), None
    given: dict[str, Any] = {"task": task, "asked": asked, "headline": headline, **settings}
    suite, reports = uncalibrated(world, detectors, **given)
    return calibrated(suite, detectors, threads), reports


def calibrated(suite: Suite, detectors: Sequence[str] | None, threads: int | None) -> Suite:
    """A suite whose detectors all have thresholds; of `all`, those that can't are left out."""
    # of what `all` means, those without a calibration are left out
    given = {spec["name"] for spec in specs_of(detectors)} if detectors else {"all"}
    labels = [entry.label for entry in suite.detector_entries if entry.spec["name"] not in given]
    refused = calibrate_with_progress(suite, threads, labels if "all" in given else ())
    if refused:
        kept = [e.spec for e in suite.detector_entries if e.label not in refused]
        notes = (*suite.notes, *(f"{label}{LEFT_OUT}{why}" for label, why in refused.items()))
        suite = replace(suite, detectors=kept, notes=notes)
    suite.check_fit()
    return suite


def uncalibrated(
    world: World,
    detectors: Sequence[str] | None,
    *,
    task: str | None = None,
    asked: Spec | None = None,
    headline: bool = False,
    **settings: Any,
) -> tuple[Suite, Reports]:
    """The suite of the options or of a task, and the reports of real input; nothing is looked up.

    `asked`: of the thresholds of detectors that ask for none of their own, by default nothing;
    `headline`: whether there are negative controls, and a drawn world, where nothing else is asked
    for; `settings`: those of a suite that no task decides.
    """
    from ..bench.suite import Suite
    from ..tasks import SUITE, task_of

    reports = None
    if task is None:
        decided, reports = _victim(world)
        decided["settings"] = own = _settings(world.settings or ())
        for name in {*own} & {*decided}:
            if not world.given(OPTIONS_OF.get(name, (name,))):
                del decided[name]  # its option has its default
        specs = specs_of(detectors) if detectors else None
        if headline:
            specs = _with_controls(world, specs, "false_alarms_per_hour" in (asked or {}))
            if world.env == ENV and world.track is None and "domain" not in own:
                from ..bench.victims import HEADLINE_DOMAIN

                decided["domain"] = HEADLINE_DOMAIN
        decided["detectors"] = specs if asked is None else _asking(world, specs, asked)
    else:
        refuse_decided(world, "--task", TASK_OPTIONS)
        chosen = task_of(task)
        notes = (f"task {chosen.key} of {SUITE}: {chosen.title}",)
        decided = {**chosen.suite_kwargs, "notes": notes}
    return Suite(**decided, **settings), reports


def refuse_decided(world: World, option: str, names: Collection[str]) -> None:
    """Raise where an option is given that another one decides."""
    for given in world.given(names).values():
        raise ValueError(f"{given} can't be given with {option}, which decides it")


def standard_players(
    world: World, name: str, sizes: Mapping[str, int]
) -> tuple[list[str], dict[str, int]]:
    """Spoofers of a suite by its name, and its sizes but for those that are given.

    Raises where there is no such suite, or where an option is given that it decides.
    """
    from .._registry import check_choice
    from ..bench.standard import SIZES, SPOOFERS, SUITES

    check_choice("suite", name, SUITES)
    refuse_decided(world, "--suite", SUITE_OPTIONS)
    given = world.given(SIZES)
    return list(SPOOFERS), {**SIZES, **{key: sizes[key] for key in given}}


def standard_suite(detectors: Sequence[str] | None, settings: dict[str, Any]) -> Suite:
    """The standard suite, with all detectors, or with those that are given and the controls."""
    from ..bench.standard import RATE, everyone_in, in_order, standard_kwargs, standard_world
    from ..bench.suite import Suite
    from ..bench.victims import CONTROLS

    if detectors is None:
        whom = in_order(everyone_in(standard_world().world, rescaled=True))
    else:
        given = specs_of(detectors)
        names = {spec["name"] for spec in given}
        whom = [*(dict(spec) for spec in CONTROLS if spec["name"] not in names), *given]
    specs = [{"false_alarms_per_hour": RATE, **spec} for spec in whom]
    return Suite(**standard_kwargs(), detectors=specs, **settings)


def world_of(world: World, task: str | None = None) -> Suite:
    """A suite for its world, or that of a task, alone: nothing is looked up, and nobody plays."""
    from ..bench.standard import nobody_in
    from ..tasks import task_of

    if task is None:
        return uncalibrated(world, ["never"], spoofers=[])[0]
    refuse_decided(world, "--task", World.__dataclass_fields__)
    return nobody_in(task_of(task).suite_kwargs)


def at_rate(false_alarms_per_hour: float | None) -> Spec | None:
    """What an option asks of the thresholds; None for nothing."""
    if false_alarms_per_hour is None:
        return None
    return {"false_alarms_per_hour": false_alarms_per_hour}


def _asking(world: World, specs: list[dict[str, Any]] | None, asked: Spec) -> list[dict[str, Any]]:
    """Detectors that are asked for some thresholds, but for those that ask for others."""
    from .._registry import check_choice
    from ..bench.victims import VICTIMS
    from ..detectors.asked import asks

    check_choice("environment of the benchmark", world.env, VICTIMS)
    named = list(VICTIMS[world.env].detectors) if specs is None else specs
    free = [not asks(spec) or spec.get("thresholds") == "rescaled" for spec in named]
    return [{**asked, **spec} if any_ else spec for spec, any_ in zip(named, free, strict=True)]


def _with_controls(
    world: World, specs: list[dict[str, Any]] | None, rescaled: bool
) -> list[dict[str, Any]]:
    """Detectors of a headline: the usual ones and the controls by default, `all` for all.
    `rescaled`: whether tests with a drift term are among all a second time, rescaled."""
    from .._registry import check_choice
    from ..bench.standard import everyone_in
    from ..bench.victims import CONTROLS, VICTIMS

    check_choice("environment of the benchmark", world.env, VICTIMS)
    if specs is None:
        return [*CONTROLS, *VICTIMS[world.env].detectors]
    if not any(spec["name"] == "all" for spec in specs):
        return specs
    named = [spec for spec in specs if spec["name"] != "all"]
    given = {spec["name"] for spec in named}
    found = everyone_in(world_of(world).world, rescaled)
    return [*named, *(spec for spec in found if spec["name"] not in given)]


def calibrate_with_progress(
    suite: Suite, threads: int | None, optional: Collection[str] = ()
) -> dict[str, str]:
    """Calibrate the detectors that ask for a rate of false alarms, and show how far that is.

    `optional`: labels of those that may have no calibration; returns why, by their labels.
    """
    from ..bench.calibrations import calibrate_suite, missing_runs

    if left := missing_runs(suite):
        with progress(left) as bar:
            return calibrate_suite(suite, threads=threads, progress=bar, optional=optional)
    return calibrate_suite(suite, threads=threads, optional=optional)


def tuning_of(runs: int, budget: float) -> Tuning:
    """A search on so many training runs, of which a sixteenth sifts."""
    from ..bench.suite import Tuning

    try:
        return Tuning(runs=runs, sift_runs=max(runs // 16, 1), budget=budget)
    except ValueError as error:  # it knows its fields, not the options
        text = str(error).replace("`tuning.runs`", "--training-seeds")
        raise ValueError(text.replace("`tuning.budget`", "--budget")) from error


def selection_of(runs: int) -> Selection | None:
    """A search for the worst attack on so many runs, of which a quarter sifts; None for none."""
    from ..bench.searches import Selection

    return Selection(runs=runs, sift_runs=max(runs // 4, 1)) if runs else None


def untuned(suite: Suite) -> Entry:
    """The suite's own spoofer, which has to know all its settings."""
    player = suite.spoofer_entries[-1]
    if player.tuned:
        raise ValueError(
            f"`{player.tuned}` = tuned needs a search: take the value that `spoofgym tune` finds"
        )
    return player


def _victim(world: World) -> tuple[dict[str, Any], Reports]:
    """Environment and settings that have options of their own, and the reports of real input."""
    if world.env != ENV:
        for option in world.given(SCENARIO_OPTIONS).values():
            raise ValueError(
                f"{option} is an option of {ENV}, not of {world.env}, whose settings are "
                "given with --set"
            )
        times = {name: getattr(world, name) for name in world.given(TIMES)}
        return {"env": world.env, **({"timeline": times} if times else {})}, None
    scenario, lines, reports = _scenario(world)
    (attack,) = specs_of([world.attack])
    return {
        "env": world.env,
        "scenario": scenario,
        "receiver": {"tuning": world.tuning},
        "attack": attack,
        "timeline": {name: getattr(world, name) for name in TIMES},
        "notes": lines,
    }, reports


def _scenario(world: World) -> tuple[Scenario, tuple[str, ...], Reports]:
    """The scenario, and the lines and reports of real input."""
    from ..sim.scenario import make_scenario

    (spec,) = specs_of([world.scenario])
    own = {"errors": world.errors, "imu": world.imu}
    named = {**spec, **{name: value for name, value in own.items() if value is not None}}
    if world.track is None and world.ephemeris is None:
        cuts = {"--from": world.from_s, "--duration": world.duration, "--date": world.day}
        for option, value in cuts.items():
            if value is not None:
                raise ValueError(f"{option} cuts a recorded track; there is no --track")
        return make_scenario(named), (), None
    if world.track is None or world.ephemeris is None:
        raise ValueError("--track and --ephemeris belong together: a flight needs its satellites")
    from ..bench.real import real_scenario

    usual = make_scenario(named)
    kept = ("errors", "imu", "epoch_interval_s", "channels", "mask_deg", "imu_rate_hz")
    real = real_scenario(
        world.track,
        world.ephemeris,
        from_s=world.from_s,
        duration_s=world.duration,
        day=None if world.day is None else _day(world.day),
        **{name: getattr(usual, name) for name in kept},
    )
    return real.scenario, real.lines, real.reports


def _day(text: str) -> date:
    from datetime import date

    try:
        return date.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"--date must be YYYY-MM-DD, got {text!r}") from error


def _settings(texts: Sequence[str]) -> dict[str, Any]:
    from ..bench.specs import parse_setting

    found: dict[str, Any] = {}
    for name, value in map(parse_setting, texts):
        if name in found:
            raise ValueError(f"--set {name} is given twice: {found[name]!r} and {value!r}")
        found[name] = value
    return found
