"""Campaigns: interrupted, resumed, refused, scored and drawn."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spoofgym.bench import CampaignResults, Suite, run_campaign, summarize
from spoofgym.bench.experiments import Store, run_experiment
from spoofgym.bench.experiments.campaign import Campaign
from spoofgym.bench.report.campaign import markdown
from spoofgym.bench.report.figures import SMALLEST_M, draw_campaign
from spoofgym.bench.report.table import interval

from .experiments.support import content as contents
from .support import small_suite


def campaign(path: Path, suite: Suite | None = None, **settings: Any) -> CampaignResults:
    return run_campaign(suite or small_suite(), path, threads=1, **settings)


def kinds(path: Path) -> list[str]:
    return sorted(key for key in contents(path) if key.endswith(".npz"))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> CampaignResults:
    return campaign(tmp_path_factory.mktemp("finished") / "results")


def test_every_part_is_a_file(finished: CampaignResults) -> None:
    keys = [*Campaign(small_suite()).parts]
    assert len(keys) == len({*keys}) == 1 + 6 + 2 + 2  # floor, runs, searches, bounds
    files = {finished.store.build_path(key).name for key in keys}
    assert set(contents(finished.path)) == {"config.json", *(f"cells/{name}" for name in files)}


@pytest.mark.parametrize("after", [1, 6])
def test_an_interrupted_campaign_goes_on_to_the_same_files(
    finished: CampaignResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    put, written = Store.put, []

    def interrupting(self: Store, cell: Any, result: Any) -> None:
        if len(written) == after:
            raise KeyboardInterrupt
        written.append(cell.key)
        put(self, cell, result)

    with monkeypatch.context() as patch:
        patch.setattr(Store, "put", interrupting)
        with pytest.raises(KeyboardInterrupt, match=rf"{after} of 11 cells are finished"):
            campaign(tmp_path)
    assert len(contents(tmp_path)) == 1 + after
    again: list[str] = []
    monkeypatch.setattr(Store, "put", lambda *given: (again.append(given[1].key), put(*given)))
    campaign(tmp_path)
    assert sorted([*written, *again]) == sorted(Campaign(small_suite()).parts)
    assert contents(tmp_path) == contents(finished.path)


def test_a_finished_campaign_is_only_read(
    finished: CampaignResults, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(finished.path)
    monkeypatch.setattr("spoofgym.bench.experiments.campaign.Panel", None)
    summary = summarize(campaign(finished.path))
    assert summary == summarize(finished) == summarize(CampaignResults.load(finished.path))
    assert contents(finished.path) == before


def test_other_results_are_refused_and_replaced_only_on_demand(
    finished: CampaignResults, tmp_path: Path
) -> None:
    none = {"spoofers": (), "detectors": ("never",)}
    campaign(tmp_path, small_suite(**none))
    (tmp_path / "mine.txt").write_text("keep")
    other = small_suite(runs=4, **none)
    with pytest.raises(ValueError, match=r"holds other results \(config.runs: 5, not 4\)"):
        campaign(tmp_path, other)
    before = kinds(tmp_path)
    campaign(tmp_path, other, overwrite=True)
    assert kinds(tmp_path) == before
    assert CampaignResults.load(tmp_path).config["runs"] == 4
    assert (tmp_path / "mine.txt").is_file()


def test_a_folder_of_an_older_format_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text('{"format": 5, "detectors": [], "versions": {}}')
    for use in (lambda: campaign(tmp_path), lambda: CampaignResults.load(tmp_path)):
        with pytest.raises(
            ValueError, match=r"config.json is of an older format, .* another folder"
        ):
            use()
    with pytest.raises(ValueError, match=r"holds no results: there is no config\.json"):
        CampaignResults.load(tmp_path / "nowhere")


def test_a_cell_of_another_campaign_is_refused(finished: CampaignResults, tmp_path: Path) -> None:
    shutil.copytree(finished.path, tmp_path / "one")
    folder = CampaignResults.load(tmp_path / "one")
    mine = folder.store.build_path("ewma / step / runs")
    mine.write_bytes(finished.store.build_path("snapshot-chi2 / step / runs").read_bytes())
    with pytest.raises(ValueError, match=r"is another cell than the one requested \(key: "):
        summarize(folder)
    mine.unlink()
    assert summarize(folder)["missing"] == ["ewma / step"]


@pytest.mark.usefixtures("default_rate")  # which processes of their own have, too
def test_processes_and_shards_write_what_one_process_does(tmp_path: Path) -> None:
    nominal = [{"name": name, "thresholds": "nominal"} for name in ("never", "snapshot-chi2")]
    weighing = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3, "thresholds": "nominal"}
    suite = small_suite(detectors=[*nominal, weighing])
    whole = contents(campaign(tmp_path / "one", suite).path)
    assert contents(campaign(tmp_path / "two", suite, jobs=2).path) == whole
    for part in (1, 2):
        run_experiment(Campaign(suite), Store(tmp_path / "shards"), shard=(part, 2), threads=1)
    assert contents(tmp_path / "shards") == whole


def test_what_a_detector_gets_does_not_depend_on_the_others(
    finished: CampaignResults, tmp_path: Path
) -> None:
    alone = campaign(tmp_path, small_suite(detectors=("snapshot-chi2",)))
    for spoofer in ("none", "step", "ramp(tuned)"):
        mine, other = (each.runs("snapshot-chi2", spoofer) for each in (alone, finished))
        assert mine is not None
        assert other is not None
        assert (mine.head, mine.series) == (other.head, other.series)
        for name, values in mine.records.items():
            np.testing.assert_array_equal(other.records[name], values)


def test_scores_follow_from_the_records(finished: CampaignResults) -> None:
    summary = summarize(finished)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert summary["missing"] == []
    assert len(summary["cells"]) == 6
    for score in summary["cells"]:
        cell = finished.runs(score["detector"], score["spoofer"])
        records = cell.records
        counts = cell.counts
        assert score["counted"] == counts.sum()
        alarmed = (records["first_alarm"] > 0)[counts]
        assert score["alarm_rate"]["value"] == pytest.approx(alarmed.mean())
        displacement = records["undetected_displacement_m"]
        mean = displacement[counts].mean()
        assert score["stealthy_displacement_m"]["value"] == pytest.approx(mean)
        zeroed = np.where(alarmed, 0.0, displacement[counts]).mean()
        assert score["alarmed_as_0_m"]["value"] == pytest.approx(zeroed)
        assert score["silent_before_onset"] == 1.0 - records["warmup_alarm"].mean()
        assert score["knowledge"]["run_time"] == "blind"
        assert score["attack"] == "false-position"
        assert (displacement <= records["largest_error_m"] + 1e-6).all()
        if score["spoofer"] == "none":
            assert not displacement.any()
    (row,) = [row for row in summary["detectors"] if row["detector"] == "ewma"]
    clean = finished.runs("ewma", "none")
    assert row["false_alarm_per_run"]["value"] == clean.alarmed.mean()
    assert row["false_alarm_per_epoch"]["value"] == pytest.approx(
        clean.records["alarm_epochs"].mean() / clean.window
    )


def test_all_cells_see_the_same_runs(finished: CampaignResults) -> None:
    for detector in ("ewma", "snapshot-chi2"):
        warm = [finished.runs(detector, s).records["warmup_alarm"] for s in ("none", "step")]
        np.testing.assert_array_equal(*warm)


def test_the_report_tells_what_was_run_and_what_came_out(finished: CampaignResults) -> None:
    text = markdown(finished, summarize(finished))
    for part in (
        "# Campaign: zhong2025",
        "| ewma | ramp(tuned) | ewma | rate_mps=",
        "5 evaluation runs, the same for all cells (entropy 0)",
        "knowledge of the spoofers at run time: blind",
        "## Detectors with nominal thresholds, whose rates of false alarms differ",
        "Budget: P(alarm | silent twin) at most 45 %, by its upper 95 % limit on the 6 of 6",
        "(chosen)",
    ):
        assert part in text
    assert "nan" not in text


def test_an_unfinished_campaign_is_reported_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    suite = small_suite(spoofers=("step",), notes=("flown by a swallow",))
    original = Store.put

    def first_only(self: Store, cell: Any, result: Any) -> None:
        original(self, cell, result)
        if cell.key.endswith("runs"):
            raise KeyboardInterrupt

    monkeypatch.setattr(Store, "put", first_only)
    with pytest.raises(KeyboardInterrupt):
        campaign(tmp_path, suite)
    results = CampaignResults.load(tmp_path)
    summary = summarize(results)
    (played,) = summary["cells"]
    text = markdown(results, summary)
    left = [f"{d} / {s}" for d in ("snapshot-chi2", "ewma") for s in ("none", "step")]
    left.remove(f"{played['detector']} / {played['spoofer']}")
    assert f"**Not finished**: {', '.join(left)}." in text
    assert "- flown by a swallow" in text
    assert draw_campaign(results, summary).stat().st_size > 10_000


def test_numbers_with_intervals() -> None:
    assert interval({"value": 12.345, "low": 11.0, "high": 13.21}) == "12.3 (11.0 to 13.2)"
    assert interval({"value": 0.0012, "low": 0.0, "high": 0.004}, 3) == "0.001 (0.000 to 0.004)"
    assert interval({"value": 359.2, "low": 350.0, "high": 366.0}) == "359 (350 to 366)"
    assert interval({"value": None, "low": None, "high": None}) == "-"


def test_the_picture_has_panels_for_many_detectors(
    finished: CampaignResults, tmp_path: Path
) -> None:
    summary = summarize(finished)
    picture = draw_campaign(finished, summary)
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    picture.unlink()


def test_what_a_later_detector_lets_pass_lies_on_the_shared_axis(
    finished: CampaignResults, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures: list[Any] = []

    def keep(figure: Any, path: Path, **_: Any) -> Path:
        figures.append(figure)
        return path

    monkeypatch.setattr("spoofgym.bench.report.figures.save_figure", keep)
    summary = summarize(finished)
    last = summary["detectors"][-1]["detector"]
    far = {"value": 4000.0, "low": 3900.0, "high": 4100.0}
    for each in summary["cells"]:
        if each["detector"] == last and each["spoofer"] != "none":
            each["stealthy_displacement_m"] = far
    draw_campaign(finished, summary)
    axes = [ax for ax in figures[0].axes if ax.get_ylabel() == "stealthy displacement [m]"]
    assert [ax.get_ylim()[0] for ax in axes] == [SMALLEST_M]
    assert axes[0].get_ylim()[1] > 4100.0
