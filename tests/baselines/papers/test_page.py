"""A page tells what its JSON file and the texts of its paper's module say."""

import json
import sys

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from baselines.papers import page
from baselines.papers.frame import Settings
from baselines.papers.run import PaperRun
from baselines.papers.tables import COUNTS

from . import toy


def test_a_page_is_made_of_a_stored_full_run(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, f"baselines.papers.{toy.KEY}", toy)
    monkeypatch.setattr(page, "KEYS", (toy.KEY,))
    monkeypatch.setattr("baselines.papers.paper.KEYS", (toy.KEY,))
    arguments = ["--out", str(tmp_path / "out"), "--docs", str(tmp_path)]
    result = CliRunner().invoke(page.app, arguments)
    assert result.exit_code == 2
    assert "part '1000 throws' of toy2025 is not in" in result.stderr

    full = PaperRun(toy.KEY, Settings(quick=False, seed=0), tmp_path / "out")
    data = full.play()
    assert CliRunner().invoke(page.app, arguments).exit_code == 0
    stored = json.loads((tmp_path / "toy2025.json").read_text())
    agreed = ("paper", "runs", "seed", "origins", "rows")
    assert {key: stored[key] for key in agreed} == full.record(data)
    written = (tmp_path / "toy2025.md").read_text()
    assert written == page.page_text(toy, stored)
    assert written.startswith("# Dice et al. (2025)\n")
    assert "python -m baselines.papers toy2025\n" in written
    assert "| all | throws \\| all | - | 3000 | - | - | - | - | - | not printed |" in written
    assert "| all | impossible | 7 | 0 | 6.5 to 7.5 | A | NO | - | - | a finding |" in written
    assert "| all | excluded | 7 | 3.5 | 3 to 4 | B | NO | yes | - | not the paper's |" in written
    assert "| all | largest | - | 6 | at most 6 | C | - | - | yes |  |" in written
    assert "- **A** (tolerance): Half an eye to either side; seed 0." in written
    assert "- 2 of 4 printed values lie inside the tolerance of the reproduction." in written
    assert "- 1 of 1 of our values agree with an independent implementation." in written
    assert "- 1 of 1 keep a limit from theory or of our own." in written
    assert "- 1 of 6 rows have no band." in written
    assert stored["pictures"] == ["dice_7.png"]
    assert "![Figure 7, drawn from our runs](figures/dice_7.png)" in written
    assert (tmp_path / "figures" / "dice_7.png").read_bytes().startswith(b"\x89PNG")

    monkeypatch.setattr(toy, "FINDINGS", "It is indeed.")
    assert CliRunner().invoke(page.app, [*arguments, "--texts-only"]).exit_code == 0
    assert "It is indeed." in (tmp_path / "toy2025.md").read_text()
    assert json.loads((tmp_path / "toy2025.json").read_text()) == stored


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [(None, None, "-"), (1.0, None, "at least 1"), (None, 2.0, "at most 2"), (1, 2.5, "1 to 2.5")],
)
def test_a_band_in_words(low, high, text):
    row = dict.fromkeys((*page.HEAD, "origin", *COUNTS))
    assert page.cells({**row, "low": low, "high": high})[4] == text


def test_a_picture_gets_small_and_stays_the_same_size(tmp_path):
    path = tmp_path / "picture.png"
    path.write_bytes(b"")
    shades = np.linspace(0, 255, 300 * 200 * 3).astype(np.uint8).reshape(200, 300, 3)
    Image.fromarray(shades).save(path)
    page.small_picture(path)
    with Image.open(path) as small:
        assert small.size == (300, 200)
        assert len(small.getcolors()) <= 64
    assert list(tmp_path.iterdir()) == [path]
