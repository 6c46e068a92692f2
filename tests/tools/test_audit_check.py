"""The check of quick audits by standard ones, small."""

from dataclasses import replace

from spoofgym.bench.experiments.audit_worlds import BUDGETS
from tools.audit_check import SIZES, check_detector, list_costs

from ..bench.detector_support import NOMINAL, small_task


def test_a_small_check_says_whether_figures_hold(monkeypatch, tmp_path):
    for size in SIZES:
        few = BUDGETS[size]._replace(runs=6, selection_runs=4, twins=4, ages=1, floor_worlds=0)
        monkeypatch.setitem(BUDGETS, size, few)
    task = small_task()
    task = replace(task, families=tuple(x for x in task.families if x.key in ("ramps", "profiles")))
    row = check_detector(task, {"name": "snapshot-chi2", **NOMINAL}, tmp_path)
    assert row["contains"] == (
        row["quick"]["low"] <= row["standard"]["value"] <= row["quick"]["high"]
    )
    assert not list_costs(task, ["no-such"])
