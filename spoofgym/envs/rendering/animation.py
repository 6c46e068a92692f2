"""Frames written as a moving picture: GIF by Pillow, MP4 by FFmpeg."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._files import whole_file
from ..._pictures import COLOURS, GREY, RED
from ..._registry import check_choice

Frame = NDArray[np.uint8]
TINTS = 10
"""Steps from a colour of the pictures to white, in the palette of a GIF."""
GIF_CLOCK_S = 0.01
"""Unit of the time that a GIF shows a frame."""


def save_animation(frames: Iterable[Frame], path: Path | str, fps: float = 25.0) -> Path:
    """Write frames as they come; none is kept.

    Parameters
    ----------
    frames : iterable of ndarray
        (H, W, 3) uint8, at least one, all of one shape; a GIF is made for those of `Painter`, and
        takes the nearest of their colours.
    path : Path or str
        File; its ending tells the format, ``.gif`` or ``.mp4``.
    fps : float
        Frames a second; a GIF has 100 over a whole number, the nearest is taken.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ValueError
        When the ending or `fps` is not valid, or there is no frame.
    ImportError
        When the library that writes the format is not installed.
    """
    path = Path(path)
    if not (np.isfinite(fps) and 0.0 < fps <= 100.0):
        raise ValueError(f"`fps` must be above 0 and at most 100, got {fps}")
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    ending = path.suffix.lower()
    check_choice("ending of an animation", ending, writers)
    stream = iter(frames)
    first = next(stream, None)
    if first is None:
        raise ValueError("an animation needs at least one frame")
    with whole_file(path) as part:
        writers[ending](chain([first], stream), first.shape[:2], part, fps)
    return path


def _write_gif(frames: Iterator[Frame], shape: tuple[int, ...], path: Path, fps: float) -> None:
    """Write a GIF, in the colours of our pictures."""
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError("a GIF needs Pillow: pip install spoofgym[report]") from error

    palette = gif_palette()
    nearest = nearest_colours(palette)

    def images() -> Iterator[Any]:
        """Frames in the colours of the palette."""
        for frame in frames:
            red, green, blue = (frame[..., k].astype(np.uint16) >> 3 for k in range(3))
            image = Image.fromarray(nearest[(red << 10) | (green << 5) | blue])
            image.putpalette(palette.tobytes())
            yield image

    stream = images()
    clock = max(round(1.0 / (fps * GIF_CLOCK_S)), 1)
    next(stream).save(
        path,
        format="GIF",
        save_all=True,
        append_images=stream,
        duration=round(1000.0 * clock * GIF_CLOCK_S),
        loop=0,
    )


def gif_palette() -> NDArray[np.uint8]:
    """Tints of all colours of the pictures, as smooth edges have them, and shades of grey.

    Returns (c, 3) red, green and blue of up to 256 colours.
    """
    named = (*COLOURS[:6], RED, GREY)
    full = np.array([[int(name[k : k + 2], 16) for k in (1, 3, 5)] for name in named])
    part = np.linspace(0.0, 1.0, TINTS, endpoint=False)[:, None, None]
    tints = (1.0 - part) * full + part * 255.0
    greys = np.repeat(np.linspace(0.0, 255.0, 64), 3)
    levels = np.concatenate([tints.ravel(), greys])
    return np.round(levels).astype(np.uint8).reshape(-1, 3)


def nearest_colours(palette: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Nearest colour of a palette for every colour of five bits a channel.

    `palette` (c, 3) uint8, c up to 256; returns (32768,) uint8, index into the palette, by red,
    green and blue from the highest bits on.
    """
    level = np.linspace(0.0, 255.0, 32)
    colours = np.stack(np.meshgrid(level, level, level, indexing="ij"), axis=-1).reshape(-1, 3)
    found = [
        ((part[:, None, :] - palette) ** 2).sum(axis=-1).argmin(axis=1)
        for part in np.array_split(colours, 32)
    ]
    return np.concatenate(found).astype(np.uint8)


def ffmpeg_program() -> str:
    """FFmpeg of this machine, or that of the package ``imageio-ffmpeg``."""
    found = shutil.which("ffmpeg")
    if found is not None:
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError as error:
        raise ImportError(
            "an MP4 needs FFmpeg: pip install spoofgym[video], or write a .gif"
        ) from error
    return str(get_ffmpeg_exe())


def _write_mp4(frames: Iterator[Frame], shape: tuple[int, ...], path: Path, fps: float) -> None:
    """Pipe frames into FFmpeg, which makes H.264 with even width and height of them."""
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
        _, told = process.communicate()
    if process.returncode:
        text = " ".join(told.decode(errors="replace").split())
        raise OSError(f"FFmpeg failed with code {process.returncode}: {text}")
