"""Calibration of detectors on clean runs of a world."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import typer
from typer import Option

from ..core.reading import parse_json
from . import options as opt
from .app import print_json, print_lines, progress
from .options import WorldOptions, with_options
from .suites import make_world, state_reality

if TYPE_CHECKING:
    from ..bench.runs.world import World
    from ..calibration.holdouts import HoldOut
    from ..detectors import Calibration, Detector


@with_options
def calibrate(
    *,
    detector: list[str] | None = Option(
        None,
        help="Detector, may be repeated; an .onnx file, too; `all` for all that suit the "
        f"victim. Default: those of the benchmark. {opt.SPEC_HELP} Exit status 1 where a "
        "named one can't be calibrated.",
    ),
    runs: int | None = Option(
        None,
        min=1,
        max=opt.LARGEST_RUNS,
        help="Clean runs. Default: 20000 for all passive detectors, 2000 for each one "
        "that de-weights.",
    ),
    false_alarms_per_hour: float = Option(
        0.2, help="Rate of false alarms to find thresholds for, per hour without attack."
    ),
    rescaled: bool = Option(
        False, "--rescaled", help="Scale innovations to the filter's variance, for cumulative sums."
    ),
    hold_out: int | None = Option(
        None, min=1, max=opt.LARGEST_RUNS, help="Count alarms on this many fresh runs."
    ),
    transfer: list[str] | None = Option(
        None,
        help="Another world to count alarms in, may be repeated: a scenario, or settings of "
        "the victim that differ, as a JSON object. On as many runs as --hold-out, or 1000.",
    ),
    check: bool = Option(False, "--check", help="Replay stored runs; fail where they now differ."),
    overwrite: bool = Option(False, "--overwrite", help="Replace calibrations that exist."),
    task: str | None = Option(None, help="World of a task, S1 to S3 or T1 to T6."),
    device: opt.Device = "cpu",
    as_json: opt.Json = False,
    options: WorldOptions,
    seed: opt.Seed = 0,
    threads: opt.Threads = None,
) -> None:
    """Calibrate thresholds to a false-alarm rate on attack-free runs (resumable)."""
    from ..bench.experiments import calibration
    from ..bench.report.results import CALIBRATIONS, print_hold_outs
    from ..calibration.holdouts import HOLDOUT_WEIGHING
    from ..calibration.holdouts import check as replay
    from ..detectors.calibration_file import TOLERANCE

    played = make_world(options, task)
    setup, rate = played.setup, false_alarms_per_hour
    judges, named = _judges(detector, played, rescaled)
    others = {text: _other(played, text) for text in transfer or ()}
    request: dict[str, Any] = {"runs": runs, "false_alarms_per_hour": rate, "rescaled": rescaled}
    settings: dict[str, Any] = {"threads": threads, "progress": progress, "device": device}
    found = calibration.calibrate(
        setup, judges, **request, **settings, entropy=seed, overwrite=overwrite, strict=False
    )
    made, lines, sound = _points(found, judges, rate)
    lines += state_reality(options)
    if check:
        replay(setup, found, judges, threads=threads)
        lines.append(f"replayed: {len(found)} calibrations hold, to {TOLERANCE:g} of every maximum")
    usable = [found[k] for k in sound], [judges[k] for k in sound]
    counted: dict[str, list[HoldOut]] = {}
    settings["false_alarms_per_hour"] = rate
    if hold_out is not None and sound:
        counted["hold-out"] = calibration.hold_out(setup, *usable, runs=hold_out, **settings)
    for text, other in others.items() if sound else ():
        count = hold_out or HOLDOUT_WEIGHING
        counted[f"in {text}"] = calibration.transfer(other, *usable, runs=count, **settings)
    if as_json:
        print_json(
            {
                "world": setup.conditions.settings,
                "window_s": setup.window_s,
                "calibrations": made,
                "notes": lines,
                **{title: [one.as_dict() for one in each] for title, each in counted.items()},
            }
        )
    else:
        CALIBRATIONS.print(f"{setup.name}: thresholds for {rate:g} false alarms an hour", made)
        print_lines(lines)
        for title, each in counted.items():
            print_hold_outs(f"{setup.name}: {title}", each)
    if not named <= set(sound):
        raise typer.Exit(1)


def _judges(
    texts: Sequence[str] | None, world: World, rescaled: bool
) -> tuple[list[Detector], set[int]]:
    """Detectors, and which of them were named; they may not request thresholds. Those that never
    alarm are left out, and of `all` those that can't be rescaled."""
    from ..calibration.thresholds import inner_detectors, suitable_detectors
    from ..detectors.build import THRESHOLD_KEYS
    from ..detectors.calibrated import describe_identity

    specs: list[Any] = opt.parse_specs(texts) if texts else list(world.default_detectors)
    named: list[Any] = []
    offered: list[Any] = []
    for spec in specs:
        request = [key for key in THRESHOLD_KEYS if key in spec]
        if texts and request:
            raise ValueError(
                f"--detector {spec['name']} has `{request[0]}`, which this command "
                "computes: give the rate by --false-alarms-per-hour"
            )
        if spec["name"] == "all":
            fit = suitable_detectors(world.setup)
            offered += [each for each in fit if each.drifts or not rescaled]
        else:
            named.append(spec)
    judges = inner_detectors([*named, *offered])
    if not judges:
        raise ValueError("there is no detector to calibrate: one that never alarms has no rate")
    words = {repr(describe_identity(each)) for each in inner_detectors(named)} if texts else set()
    return judges, {k for k, each in enumerate(judges) if repr(describe_identity(each)) in words}


def _other(world: World, text: str) -> Any:
    """Another world: settings of this one that differ."""
    from ..core.registry import check_keywords

    if text.lstrip().startswith("{"):
        changed = parse_json(text, f"--transfer {text[:200]!r}")
    else:
        (changed,) = ({"scenario": spec} for spec in opt.parse_specs([text]))
    known = inspect.signature(world.kind).parameters
    settings = [name for name in known if name != "detector"]
    check_keywords(f"the world of --transfer {text}", changed, settings)
    found = world.copy_with(**changed).setup
    if found.conditions.digest == world.setup.conditions.digest:
        raise ValueError(f"--transfer {text!r} is the same world: that is what --hold-out counts")
    return found


def _points(
    found: Sequence[Calibration], judges: Sequence[Detector], rate: float
) -> tuple[list[dict[str, Any]], list[str], list[int]]:
    """Operating points, notes, and which detectors have one."""
    from ..detectors.calibrated import NOISY_WARMUP, noisy_warmup

    points: list[dict[str, Any]] = []
    lines: list[str] = []
    sound: list[int] = []
    for k, (each, judge) in enumerate(zip(found, judges, strict=True)):
        name = judge.label or str(each.detector["name"])
        points.append({"detector": name, "file": str(each.path), "runs": each.runs, "scale": None})
        try:
            point = each.point(rate)
        except ValueError as error:
            lines.append(str(error))
            continue
        sound.append(k)
        points[-1] |= point._asdict()
        if point.warmup_alarms > NOISY_WARMUP:
            lines.append(noisy_warmup(name, point))
    return points, lines, sound
