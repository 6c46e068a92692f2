"""The check of quick audits by standard ones, small."""

import csv
from dataclasses import replace

import numpy as np

from spoofgym.bench.experiments.audit_worlds import BUDGETS
from spoofgym.bench.runs.record import MEASURES, Aim, Protection, Winner
from spoofgym.bench.scores.detector import FamilyScore
from spoofgym.bench.scores.scores import SHARES
from tools import audit_check

from ..bench.detector_support import NOMINAL, small_task


def test_a_small_check_says_whether_figures_hold_and_goes_on(monkeypatch, tmp_path, capsys):
    for size in ("quick", "standard"):
        few = BUDGETS[size]._replace(runs=6, selection_runs=4, twins=4, ages=1, floor_worlds=0)
        monkeypatch.setitem(BUDGETS, size, few)
    task = small_task()
    task = replace(task, families=tuple(x for x in task.families if x.key in ("ramps", "profiles")))
    specs = [{"name": name, **NOMINAL} for name in ("snapshot-chi2", "cusum")]
    monkeypatch.setattr(audit_check, "get_detector_task", lambda key: task)
    monkeypatch.setattr(audit_check, "draw_detectors", lambda *given: specs)
    words = ["small", "--out", str(tmp_path)]
    code = audit_check.main(words)
    shown = capsys.readouterr().out
    rows = [*csv.DictReader((tmp_path / "contains.csv").read_text().splitlines())]
    assert len(rows) == 2 * 3
    held = [row["contains"] == "True" for row in rows if row["figure"] == "exceeded_0.5"]
    assert f"exceeded_0.5: {sum(held)} of 2 quick intervals hold" in shown
    assert code == (not all(held))
    assert "no shipped spoofer was made for it" in shown
    monkeypatch.setattr("spoofgym.bench.experiments.audit_cells.play_searches", None)
    assert audit_check.main(words) == code  # nothing plays again


def test_the_worst_of_all_families_is_compared_with_shipped_spoofers():
    def family(key, moved):
        aim, spec = Aim(MEASURES[0], SHARES[0]), {"name": "ramp"}
        winner = Winner("a", "ramp", "rate_mps", 1.0, spec, (aim,), {MEASURES[0]: moved})
        found = Protection({}, (winner,), np.ones(40, dtype=bool), np.arange(40), None)
        return FamilyScore(key, False, 30.0, found)

    class Found:
        families = family("ramps", np.arange(40.0)), family("shipped", np.arange(40.0) - 2.0)

    less = audit_check.compare_shipped(Found)
    assert less["family"] == "ramps"
    assert (less["value"], less["low"], less["high"]) == (2.0, 2.0, 2.0)
    Found.families = Found.families[:1]
    assert audit_check.compare_shipped(Found) is None
