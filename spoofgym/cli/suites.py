"""From the options of a command to a suite of the benchmark."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .options import ENV, SCENARIO_OPTIONS, TASK_OPTIONS, TIMES, World

if TYPE_CHECKING:
    from datetime import date

    from ..bench.entries import Entry
    from ..bench.suite import Suite, Tuning
    from ..sim.scenario import Scenario

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
    world: World, detectors: Sequence[str] | None, *, task: str | None = None, **settings: Any
) -> tuple[Suite, Reports]:
    """The suite of the options or of a task, and the reports of real input.

    `settings`: those of a suite that no task decides.
    """
    from ..bench.suite import Suite
    from ..tasks import SUITE, task_of

    reports = None
    if task is None:
        decided, reports = _victim(world)
        decided["settings"] = _settings(world.settings or ())
        decided["detectors"] = specs_of(detectors) if detectors else None
    else:
        for option in world.given(TASK_OPTIONS).values():
            raise ValueError(f"{option} can't be given with --task, which decides it")
        chosen = task_of(task)
        notes = (f"task {chosen.key} of {SUITE}: {chosen.title}",)
        decided = {**chosen.suite_kwargs, "notes": notes}
    suite = Suite(**decided, **settings)
    suite.check_fit()
    return suite, reports


def tuning_of(runs: int, budget: float) -> Tuning:
    """A search on so many training runs, of which a sixteenth sifts."""
    from ..bench.suite import Tuning

    return Tuning(runs=runs, sift_runs=max(runs // 16, 1), budget=budget)


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
    """Settings by name."""
    from ..bench.specs import parse_setting

    found: dict[str, Any] = {}
    for name, value in map(parse_setting, texts):
        if name in found:
            raise ValueError(f"--set {name} is given twice: {found[name]!r} and {value!r}")
        found[name] = value
    return found
