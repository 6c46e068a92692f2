"""Campaigns: interrupted, resumed, refused, scored and drawn."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from spoofgym.bench import CampaignResults, run_campaign, summarize
from spoofgym.bench.experiments import Store, run_experiment
from spoofgym.bench.experiments.campaign import Campaign
from spoofgym.bench.report.campaign import INTEGRITY, groups, integrity_rows, list_uncovered
from spoofgym.bench.report.campaign_page import build_page
from spoofgym.bench.report.page import render_page
from spoofgym.bench.runs.panel import Panel
from spoofgym.bench.runs.record import STANFORD, record_runs
from spoofgym.bench.scores.campaign import score_detector

from .experiments.support import content as contents
from .support import small_suite


def campaign(path, suite=None, **settings):
    return run_campaign(suite or small_suite(), path, threads=1, **settings)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return campaign(tmp_path_factory.mktemp("finished") / "results")


@pytest.fixture(scope="module")
def summary(finished):
    return summarize(finished)


def test_an_interrupted_campaign_goes_on_to_the_same_files(finished, tmp_path, monkeypatch):
    put, written = Store.put, []

    def interrupting(self, cell, result):
        if len(written) == 6:
            raise KeyboardInterrupt
        written.append(cell.key)
        put(self, cell, result)

    with monkeypatch.context() as patch:
        patch.setattr(Store, "put", interrupting)
        with pytest.raises(KeyboardInterrupt, match="6 of 11 cells are finished"):
            campaign(tmp_path)
    assert len(contents(tmp_path)) == 1 + 6
    again = []
    monkeypatch.setattr(Store, "put", lambda *given: (again.append(given[1].key), put(*given)))
    campaign(tmp_path)
    keys = {*Campaign(small_suite()).parts}
    assert len(keys) == 1 + 6 + 2 + 2  # floor, runs, searches, bounds
    assert sorted([*written, *again]) == sorted(keys)
    assert contents(tmp_path) == contents(finished.path)


def test_a_finished_campaign_is_only_read(finished, summary, monkeypatch):
    before = contents(finished.path)
    monkeypatch.setattr("spoofgym.bench.experiments.campaign.Panel", None)
    for results in (campaign(finished.path), CampaignResults.load(finished.path)):
        assert summarize(results) == summary
    assert contents(finished.path) == before


def test_what_is_no_folder_or_cell_of_this_campaign_is_refused(finished, tmp_path):
    (tmp_path / "config.json").write_text('{"format": 5, "detectors": [], "versions": {}}')
    for use in (campaign, CampaignResults.load):
        with pytest.raises(ValueError, match=r"config.json is of an older format"):
            use(tmp_path)
    shutil.copytree(finished.path, tmp_path / "one")
    folder = CampaignResults.load(tmp_path / "one")
    mine = folder.store.build_path("ewma / step / runs")
    mine.write_bytes(finished.store.build_path("snapshot-chi2 / step / runs").read_bytes())
    with pytest.raises(ValueError, match=r"is another cell than the one requested \(key: "):
        summarize(folder)
    mine.unlink()
    summary = summarize(folder)
    assert summary["missing"] == ["ewma / step"]
    assert "<b>Not finished</b>: ewma / step." in render_page(build_page(folder, summary))
    with pytest.raises(ValueError, match=r"holds other results \(config.runs: 5, not 4\)"):
        campaign(tmp_path / "one", small_suite(runs=4))


@pytest.mark.usefixtures("default_rate")  # which processes of their own have, too
@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_processes_and_shards_write_what_one_process_does(jobs, tmp_path):
    nominal = [{"name": name, "thresholds": "nominal"} for name in ("never", "snapshot-chi2")]
    weighing = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3, "thresholds": "nominal"}
    suite = small_suite(detectors=[*nominal, weighing])
    whole = contents(campaign(tmp_path / "one", suite).path)
    for part in (1, 2):
        shard = {"shard": (part, 2)} if jobs == 1 else {}
        run_experiment(Campaign(suite), Store(tmp_path / "two"), jobs=jobs, threads=1, **shard)
    assert contents(tmp_path / "two") == whole


def test_scores_follow_from_the_records_and_the_report_tells_what_came_out(finished, summary):
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert summary["missing"] == []
    assert len(summary["cells"]) == 6
    for score in summary["cells"]:
        cell = finished.runs(score["detector"], score["spoofer"])
        records, counts = cell.records, cell.counts
        # all cells see the same runs
        none = finished.runs(score["detector"], "none").records
        np.testing.assert_array_equal(records["warmup_alarm"], none["warmup_alarm"])
        assert score["counted"] == counts.sum()
        alarmed = (records["first_alarm"] > 0)[counts]
        assert score["alarm_rate"]["value"] == pytest.approx(alarmed.mean())
        displacement = records["undetected_displacement_m"]
        mean = displacement[counts].mean()
        assert score["stealthy_displacement_m"]["value"] == pytest.approx(mean)
        zeroed = np.where(alarmed, 0.0, displacement[counts]).mean()
        assert score["alarmed_as_0_m"]["value"] == pytest.approx(zeroed)
        assert score["silent_before_onset"] == 1.0 - records["warmup_alarm"].mean()
        assert (score["knowledge"]["run_time"], score["attack"]) == ("blind", "false-position")
        assert (displacement <= records["largest_error_m"] + 1e-6).all()
        assert score["spoofer"] != "none" or not displacement.any()
    (row,) = [row for row in summary["detectors"] if row["detector"] == "ewma"]
    clean = finished.runs("ewma", "none")
    assert row["false_alarm_per_run"]["value"] == clean.alarmed.mean()
    epochs = clean.records["alarm_epochs"].mean() / clean.window
    assert row["false_alarm_per_epoch"]["value"] == pytest.approx(epochs)
    text = render_page(build_page(finished, summary))
    for part in (
        "<h1>Campaign: zhong2025</h1>",
        "<td>ewma</td><td>ramp(tuned)</td><td>ewma</td><td>rate_mps=",
        "5 runs each",
        "<td>ramp(tuned)</td><td>blind</td>",
        "<h2>Detectors with nominal thresholds, whose rates of false alarms differ</h2>",
        "<dt>entropy</dt><dd>0</dd>",
    ):
        assert part in text
    assert "nan" not in text


def test_clean_runs_of_a_detector_with_a_protection_level_make_a_stanford_diagram():
    suite = small_suite(
        detectors=(
            {"name": "solution-separation", "thresholds": "nominal", "longest_s": 30.0},
            "snapshot-chi2",
        )
    )
    judges, found = [each.build() for each in suite.detector_players], []
    for some in (judges, judges[:1]):
        rngs = lambda: suite.generators("evaluation", 5)  # noqa: E731
        panel = Panel(suite.world.setup, some, rngs, threads=1)
        for k, each in enumerate(some):
            head = {
                "detector": str(k),
                "protects_s": 30.0,
                "judges_channels": each.scope == "channel",
            }
            runs = panel.setup, head, panel.warmup_alarm[:, k], panel.clean[k], panel.clean[k]
            found.append(record_runs(*runs, alert_limit_m=60.0))
    both, other, alone = found
    assert "protection_level" not in score_detector(other)
    for name, array in alone.records.items():
        np.testing.assert_array_equal(array, both.records[name])
    assert (sum(both.records[f"{name}_epochs"] for name in STANFORD) == both.window).all()
    row = {**score_detector(both), "footing": "0.2"}
    level = row["protection_level"]
    assert 1.0 < level["median_m"] < 1000.0
    assert sum(level[name]["value"] for name in STANFORD) == pytest.approx(1.0, abs=1e-3)
    (group,) = groups({"detectors": [row]})
    assert integrity_rows({"detectors": [row]}, group) == [row]
    assert "| 0 |" in INTEGRITY.markdown([row])
    json.dumps(row, allow_nan=False)
    uncovered = score_detector(replace(both, head={**both.head, "protects_s": 20.0}))
    why = "the attack of 25 s is longer than the 20 s of its bank"
    assert uncovered["protection_level"] == {"why": why}
    assert integrity_rows({"detectors": [{**uncovered, "footing": "0.2"}]}, group) == []
    assert list_uncovered({"detectors": [uncovered]}) == [f"0: {why}"]
