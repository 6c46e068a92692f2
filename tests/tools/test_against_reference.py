"""A detector against the reference: paired with itself it differs in nothing, and ages are kept."""

import json

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
for name in ("torch", "tyro"):
    pytest.importorskip(name)

from spoofgym.bench.experiments.audit import Auditor
from spoofgym.tasks import DETECTOR_TASKS
from tools import against_reference as module
from tools.pages import DOCS, fit_tables, marks, part_between

NONE = {"value": 0.0, "low": 0.0, "high": 0.0}
QUICK = {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"}
CHI = {"name": "sequential-chi2", "signals": "range_rate", "thresholds": "nominal"}


@pytest.fixture
def auditor(monkeypatch):
    monkeypatch.setattr(module, "AGES_S", (10.0, 70.0))
    monkeypatch.setattr(module, "BOUNDS_S", (0.0, 200.0, 520.0))
    sizes = {"runs": 8, "selection_runs": 4, "families": ["ramps"], "entropy": 5}
    return Auditor(DETECTOR_TASKS["D1"], "quick", threads=1, **sizes)


@pytest.mark.usefixtures("default_rate")
def test_one_that_sums_up_for_ever_alarms_more_often_later_and_one_epoch_does_not(auditor):
    detectors = auditor.worlds.build_detectors([CHI, QUICK])
    clean = module.play_clean(auditor.worlds, detectors, 8)
    assert clean["windows"] == [16, 8]  # of 160 s each
    for each in clean["detectors"]:
        assert sum(np.multiply([x["value"] for x in each["often"]], clean["windows"])) <= 3.0
    ages = module.play_ages(auditor.worlds, detectors, 4)["ages"]
    assert [each["age_s"] for each in ages] == [10.0, 70.0]
    same = module.play_ages(auditor.worlds, detectors[1:] * 2, 4)["ages"]
    for mine, twice in zip(ages, same, strict=True):
        assert mine["found"][1] == twice["found"][0] == twice["found"][1]
        assert twice["less"]["value"] == 0.0
        assert mine["less"]["value"] == pytest.approx(
            mine["found"][0]["value"] - mine["found"][1]["value"], abs=0.3
        )


@pytest.mark.nightly
@pytest.mark.usefixtures("default_rate")
def test_against_itself_no_family_differs(auditor):
    again = {**QUICK, "false_alarm": 1.0000001e-5}  # the same to seven digits, by another label
    found = module.play_families(auditor, [QUICK, again])
    assert found["families"]["ramps"]["less"] == found["less"] == NONE
    assert "| `ramps` |" in module.tabulate({"families": found})


def test_settings_are_read_as_on_every_command_line():
    with pytest.raises(SystemExit, match="`smoothing` must be a number above 0 and at most 1"):
        module.main(["ewma:smoothing=2"])


def test_the_page_has_the_tables_of_its_results():
    page, kept = (DOCS / "hours.md").read_text(), json.loads(module.DATA_FILE.read_text())
    for task, found in kept.items():
        wanted = fit_tables(f"{module.tabulate(found)}\n")
        assert part_between(page, *marks(f"hours-{task}")) == f"\n{wanted}"


@pytest.mark.parametrize(("runs", "families"), [(24, ["ramps", "early"]), (12, ["early"])])
def test_families_join_those_that_met_as_many_runs(runs, families):
    sizes, new = {"runs": 24, "selection_runs": 12}, {"runs": runs, "selection_runs": 12}
    kept = {"ages": {"runs": 24}, "families": {**sizes, "families": {"ramps": 1}}}
    found = module.take({"families": {**new, "families": {"early": 2}}}, kept)
    assert [*found["families"]["families"]] == families
    assert found["ages"] == kept["ages"]
