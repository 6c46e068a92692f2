"""Entries of a leaderboard: what is wrong with one is named, and claims are held to intervals."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from spoofgym.bench.experiments.audit import Auditor
from spoofgym.bench.experiments.entry import INTERVAL, compare_figures, list_detector_figures
from spoofgym.tasks import DETECTOR_TASKS

from ..command_line import call, read, refused
from ..outside import detectors
from .detector_support import small_task

SMALL = ["--runs", "6", "--selection-runs", "4", "--family", "ramps", "--threads", "1"]


def write_entry(folder, **changes):
    folder.mkdir(exist_ok=True)
    shutil.copy(detectors.__file__, folder / "mine.py")
    entry = {
        "format": 1,
        "suite": "spoofgym-bench-v1",
        "task": "D1",
        "side": "detector",
        "name": "mine",
        "who": "A. Nyone",
        "player": "mine:AverageRate:threshold_scale=30.0",
        "files": {"mine.py": hashlib.sha256((folder / "mine.py").read_bytes()).hexdigest()},
        "figures": {"p_hmi": 0.9},
    }
    (folder / "entry.json").write_text(json.dumps({**entry, **changes}))
    return folder


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setitem(DETECTOR_TASKS, "D1", small_task())


def claim_all(known):
    return 0.5 if known is INTERVAL else {key: claim_all(each) for key, each in known.items()}


def check(folder, *more):
    return ["audit", "--check", str(folder), "--out", str(folder.parent / "out"), *SMALL, *more]


@pytest.mark.parametrize(
    "player",
    [
        "snapshot-chi2:thresholds=nominal",
        pytest.param("mine:AverageRate:threshold_scale=30.0", marks=pytest.mark.nightly),
    ],
)
def test_a_good_entry_holds_and_a_false_figure_is_named(player, tmp_path):
    claims = {"p_hmi": 0.9, "exceeded_m": {"0.5": 6.6}}
    good = write_entry(tmp_path / "good", player=player, figures=claims)
    here = Path.cwd()
    found = read(*check(good, "--json", "--seed", "0"))
    assert Path.cwd() == here
    rows = {row["name"]: row for row in found["figures"]}
    assert [*rows] == ["p_hmi", "exceeded_m 0.5"]
    assert rows["p_hmi"]["value"] == found["audit"]["p_hmi"]["value"]
    assert all(row["low"] <= row["claimed"] <= row["high"] for row in rows.values())
    assert found["audit"]["budget"] == "quick"
    known = list_detector_figures(["ramps"])
    assert len([*compare_figures(claim_all(known), found["audit"])]) == 13
    proud = write_entry(good, player=player, figures={**claims, "p_hmi": 0.1})
    result = call(*check(proud, "--seed", "0"))  # the same detector on the same runs
    assert result.exit_code == 1
    assert result.stdout.splitlines()[-1] == "mine by A. Nyone: claims what is not found: p_hmi"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"files": {}}, "must have the digest of mine.py"),
        ({"files": {"mine.py": "0" * 64}}, "mine.py is another file than entry.json says"),
        ({"suite": "spoofgym-bench-v7"}, "not 'spoofgym-bench-v7': audit again"),
        ({"figures": {"p_hmi": "good"}}, "entry.json: `figures.p_hmi"),
        ({"figures": {}}, "`figures`: Dictionary should have at least 1 item"),
        ({"name": "../up"}, "`name`: String should match pattern"),
        ({"side": "both"}, "`side`: Input should be 'detector' or 'spoofer'"),
        ({"task": "S1"}, "unknown task for detectors 'S1'"),
        ({"added": 1}, "`added`: Extra inputs are not permitted, got 1"),
    ],
)
def test_a_wrong_entry_is_refused_in_a_line_before_anything_plays(changes, message, tmp_path):
    assert message in refused(*check(write_entry(tmp_path / "entry", **changes)))


@pytest.mark.parametrize(
    ("figures", "message"),
    [
        (
            {"p_hmi": 0.9, "exceeded": {"0.5": 6.6}},
            "no figure 'exceeded'; valid: p_hmi, exceeded_m",
        ),
        ({"families": {"dashes": {"p_hmi": 0.9}}}, "no figure 'dashes'; valid: ramps"),
        ({"exceeded_m": {"0.05": 6.6, "0.1": 6.6}}, "no figure '0.1'; valid: 0.5, 0.05"),
        ({"exceeded_m": 6.6}, "no figure 'exceeded_m' with an interval"),
    ],
)
def test_an_unknown_figure_is_refused_before_anything_plays(
    figures, message, tmp_path, monkeypatch
):
    monkeypatch.setattr(Auditor, "prepare", None)
    assert message in refused(*check(write_entry(tmp_path / "entry", figures=figures)))


def test_a_missing_file_and_a_missing_entry_are_refused(tmp_path):
    entry = write_entry(tmp_path / "entry")
    assert "--task, --shard and --log don't go with --check" in refused(
        *check(entry, "--task", "D2")
    )
    (entry / "mine.py").unlink()
    assert "names the file mine.py, which is not in" in refused(*check(entry))
    (entry / "entry.json").unlink()
    assert "entry.json: No such file or directory" in refused(*check(entry))


def test_figures_are_found_by_the_names_of_detectors_and_families():
    estimate = {"value": 2.0, "low": 1.0, "high": 3.0}
    found = {"detectors": [{"detector": "ewma", "exceeded_m": {"0.5": estimate}}], "runs": 4}
    claim = {"detectors": {"ewma": {"exceeded_m": {"0.5": 3.5}}}}
    (figure,) = compare_figures(claim, found)
    assert (figure.name, figure.value, figure.holds) == (
        "detectors ewma exceeded_m 0.5",
        2.0,
        False,
    )
    claim["detectors"]["ewma"]["exceeded_m"]["0.5"] = 3.02  # rounded
    assert all(each.holds for each in compare_figures(claim, found))
    (figure,) = compare_figures({"x": 1.0}, {"x": {"value": None, "low": None, "high": None}})
    assert not figure.holds
    few = {"value": 3.0, "low": 2.0, "high": None}  # runs: nothing bounds it above
    assert [next(compare_figures({"x": x}, {"x": few})).holds for x in (1.9, 9.0)] == [False, True]
    with pytest.raises(ValueError, match="no figure 'cusum'; valid: ewma"):
        [*compare_figures({"detectors": {"cusum": 1.0}}, found)]
    with pytest.raises(ValueError, match="no figure 'runs' with an interval"):
        [*compare_figures({"runs": 4.0}, found)]
