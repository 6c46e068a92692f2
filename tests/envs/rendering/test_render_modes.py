"""Pictures of the environments, by Gymnasium's contract."""

import itertools
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from spoofgym.duel_v0 import DetectorView
from spoofgym.envs import SpoofEnv
from spoofgym.envs.env import CoreEnv

matplotlib = pytest.importorskip("matplotlib")

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 10.0, "time_to_alert_s": 2.0}
RANDOM = {"target_heading_deg": "random", "twin": True}
IDS = {
    "spoofgym/Zhong2025-v0": {"timeline": SHORT, "action": "full-command"},
    "spoofgym/Snapshot-v0": {"domain": {"turned_deg": [0.0, 360.0], "worlds": 3}, **RANDOM},
    "spoofgym/LooselyCoupled-v0": {"domain": {"start_s": [0.0, 5.0]}, **RANDOM},
    "spoofgym/WheeledRobot-v0": {"domain": {"start_s": [0.0, None]}, **RANDOM},
}
PUSH = np.array([0.2, 1.0], dtype=np.float32)


def make(name="spoofgym/Zhong2025-v0", mode="rgb_array", **kwargs):
    return gym.make(name, render_mode=mode, **IDS[name], **kwargs)


@pytest.mark.parametrize("name", IDS)
def test_frames_are_pixels_that_change(name):
    env = make(name, end_at_alarm=False)
    env.reset(seed=2)
    frames = [env.render()]
    action = np.full(env.action_space.shape, 0.5, dtype=np.float32)
    for _ in range(3):
        env.step(action)
        frames.append(env.render())
    height, width, _ = frames[0].shape
    assert (height % 2, width % 2) == (0, 0)  # as H.264 wants it
    for frame, following in itertools.pairwise(frames):
        assert (frame.shape, frame.dtype) == ((height, width, 3), np.uint8)
        assert (frame != following).any()
    np.testing.assert_array_equal(env.render(), frames[-1])
    env.close()
    env.close()
    plain = make(name).unwrapped
    assert plain.metadata["render_modes"] == ["human", "rgb_array"]
    assert plain.metadata["render_fps"] == pytest.approx(1.0 / plain.core.setup.interval_s)
    if "Snapshot" in name:  # one is enough
        check_env(plain)


def test_a_render_mode_leaves_the_game_alone_and_goes_on_in_a_copy():
    drawn, plain = make().unwrapped, make(mode=None).unwrapped
    np.testing.assert_array_equal(drawn.reset(seed=4)[0], plain.reset(seed=4)[0])
    for _ in range(3):
        mine, theirs = drawn.step(PUSH), plain.step(PUSH)
        np.testing.assert_array_equal(mine[0], theirs[0])
        assert mine[1:] == theirs[1:]
        drawn.render()
    copy = pickle.loads(pickle.dumps(drawn))
    drawn.step(PUSH)
    copy.step(PUSH)
    mine, theirs = drawn._screen._history, copy._screen._history
    for name in ("time_s", "ratio", "twin_ratio", "induced_m"):
        np.testing.assert_array_equal(mine.number(name), theirs.number(name))
    assert copy.render().shape == drawn.render().shape


def test_the_window_follows_every_step():
    from tests.window import FigureCanvas

    env = make(mode="human")
    FigureCanvas.drawn = 0
    env.reset(seed=1)
    assert FigureCanvas.drawn == 1
    env.step(PUSH)
    assert FigureCanvas.drawn == 2
    assert env.render() is None
    env.close()
    env.close()


def test_without_a_display_it_says_what_to_do():
    matplotlib.use("agg")
    message = "'human' needs a display.*use render_mode='rgb_array', or set MPLBACKEND.*skip_render"
    with pytest.raises(RuntimeError, match=message):
        make("spoofgym/Snapshot-v0", mode="human").reset(seed=0)
    with pytest.raises(RuntimeError, match=message):
        check_env(make("spoofgym/Snapshot-v0").unwrapped)
    check_env(make("spoofgym/Snapshot-v0").unwrapped, skip_render_check=True)


def test_wrong_uses_are_told():
    bare = CoreEnv(DetectorView(timeline=SHORT, domain={"turn_on": "drawn"}).core)
    assert bare.metadata["render_modes"] == []  # of the detector's side
    for make_it, error, message in (
        (lambda: SpoofEnv(render_mode="rgb"), ValueError, "`render_mode` must be 'human' or 'rgb"),
        (lambda: CoreEnv(bare.core, render_mode="rgb_array"), ValueError, "got 'rgb_array'"),
        (lambda: make().unwrapped.render(), RuntimeError, r"call reset\(\) before render\(\)"),
    ):
        with pytest.raises(error, match=message):
            make_it()
    plain = make(mode=None).unwrapped
    plain.reset(seed=0)
    with pytest.warns(UserWarning, match="needs a render mode"):
        assert plain.render() is None


def test_gymnasium_s_recorders_take_the_frames(tmp_path):
    env = make("spoofgym/Snapshot-v0", mode="rgb_array_list")
    env.reset(seed=0)
    env.step(np.zeros(4, dtype=np.float32))
    assert len(env.render()) == 2
    pytest.importorskip("moviepy", reason="RecordVideo needs moviepy")
    env = gym.wrappers.RecordVideo(make("spoofgym/Snapshot-v0"), str(tmp_path / "films"), fps=10)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(4, dtype=np.float32))
    env.close()
    (film,) = tmp_path.rglob("*.mp4")
    assert b"ftyp" in film.read_bytes()[:16]
