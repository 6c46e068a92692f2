"""A detector by file, wherever a detector is named."""

from __future__ import annotations

import json
import shutil

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from onnx import helper, numpy_helper

import spoofgym
from spoofgym import duel_v0
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.players import specify_detector
from spoofgym.calibration import calibrate_detectors
from spoofgym.calibration.clean_runs import Player
from spoofgym.cli.app import app
from spoofgym.core.registry import parse_spec
from spoofgym.detectors import LearnedDetector, calibrated, detector_in_world, make_detector
from spoofgym.detectors.calibrated import describe_identity
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from spoofgym.envs.wrappers import DetectorWrapper, WatchWrapper
from spoofgym.limits import Replay
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.setup import seed_sequences
from spoofgym.testing import check_detector

from .files import TERMS, edit_card, value, write_guard

FAST = {"warmup_s": 6.0, "live_s": 3.0, "attack_s": 8.0, "time_to_alert_s": 1.0}
ID = "spoofgym/TightlyCoupled-v0"
RATE = 60.0


@pytest.fixture
def guard(tmp_path):
    return write_guard(tmp_path, threshold=0.9)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "own"))
    return tmp_path / "own"


def tight(detector="never"):
    setup = TightlyCoupledSetup(detector=detector, timeline=FAST)
    setup.env_id, setup.raw_settings = ID, {"timeline": FAST}
    return setup


def statistic(env, action):
    """Of the first receiver, after a step."""
    env.step(action)
    return env.unwrapped.core.engine.simulator.verdict.statistic[0, 0]


def inner(env):
    return env.unwrapped.core.setup.detector


def test_a_name_makes_a_detector_with_the_threshold_of_its_card(guard):
    made = make_detector(str(guard))
    assert (type(made.detector), made.scale) == (LearnedDetector, 0.9)
    own = make_detector({"name": str(guard), "threshold": 0.4})
    nominal = make_detector({"name": str(guard), "thresholds": "nominal"})
    factor = make_detector({"name": str(guard), "threshold_scale": 0.3})
    assert [each.scale for each in (own, nominal, factor)] == [0.4, 0.9, 0.3]
    rate = make_detector({"name": str(guard), "false_alarms_per_hour": 0.2})
    assert (rate.resolved, rate.detector.label) == (False, "guard")
    with pytest.raises(
        ValueError, match=r"no setting 'level'; valid: threshold, quiet_epochs, sha"
    ):
        make_detector({"name": str(guard), "level": 1.0})
    with pytest.raises(ValueError, match="must be a number above 0 and at most 1, got 2"):
        make_detector({"name": str(guard), "threshold": 2})
    with pytest.raises(
        ValueError, match=r"has a `threshold` of its own, and a request for another"
    ):
        make_detector({"name": str(guard), "threshold": 0.5, "false_alarms_per_hour": 1.0})
    with pytest.raises(ValueError, match=r"there is no ONNX file nowhere\.onnx"):
        make_detector("nowhere.onnx")
    with pytest.raises(ValueError, match=r"has the SHA-256 .*; `sha256` must be 0000"):
        make_detector({"name": str(guard), "sha256": "0" * 64})


def test_no_file_is_without_a_threshold_by_accident(tmp_path):
    fresh = write_guard(tmp_path, "fresh")
    for spec in (str(fresh), {"name": str(fresh), "thresholds": "nominal"}):
        with pytest.raises(ValueError, match=r"fresh\.onnx has no threshold on its card: ask for"):
            make_detector(spec)
    check_detector(str(fresh))  # which is not about thresholds
    asked = {"name": str(fresh), "false_alarms_per_hour": RATE}
    with pytest.raises(ValueError, match=r'or give a threshold: .*"threshold": 0\.9') as told:
        gym.make(ID, detector=asked, timeline=FAST)
    assert "nominal" not in str(told.value)


def test_environments_take_a_file_and_their_spec_is_json(guard):
    envs = [
        gym.make(ID, detector=str(guard), timeline=FAST),
        DetectorWrapper(gym.make(ID, timeline=FAST), str(guard)),
    ]
    spec = EnvSpec.from_json(envs[0].spec.to_json())
    assert spec.kwargs["detector"] == str(guard)
    envs.append(gym.make(spec))
    seen = []
    for env in envs:
        env.reset(seed=3)
        seen.append([statistic(env, env.action_space.low) for _ in range(6)])
        assert inner(env).detector.sha256 == LearnedDetector(str(guard)).sha256
    assert seen[0] == seen[1] == seen[2]
    assert len({*seen[0]}) == 6
    batch = gym.make_vec(ID, num_envs=3, detector=str(guard), timeline=FAST)
    batch.reset(seed=3)
    low = np.tile(batch.single_action_space.low, (3, 1))
    assert [statistic(batch, low) for _ in range(6)] == seen[0]
    learner = SpoofVecEnv(2, detector=str(guard), timeline=FAST, seed=0)
    learner.reset()
    assert inner(learner).scale == 0.9


def test_a_passive_one_watches_beside_the_detector_in_the_loop(guard):
    plain = gym.make(ID, detector="never", timeline=FAST)
    watched = WatchWrapper(gym.make(ID, detector="never", timeline=FAST), [str(guard)])
    for env in (plain, watched):
        env.reset(seed=1)
    for _ in range(5):
        action = plain.action_space.high
        one, two = plain.step(action), watched.step(action)
        np.testing.assert_array_equal(one[0], two[0])
    assert 0.0 < two[4]["watch_guard_ratio"] < 1.0 / 0.9


def test_it_is_calibrated_by_the_command_that_the_error_names(guard, folder, tmp_path, capsys):
    asked = {"name": str(guard), "false_alarms_per_hour": RATE}
    with pytest.raises(ValueError, match=r"no calibration of .*guard\.onnx in zhong2025") as told:
        gym.make(ID, detector=asked, timeline=FAST)
    command = str(told.value).split("`")[1]
    import shlex

    words = shlex.split(command)
    assert words[:2] == ["spoofgym", "calibrate"]
    app([*words[1:], "--runs", "40", "--json"], standalone_mode=False)
    found = json.loads(capsys.readouterr().out)["calibrations"]
    assert [each["detector"] for each in found] == ["guard"]
    env = gym.make(ID, detector=asked, timeline=FAST)
    assert inner(env).scale == found[0]["scale"]
    # by content and settings, wherever the file is
    moved = write_guard(tmp_path / "elsewhere", "copy", threshold=0.2)
    assert inner(gym.make(ID, detector={**asked, "name": str(moved)}, timeline=FAST)).scale > 0.0
    for change in (
        {"terms": [*TERMS[:2], {"name": "elapsed", "scale_s": 9.0}]},
        {"quiet_epochs": 3},
    ):
        other = write_guard(tmp_path / "other", "guard", **change)
        with pytest.raises(ValueError, match=r"no calibration of .*other/guard\.onnx"):
            gym.make(ID, detector={**asked, "name": str(other)}, timeline=FAST)


def test_a_calibration_does_not_depend_on_the_threshold_of_the_card(guard, folder, tmp_path):
    settings = {"runs": 24, "false_alarms_per_hour": RATE}
    (by_card,) = calibrate_detectors(tight(), str(guard), **settings)
    fresh = write_guard(tmp_path / "fresh")
    assert describe_identity(LearnedDetector(str(fresh))) == describe_identity(
        LearnedDetector(str(guard))
    )
    (again,) = calibrate_detectors(tight(), str(fresh), **settings, overwrite=True)
    assert again.largest == by_card.largest
    assert max(by_card.largest) <= 1.0


def test_passive_detectors_share_a_pass_and_see_what_each_sees_in_the_loop(guard):
    setup, player = tight(), Player(tight(), threads=1)
    judges = [LearnedDetector(str(guard)), make_detector("snapshot-chi2")]
    together = player.play(judges, range(6))
    alone = player.play(judges[:1], range(6), in_loop=True)
    np.testing.assert_array_equal(together.column(0).judged, alone.column(0).judged)
    assert setup.live == 6


def test_it_is_asked_from_when_it_is_switched_on(guard, tmp_path):
    """Its statistic is one in the monitored warm-up; one that is quiet there has none."""
    quiet = write_guard(tmp_path / "quiet", quiet_epochs=6)
    player = Player(tight(), threads=1)
    judges = [LearnedDetector(str(guard)), LearnedDetector(str(quiet))]
    found = player.play(judges, range(4))
    assert (found.before[:, 0] > 0.0).all()
    assert (found.before[:, 1] == 0.0).all()
    assert (found.judged != 0.0).all()
    assert judges[1].spec == {"name": str(quiet)}
    later = LearnedDetector(str(quiet), quiet_epochs=2)
    assert later.spec == {"name": str(quiet), "quiet_epochs": 2}
    assert describe_identity(later) != describe_identity(judges[1])


def test_a_pool_of_the_duel_keeps_the_warm_up_of_the_card(guard, tmp_path):
    """Older cards say nothing, so that their detectors are not asked in the duel's warm-up."""
    old = write_guard(tmp_path / "old", "old", threshold=0.9)
    edit_card(old, quiet_epochs=..., terms=TERMS, channels=..., interval_s=...)
    edit_card(old, terms=[{"name": name} for name in TERMS])
    view = duel_v0.SpooferView([str(guard), str(old)], timeline=FAST)
    first, second = (each.detector for each in view.core.setup.detector.judges)
    assert (first.judge_by.quiet, second.judge_by.quiet) == (0, view.core.setup.live)
    assert second.spec == {"name": str(old), "quiet_epochs": 6}
    assert make_detector(str(old)).detector.judge_by.quiet == 0


def test_an_older_card_has_the_terms_of_the_duel(tmp_path):
    path = write_guard(tmp_path, terms=None, state=None, weighs=True)
    whole = LearnedDetector(str(path))
    edit_card(path, terms=..., state=..., channels=..., interval_s=..., quiet_epochs=...)
    old = LearnedDetector(str(path))
    assert old.card.terms is None
    assert old.judge_by.observed_terms == whole.judge_by.observed_terms
    check_detector(str(path))


def test_what_was_made_for_another_receiver_is_refused(guard):
    edit_card(guard, interval_s=1.0)
    with pytest.raises(ValueError, match=r"'guard' .* interval_s: 1 on the card, 0\.5 here"):
        gym.make(ID, detector=str(guard), timeline=FAST).reset()
    edit_card(guard, channels=9)
    with pytest.raises(ValueError, match=r"'guard' .* made for 9 slots of satellites, and .* 12"):
        gym.make(ID, detector=str(guard), timeline=FAST).reset()


def test_a_campaign_names_it_by_content(guard, tmp_path):
    entry = specify_detector(str(guard))
    assert entry.label.startswith("guard")
    assert entry.spec["sha256"] == LearnedDetector(str(guard)).sha256
    again = detector_in_world(json.loads(json.dumps(entry.spec)))
    assert (again.scale, again.detector.sha256) == (0.9, entry.spec["sha256"])
    text = parse_spec(f"{guard}:threshold=0.5")
    assert specify_detector(text).spec["threshold_scale"] == 0.5
    plain = specify_detector(LearnedDetector(str(guard)))
    assert detector_in_world(plain.spec).scale == 1.0
    moved = tmp_path / "moved"
    moved.mkdir()
    for suffix in (".onnx", ".json"):
        shutil.copy(guard.with_suffix(suffix), moved)
    one, other = (
        Suite(detectors=[str(path)], spoofers=["none"], timeline=FAST, runs=4)
        for path in (guard, moved / guard.name)
    )
    assert one.config == other.config
    assert one.digest == other.digest
    edit_card(moved / guard.name, threshold=0.8)
    changed = Suite(detectors=[str(moved / guard.name)], spoofers=["none"], timeline=FAST, runs=4)
    assert changed.digest != one.digest


def test_spoofers_are_scored_against_it(guard):
    score = spoofgym.evaluate(
        {"name": "ramp", "rate_mps": 0.2},
        detector=str(guard),
        runs=4,
        fit_runs=80,
        amplitude=None,
        timeline=FAST,
    )
    assert score.detector.startswith("guard")
    assert np.isfinite(score.displacement_m).all()
    with pytest.raises(ValueError, match=r"no calibration of .*guard\.onnx"):
        Evaluator(detector={"name": str(guard), "false_alarms_per_hour": 5.0}, timeline=FAST)


def energy(_):
    """A network whose statistic grows with the sum of squares of what is observed."""
    nodes = [
        helper.make_node("Mul", ["observation", "observation"], ["square"]),
        helper.make_node("ReduceSum", ["square", "axes"], ["sum"], keepdims=1),
        helper.make_node("Mul", ["sum", "small"], ["scaled"]),
        helper.make_node("Sub", ["scaled", "one"], ["action"]),
    ]
    tensors = {"axes": np.int64([1]), "small": np.float32([0.05]), "one": np.float32([1.0])}
    graph = helper.make_graph(
        nodes,
        "policy",
        [value("observation", 24)],
        [value("action", 1)],
        [numpy_helper.from_array(array, name) for name, array in tensors.items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)


def test_a_passive_one_is_replayed_as_it_is_played(tmp_path):
    """Judged by its own `judge` on responses: what the engine gives, to first order."""
    from ...limits.test_response import played, ramp_of

    guard = write_guard(tmp_path, terms=["average-innovation"], state=None, edit=energy)
    setup = TightlyCoupledSetup(detector="never", timeline={**FAST, "attack_s": 30.0})
    detector, curve = LearnedDetector(str(guard)), ramp_of(setup)
    replay = Replay(setup, [detector], seed_sequences(0, "training", setup.name, 3), threads=2)
    found = replay.play(0, np.array([0.0 * curve, curve]))
    clean, attacked = (
        played(setup, [detector], 3, each)[0][:, 0].max(axis=0) for each in (0.0 * curve, curve)
    )
    assert (attacked > clean).all()
    np.testing.assert_allclose(found.peak[0], clean, rtol=1e-4)
    assert (np.abs(found.peak[1] - attacked) < 0.1 * (attacked - clean)).all()


def test_limits_say_that_it_has_no_bound(guard, capsys):
    arguments = ["limits", "--set", f"timeline={json.dumps(FAST)}", "--json"]
    app([*arguments, "--detector", f"{guard}:threshold=0.9"], standalone_mode=False)
    found = json.loads(capsys.readouterr().out)["zero_alarm"]
    assert "no zero-alarm bound for LearnedDetector" in json.dumps(found)


def test_the_default_rate_is_asked_for_in_a_world(guard, monkeypatch):
    monkeypatch.setattr(calibrated, "DEFAULT_RATE", 0.2)
    made = tight("never").copy_with(
        detector=detector_in_world({"name": str(guard), "threshold": 0.4})
    )
    assert made.detector.scale == 0.4
    with pytest.raises(ValueError, match=r"no calibration of .*guard\.onnx .* 0\.2 false alarms"):
        gym.make(ID, detector=str(guard), timeline=FAST)
    pool = {"name": "pool", "members": [{"name": str(guard), "threshold": 0.4}, "never"]}
    assert tight(pool).detector.judges[0].scale == 0.4
