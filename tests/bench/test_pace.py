"""A spoofer that decides every few epochs, in a world where it could decide at every one."""

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.bench.report.figures import frame_count, play_frames
from spoofgym.bench.runs.play import WarmStart, play_side_by_side
from spoofgym.bench.runs.players import specify_spoofer
from spoofgym.envs.context import apply_pace
from spoofgym.envs.spoofer_binding import attach, bound_spoofer, get_tuning_range
from spoofgym.spoofers import OnnxPolicy, make_spoofer
from spoofgym.spoofers.scaled import Scaled

from .support import LATE, Mirror, small_suite, write_policy


def suite_of(**pace):
    return small_suite(detectors=("ewma",), settings=pace)


def setup_of(**pace):
    suite = suite_of(**pace)
    return suite.setup(suite.detector_players[0])


def attacked(world, spoofer, drop_alarmed=False):
    suite = suite_of(**world)
    setup = suite.setup(suite.detector_players[0])
    start = WarmStart(setup, suite.generators("evaluation", 12), threads=1)
    return play_side_by_side(start, [spoofer], drop_alarmed=drop_alarmed)[0]


@pytest.mark.parametrize(("between", "amplitude"), [("hold", None), ("linear", 0.5)])
def test_it_is_what_it_does_in_a_world_with_such_decisions(between, amplitude):
    pace = {**LATE, "between": between}

    def made(**own):
        return Mirror(**own) if amplitude is None else Scaled(Mirror(**own), amplitude)

    own, same, worlds, always = (
        attacked(world, made(**mine))
        for world, mine in (({}, pace), (pace, pace), (pace, {}), ({}, {}))
    )
    for other in (same, worlds):
        np.testing.assert_array_equal(own.position, other.position)
        np.testing.assert_array_equal(own.alarm, other.alarm)
    assert (own.position != always.position).any()
    # runs that are dropped change nothing for the others
    some, silent = attacked({}, made(**pace), drop_alarmed=True), own.first_alarm == 0
    np.testing.assert_array_equal(own.position[:, silent], some.position[:, silent])


def test_its_context_and_its_range_are_those_of_its_decisions():
    class Reach(Mirror):
        tunable, far = "far", 1.0

        @classmethod
        def tuning_range(cls, context):
            return 1.0, 1.0 + context.interval_s

    setup = setup_of()
    context, _, _ = bound_spoofer(Mirror(**LATE), setup, 3)
    assert (context.interval_s, context.steps) == (2.5, setup.steps // 5)
    assert setup.repeat == 1  # the world is as it was
    assert get_tuning_range(Reach(**LATE), setup) == (1.0, 3.5)
    assert make_spoofer("ramp").decision_interval_s is None


def test_a_policy_of_an_onnx_file_decides_as_its_card_says(tmp_path):
    path = str(tmp_path / "push.onnx")
    write_policy(tmp_path / "push.onnx", suite_of(**LATE), "blind", (0.0, 0.05))
    policy = OnnxPolicy(path)
    assert (policy.decision_interval_s, policy.between) == (2.5, "linear")
    own, worlds = (attacked(world, policy) for world in ({}, LATE))
    np.testing.assert_array_equal(own.position, worlds.position)
    # an animation has a frame for every epoch: its own decisions, and those of the world
    for suite, decisions, every in ((suite_of(), 40, 20), (suite_of(**LATE), 8, 4)):
        (detector,) = suite.detector_players
        frames = list(play_frames(suite, detector, specify_spoofer(path), every=every))
        assert len(frames) == frame_count(suite, detector, every=every) == 1 + decisions // every


@pytest.mark.parametrize(
    ("own", "world", "message"),
    [
        ({"decision_interval_s": 0.7}, {}, "Mirror decides by .*=0.7 .*multiple of the interval"),
        ({"decision_interval_s": 3.0}, {}, "Mirror decides by .*=3.0 .*whole number of decisions"),
        ({"between": "linear"}, {}, "needs a `decision_interval_s`"),
        ({"decision_interval_s": 5.0}, LATE, "Mirror decides every 5 s .hold between., but this"),
    ],
)
def test_a_pace_that_does_not_fit_is_told(own, world, message):
    with pytest.raises(ValueError, match=message):
        apply_pace(setup_of(**world), Mirror(**own))


def test_a_pace_that_a_campaign_or_an_environment_would_lose_is_refused():
    ramp = make_spoofer("ramp")
    ramp.decision_interval_s = 2.5
    for each in (ramp, Scaled(ramp, 0.5)):
        with pytest.raises(ValueError, match=r"`decision_interval_s` = 2.5 was set on an object"):
            specify_spoofer(each)
    assert specify_spoofer(Mirror(**LATE)).spec["between"] == "linear"
    often, late = (
        gym.make("spoofgym/Zhong2025-v0", knowledge="oracle", **pace) for pace in ({}, LATE)
    )
    with pytest.raises(ValueError, match=r"make it with decision_interval_s=2\.5, between='lin"):
        attach(Mirror(**LATE), often)
    assert attach(Mirror(**LATE), late).context.interval_s == 2.5
