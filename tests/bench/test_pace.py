"""A spoofer that decides every few epochs, in a world where it could decide at every one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.report.figures import frame_count, play_frames
from spoofgym.bench.runs.play import Runs, WarmStart, play
from spoofgym.bench.runs.players import specify_policy, specify_spoofer
from spoofgym.envs.spoofer_binding import apply_pace, attach, bound_spoofer, get_tuning_range
from spoofgym.spoofers import OnnxPolicy, Spoofer, SpooferContext, make_spoofer
from spoofgym.spoofers.learned import ModelPolicy
from spoofgym.spoofers.scaled import Scaled

from .support import small_suite, write_policy

RUNS = 12
LATE = {"decision_interval_s": 2.5, "between": "linear"}


@dataclass
class Mirror(Spoofer):
    """Commands what it observes; all the bits of an observation show in its run."""

    decision_interval_s: float | None = None
    between: str = "hold"

    knowledge: ClassVar[str] = "oracle"

    def act(self, observation: np.ndarray) -> np.ndarray:
        a = len(self.context.action_names)
        return np.ascontiguousarray(np.clip(observation[:, -a:].astype(np.float64), -1.0, 1.0))


def attacked(suite: Suite, spoofer: Spoofer, drop_alarmed: bool = False) -> Runs:
    setup = suite.setup(suite.detector_players[0])
    start = WarmStart(setup, suite.generators("evaluation", RUNS), threads=1)
    return play(start, spoofer, drop_alarmed=drop_alarmed)


@pytest.fixture(scope="module")
def suite() -> Suite:
    return small_suite(detectors=("ewma",))


@pytest.mark.parametrize("between", ["hold", "linear"])
@pytest.mark.parametrize("amplitude", [None, 0.5])
def test_it_is_what_it_does_in_a_world_with_such_decisions(
    suite: Suite, between: str, amplitude: float | None
) -> None:
    pace = {"decision_interval_s": 2.5, "between": between}
    world = small_suite(detectors=("ewma",), settings=pace)

    def made(**own: Any) -> Spoofer:
        mirror = Mirror(**own)
        return mirror if amplitude is None else Scaled(mirror, amplitude)

    own, worlds, always = (
        attacked(suite, made(**pace)),
        attacked(world, made()),
        attacked(suite, made()),
    )
    np.testing.assert_array_equal(own.position, worlds.position)
    np.testing.assert_array_equal(own.alarm, worlds.alarm)
    assert (own.position != always.position).any()
    same = attacked(world, made(**pace))
    np.testing.assert_array_equal(own.position, same.position)


def test_runs_that_are_dropped_change_nothing_for_the_others(suite: Suite) -> None:
    mirror = Mirror(**LATE)
    every, some = attacked(suite, mirror), attacked(suite, mirror, drop_alarmed=True)
    silent = every.first_alarm == 0
    np.testing.assert_array_equal(every.position[:, silent], some.position[:, silent])


def test_its_context_is_that_of_its_decisions(suite: Suite) -> None:
    setup = suite.setup(suite.detector_players[0])
    context, _, _ = bound_spoofer(Mirror(**LATE), setup, 3)
    assert (context.interval_s, context.steps) == (2.5, setup.steps // 5)
    assert setup.repeat == 1  # the world is as it was


def test_a_policy_of_an_onnx_file_decides_as_its_card_says(suite: Suite, tmp_path: Path) -> None:
    late = small_suite(detectors=("ewma",), settings=LATE)
    write_policy(tmp_path / "push.onnx", late, "blind", (0.0, 0.05))
    policy = OnnxPolicy(str(tmp_path / "push.onnx"))
    assert (policy.decision_interval_s, policy.between) == (2.5, "linear")
    own, worlds = attacked(suite, policy), attacked(late, policy)
    np.testing.assert_array_equal(own.position, worlds.position)


def test_a_model_takes_its_pace_from_its_environment() -> None:
    sb3 = pytest.importorskip("spoofgym.sb3")
    envs = sb3.SpoofVecEnv(2, detector="never", **LATE)

    class Model:
        def predict(self, seen: np.ndarray, deterministic: bool) -> tuple[np.ndarray, None]:
            return np.zeros((len(seen), 1)), None

        def get_env(self) -> object:
            return envs

    spoofer = specify_policy(Model(), None, None).fixed_spec
    assert isinstance(spoofer, ModelPolicy)
    assert (spoofer.decision_interval_s, spoofer.between) == (2.5, "linear")
    envs.close()


@pytest.mark.parametrize(
    ("own", "world", "message"),
    [
        ({"decision_interval_s": 0.7}, {}, "Mirror decides by .*=0.7 .*multiple of the interval"),
        ({"decision_interval_s": 3.0}, {}, "Mirror decides by .*=3.0 .*whole number of decisions"),
        ({"decision_interval_s": "ten"}, {}, "Mirror decides by .*='ten' .*decision_interval_s"),
        ({"decision_interval_s": 0.0}, LATE, "Mirror decides by .*=0.0 .*must be a number above 0"),
        ({"between": "linear"}, {}, "needs a `decision_interval_s`"),
        (
            {"decision_interval_s": 2.5, "between": "spline"},
            {},
            "`between` must be 'hold' or 'linear', got",
        ),
        ({"decision_interval_s": 5.0}, LATE, "Mirror decides every 5 s .hold between., but this"),
        ({"decision_interval_s": 2.5}, LATE, "this world every 2.5 s .linear between."),
    ],
)
def test_a_pace_that_does_not_fit_is_told(
    own: dict[str, Any], world: dict[str, object], message: str
) -> None:
    suite = small_suite(detectors=("ewma",), settings=world)
    with pytest.raises(ValueError, match=message):
        apply_pace(suite.setup(suite.detector_players[0]), Mirror(**own))


@pytest.mark.parametrize("amplitude", [None, 0.5])
def test_a_pace_that_a_campaign_would_lose_is_refused(amplitude: float | None) -> None:
    ramp = make_spoofer("ramp")
    ramp.decision_interval_s = 2.5
    with pytest.raises(ValueError, match=r"`decision_interval_s` = 2.5 was set on an object of"):
        specify_spoofer(ramp if amplitude is None else Scaled(ramp, amplitude))
    assert specify_spoofer(Mirror(**LATE)).spec["between"] == "linear"


def test_an_environment_asks_it_as_often_as_it_decides() -> None:
    envs = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=2, knowledge="oracle")
    with pytest.raises(
        ValueError, match=r"make it with decision_interval_s=2\.5, between='linear'"
    ):
        attach(Mirror(**LATE), envs)
    envs.close()
    late = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=2, knowledge="oracle", **LATE)
    assert attach(Mirror(**LATE), late).context.interval_s == 2.5
    late.close()


class Reach(Mirror):
    """Has a setting whose range depends on how often it decides."""

    tunable = "far"
    far = 1.0

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        return 1.0, 1.0 + context.interval_s


def test_a_setting_has_the_range_of_its_own_decisions(suite: Suite) -> None:
    setup = suite.setup(suite.detector_players[0])
    assert get_tuning_range(Reach(**LATE), setup) == (1.0, 3.5)


def test_a_calibration_is_asked_for_by_a_command_without_it() -> None:
    late = small_suite(settings=LATE)
    assert "decision" not in late.setup(late.detector_players[0]).conditions.options


def test_an_animation_has_a_frame_for_every_epoch(suite: Suite, tmp_path: Path) -> None:
    late = small_suite(detectors=("ewma",), settings=LATE)
    write_policy(tmp_path / "push.onnx", late, "blind", (0.0, 0.05))
    (detector,) = suite.detector_players
    entry = specify_spoofer(str(tmp_path / "push.onnx"))
    counts = [len(list(play_frames(each, detector, entry, every=4))) for each in (suite, late)]
    assert counts == [1 + 40 // 4, 1 + 8 // 4]  # its own decisions, and those of the world
    assert counts == [frame_count(each, detector, every=4) for each in (suite, late)]


def test_calibrations_hold_however_often_a_spoofer_decides() -> None:
    often, late = small_suite(), small_suite(settings=LATE)
    conditions = [each.setup(each.detector_players[0]).conditions for each in (often, late)]
    assert conditions[0].settings == conditions[1].settings


def test_a_scripted_spoofer_decides_at_every_decision_of_the_world() -> None:
    assert make_spoofer("ramp").decision_interval_s is None
