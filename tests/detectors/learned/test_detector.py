"""A detector by file, wherever a detector is named; recurrent networks with declared states."""

import json
import shlex
import shutil

import gymnasium as gym
import numpy as np
import onnx
import onnxruntime
import pytest
from gymnasium.envs.registration import EnvSpec
from onnx import numpy_helper

from spoofgym import duel_v0
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.world import PLAIN_ID
from spoofgym.calibration.clean_runs import Player
from spoofgym.cli.app import app
from spoofgym.core.registry import parse_spec
from spoofgym.detectors import LearnedDetector, detector_in_world, make_detector
from spoofgym.detectors.calibrated import describe_identity
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from spoofgym.policies.load import OnnxDetector
from spoofgym.policies.onnx_file import describe_file
from spoofgym.policies.onnx_model import OnnxModel
from spoofgym.policies.zoo import list_shipped, resolve_path
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.testing import check_detector
from spoofgym.testing.epochs import engine_script
from spoofgym.wrappers import DetectorWrapper, WatchWrapper

from ...spoofers.policies import written
from .files import TERMS, edit_card, value, write_guard

FAST = {"warmup_s": 6.0, "live_s": 3.0, "attack_s": 8.0, "time_to_alert_s": 1.0}
ID = "spoofgym/Zhong2025-v0"
RATE = {"false_alarms_per_hour": 60.0}


@pytest.fixture
def guard(tmp_path):
    return str(write_guard(tmp_path, threshold=0.9))


def tight(detector="never"):
    setup = TightlyCoupledSetup(detector=detector, timeline=FAST)
    setup.env_id, setup.raw_settings = ID, {"timeline": FAST}
    return setup


def make(detector):
    return gym.make(ID, detector=detector, timeline=FAST)


def inner(env):
    return env.unwrapped.core.setup.detector


def test_a_name_makes_a_detector_with_the_threshold_of_its_card(guard):
    made = make_detector(guard)
    assert (type(made.detector), made.scale) == (LearnedDetector, 0.9)
    scales = {"threshold": 0.4}, {"thresholds": "nominal"}, {"threshold_scale": 0.3}
    assert [make_detector({"name": guard, **each}).scale for each in scales] == [0.4, 0.9, 0.3]
    rate = make_detector({"name": guard, **RATE})
    assert (rate.resolved, rate.detector.label) == (False, "guard")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"threshold": 0.5, **RATE}, "has a `threshold` of its own, and a request for another"),
        ({"name": "nowhere.onnx"}, r"there is no ONNX file nowhere\.onnx"),
        ({"sha256": "0" * 64}, "has the SHA-256 .*; `sha256` must be 0000"),
    ],
)
def test_what_does_not_go_with_a_file_is_refused(guard, settings, said):
    with pytest.raises(ValueError, match=said):
        make_detector({"name": guard, **settings})


def test_no_file_is_without_a_threshold_by_accident(tmp_path):
    fresh = str(write_guard(tmp_path, "fresh"))
    for spec in (fresh, {"name": fresh, "thresholds": "nominal"}):
        with pytest.raises(ValueError, match=r"fresh\.onnx has no threshold on its card: ask for"):
            make_detector(spec)
    check_detector(fresh)  # which is not about thresholds
    with pytest.raises(ValueError, match=r'or give a threshold: .*"threshold": 0\.9') as told:
        make({"name": fresh, **RATE})
    assert "nominal" not in str(told.value)


def test_environments_take_a_file_and_their_spec_is_json(guard):
    def statistics(env):
        env.reset(seed=3)
        still, found = np.zeros(env.action_space.shape), []
        for _ in range(4):
            env.step(still)
            found.append(env.unwrapped.core.engine.simulator.verdict.statistic[0, 0])
        return found

    named = make(guard)
    spec = EnvSpec.from_json(named.spec.to_json())
    assert spec.kwargs["detector"] == guard
    seen = statistics(named)
    assert len({*seen}) == 4
    batch = gym.make_vec(ID, num_envs=3, detector=guard, timeline=FAST)
    wrapped = DetectorWrapper(gym.make(ID, timeline=FAST), guard)
    for env in (gym.make(spec), wrapped, batch):
        assert statistics(env) == seen
        assert inner(env).detector.sha256 == LearnedDetector(guard).sha256
    learner = SpoofVecEnv(2, env_id=ID, detector=guard, timeline=FAST, seed=0)
    learner.reset()
    assert inner(learner).scale == 0.9
    # a passive one sees the same beside the detector in the loop
    watched = WatchWrapper(make("never"), [guard])
    watched.reset(seed=3)
    still = np.zeros(watched.action_space.shape)
    ratios = [watched.step(still)[4]["watch_guard_ratio"] for _ in range(4)]
    np.testing.assert_allclose(ratios, np.array(seen) / 0.9)


def test_it_is_calibrated_by_the_command_that_the_error_names(guard, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "own"))
    with pytest.raises(ValueError, match=r"no calibration of .*guard\.onnx in zhong2025") as told:
        make({"name": guard, **RATE})
    words = shlex.split(str(told.value).split("`")[1])
    assert words[:2] == ["spoofgym", "calibrate"]
    app([*words[1:], "--runs", "40", "--json"], standalone_mode=False)
    (found,) = json.loads(capsys.readouterr().out)["calibrations"]
    assert found["detector"] == "guard"
    assert found["scale"] <= 1.0
    # by content and settings, wherever the file is, whatever threshold is on its card
    moved = str(write_guard(tmp_path / "elsewhere", "copy", threshold=0.2))
    for name in (guard, moved):
        assert inner(make({"name": name, **RATE})).scale == found["scale"]
    elapsed = {"name": "elapsed", "scale_s": 9.0}
    for change in ({"terms": [*TERMS[:2], elapsed]}, {"quiet_epochs": 3}):
        other = str(write_guard(tmp_path / "other", "guard", **change))
        with pytest.raises(ValueError, match=r"no calibration of .*other/guard\.onnx"):
            make({"name": other, **RATE})


def test_passive_ones_share_a_pass_and_are_asked_from_when_they_are_switched_on(guard, tmp_path):
    quiet = str(write_guard(tmp_path / "quiet", quiet_epochs=6))
    player = Player(tight(), threads=1)
    judges = [LearnedDetector(guard), LearnedDetector(quiet)]
    found = player.play([*judges, make_detector("snapshot-chi2")], range(4))
    alone = player.play(judges[:1], range(4), in_loop=True)
    np.testing.assert_array_equal(found.column(0).judged, alone.column(0).judged)
    assert tight().live == 6
    assert (found.before[:, 0] > 0.0).all()
    assert (found.before[:, 1] == 0.0).all()
    assert (found.judged[:, :2] != 0.0).all()
    assert judges[1].spec == {"name": quiet}
    later = LearnedDetector(quiet, quiet_epochs=2)
    assert later.spec == {"name": quiet, "quiet_epochs": 2}
    assert describe_identity(later) != describe_identity(judges[1])


def test_older_cards_have_the_terms_and_the_warm_up_of_the_duel(guard, tmp_path):
    """Older cards say nothing, so that their detectors are not asked in the duel's warm-up."""
    old = write_guard(tmp_path / "old", "old", threshold=0.9)
    terms = [{"name": name} for name in TERMS]
    edit_card(old, quiet_epochs=..., terms=terms, channels=..., interval_s=...)
    view = duel_v0.SpooferView([guard, str(old)], scenario="trolley", timeline=FAST)
    first, second = (each.detector for each in view.core.setup.detector.judges)
    assert (first.judge_by.quiet, second.judge_by.quiet) == (0, view.core.setup.live)
    assert second.spec == {"name": str(old), "quiet_epochs": 6}
    assert make_detector(str(old)).detector.judge_by.quiet == 0
    path = write_guard(tmp_path, terms=None, state=None, weighs=True)
    whole = LearnedDetector(str(path))
    edit_card(path, terms=..., state=..., channels=..., interval_s=..., quiet_epochs=...)
    old = LearnedDetector(str(path))
    assert old.card.terms is None
    assert old.judge_by.observed_terms == whole.judge_by.observed_terms
    check_detector(str(path))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"interval_s": 1.0}, r"interval_s: 1 on the card, 0\.5 here"),
        ({"channels": 9}, "made for 9 slots of satellites, and .* 12"),
    ],
)
def test_what_was_made_for_another_receiver_is_refused(tmp_path, change, said):
    path = write_guard(tmp_path, threshold=0.9)
    edit_card(path, **change)
    with pytest.raises(ValueError, match=f"'guard' .* {said}"):
        make(str(path)).reset()


def test_a_campaign_names_it_by_content(guard, tmp_path):
    entry = specify_detector(guard)
    assert entry.label.startswith("guard")
    assert entry.spec["sha256"] == LearnedDetector(guard).sha256
    again = detector_in_world(json.loads(json.dumps(entry.spec)))
    assert (again.scale, again.detector.sha256) == (0.9, entry.spec["sha256"])
    text = parse_spec(f"{guard}:threshold=0.5")
    assert specify_detector(text).spec["threshold_scale"] == 0.5
    plain = specify_detector(LearnedDetector(guard))
    assert detector_in_world(plain.spec).scale == 1.0
    moved = shutil.copytree(tmp_path, tmp_path / "moved") / "guard.onnx"
    suite = {"env": PLAIN_ID, "spoofers": ["none"], "timeline": FAST, "runs": 4}
    one, other = (Suite(detectors=[str(each)], **suite) for each in (guard, moved))
    assert (one.config, one.digest) == (other.config, other.digest)
    edit_card(moved, threshold=0.8)
    assert Suite(detectors=[str(moved)], **suite).digest != one.digest


def test_a_shipped_name_stands_for_its_file_and_others_are_paths_or_refused(
    guard, tmp_path, monkeypatch
):
    assert resolve_path("runs/mine.onnx").as_posix() == "runs/mine.onnx"
    with pytest.raises(ValueError, match="unknown detector 'trolley-guard'"):
        make_detector("trolley-guard")
    assert "guard" not in list_shipped("detector")
    monkeypatch.setattr("spoofgym.policies.zoo.ZOO_FOLDER", tmp_path)
    assert list_shipped("detector") == ("guard",)
    made = make_detector("guard").detector
    assert (made.label, made.spec) == ("guard", {"name": "guard"})
    assert describe_identity(made) == describe_identity(LearnedDetector(guard))
    with pytest.raises(ValueError, match="did you mean 'guard'"):
        make_detector("gardx")


TWO = {"hidden": 4, "slow": 2}


@pytest.mark.parametrize(("statistic", "weighs"), [("receiver", False), ("channel", True)])
def test_a_recurrent_detector_keeps_the_contract(tmp_path, statistic, weighs):
    terms = [*TERMS, {"name": "classic", "detector": "cusum"}]
    path = write_guard(tmp_path, state=TWO, terms=terms, statistic=statistic, weighs=weighs)
    check_detector(str(path))


def test_states_are_handed_on_from_epoch_to_epoch(tmp_path):
    path, script = write_guard(tmp_path, state=TWO), engine_script()
    detector = LearnedDetector(str(path))
    detector.bind(script.context)
    session = onnxruntime.InferenceSession(path.read_bytes())
    first = [np.zeros((5, size), np.float32) for size in TWO.values()]
    states = first
    for epoch in script.epochs:
        statistic = detector.judge(epoch).statistic
        seen = detector.memory["observation"]
        given = {"observation": seen, **dict(zip(TWO, states, strict=True))}
        action, *states = session.run(["action", "next_hidden", "next_slow"], given)
        np.testing.assert_allclose(statistic, 0.5 * (action + 1.0), atol=1e-6)
    forgetful, _ = OnnxDetector(path).model.step(seen, first)
    assert np.abs(0.5 * (forgetful + 1.0) - statistic).max() > 1e-3


def states(*sizes, name="hidden"):
    return [{"name": name, "size": size} for size in sizes]


def output_gone(model):
    kept = [each for each in model.graph.output if each.name != "next_hidden"]
    del model.graph.output[:]
    model.graph.output.extend(kept)


def resized(name, size, batch="batch"):
    def edit(model):
        for each in (*model.graph.input, *model.graph.output):
            if each.name == name:
                each.CopyFrom(value(name, size, batch))

    return edit


REFUSED = [
    (output_gone, states(4), r"no output next_hidden of a state; .* next_hidden of float32"),
    (None, [], r"has 2 inputs \(observation, hidden\); the card has one .*declared as `state`"),
    (None, states(5), r"hidden of float32 \(batch, 4\); .* and hidden of float32 \(batch, 5\)"),
    (resized("hidden", 4, 1), states(4), r"hidden with a fixed batch of 1; "),
    (None, states(4, name="next hidden"), r"`state\.0\.name`: "),
    (None, states(4, 4), "names of `state` must differ, got hidden, hidden"),
]


@pytest.mark.parametrize(("edit", "state", "message"), REFUSED)
def test_a_state_that_does_not_fit_is_refused(edit, state, message, tmp_path):
    path = write_guard(tmp_path)
    if edit is not None:
        model = onnx.load(path)
        edit(model)
        path.write_bytes(written(model))
        edit_card(path, file=describe_file(path.name, path.read_bytes()).model_dump())
    edit_card(path, state=state)
    with pytest.raises(ValueError, match=message):
        LearnedDetector(str(path))


def late(model):
    """The state grows by a third at each epoch, and is infinite after some hundred."""
    (tensor,) = (each for each in model.graph.initializer if each.name == "keep")
    tensor.CopyFrom(numpy_helper.from_array(np.float32([3.0]), "keep"))


def test_a_network_that_grows_or_answers_otherwise_when_asked_again_is_refused(
    tmp_path, monkeypatch
):
    path = write_guard(tmp_path, edit=late)
    with pytest.raises(ValueError, match="the state next_hidden with a value that is not finite"):
        LearnedDetector(str(path))
    path, asked, known = write_guard(tmp_path), [], OnnxModel.step

    def step(self, seen, states):
        action, after = known(self, seen, states)
        asked.append(len(seen))
        return action * (1.0 - 1e-6 * len(asked)), after

    monkeypatch.setattr(OnnxModel, "step", step)
    monkeypatch.setattr("spoofgym.policies.trial._passed", set())
    with pytest.raises(ValueError, match="the same observation differently the second time"):
        OnnxDetector(path)
