"""Frames written as an animation: GIF and WebP by Pillow, MP4 by FFmpeg."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.declared import check_number
from ...core.extras import name_extra
from ...core.files import whole_file
from ...core.registry import check_choice

Frame = NDArray[np.uint8]
QUALITY = 75
"""Of the pictures of a WebP, of 100."""


def save_animation(frames: Iterable[Frame], path: Path | str, fps: float = 25.0) -> Path:
    """Write frames as they come; none is stored.

    Parameters
    ----------
    frames : iterable of ndarray
        (H, W, 3) uint8, at least one, all of one shape; a GIF takes 256 colours for each.
    path : Path or str
        File; its ending says the format, ``.gif``, ``.webp`` or ``.mp4``.
    fps : float
        Frames a second; a GIF has 100 over a whole number, the nearest is taken.

    Returns
    -------
    Path
        The file.
    """
    path = Path(path)
    write = animation_writer(path, fps)
    stream = iter(frames)
    first = next(stream, None)
    if first is None:
        raise ValueError("an animation needs at least one frame")
    with whole_file(path) as part:
        write(chain([first], stream), first.shape[:2], part, fps)
    return path


def animation_writer(path: Path, fps: float) -> Callable[..., None]:
    """What writes a format; a ValueError for an ending or a pace that `save_animation` refuses."""
    check_number("fps", fps, above=0.0, most=100.0)
    ending = path.suffix.lower()
    check_choice("ending of an animation", ending, WRITERS)
    return WRITERS[ending]


def _import_pillow() -> Any:
    try:
        from PIL import Image
    except ImportError as error:
        raise name_extra("a GIF or WebP", error, "report") from error
    return Image


def _write_webp(frames: Iterator[Frame], shape: tuple[int, ...], path: Path, fps: float) -> None:
    images, pace = map(_import_pillow().fromarray, frames), max(round(1000.0 / fps), 1)
    settings: dict[str, Any] = {"append_images": images, "duration": pace, "quality": QUALITY}
    next(images).save(path, format="WEBP", save_all=True, loop=0, **settings)


def _write_gif(frames: Iterator[Frame], shape: tuple[int, ...], path: Path, fps: float) -> None:
    Image = _import_pillow()
    # of three ways to choose 256 colours the one that also keeps those of a few pixels, as alarms
    images = (Image.fromarray(f).quantize(256, Image.Quantize.MAXCOVERAGE) for f in frames)
    pace = 10 * max(round(100.0 / fps), 1)
    next(images).save(
        path, format="GIF", save_all=True, append_images=images, duration=pace, loop=0
    )


def ffmpeg_program() -> str:
    if (found := shutil.which("ffmpeg")) is not None:
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError as error:
        what = "an MP4 without FFmpeg on the path, unlike a .gif or .webp,"
        raise name_extra(what, error, "video") from error
    return str(get_ffmpeg_exe())


def _write_mp4(frames: Iterator[Frame], shape: tuple[int, ...], path: Path, fps: float) -> None:
    height, width = shape
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}"]
    wanted = ["-vf", "crop=trunc(iw/2)*2:trunc(ih/2)*2", "-c:v", "libx264", "-preset", "veryfast"]
    wanted += ["-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"]
    command = [ffmpeg_program(), "-y", "-loglevel", "error", *given, "-i", "-", *wanted, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        pipe: Any = process.stdin
        try:
            for frame in frames:
                pipe.write(np.ascontiguousarray(frame).data)
        except BrokenPipeError:
            pass  # FFmpeg has ended early, and says why
        except BaseException:
            process.kill()
            raise
        _, said = process.communicate()
    if process.returncode:
        text = " ".join(said.decode(errors="replace").split())
        raise OSError(f"FFmpeg failed with code {process.returncode}: {text}")


WRITERS: dict[str, Callable[..., None]] = {
    ".gif": _write_gif,
    ".webp": _write_webp,
    ".mp4": _write_mp4,
}
"""What writes a format, by its ending."""
