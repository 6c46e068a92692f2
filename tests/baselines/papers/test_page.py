"""A page tells what its JSON file and the texts of its paper's module say."""

import json
import sys

import numpy as np
from PIL import Image
from typer.testing import CliRunner

from baselines.papers import page
from baselines.papers.frame import Settings
from baselines.papers.run import PaperRun

from . import toy


def test_a_page_is_made_of_a_stored_full_run(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, f"baselines.papers.{toy.KEY}", toy)
    monkeypatch.setattr(page, "KEYS", (toy.KEY,))
    monkeypatch.setattr("baselines.papers.paper.KEYS", (toy.KEY,))

    def called(*more):
        words = ["--out", str(tmp_path / "out"), "--docs", str(tmp_path), *more]
        return CliRunner().invoke(page.app, words)

    result = called()
    assert result.exit_code == 2
    assert "part '1000 throws' of toy2025 is not in" in result.stderr
    full = PaperRun(toy.KEY, Settings(quick=False, seed=0), tmp_path / "out")
    data = full.play()
    assert called().exit_code == 0
    stored = json.loads((tmp_path / "toy2025.json").read_text())
    agreed = ("paper", "runs", "seed", "origins", "rows")
    assert {key: stored[key] for key in agreed} == full.record(data)
    written = (tmp_path / "toy2025.md").read_text()
    assert written == page.page_text(toy, stored)
    assert written.startswith("# Dice et al. (2025)\n")
    for line in (
        "python -m baselines.papers toy2025\n",
        "| Table 1 | 2 | 2 of 2 | - | - | 0 |",
        "| Table 2 | 4 | 0 of 2 | 1 of 1 | 1 of 1 | 1 |",
        "[toy2025.csv](toy2025.csv)",
        "- 2 of 4 printed values lie inside the tolerance of the reproduction.",
        "- 1 of 1 of our values agree with an independent implementation.",
        "- 1 of 1 keep a limit from theory or of our own.",
        "- 1 of 6 rows have no band.",
        "![Figure 7, drawn from our runs](figures/dice_7.png)",
    ):
        assert line in written
    lines = (tmp_path / "toy2025.csv").read_text().splitlines()
    for line in (
        "Table 2,all,throws | all,-,3000,-,-,-,-,-,not printed",
        "Table 2,all,impossible,7,0,6.5 to 7.5,A,NO,-,-,a finding",
        "Table 2,all,excluded,7,3.5,3 to 4,B,NO,yes,-,not the paper's",
        "Table 2,all,largest,-,6,at most 6,C,-,-,yes,",
    ):
        assert line in lines
    bands = (tmp_path / "toy2025_bands.csv").read_text()
    assert "A,tolerance,Half an eye to either side; seed 0.\n" in bands
    assert (tmp_path / "toy2025.png").read_bytes().startswith(b"\x89PNG")
    assert page.cells({**stored["rows"][-1], "low": 1.0, "high": None})[4] == "at least 1"
    assert stored["pictures"] == ["dice_7.png"]
    assert (tmp_path / "figures" / "dice_7.png").read_bytes().startswith(b"\x89PNG")
    monkeypatch.setattr(toy, "FINDINGS", "It is indeed.")
    assert called("--texts-only").exit_code == 0
    assert "It is indeed." in (tmp_path / "toy2025.md").read_text()
    assert json.loads((tmp_path / "toy2025.json").read_text()) == stored


def test_a_picture_gets_small_and_stays_the_same_size(tmp_path):
    path = tmp_path / "picture.png"
    shades = np.linspace(0, 255, 300 * 200 * 3).astype(np.uint8).reshape(200, 300, 3)
    Image.fromarray(shades).save(path)
    page.small_picture(path)
    with Image.open(path) as small:
        assert small.size == (300, 200)
        assert len(small.getcolors()) <= 64
    assert list(tmp_path.iterdir()) == [path]
