"""One run of the benchmark: its figures, its picture, its animation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Option

from . import options as opt
from .app import can_draw, print_json, print_lines, progress
from .options import SuiteOptions, with_options
from .suites import Reports, build_suite, calibrate_suite

if TYPE_CHECKING:
    from ..bench.experiments.suite import Suite
    from ..bench.runs.episode import Episode
    from ..bench.runs.players import PlayerSpec


MOST_FRAMES = 80
"""Of an animation by default, a WebP of 1 MB or so."""


@dataclass(frozen=True, kw_only=True)
class RunOptions(SuiteOptions):
    """Options of one run."""

    detector: str | None = Option(
        None,
        help="Detector; an .onnx file, too. Default: that of the world; with --scenario or "
        "--track, ewma or one that suits the victim. "
        f"{opt.SPEC_HELP}",
    )
    spoofer: str = Option(
        "ramp", help=f"Spoofer; a shipped name or an .onnx file, too. {opt.SPEC_HELP}"
    )
    number: int = Option(
        0,
        "--run",
        min=0,
        max=opt.LARGEST_RUNS - 1,
        help="Which of the benchmark's evaluation runs.",
    )


@with_options
def run(
    *,
    out: Path = Option(
        Path("episode.png"),
        help="File to write. A picture; .png if the name has no ending. With .gif, .webp or "
        ".mp4 (needs FFmpeg) an animation; with .mat or .parquet every epoch as numbers.",
    ),
    picture: bool = Option(True, help="Draw the picture."),
    fps: float = Option(10.0, help="Frames of an animation a second."),
    every: int | None = Option(
        None,
        min=1,
        help=f"Epochs for each frame of an animation, or decisions where the world has them. "
        f"Default: as many as keep the frames to {MOST_FRAMES} at most.",
    ),
    as_json: opt.Json = False,
    options: RunOptions,
) -> None:
    """Play one run of the benchmark and its clean twin: a summary, and a picture or animation.

    By default it is a ramp of 0.5 m/s in the world of task S1, against the detector of S1; with
    --scenario zhong2025 in the papers' world, which is faster.
    """
    from ..bench.report.table import FIELDS
    from ..bench.runs.episode import draw_episode, play_episode
    from ..core.files import COLUMN_FILES, check_pyarrow, write_columns
    from ..envs.rendering.animation import WRITERS, animation_writer

    numbers = out.suffix.lower() in COLUMN_FILES
    picture = picture and not numbers and can_draw(out, WRITERS)
    animated = out.suffix.lower() in WRITERS
    if out.suffix.lower() == ".parquet":
        check_pyarrow()
    if picture and animated:
        animation_writer(out, fps)
    suite, judge, player, reports = _suite(options)
    if not as_json:
        print_lines((*suite.notes, *suite.captions))
    episode = play_episode(suite.world, judge, player, options.number, options.seed)
    summary = episode.summary()
    if numbers:
        write_columns(out, episode.columns())
        summary["epochs"] = str(out)
    if picture and animated:
        _animate(suite, episode, options, out, fps, every)
        summary["picture"] = str(out)
    elif picture:
        summary["picture"] = str(draw_episode(episode, out))
    if as_json:
        print_json({**summary, "input": reports})
        return
    FIELDS.print(f"{player.label} against {judge.label}", summary.items())


def _animate(
    suite: Suite,
    episode: Episode,
    options: RunOptions,
    out: Path,
    fps: float,
    every: int | None,
) -> None:
    """Write the run as an animation: flight, satellites, statistic, error."""
    import numpy as np

    from ..bench.report.figures import frame_count, play_frames
    from ..envs.rendering.animation import save_animation

    judge, player = episode.detector, episode.spoofer
    largest_m = float(np.linalg.norm(episode.error_n[..., :2], axis=-1).max())
    if every is None:
        every = -(-frame_count(suite, judge) // (MOST_FRAMES - 1))
    with progress(frame_count(suite, judge, every)) as bar:

        def frames() -> Iterator[Any]:
            how: dict[str, Any] = {"every": every, "largest_m": largest_m}
            for frame in play_frames(suite, judge, player, options.number, **how):
                yield frame
                bar.advance(1.0, "drawing")

        save_animation(frames(), out, fps)


def _suite(options: RunOptions) -> tuple[Suite, PlayerSpec, PlayerSpec, Reports]:
    """The suite of one pair, its detector, its spoofer, which has to know all its settings, and
    the reports of real input."""
    detectors = None if options.detector is None else [options.detector]
    suite, reports = build_suite(options, detectors, spoofers=opt.parse_specs([options.spoofer]))
    suite = calibrate_suite(suite, detectors, None)
    player = suite.spoofer_players[-1]
    if player.tuned:
        raise ValueError(
            f"`{player.tuned}` = tuned needs a search: take the value that `spoofgym bench "
            "--fit-only` finds"
        )
    return suite, suite.detector_players[-1], player, reports
