"""What is calibrated for the package is what its tasks for detectors name."""

import pytest

from spoofgym.bench.experiments.suite import list_task_detectors
from spoofgym.calibration.thresholds import inner_detectors
from spoofgym.detectors.calibrated import describe_identity
from spoofgym.tasks import DETECTOR_TASKS
from tests.nightly import heavy
from tools.calibrations import OWN_WORLDS, list_detectors


@pytest.mark.parametrize("world", heavy(OWN_WORLDS, "S2", "S3", "T4"))
def test_the_classics_of_tasks_for_detectors_are_calibrated_in_their_world(world):
    # the worlds of T5 and T6 differ from that of T3 by their attack alone
    same = {"T3": ("T3", "T5", "T6")}.get(world, (world,))
    tasks = [t for t in DETECTOR_TASKS.values() if t.task.key in same]
    made = [*map(describe_identity, list_detectors(world, None))]  # which looks at no setup here
    for task in tasks:
        wanted = inner_detectors(list_task_detectors(task.task))
        assert len(wanted) > 8
        assert all(describe_identity(each) in made for each in wanted)
