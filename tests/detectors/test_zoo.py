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

LARGEST_BYTES = 200_000


@pytest.mark.parametrize("name", list_shipped("detector"))
def test_a_name_stands_for_its_file(name: str) -> None:
    pytest.importorskip("onnxruntime")
    made = make_detector({"name": name, "threshold": 0.9})
    assert isinstance(made, Calibrated)
    named, read = made.detector, LearnedDetector(str(resolve_path(name)))
    assert isinstance(named, LearnedDetector)
    assert named.label == name
    assert describe_identity(named) == describe_identity(read)
    assert named.spec == {"name": name}
    assert resolve_path(name).stat().st_size < LARGEST_BYTES


@pytest.mark.parametrize("name", list_shipped("detector"))
def test_it_has_a_threshold_in_the_world_that_it_was_made_for(name: str) -> None:
    pytest.importorskip("onnxruntime")
    made = make_detector({"name": name, "false_alarms_per_hour": 0.2})
    assert isinstance(made, Calibrated)
    trained_in = made.detector.card.training["task"]  # type: ignore[attr-defined]
    world = World.of(trained_in).setup
    resolve_thresholds(made, world)
    assert 0.0 < (made.scale or 0.0) < 1.0
    (found,) = made._load_candidates(world.conditions, describe_identity(made.detector))
    assert found.path is not None
    assert found.path.is_relative_to(SHIPPED_FOLDER)


def test_they_are_listed_and_their_cards_are_there() -> None:
    assert set(list_shipped("detector")) <= {row["name"] for row in KINDS["detectors"]()}
    assert [
        name for name in list_shipped("detector") if not (ZOO_FOLDER / f"{name}.json").is_file()
    ] == []
    assert resolve_path("runs/mine.onnx").as_posix() == "runs/mine.onnx"


def test_another_name_is_refused() -> None:
    with pytest.raises(ValueError, match="trolley-gaurd"):
        make_detector("trolley-gaurd")
