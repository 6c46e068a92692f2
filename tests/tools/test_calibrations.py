"""What is calibrated for the package is what its tasks for detectors name."""

from __future__ import annotations

import pytest

from spoofgym.bench.detector_cards import classics_of
from spoofgym.detector_tasks import DETECTOR_TASKS
from spoofgym.detectors.calibrated import identity_of
from spoofgym.simulators.calibration import inner_detectors
from tools.calibrations import OWN_WORLDS, WORLDS, detectors_of, setup_of


@pytest.mark.parametrize("key", DETECTOR_TASKS)
def test_the_classics_of_a_task_for_detectors_are_calibrated_in_its_world(key):
    task = DETECTOR_TASKS[key]
    # the worlds of T5 and T6 differ from that of T3 by their attack alone
    world = task.world_of if task.world_of in OWN_WORLDS else "T3"
    assert world in WORLDS
    made = [identity_of(each) for each in detectors_of(world, setup_of(world))]
    wanted = inner_detectors(classics_of(task))
    assert len(wanted) > 8
    assert all(identity_of(each) in made for each in wanted)
