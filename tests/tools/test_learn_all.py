"""All trainings by one command: what has ended is not run again, and every command is one."""

from __future__ import annotations

import importlib.util
import json
import subprocess

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
for name in ("torch", "tyro"):
    pytest.importorskip(name)

from rich.console import Console

from spoofgym.detector_tasks import DETECTOR_TASKS
from spoofgym.tasks import TASKS
from tools.learn_all import MARKS, Settings, run, steps_of

QUIET = Console(quiet=True)


def writing(path):
    """A step that appends a line to a file."""
    return ["-c", f"open({str(path)!r}, 'a').write('x')"]


def test_a_killed_run_goes_on_with_the_step_that_was_not_finished(tmp_path):
    first, last = tmp_path / "first", tmp_path / "last"
    fails = {"one": writing(first), "two": ["-c", "raise SystemExit(3)"], "three": writing(last)}
    with pytest.raises(subprocess.CalledProcessError, match="status 3"):
        run(tmp_path, fails, QUIET)
    assert not last.exists()
    done = run(tmp_path, {**fails, "two": writing(last)}, QUIET)
    assert list(done) == ["one", "two", "three"]
    assert first.read_text() == "x"
    assert last.read_text() == "xx"
    assert json.loads((tmp_path / MARKS).read_text()) == done
    run(tmp_path, {"one": writing(last), "three": writing(last)}, QUIET)
    assert first.read_text() == "x"
    assert last.read_text() == "xxx"  # "one" has another command now


def test_every_task_and_every_page_has_its_step(tmp_path):
    steps = steps_of(tmp_path)
    assert {f"ppo-{key}" for key in TASKS} | {f"cards-{key}" for key in DETECTOR_TASKS} <= {*steps}
    for option, module, *_ in steps.values():
        assert option == "-m"
        assert importlib.util.find_spec(module) is not None
    names = [*steps]
    assert names.index("data") < names.index("guard") < names.index("threshold")
    page = names.index("page")
    assert all(names.index(name) < page for name in ("spoofers", "refits", "fresh-T1", "plain-T2"))


def test_names_of_steps_are_checked(tmp_path):
    with pytest.raises(ValueError, match="unknown step 'ppo-T9'"):
        Settings(out=tmp_path, only=("ppo-T9",))
