"""The tasks of both sides stay as they are: settings by a digest, and what stated players get."""

import json

import numpy as np
import pytest

from spoofgym.core.settings import compute_digest
from spoofgym.tasks import DETECTOR_TASKS, TASKS
from tests.nightly import heavy

from . import detector_tasks, tasks

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

KEPT = {**json.loads(tasks.KEPT.read_text()), **json.loads(detector_tasks.KEPT.read_text())}
EVERY = {**TASKS, **DETECTOR_TASKS}


@pytest.mark.parametrize("key", heavy(EVERY, "S2", "S3", "D2", "D3", "T4", "v1/D2"))
def test_the_settings_of_a_task_never_change(key):
    kept = KEPT[key]
    now = (tasks if key in TASKS else detector_tasks).resolved(EVERY[key])
    changed = tasks.differences(kept["settings"], now)
    assert not changed, f"task {key} has changed, which makes it another task: {changed}"
    assert compute_digest(now) == kept["sha256"]


@pytest.mark.parametrize("key", heavy(TASKS, "S2", "S3", "T4"))
@pytest.mark.parametrize("seeds", heavy([tasks.SEEDS[:1], tasks.SEEDS], tasks.SEEDS), ids=len)
def test_a_stated_spoofer_gets_what_it_got(key, seeds):
    found = tasks.returns(TASKS[key], seeds)
    for name, values in found.items():
        kept = KEPT[key][name][: len(seeds)]
        np.testing.assert_allclose(values, kept, rtol=1e-6, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("key", heavy(DETECTOR_TASKS, "D1", "D2", "D3", "v1/D2"))
def test_stated_attacks_come_as_far_as_they_did(key):
    task, kept = DETECTOR_TASKS[key], KEPT[key]["reached"]
    assert list(kept) == [family.key for family in task.held_out]
    for family in task.held_out:
        found, before = detector_tasks.reached(task, family), kept[family.key]
        assert found["numbers"] == before["numbers"], family.key
        np.testing.assert_allclose(
            found["displacement_m"], before["displacement_m"], rtol=1e-6, atol=2e-6
        )


def test_tasks_differ_and_are_all_kept():
    assert list(KEPT) == list(EVERY)
    assert len({each["sha256"] for each in KEPT.values()}) == len(EVERY)
    for key, each in KEPT.items():
        if key in TASKS:
            assert max(each["undetected_displacement_m"]) > 0.5
        else:
            moved = [np.max(found["displacement_m"]) for found in each["reached"].values()]
            assert min(moved) > 1.0
