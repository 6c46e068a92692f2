"""The notebooks of docs/tutorials run, and hold what they printed."""

import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from .pages import ROOT

TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.ipynb"))
NEEDED = {"train_a_spoofer": "stable_baselines3"}


def read_cells(path: Path) -> list[dict]:
    return [each for each in json.loads(path.read_text())["cells"] if each["cell_type"] == "code"]


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_notebook_was_run_from_top_to_bottom_without_a_warning(path):
    cells = read_cells(path)
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [each for cell in cells for each in cell["outputs"]]
    assert {each["output_type"] for each in outputs} <= {"stream", "display_data"}
    assert all(each.get("name") != "stderr" for each in outputs)


@pytest.mark.nightly
@pytest.mark.usefixtures("default_rate_of_module", "in_tmp_path")
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_notebook_runs_as_it_stands(path, monkeypatch):
    pytest.importorskip(NEEDED.get(path.stem, "numpy"))
    monkeypatch.setenv("MPLBACKEND", "agg")
    notebook = ModuleType("notebook")  # its classes are found by their module, as in a notebook
    monkeypatch.setitem(sys.modules, notebook.__name__, notebook)
    for cell in read_cells(path):
        exec(compile("".join(cell["source"]), path.name, "exec"), vars(notebook))
