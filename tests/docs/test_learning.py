"""The code of the page on well-posed learning runs, block after block."""

from __future__ import annotations

import re
import types
from pathlib import Path

import pytest

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

pytest.importorskip("stable_baselines3")

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "learning.md").read_text()
CODE = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_code_runs_in_its_order(capsys):
    module = types.ModuleType("page")
    for block in CODE:
        exec(compile(block, "docs/learning.md", "exec"), module.__dict__)
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "3600 epochs, 360 decisions"
    assert float(printed[1].split()[0]) >= 60.0
    assert printed[1].endswith("1.0")
    assert printed[2] == "[0. 0. 0. 0.]"
    assert float(printed[3]) > 10.0  # full pushes alarm more often than the budget allows
    assert printed[4] == "[85. 85. 85.]"


def test_the_code_on_tasks_runs(capsys):
    page = (Path(__file__).resolve().parents[2] / "docs" / "tasks.md").read_text()
    module = types.ModuleType("tasks")
    for block in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL):
        exec(compile(block, "docs/tasks.md", "exec"), module.__dict__)
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("drawn worlds, matched receiver")
    assert "meaconer" in printed[1]  # a family that a task for detectors holds out
    assert len(printed) == 7
