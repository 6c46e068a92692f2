"""What is calibrated for the package is what its tasks for detectors name."""

import pytest

from spoofgym.bench.report.tasks import classics_of
from spoofgym.calibration.thresholds import inner_detectors
from spoofgym.detectors.calibrated import identity_of
from spoofgym.tasks import DETECTOR_TASKS
from tests.nightly import heavy
from tools.calibrations import OWN_WORLDS, detectors_of


@pytest.mark.parametrize("world", heavy(OWN_WORLDS, "T4"))
def test_the_classics_of_tasks_for_detectors_are_calibrated_in_their_world(world):
    # the worlds of T5 and T6 differ from that of T3 by their attack alone
    tasks = [t for t in DETECTOR_TASKS.values() if (t.world_of == "T4") == (world == "T4")]
    made = [identity_of(each) for each in detectors_of(world, None)]  # which looks at no setup here
    for task in tasks:
        wanted = inner_detectors(classics_of(task))
        assert len(wanted) > 8
        assert all(identity_of(each) in made for each in wanted)
