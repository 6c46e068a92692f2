"""Campaigns: interrupted, resumed, refused, scored and drawn."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spoofgym.bench import ResultsFolder, Suite, run_campaign, summarize
from spoofgym.bench.experiments.remaining import expected_work
from spoofgym.bench.report.campaign import markdown
from spoofgym.bench.report.figures import SMALLEST_M, draw_campaign
from spoofgym.bench.report.table import interval
from spoofgym.bench.runs.record import Cell

from .support import small_suite


class Counted:
    """Adds up the work that it is told of."""

    def __init__(self) -> None:
        self.done = 0.0

    def advance(self, amount: float, now: str) -> None:
        assert amount >= 0.0
        assert now
        self.done += amount


def campaign(path: Path, suite: Suite | None = None, **settings: Any) -> ResultsFolder:
    folder = ResultsFolder(path)
    played = suite or small_suite()
    folder.open(played)
    run_campaign(played, folder, threads=1, **settings)
    return folder


def contents(path: Path) -> dict[str, bytes]:
    return {
        file.relative_to(path).as_posix(): file.read_bytes()
        for file in sorted(path.rglob("*"))
        if file.is_file()
    }


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> ResultsFolder:
    return campaign(tmp_path_factory.mktemp("finished") / "results")


def test_every_cell_and_search_has_a_file(finished: ResultsFolder) -> None:
    assert set(contents(finished.path)) == {
        "config.json",
        *(
            f"cells/{detector}--{spoofer}.jsonl"
            for detector in ("snapshot-chi2", "ewma")
            for spoofer in ("none", "step", "ramp-tuned")
        ),
        *(f"tuning/{detector}--ramp-tuned.json" for detector in ("snapshot-chi2", "ewma")),
        *(f"limits/{name}.json" for name in ("floor", "snapshot-chi2", "ewma")),
    }


@pytest.mark.parametrize("after", [1, 4])
def test_an_interrupted_campaign_goes_on_to_the_same_files(
    finished: ResultsFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    put_cell, put_tuning = ResultsFolder.put_cell, ResultsFolder.put_tuning
    written: list[str] = []

    def interrupting(put: Any) -> Any:
        def wrapped(self: ResultsFolder, thing: Any) -> None:
            if len(written) == after:
                raise KeyboardInterrupt
            written.append(thing.spoofer if isinstance(thing, Cell) else "search")
            put(self, thing)

        return wrapped

    with monkeypatch.context() as patch:
        patch.setattr(ResultsFolder, "put_cell", interrupting(put_cell))
        patch.setattr(ResultsFolder, "put_tuning", interrupting(put_tuning))
        with pytest.raises(KeyboardInterrupt):
            campaign(tmp_path)
    assert len(contents(tmp_path)) == 1 + after
    again: list[str] = []
    monkeypatch.setattr(
        ResultsFolder,
        "put_cell",
        lambda self, cell: (again.append(cell.spoofer), put_cell(self, cell))[1],
    )
    campaign(tmp_path)
    assert len(again) == 6 - sum(name != "search" for name in written)
    assert contents(tmp_path) == contents(finished.path)


def test_a_finished_campaign_has_nothing_left_to_do(finished: ResultsFolder) -> None:
    before = contents(finished.path)
    counted = Counted()
    assert expected_work(small_suite(), finished) == 0.0
    campaign(finished.path, progress=counted)
    assert counted.done == 0.0
    assert contents(finished.path) == before


def test_progress_ends_where_it_was_expected_to(tmp_path: Path) -> None:
    counted, suite = Counted(), small_suite()
    total = expected_work(suite, ResultsFolder(tmp_path))
    campaign(tmp_path, suite, progress=counted)
    assert counted.done == pytest.approx(total, rel=0.01)


def test_other_results_are_refused_and_replaced_only_on_demand(
    finished: ResultsFolder, tmp_path: Path
) -> None:
    folder = campaign(tmp_path, small_suite(spoofers=("none",), detectors=("ewma",)))
    (tmp_path / "mine.txt").write_text("keep")
    other = small_suite(runs=4)
    with pytest.raises(
        ValueError, match=r"another campaign \(different: detectors, spoofers, runs"
    ):
        folder.open(other)
    assert (tmp_path / "cells" / "ewma--none.jsonl").is_file()
    folder.open(other, overwrite=True)
    assert set(contents(tmp_path)) == {"config.json", "mine.txt"}


def test_a_folder_of_something_else_is_never_touched(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    for overwrite in (False, True):
        with pytest.raises(ValueError, match=r"not empty and holds no config.json .*thesis.tex"):
            ResultsFolder(tmp_path).open(small_suite(), overwrite=overwrite)
    (tmp_path / "config.json").write_text('{"editor": "vim"}')
    with pytest.raises(ValueError, match="is not the configuration of a campaign"):
        ResultsFolder(tmp_path).open(small_suite(), overwrite=True)
    assert len(contents(tmp_path)) == 2
    with pytest.raises(ValueError, match="is not a folder"):
        ResultsFolder(tmp_path / "thesis.tex").open(small_suite())


def test_a_damaged_cell_is_named(finished: ResultsFolder, tmp_path: Path) -> None:
    damaged = ResultsFolder(tmp_path)
    for name, content in contents(finished.path).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    path = tmp_path / "cells" / "ewma--step.jsonl"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]))
    with pytest.raises(ValueError, match=r"ewma--step.jsonl is damaged .* run again"):
        damaged.cell("ewma", "step")


def test_cells_of_another_seed_detector_or_campaign_are_refused(
    finished: ResultsFolder, tmp_path: Path
) -> None:
    one = tmp_path / "one"
    shutil.copytree(finished.path, one)
    other = campaign(tmp_path / "other", small_suite(entropy=1, spoofers=("step",)))
    folder = ResultsFolder(one)
    mine, theirs = (path / "cells" / "ewma--step.jsonl" for path in (one, other.path))
    own = mine.read_bytes()
    mine.write_bytes(theirs.read_bytes())
    for look in (lambda: summarize(folder), lambda: expected_work(small_suite(), folder)):
        with pytest.raises(ValueError, match=r"ewma--step.jsonl is .* entropy is 1 and not 0;"):
            look()
    mine.write_bytes((one / "cells" / "snapshot-chi2--step.jsonl").read_bytes())
    with pytest.raises(ValueError, match=r"detector is 'snapshot-chi2' and not 'ewma';"):
        folder.cell("ewma", "step")
    mine.write_bytes(own.replace(small_suite().digest.encode(), b"0123456789abcdef"))
    with pytest.raises(ValueError, match="folder: campaign is '0123456789abcdef' and not"):
        folder.has_cell("ewma", "step")
    lines = own.splitlines(keepends=True)
    mine.write_bytes(b"".join(lines[:-2] + lines[-1:]))
    with pytest.raises(ValueError, match="runs is 4 and not 5"):
        folder.cell("ewma", "step")
    mine.write_bytes(own)
    search = one / "tuning" / "ewma--ramp-tuned.json"
    search.write_text(search.read_text().replace('"entropy": 0', '"entropy": 7'))
    with pytest.raises(ValueError, match=r"ewma--ramp-tuned.json .* entropy is 7 and not 0"):
        summarize(folder)


@pytest.mark.usefixtures("default_rate")  # which processes of their own have, too
def test_several_processes_write_what_one_does(tmp_path: Path) -> None:
    counted = Counted()
    nominal = [{"name": name, "thresholds": "nominal"} for name in ("never", "snapshot-chi2")]
    suite, folder = small_suite(detectors=nominal), ResultsFolder(tmp_path / "two")
    folder.open(suite)
    expected = expected_work(suite, folder)
    run_campaign(suite, folder, threads=1, jobs=2, progress=counted)
    assert counted.done == pytest.approx(expected)
    assert contents(folder.path) == contents(campaign(tmp_path / "one", suite).path)
    with pytest.raises(ValueError, match="`jobs` must be at least 1, got 0"):
        run_campaign(suite, folder, jobs=0)


def test_campaigns_do_not_mix(tmp_path: Path) -> None:
    first, second = ResultsFolder(tmp_path), ResultsFolder(tmp_path)
    suite, other = small_suite(detectors=("never",), spoofers=()), small_suite(entropy=1)
    first.open(suite)
    run_campaign(suite, first, threads=1)
    cell = first.cell("never", "none")
    second.open(other, overwrite=True)
    with pytest.raises(ValueError, match="has been taken by another campaign"):
        first.put_cell(cell)
    assert set(contents(tmp_path)) == {"config.json"}


def test_of_two_that_begin_in_one_moment_one_is_refused(tmp_path: Path) -> None:
    class Late:
        """A suite that another one overtakes, when it has seen that the folder is empty."""

        digest = small_suite().digest

        @property
        def config(self) -> dict[str, Any]:
            if not (tmp_path / "config.json").exists():
                ResultsFolder(tmp_path).open(small_suite(entropy=1))
            return small_suite().config

    late: Any = Late()
    with pytest.raises(ValueError, match=r"another campaign \(different: entropy\)"):
        ResultsFolder(tmp_path).open(late)
    assert ResultsFolder(tmp_path).config()["entropy"] == 1


def test_the_same_campaign_twice_at_once_ends_with_both_right(
    finished: ResultsFolder, tmp_path: Path
) -> None:
    code = (
        "import sys\nfrom pathlib import Path\nfrom tests.bench.test_campaign import campaign\n"
        "from spoofgym.detectors import calibrated\ncalibrated.DEFAULT_RATE = None\n"
        "campaign(Path(sys.argv[1]))\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "results")]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    for each in both:
        _, said = each.communicate(timeout=600)
        assert each.returncode == 0, said
    assert contents(tmp_path / "results") == contents(finished.path)


def test_what_a_dead_process_left_is_removed_at_open(tmp_path: Path) -> None:
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom spoofgym.core.files import whole_file\n"
        "with whole_file(Path(sys.argv[1])) as part:\n"
        "    part.write_bytes(b'half')\n    os._exit(0)\n"
    )
    ResultsFolder(tmp_path).open(small_suite())
    for name in ("config.json", "cells/one.jsonl", "tuning/one.json"):
        subprocess.run([sys.executable, "-c", code, str(tmp_path / name)], check=True)
    assert len(contents(tmp_path)) == 4
    ResultsFolder(tmp_path).open(small_suite())
    assert set(contents(tmp_path)) == {"config.json"}


def test_cells_come_back_as_they_were_written(finished: ResultsFolder) -> None:
    cell = finished.cell("ewma", "step")
    again = Cell.from_lines(cell.to_lines())
    assert (again.head, again.series) == (cell.head, cell.series)
    for name, values in cell.records.items():
        np.testing.assert_array_equal(again.records[name], values)


def test_scores_follow_from_the_records(finished: ResultsFolder) -> None:
    summary = summarize(finished)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert summary["missing"] == []
    assert len(summary["cells"]) == 6
    for score in summary["cells"]:
        cell = finished.cell(score["detector"], score["spoofer"])
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
    clean = finished.cell("ewma", "none")
    assert row["false_alarm_per_run"]["value"] == clean.alarmed.mean()
    assert row["false_alarm_per_epoch"]["value"] == pytest.approx(
        clean.records["alarm_epochs"].mean() / clean.window
    )


def test_results_of_another_format_are_not_scored(tmp_path: Path) -> None:
    folder = ResultsFolder(tmp_path)
    folder.open(small_suite())
    config = folder.config()
    folder.put_text("config.json", json.dumps({**config, "format": 1}))
    with pytest.raises(ValueError, match=r"holds results of format 1, .* scores format 5: play"):
        summarize(folder)


def test_all_cells_see_the_same_runs(finished: ResultsFolder) -> None:
    for detector in ("ewma", "snapshot-chi2"):
        warm = [finished.cell(detector, s).records["warmup_alarm"] for s in ("none", "step")]
        np.testing.assert_array_equal(*warm)


def test_the_report_tells_what_was_run_and_what_came_out(finished: ResultsFolder) -> None:
    text = markdown(finished.config(), summarize(finished))
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
    folder = ResultsFolder(tmp_path)
    folder.open(suite)
    original = ResultsFolder.put_cell

    def first_only(self: ResultsFolder, cell: Cell) -> None:
        original(self, cell)
        raise KeyboardInterrupt

    monkeypatch.setattr(ResultsFolder, "put_cell", first_only)
    with pytest.raises(KeyboardInterrupt):
        run_campaign(suite, folder, threads=1)
    summary = summarize(folder)
    text = markdown(folder.config(), summary)
    assert "**Not finished**: snapshot-chi2 / step, ewma / none, ewma / step." in text
    assert "- flown by a swallow" in text
    assert draw_campaign(folder, summary).stat().st_size > 10_000


def test_numbers_with_intervals() -> None:
    assert interval({"value": 12.345, "low": 11.0, "high": 13.21}) == "12.3 (11.0 to 13.2)"
    assert interval({"value": 0.0012, "low": 0.0, "high": 0.004}, 3) == "0.001 (0.000 to 0.004)"
    assert interval({"value": 359.2, "low": 350.0, "high": 366.0}) == "359 (350 to 366)"
    assert interval({"value": None, "low": None, "high": None}) == "-"


def test_the_picture_has_panels_for_many_detectors(finished: ResultsFolder, tmp_path: Path) -> None:
    summary = summarize(finished)
    picture = draw_campaign(finished, summary)
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    picture.unlink()


def test_what_a_later_detector_lets_pass_lies_on_the_shared_axis(
    finished: ResultsFolder, monkeypatch: pytest.MonkeyPatch
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
