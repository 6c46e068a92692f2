"""The reproduction of zhong2025, with too few runs to tell anything but that it holds together."""

import re

import pytest

from baselines.papers import zhong2025
from baselines.papers.frame import Band, Settings
from baselines.papers.zhong2025.runs import TABLED

QUICK = Settings(quick=True, seed=1)


@pytest.fixture(scope="module")
def data():
    """What one part of each kind returns, taken for that of all of its kind."""
    done = {}
    for part in zhong2025.parts(QUICK):
        if part.function not in done:
            done[part.function] = part.function(**{**part.settings, "runs": 2})
    return {part.name: done[part.function] for part in zhong2025.parts(QUICK)}


def test_every_figure_of_the_tables_has_a_row(data):
    full = zhong2025.parts(Settings(quick=False, seed=5))
    assert {part.settings["runs"] for part in full if part.name in TABLED} == {50}
    rows = zhong2025.rows(data, QUICK)
    keys = [(row.table, row.row, row.quantity) for row in rows]
    assert len(set(keys)) == len(keys)
    for table, number in (("Table 4", 18), ("Table 5", 18), ("Experiment 8", 5)):
        printed = [row for row in rows if row.table == table and row.paper is not None]
        printed = [row for row in printed if not re.search("share|other", row.quantity)]
        assert len(printed) == number
        assert all(None not in (row.band.low, row.band.high) for row in printed)
    for row in rows:
        values = vars(row).values()
        assert all(isinstance(value, float | int | str | Band | None) for value in values)
        assert row.band is not None or row.note


def test_the_figures_are_drawn(data, tmp_path):
    pytest.importorskip("matplotlib")
    paths = zhong2025.figures(data, tmp_path / "pictures")
    assert [path.stem for path in paths] == [
        f"zhong2025_figure_{number}" for number in (2, 3, 4, 5, 7, 8, 9, 10)
    ]
    assert all(path.stat().st_size > 10_000 for path in paths)
