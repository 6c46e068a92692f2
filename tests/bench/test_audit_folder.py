"""A folder of an audit: killed at any moment it goes on, and two audits may fill it at once."""

import json
import signal
import subprocess
import sys
import time

import pytest

from ..docs.pages import ROOT

pytestmark = pytest.mark.nightly
AUDIT = """
import json, sys
import spoofgym
from tests.bench.detector_support import small_task

spec = {"name": "snapshot-chi2", "thresholds": "nominal"}
sizes = {"runs": 6, "selection_runs": 4, "families": ["ramps", "dashes", "quiet"], "threads": 1}
found = spoofgym.audit(spec, small_task(), "quick", folder=sys.argv[1], **sizes)
print(json.dumps({**found.as_dict(), "cost_us": 0.0}))
"""
CELLS = 5  # three families, false alarms, ages


def start(folder):
    command = [sys.executable, "-W", "ignore", "-c", AUDIT, str(folder)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)


def finish(process):
    out, _ = process.communicate(timeout=600)
    assert process.returncode == 0
    return json.loads(out)


def seeded(folder):
    folder.mkdir()
    (folder / "entropy").write_text("7\n")
    return folder


def cells(folder):
    found = folder.glob("small/cells/*.npz")
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in found}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = seeded(tmp_path_factory.mktemp("audit") / "whole")
    return finish(start(folder)), cells(folder)


def test_a_kill_loses_running_cells_only(whole, tmp_path):
    folder = seeded(tmp_path / "killed")
    for count in range(CELLS):  # once there are so many, and a moment later
        process, before = start(folder), cells(folder)
        while process.poll() is None and len(cells(folder)) < count:
            time.sleep(0.01)
        time.sleep(0.3 * count)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert cells(folder).items() >= before.items()  # none of them was played again
    before = cells(folder)
    assert finish(start(folder)) == whole[0]
    assert cells(folder).items() >= before.items()
    contents = [{name: x for name, (_, x) in each.items()} for each in (cells(folder), whole[1])]
    assert contents[0] == contents[1]
    assert len(contents[0]) == CELLS
    assert not list(folder.rglob("*.part"))


def test_two_audits_in_one_folder_say_the_same(tmp_path):
    first, second = start(tmp_path), start(tmp_path)
    found = finish(first), finish(second)
    assert found[0] == found[1]
    assert len(cells(tmp_path)) == CELLS
