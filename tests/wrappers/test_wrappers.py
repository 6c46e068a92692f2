"""Detectors as ordinary wrappers: recorded, checked and scored."""

import gymnasium as gym
import numpy as np
import pytest

import spoofgym
from spoofgym.detectors import Detector
from spoofgym.detectors.base import compare
from spoofgym.wrappers import (
    AlarmRecorder,
    DetectorWrapper,
    EpochInfo,
    PassiveDetector,
    check_wrapper,
    evaluate_wrapped,
    vector,
)

from ..envs.support import HOLD, SHORT, STEPS, AlarmAt, LooksAtEpochs

ID = "spoofgym/Zhong2025-v0"
FAST = {"name": "ramp", "rate_mps": 1.0}
LARGEST = 1.6


def bare(**settings):
    return gym.make(ID, **{"detector": "never", "timeline": SHORT, **settings})


def largest(epoch):
    """Largest normalized innovation."""
    return np.max(np.abs(epoch.innovation) / np.sqrt(epoch.innovation_variance), axis=-1)


class Plain(LooksAtEpochs):
    """A detector in ten lines, which knows nothing of this library."""

    def look(self, epochs):
        statistic = max(map(largest, epochs))
        return {"statistic": statistic, "threshold": LARGEST, "alarm": statistic > LARGEST}


class Same(Detector):
    """The same as a detector of the library."""

    paper = "groves2013"

    def judge(self, epoch):
        return compare(largest(epoch)[:, None], LARGEST)

    def bind(self, context):
        super().bind(context)


class CountsSteps(gym.Wrapper):
    """Alarms at a number of steps after the reset, or gives them as its statistic."""

    def __init__(self, env, as_statistic=False):
        super().__init__(env)
        self.as_statistic = as_statistic

    def reset(self, **kwargs):
        self.steps = 0
        return super().reset(**kwargs)

    def step(self, action):
        *result, info = super().step(action)
        self.steps += 1
        counted = {"statistic": self.steps, "threshold": 30.0}
        info |= counted if self.as_statistic else {"alarm": self.steps >= 30}
        return *result, info


def test_the_ten_lines_alarm_as_their_detector_does():
    plain, own = Plain(EpochInfo(bare(), ())), PassiveDetector(bare(), {"name": "never"})
    with pytest.warns(UserWarning, match="Same plays uncalibrated"):
        own = PassiveDetector(bare(), Same())
    with pytest.warns(UserWarning, match="Same plays uncalibrated"):
        within = DetectorWrapper(gym.make(ID, timeline=SHORT), Same())
    seen = []
    for seed in range(4):
        mine, theirs = plain.reset(seed=seed)[1], own.reset(seed=seed)[1]
        assert mine["alarm"] == theirs["alarm"] == within.reset(seed=seed)[1]["warmup_alarm"]
        over = False
        while not over:
            *_, over, _, mine = plain.step([0.2 * seed])
            theirs, inside = (env.step([0.2 * seed])[2:] for env in (own, within))
            assert mine["statistic"] == theirs[2]["statistic"]
            assert mine["alarm"] == theirs[2]["alarm"] == inside[2]["alarm"]
            assert over == theirs[0] == inside[0]
            if not mine["alarm"]:
                seen.append(False)
                continue
            assert mine["statistic"] == inside[2]["statistic"] > inside[2]["threshold"] == LARGEST
            seen.append(True)
    assert 0 < sum(seen) < len(seen)


@pytest.fixture(scope="module")
def score():
    return evaluate_wrapped(
        Plain(EpochInfo(bare(), ())), 40, false_alarms_per_hour=10.0, spoofers=[FAST]
    )


def test_a_statistic_is_calibrated_and_scored(score):
    assert score.scale > 0.0
    assert score.false_alarms_per_hour.low <= 10.0 <= score.false_alarms_per_hour.high
    (found,) = score.attacks
    assert found is score.worst
    assert found.never_m > 1.0
    assert str(score).startswith("threshold x ")
    assert "ramp, rate_mps=1.0: " in str(score)
    assert score.requested_per_hour == 10.0
    assert "above the requested" not in str(score)
    hasty = score._replace(requested_per_hour=score.false_alarms_per_hour.low / 2.0)
    assert "\nfalse alarms above the requested " in str(hasty)
    outside = PassiveDetector(bare(), {"name": "never"})
    with pytest.raises(ValueError, match="the statistic is 0 in nearly every clean run"):
        evaluate_wrapped(outside, 40, false_alarms_per_hour=10.0, spoofers=[FAST])


def test_a_model_plays_by_its_own_observations_and_one_that_does_not_fit_is_refused(score):
    def push(seen):
        assert seen.shape[1] < bare().observation_space.shape[0]  # it is blind
        return np.ones((len(seen), 1))

    env, own = Plain(EpochInfo(bare(), ())), {"false_alarms_per_hour": 10.0}
    (found,) = evaluate_wrapped(env, 40, spoofers=[push], **own).attacks
    assert found._replace(spoofer="ramp, rate_mps=1.0") == score.attacks[0]
    assert found.spoofer == "push"
    with pytest.raises(ValueError, match="'ewma-ppo' was made for another environment"):
        evaluate_wrapped(env, 40, spoofers=["ewma-ppo"], **own)


def test_single_and_vector_have_the_same_score(score, bars):
    class Row(vector.EpochInfo):
        def reset(self, **kwargs):
            observation, info = super().reset(**kwargs)
            return observation, self.look(info)

        def step(self, actions):
            *result, info = super().step(actions)
            return *result, self.look(info)

        def look(self, info):
            info["statistic"] = np.array(
                [max(map(largest, e), default=0.0) for e in info["epochs"]]
            )
            info["threshold"] = np.full(3, LARGEST)
            return info

    envs = gym.make_vec(ID, num_envs=3, detector="never", timeline=SHORT)
    again = evaluate_wrapped(Row(envs, ()), 40, false_alarms_per_hour=10.0, spoofers=[FAST])
    assert again == score
    assert [sum(done) for _, done in bars] == [total for total, _ in bars] == [120.0]


@pytest.mark.parametrize("as_statistic", [False, True])
def test_what_counts_steps_scores_as_never_does(as_statistic):
    env = CountsSteps(EpochInfo(bare(), ()), as_statistic)
    score = evaluate_wrapped(env, 40, false_alarms_per_hour=10.0, spoofers=[FAST])
    (found,) = score.attacks
    if not as_statistic:
        assert found.undetected_displacement_m.value == found.never_m
        assert "uncalibrated" in str(score)
        with pytest.raises(ValueError, match="comes 30 steps after the reset in every clean run"):
            check_wrapper(env)
    assert found.undetected_displacement_m.value > 0.9 * found.never_m


class Wrong(gym.Wrapper):
    """Sets what it is told, and shifts what is observed."""

    def __init__(self, env, shift=0.0, **told):
        super().__init__(env)
        self.shift, self.told = np.float32(shift), told

    def step(self, action):
        observation, *rest, info = super().step(action)
        return observation + self.shift, *rest, info | self.told


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({}, "'alarm'. is missing"),
        ({"alarm": 1}, r"info\['alarm'\] must be boolean, got 1"),
        ({"alarm": [True, False]}, "must have one value"),
        ({"statistic": 1.0}, "sets both"),
        ({"statistic": np.nan, "threshold": 1.0}, "must be finite"),
        ({"statistic": 1.0, "threshold": 0.0}, "must be above 0"),
        ({"alarm": False, "shift": 1e-3}, "it changes the observation"),
    ],
)
def test_what_is_wrong_is_named(told, message):
    with pytest.raises(ValueError, match=message):
        check_wrapper(Wrong(EpochInfo(bare(), ()), **told))


def test_what_is_right_passes_and_leaves_the_environment_as_it_was():
    env = Plain(EpochInfo(bare(), ()))
    inner = env.unwrapped
    check_wrapper(env)
    assert env.unwrapped is inner
    env.reset(seed=1)
    assert "displacement_m" in env.step([0.0])[4]


def test_what_can_not_be_scored_is_refused():
    assert spoofgym.evaluate_wrapped is evaluate_wrapped
    with pytest.raises(ValueError, match="has no epochs: make the environment with epoch=True"):
        evaluate_wrapped(CountsSteps(bare()))
    with pytest.raises(ValueError, match="in the loop, and the scored detector is outside"):
        evaluate_wrapped(CountsSteps(EpochInfo(bare(detector={"name": "shewhart"}))))
    with pytest.raises(ValueError, match=r"neither info.'alarm'. nor"):
        evaluate_wrapped(Wrong(EpochInfo(bare(), ())), 2)


class EndsAlone(gym.vector.VectorWrapper):
    """Ends episodes without a word to the environment."""

    def step(self, actions):
        observation, reward, terminated, *rest = super().step(actions)
        return observation, reward, np.ones_like(terminated), *rest


def test_alarms_are_recorded_over_episodes():
    alarm = AlarmAt(30)  # ten epochs after the onset
    env = AlarmRecorder(gym.make(ID, detector=alarm, timeline=SHORT))
    envs = gym.make_vec(ID, num_envs=2, detector=alarm, timeline=SHORT)
    envs = vector.AlarmRecorder(envs)
    for action in (0.0, 1.0, 1.0):
        env.reset(seed=3)
        while not env.step([action])[2]:
            pass
    found = env.alarms.summarize()
    assert (found.clean, found.attacked, found.missed.value) == (1, 2, 0.0)
    assert (found.false_alarm.value, found.delay_s.value) == (1 / 3, 5.0)
    assert found.undetected_displacement_m.value >= 0.0
    assert "1 clean and 2 attacked episodes" in str(found)
    envs.reset(seed=3)
    for _ in range(23):
        envs.step([[0.0], [1.0]])
    both = envs.alarms.summarize()
    assert (both.clean, both.attacked, both.delay_s.value) == (2, 2, 5.0)
    fly_on = vector.AlarmRecorder(EndsAlone(envs.env))
    fly_on.reset(seed=3)
    with pytest.raises(ValueError, match=r"receivers 0, 1, which fly on: .*end_episodes\(mask\)"):
        fly_on.step([[0.0], [1.0]])
    wrong = AlarmRecorder(Wrong(bare(), alarm=1))
    wrong.reset(seed=0)
    with pytest.raises(ValueError, match=r"'alarm'. must be boolean, True at an alarm; got 1"):
        wrong.step([0.0])


def test_the_displacement_of_a_recorder_is_that_of_the_environment():
    """Of an alarm within and outside, at the same epochs."""
    for at in (5, 25, STEPS + HOLD - 2):
        alarm = AlarmAt(20 + at)
        within = AlarmRecorder(gym.make(ID, detector=alarm, timeline=SHORT))
        with pytest.warns(UserWarning, match="uncalibrated"):
            outside = AlarmRecorder(PassiveDetector(gym.make(ID, timeline=SHORT), alarm))
        for env in (within, outside):
            env.reset(seed=5)
            while not env.step([1.0])[2]:
                pass
        mine, theirs = (env.alarms.summarize() for env in (within, outside))
        assert mine.undetected_displacement_m == theirs.undetected_displacement_m
        assert theirs.delay_s.value == 0.5 * at
