"""Shipped detectors that have learned, by their names."""

from __future__ import annotations

import pytest

from spoofgym.bench.report.catalogue import KINDS
from spoofgym.bench.runs.world import World
from spoofgym.detectors import Calibrated, make_detector
from spoofgym.detectors.calibrated import describe_identity, resolve_thresholds
from spoofgym.detectors.calibration_file import SHIPPED_FOLDER
from spoofgym.detectors.learned import LearnedDetector
from spoofgym.policies.zoo import ZOO_FOLDER, list_shipped, resolve_path


@pytest.mark.parametrize("name", list_shipped("detector"))
def test_a_name_stands_for_its_file_with_a_threshold_in_the_world_that_it_was_made_for(
    name: str,
) -> None:
    pytest.importorskip("onnxruntime")
    named = make_detector({"name": name, "threshold": 0.9})
    assert isinstance(named, Calibrated)
    path, detector = resolve_path(name), named.detector
    assert isinstance(detector, LearnedDetector)
    assert (detector.label, detector.spec) == (name, {"name": name})
    assert describe_identity(detector) == describe_identity(LearnedDetector(str(path)))
    assert path.stat().st_size < 200_000
    assert (ZOO_FOLDER / f"{name}.json").is_file()
    assert name in {row["name"] for row in KINDS["detectors"]()}
    made = make_detector({"name": name, "false_alarms_per_hour": 0.2})
    assert isinstance(made, Calibrated)
    world = World.of(detector.card.training["task"]).setup
    resolve_thresholds(made, world)
    assert 0.0 < (made.scale or 0.0) < 1.0
    (found,) = made._load_candidates(world.conditions, describe_identity(detector))
    assert found.path is not None
    assert found.path.is_relative_to(SHIPPED_FOLDER)


def test_other_names_are_paths_or_refused() -> None:
    assert resolve_path("runs/mine.onnx").as_posix() == "runs/mine.onnx"
    with pytest.raises(ValueError, match="trolley-gaurd"):
        make_detector("trolley-gaurd")
