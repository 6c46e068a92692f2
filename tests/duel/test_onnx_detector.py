"""Detector policies in ONNX files, with their cards."""

import json

import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.calibration import calibrate_detectors, check
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE, run_probability
from spoofgym.duel.duel import with_world
from spoofgym.duel.opponents import make_opponent
from spoofgym.simulation import TightlyCoupledSetup

from ..spoofers.policies import network, write_policy, written
from .support import BRIEF

SETTINGS = {**BRIEF, "runs": 19}


@pytest.fixture
def file(tmp_path):
    view = duel_v0.DetectorView(**BRIEF)
    path = tmp_path / "guard.onnx"
    sizes = view.observation_space.shape[0], view.action_space.shape[0]
    path.write_bytes(written(network(*sizes)))
    duel_v0.write_card(path, view, name="guard")
    found = duel_v0.calibrate_policy(duel_v0.OnnxDetector(path), **SETTINGS)
    card = duel_v0.write_card(path, view, name="guard", calibration=found)
    assert card.threshold == found.point(per_run=0.05).scale
    return path


def edit(path, **fields):
    card = path.with_suffix(".json")
    card.write_text(json.dumps(json.loads(card.read_text()) | fields))


def test_a_file_stands_in_a_pool(file, tmp_path):
    view = duel_v0.SpooferVectorView(4, [str(file), "ewma"], **BRIEF)
    view.reset(seed=3)
    for _ in range(5):
        view.step(np.zeros((4, 1)))
    assert set(view.opponents) <= {str(file), "ewma"}
    other = duel_v0.SpooferView({"name": str(file), "threshold": 0.25}, **BRIEF)
    (member,) = other.core.setup.detector.judges
    assert (member.scale, member.detector.card.exclusion_s) == (0.25, 30.0)
    store = tmp_path / "store"
    first = duel_v0.calibrate_policy(duel_v0.OnnxDetector(file), **SETTINGS, store=store)
    assert first.detector["policy"] == duel_v0.OnnxDetector(file).card.file.sha256[:16]
    assert len(list(store.iterdir())) == 1


def test_a_file_is_calibrated_by_the_mechanism_of_all_detectors(file, tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "own"))
    asked = {"name": str(file), "false_alarms_per_hour": 20.0}
    told = r"no calibration of .*guard\.onnx .*--detector .*guard\.onnx --false-alarms-per-hour 20`"
    with pytest.raises(ValueError, match=told):
        duel_v0.SpooferView(asked, **BRIEF)
    setup = TightlyCoupledSetup(detector="never", **with_world(BRIEF))
    judge = make_opponent(asked, setup.live)
    (found,) = calibrate_detectors(setup, judge, runs=40, false_alarms_per_hour=20.0)
    check(setup, [found], judge)
    (member,) = duel_v0.SpooferView(asked, **BRIEF).core.setup.detector.judges
    assert (member.scale, member.detector.quiet_epochs) == (found.point(20.0).scale, setup.live)
    assert duel_v0.calibrate_policy(
        duel_v0.OnnxDetector(file),
        **BRIEF,
        runs=40,
        false_alarm=run_probability(20.0, setup.window_s),
    ).point(20.0).scale == pytest.approx(member.scale, rel=1e-10)


def test_what_does_not_fit_is_refused_by_name(file):
    names = duel_v0.OnnxDetector(file).card.observation.model_dump()
    for changes, message in (
        (
            {"names": ["odd", *names["names"][1:]]},
            r"the detector 'guard' \(.*guard.onnx\).* odd only on the card; .*: range_inn",
        ),
        ({"high": [11.0, *names["high"][1:]]}, r"'guard' .* observation\.high: "),
    ):
        edit(file, observation={**names, **changes})
        with pytest.raises(ValueError, match=message):
            duel_v0.SpooferView(str(file), **BRIEF).reset(seed=0)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"threshold": None}, "has no threshold on its card: ask for"),
        ({"threshold": 1.5}, "`threshold`: Input should be less than or equal to 1, got 1.5"),
        ({"weighs": "often"}, r"card .*guard\.json: `weighs`: "),
        ({"file": {"name": "x.onnx", "sha256": "0" * 64, "bytes": 1, "opset": 18}}, "and 1 on its"),
    ],
)
def test_damaged_cards(file, fields, message):
    edit(file, **fields)
    with pytest.raises(ValueError, match=message) as told:
        duel_v0.SpooferView(str(file), **BRIEF)
    assert "\n" not in str(told.value)
    assert "errors.pydantic.dev" not in str(told.value)


def test_other_files(file, tmp_path):
    spoofer, small = write_policy(file.parent, "tiny"), tmp_path / "small.onnx"
    small.write_bytes(written(network(3, 2)))
    view = duel_v0.DetectorView(**BRIEF)
    for make, message in (
        (lambda: duel_v0.DetectorView(str(file)), "is that of a detector policy, .* SpooferView"),
        (lambda: duel_v0.SpooferView(str(spoofer)), "is that of a spoofer, .* DetectorView"),
        (lambda: duel_v0.SpooferView({"name": str(file), "level": 0.2}), "no setting 'level'; va"),
        (lambda: duel_v0.write_card(small, view, name="small"), r"\(batch, 3\); the card has"),
        (lambda: duel_v0.OnnxDetector("guard.pt"), r"must be the path of an \.onnx file"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
