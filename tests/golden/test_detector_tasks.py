"""The tasks for detectors stay as they are: settings by a digest, figures of stated attacks."""

from __future__ import annotations

import json

import numpy as np
import pytest

from spoofgym.core.settings import compute_digest
from spoofgym.tasks import DETECTOR_TASKS
from tests.nightly import heavy

from .detector_tasks import KEPT, reached, resolved
from .tasks import differences

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")


@pytest.fixture(scope="module")
def kept():
    return json.loads(KEPT.read_text())


@pytest.mark.parametrize("key", heavy(DETECTOR_TASKS, "D2"))
def test_the_settings_of_a_task_never_change(key, kept):
    now = resolved(DETECTOR_TASKS[key])
    changed = differences(kept[key]["settings"], now)
    assert not changed, f"task {key} has changed, which makes it another task: {changed}"
    assert compute_digest(now) == kept[key]["sha256"]


@pytest.mark.parametrize("key", heavy(DETECTOR_TASKS, "D2"))
def test_stated_attacks_come_as_far_as_they_did(key, kept):
    task = DETECTOR_TASKS[key]
    assert list(kept[key]["reached"]) == [family.key for family in task.held_out]
    for family in task.held_out:
        found, before = reached(task, family), kept[key]["reached"][family.key]
        assert found["numbers"] == before["numbers"], family.key
        np.testing.assert_allclose(
            found["displacement_m"], before["displacement_m"], rtol=1e-6, atol=2e-6
        )


def test_tasks_differ_and_are_all_kept(kept):
    assert list(kept) == list(DETECTOR_TASKS)
    assert len({each["sha256"] for each in kept.values()}) == len(DETECTOR_TASKS)
    for each in kept.values():
        far = [max(max(moved) for moved in x["displacement_m"]) for x in each["reached"].values()]
        assert min(far) > 1.0
