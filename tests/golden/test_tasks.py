"""The tasks stay as they are: their settings by a digest, and what a stated spoofer gets."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from spoofgym.core.settings import compute_digest
from spoofgym.tasks import TASKS
from tests.nightly import heavy

from .tasks import KEPT, differences, resolved, returns

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")


@pytest.fixture(scope="module")
def kept():
    return json.loads(KEPT.read_text())


@pytest.mark.parametrize("key", heavy(TASKS, "T4"))
def test_the_settings_of_a_task_never_change(key, kept):
    now = resolved(TASKS[key])
    changed = differences(kept[key]["settings"], now)
    assert not changed, f"task {key} has changed, which makes it another task: {changed}"
    assert compute_digest(now) == kept[key]["sha256"]


@pytest.mark.parametrize("key", heavy(TASKS, "T4"))
def test_a_stated_spoofer_gets_what_it_got(key, kept):
    found = returns(TASKS[key])
    for name, values in found.items():
        np.testing.assert_allclose(values, kept[key][name], rtol=1e-6, atol=1e-6, err_msg=name)


def test_a_change_is_named_by_its_key(kept):
    changed = copy.deepcopy(kept["T3"]["settings"])
    changed["spec"]["domain"]["worlds"] = 33
    changed["world"]["more"] = 1
    assert differences(kept["T3"]["settings"], changed) == [
        "world.more: 'nothing' is 1 now",
        "spec.domain.worlds: 32 is 33 now",
    ]
    assert compute_digest(changed) != kept["T3"]["sha256"]


def test_tasks_differ_and_are_all_kept(kept):
    assert list(kept) == list(TASKS)
    assert len({each["sha256"] for each in kept.values()}) == len(TASKS)
    for each in kept.values():
        assert max(each["undetected_displacement_m"]) > 0.5
