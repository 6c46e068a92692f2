"""The page shows what is kept of the corrections, and results of other sizes do not mix."""

import json

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
for name in ("stable_baselines3", "tyro"):
    pytest.importorskip(name)

from tools.pages import fit_tables, marks, part_between
from tools.residual_page import DATA_FILE, PAGE, take
from train.residual_ppo import build_table


def test_the_page_has_the_table_of_the_kept_results_to_which_rows_are_added():
    kept = json.loads(DATA_FILE.read_text())
    assert part_between(PAGE.read_text(), *marks("residual")) == fit_tables(
        f"\n{build_table(kept)}\n"
    )
    (detector, found), *_ = kept["detectors"].items()
    some = {**kept, "detectors": {detector: {**found, "rows": {}}}}
    assert take(some, json.loads(DATA_FILE.read_text())) == kept
    with pytest.raises(ValueError, match=r"residual\.json has results of other steps"):
        take({**kept, "steps": 1}, kept)
