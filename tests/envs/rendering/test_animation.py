"""Moving pictures."""

import sys

import numpy as np
import pytest

from spoofgym.envs.rendering import animation, save_animation

Image = pytest.importorskip("PIL.Image")


def frames(count=3, height=20, width=30):
    for k in range(count):
        frame = np.full((height, width, 3), 255, dtype=np.uint8)
        frame[5:10, 5 * k : 5 * k + 5] = (0xB2, 0x18, 0x2B)
        yield frame


def test_a_gif_holds_the_frames_and_their_pace(tmp_path):
    path = save_animation(frames(), tmp_path / "deep" / "run.gif", fps=20.0)
    with Image.open(path) as film:
        assert (film.n_frames, film.size) == (3, (30, 20))
        assert film.info["duration"] == 50
        for k, frame in enumerate(frames()):
            film.seek(k)
            seen = np.asarray(film.convert("RGB")).astype(int)
            assert np.abs(seen - frame).max() <= 2
    assert not list(tmp_path.rglob("*.part"))


def test_an_mp4_is_one(tmp_path):
    try:
        animation.ffmpeg_program()
    except ImportError as error:
        pytest.skip(str(error))
    path = save_animation(frames(height=65, width=67), tmp_path / "run.mp4")
    assert b"ftyp" in path.read_bytes()[:16]


@pytest.mark.parametrize(
    ("name", "fps", "count", "message"),
    [
        ("run.avi", 25.0, 3, "unknown ending of an animation '.avi'; valid: .gif, .mp4"),
        ("run.gif", 0.0, 3, "`fps` must be a number above 0 and at most 100, got 0"),
        ("run.gif", 1000.0, 3, "`fps` must be a number above 0 and at most 100, got 1000"),
        ("run.gif", 25.0, 0, "at least one frame"),
    ],
)
def test_wrong_settings_are_told(tmp_path, name, fps, count, message):
    with pytest.raises(ValueError, match=message):
        save_animation(frames(count), tmp_path / name, fps)


def test_what_ffmpeg_lacks_is_told_and_leaves_no_file(tmp_path, monkeypatch):
    film, program = tmp_path / "run.mp4", tmp_path / "ffmpeg"
    with monkeypatch.context() as patch:
        patch.setattr(animation.shutil, "which", lambda name: None)
        patch.setitem(sys.modules, "imageio_ffmpeg", None)
        with pytest.raises(ImportError, match=r"unlike a .gif or .webp, .*spoofgym\[video\]"):
            save_animation(frames(), film)
    program.write_text("#!/bin/sh\necho no such codec >&2\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr(animation, "ffmpeg_program", lambda: str(program))
    with pytest.raises(OSError, match="code 3: no such codec"):
        save_animation(frames(200, 200, 300), film)
    assert [*tmp_path.iterdir()] == [program]
