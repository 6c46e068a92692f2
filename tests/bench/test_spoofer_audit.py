"""Audits of a spoofer: its figures are those of a campaign at exactly the budget, and go on."""

import json

import numpy as np
import pytest

from spoofgym.bench.experiments import suite
from spoofgym.bench.experiments.campaign import CampaignResults, run_campaign, summarize
from spoofgym.bench.experiments.entry import FILE, compare_figures, list_spoofer_figures
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.report.campaign import list_limit_notes
from spoofgym.bench.scores.at_budget import AlarmCurve, exceed_at_budget
from spoofgym.bench.scores.campaign import HALF
from spoofgym.cli.suites import leave_uncalibrated
from spoofgym.tasks import DETECTOR_TASKS

from ..command_line import call, read, refused
from ..detectors.learned.files import write_guard
from .detector_support import NOMINAL, small_task
from .support import small_suite
from .test_entry import claim_all

OWN = """
from spoofgym.spoofers import Ramp

class Key(Ramp):
    def __init__(self, **settings):
        raise KeyError("rate")

class Acts(Ramp):
    def act(self, seen):
        return {}[0]
"""


@pytest.fixture(autouse=True)
def few_detectors(monkeypatch):
    found = [{"name": "never"}, {"name": "snapshot-chi2", **NOMINAL}]
    monkeypatch.setattr(suite, "list_standard_detectors", lambda task=None: found)
    monkeypatch.setitem(DETECTOR_TASKS, "D1", small_task())


def words(folder, *more):
    sizes = ["--budget", "quick", "--runs", "12", "--threads", "1", "--seed", "3"]
    return ["audit", *sizes, "--out", str(folder), *more]


def test_a_spoofer_meets_the_detectors_of_the_suite_beside_the_usual_attacks(tmp_path, monkeypatch):
    (found,) = read(*words(tmp_path, "--spoofer", "ramp", "--json"))
    never, snapshot = found["detectors"]
    assert [row["detector"] for row in (never, snapshot)] == ["never", "snapshot-chi2"]
    assert set(snapshot["others"]) == {"open-loop", "accelerating-ramp"}
    known = list_spoofer_figures(["never", "snapshot-chi2"], ["open-loop", "accelerating-ramp"])
    assert len([*compare_figures(claim_all(known), found)]) == 2 * (2 + 3 * 2)
    moved = snapshot["exceeded_m"]["0.5"]
    assert moved["low"] <= moved["value"] <= moved["high"] < never["exceeded_m"]["0.5"]["value"]
    assert moved["low"] < moved["high"]  # the fit is in it
    assert 0.0 < found["floor_m"]["half"]["value"] < found["floor_m"]["few"]["value"]
    cells = CampaignResults.load(tmp_path / "small-ramp-tuned")
    monkeypatch.setattr("spoofgym.bench.experiments.campaign.Panel", None)  # nothing plays again
    lines = call(*words(tmp_path, "--spoofer", "ramp")).stdout.splitlines()
    assert lines[-1] == found["answer"]
    assert lines[-2] == f"Report: {cells.path / 'report.html'}"
    assert max(map(len, lines[:-2])) <= 100
    assert (cells.path / "report.html").is_file()
    assert json.loads((cells.path / "summary.json").read_text())["entropy"] == 3


def test_the_stored_floor_of_a_task_is_not_computed_again(tmp_path, monkeypatch):
    assert suite.find_stored_floor(small_task()) is None
    floor = suite.find_stored_floor(DETECTOR_TASKS["D2"])
    monkeypatch.setattr("spoofgym.bench.search.bounds.compute_frontier", None)
    played = small_suite(detectors=("never",), spoofers=("step",), floor=floor)
    found = summarize(run_campaign(played, tmp_path, threads=1))
    assert found["limits"]["floor"]["floor_m"] == floor["floor_m"]
    (row,) = found["detectors"]
    assert row["bracket"]["floor_m"][HALF] == floor["floor_m"]["half"]["value"]
    assert floor["assumptions"][0] in list_limit_notes(found)[-1]


def test_a_stored_curve_is_fitted_and_not_searched_again(tmp_path, monkeypatch):
    monkeypatch.setattr("spoofgym.bench.search.open_loop.search_aims", None)
    spoofer = {"name": "open-loop", "amplitude": "tuned"}
    curves = {"snapshot-chi2": [0.0, 1.0, 2.0]}
    detectors = ({"name": "snapshot-chi2", **NOMINAL},)
    played = small_suite(detectors=detectors, spoofers=(spoofer,), curves=curves)
    assert played.digest != small_suite(detectors=detectors, spoofers=(spoofer,)).digest
    results = run_campaign(played, tmp_path, threads=1)
    (cell,) = (x for x in summarize(results)["cells"] if x["spoofer"] != "none")
    rates = np.array(cell["spoofer_settings"]["rates_mps"])
    assert rates[2] == pytest.approx(2.0 * rates[1])
    assert rates[0] == 0.0 < rates[1]
    (row,) = summarize(results)["detectors"]
    assert row["bracket"]["open_loop"]["by"] == "the task's stored search"


def test_an_unknown_figure_of_a_spoofer_is_refused_before_anything_plays(tmp_path, monkeypatch):
    monkeypatch.setattr("spoofgym.cli.audit.calibrate_suite", None)
    entry = {"format": 1, "suite": "spoofgym-bench-v1", "task": "D1", "side": "spoofer"}
    entry |= {"name": "mine", "who": "A. Nyone", "player": "ramp", "files": {}}
    entry["figures"] = {"detectors": {"ewma": {"alarm_rate": 0.05}}}
    (tmp_path / FILE).write_text(json.dumps(entry))
    message = "no figure 'ewma'; valid: never, snapshot-chi2"
    assert message in refused(*words(tmp_path / "out", "--check", str(tmp_path)))


def test_a_quick_audit_leaves_out_detectors_without_thresholds():
    detectors = ["never", {"name": "ewma", "smoothing": 0.123, "false_alarms_per_hour": 0.2}]
    whole = Suite(scenario="zhong2025", detectors=detectors, spoofers=["ramp"])
    label = whole.detector_players[1].label
    part, note = leave_uncalibrated(whole, None)
    assert [each.label for each in part.detector_players] == ["never"]
    assert note == f"left out, as a quick audit makes no calibration: {label}"
    assert part.notes == (note,)
    same, text = leave_uncalibrated(whole, lambda entry: "2000 clean runs")
    assert same is whole
    assert text == f"calibrated first, and stored: {label}: 2000 clean runs"
    assert leave_uncalibrated(part, None) == (part, "")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["ewma", "--spoofer", "ramp"], "a DETECTOR, a --spoofer or an entry (--check)"),
        ([], "a DETECTOR, a --spoofer or an entry (--check)"),
        (["--spoofer", "none"], "attacks nothing"),
        (["--spoofer", "raises:Any"], "raises ZeroDivisionError when it is imported"),
        (["--spoofer", "own:Key"], "spoofer 'own:Key': KeyError: 'rate'"),
        (["--spoofer", "own:Acts"], "Acts raises KeyError: 0"),
        (["--spoofer", "guard.onnx"], "is that of a detector policy, which is no spoofer"),
        (["--spoofer", "ewma-ppo"], "to `spoofgym bench`: an audit plays in the world of small"),
        (["--spoofer", "ramp", "--family", "ramps"], "are options of a detector's audit"),
    ],
)
def test_wrong_input_gets_one_line(given, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "raises.py").write_text("1 / 0\n")
    (tmp_path / "own.py").write_text(OWN)
    write_guard(tmp_path, threshold=0.9)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert message in refused(*words("out", *given))


def test_what_is_exceeded_at_the_budget_lies_between_the_amplitudes_played():
    runs = np.arange(40.0)
    curve = AlarmCurve(
        amplitudes=np.array([1.0, 2.0]),
        alarm_amplitude=1.0 + runs / 39.0,
        displacement={"undetected_displacement_m": np.stack([runs, 2.0 * runs])},
        alarmed=np.zeros((2, 40), dtype=bool),
        sky=np.arange(40),
        chosen=1.0,
    )
    # a quarter alarm at a quarter of the way, and half of the runs are beyond their 20th largest
    at = (0.25 * 40 - 1) / 39.0
    found = exceed_at_budget(curve, 0.25, 0.5)
    assert found.value == pytest.approx((1.0 + at) * 20.0)
    assert found.low < found.value < found.high
