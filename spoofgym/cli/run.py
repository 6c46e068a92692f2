"""One run of the benchmark: its figures, its picture, its animation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options as opt
from .bench import Reports, at_rate, suite_of, untuned
from .options import World, specs_of, with_world
from .output import print_json, print_lines, print_table, progress

if TYPE_CHECKING:
    from ..bench.experiments.suite import Suite


@with_world
def run(
    *,
    detector: opt.Detector = None,
    spoofer: opt.Spoofer = "ramp",
    number: opt.Run = 0,
    out: Annotated[Path, typer.Option(help="File of the picture; .png without an ending.")] = Path(
        "episode.png"
    ),
    picture: Annotated[bool, typer.Option(help="Draw the picture.")] = True,
    as_json: opt.Json = False,
    world: World,
    seed: opt.Seed = 0,
    allow_oracles: opt.Oracles = False,
    false_alarms_per_hour: opt.Rate = None,
) -> None:
    """Play one run of the benchmark and its clean twin: a summary, and a picture."""
    from ..bench.runs.episode import draw_episode, play_episode
    from ..core.plots import check_picture

    if picture:
        check_picture(out)
    suite, reports = _suite(world, detector, spoofer, seed, allow_oracles, false_alarms_per_hour)
    judge, player = suite.detector_entries[-1], untuned(suite)
    if not as_json:
        print_lines((*suite.notes, *suite.captions))
    episode = play_episode(suite.world, judge, player, number, seed)
    summary = episode.summary()
    if picture:
        summary["picture"] = str(draw_episode(episode, out))
    if as_json:
        print_json({**summary, "input": reports})
        return
    rows = [(key, "-" if value is None else str(value)) for key, value in summary.items()]
    print_table(f"{player.label} against {judge.label}", ("", ""), rows)


@with_world
def render(
    *,
    detector: opt.Detector = None,
    spoofer: opt.Spoofer = "ramp",
    number: opt.Run = 0,
    out: Annotated[
        Path, typer.Option(help="File of the animation, .gif or .mp4 (needs FFmpeg).")
    ] = Path("run.gif"),
    fps: Annotated[
        float, typer.Option(help="Frames a second; 2 is real time with epochs of 0.5 s.")
    ] = 25.0,
    every: Annotated[int, typer.Option(min=1, help="A frame for every so many epochs.")] = 1,
    world: World,
    seed: opt.Seed = 0,
    allow_oracles: opt.Oracles = False,
    false_alarms_per_hour: opt.Rate = None,
) -> None:
    """Draw one run of the benchmark as an animation: flight, satellites, statistic, error."""
    from ..bench.report.figures import frame_count, play_frames
    from ..envs.rendering.animation import animation_writer, save_animation

    animation_writer(out, fps)
    suite, _ = _suite(world, detector, spoofer, seed, allow_oracles, false_alarms_per_hour)
    judge, player = suite.detector_entries[-1], untuned(suite)
    print_lines((*suite.notes, *suite.captions))
    with progress(frame_count(suite, judge, every)) as bar:

        def frames() -> Iterator[Any]:
            for frame in play_frames(suite, judge, player, number, every=every):
                yield frame
                bar.advance(1.0, "drawing")

        save_animation(frames(), out, fps)
    typer.echo(f"written: {out}")


def _suite(
    world: World,
    detector: str | None,
    spoofer: str,
    seed: int,
    allow_oracles: bool,
    rate: float | None,
) -> tuple[Suite, Reports]:
    return suite_of(
        world,
        [detector] if detector else None,
        spoofers=specs_of([spoofer]),
        entropy=seed,
        allow_oracles=allow_oracles,
        asked=at_rate(rate),
    )
