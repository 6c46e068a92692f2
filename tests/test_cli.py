"""The command line: what it prints, writes and plays."""

import dataclasses
import json
import re
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import typer

from spoofgym import __version__
from spoofgym.bench.experiments import Store
from spoofgym.bench.experiments.campaign import CampaignResults
from spoofgym.cli import app
from spoofgym.cli.options import WorldOptions
from spoofgym.detectors import DETECTORS
from spoofgym.policies import list_shipped
from spoofgym.spoofers import SPOOFERS
from spoofgym.tasks import TASKS

from .command_line import FIXED, QUICK, SHORT, TRAINING, TWO, call, read, refused

pytestmark = pytest.mark.usefixtures("in_tmp_path")

WORLD = ("run", "bench", "limits", "dataset")
"""Commands with the options of a world."""


def test_help_of_every_command_with_the_options_of_the_world_where_it_plays():
    text = call("--help").output
    for command in (*WORLD, "demo", "list", "audit", "game", "report", "warmup"):
        assert command in text
        page = call(command, "--help")
        assert page.exit_code == 0
        assert ("--set" in page.output) == (command in WORLD)
    assert call("--version").output.strip() == __version__
    group = typer.main.get_group(app)
    names = [field.name for field in dataclasses.fields(WorldOptions) if field.name != "context"]
    for command in WORLD:
        options = [option.name for option in group.commands[command].params]
        start = options.index("env")
        assert options[start : start + len(names)] == names


def test_a_demo_shows_one_attack_that_is_missed_and_found():
    shown = call("demo")
    missed, found = (line for line in shown.output.splitlines() if " raises " in line)
    assert missed.startswith("ewma raises no alarm: the position ends 59.1 m off.")
    assert found.startswith("snapshot-chi2 raises an alarm after 4 s: 0.0 m went undetected.")
    assert "Next: spoofgym audit ewma --budget quick" in shown.output
    assert Path("demo.png").stat().st_size > 20_000
    runs = read("demo", "--no-picture", "--json")["runs"]
    assert [run["alarm"] for run in runs] == [False, True]


def test_list_names_all_there_is_and_marks_oracles(monkeypatch):
    fixes = type("Fixes", (DETECTORS["ewma"],), {"__doc__": "Fixes.", "measures": "position"})
    monkeypatch.setitem(DETECTORS, "fixes", fixes)
    found = read("list", "--json")
    assert set(found) == {"envs", "scenarios", "attacks", "detectors", "spoofers", "shipped"}
    names = {kind: {row["name"]: row for row in rows} for kind, rows in found.items()}
    assert read("list", "ewma", "--json")[1] == {
        **{"name": "false_alarm", "needed": False, "default": 1e-5, "unit": ""},
        "valid": "a number above 0 and below 1",
        "help": "Alpha: probability of an alarm of one satellite in one epoch.",
    }
    table = " ".join(call("list", "false-position").output.split())
    assert "acceleration_limit_mps2 0.05 m/s^2 a number above 0" in table
    assert {*names["detectors"]} == {*DETECTORS}
    assert {*names["spoofers"]} == {*SPOOFERS}
    assert [*names["shipped"]] == [*list_shipped("spoofer"), *list_shipped("detector")]
    assert all(row["summary"] for rows in found.values() for row in rows)
    ramp = {"settings": {"heading_deg": 90.0, "rate_mps": 0.5}, "tunable": "rate_mps"}
    assert names["spoofers"]["ramp"].items() >= {**ramp, "knowledge": "blind"}.items()
    for name, row in names["envs"].items():
        assert row["settings"].items() >= json.loads(json.dumps(gym.spec(name).kwargs)).items()
    table = " ".join(call("list", "envs").output.split())
    assert f"spoofgym/BenchS2-v2 task S2: {TASKS['S2'].title}" in table
    assert "pool=" not in table  # nor any other setting, which fill a screen each
    assert "ewma, has shipped thresholds in zhong2025 alone" in call("list", "scenarios").output
    assert "decision_interval_s" in call("list", "spoofgym/BenchS2-v2").output
    oracles = [name for name, row in names["detectors"].items() if row["oracle"]]
    assert oracles == ["oracle-ramp", "oracle-step"]
    assert names["detectors"]["fixes"]["measures"] == "position"
    table = " ".join(call("list", "detectors").output.split())
    assert table.count("[oracle, knows what no receiver does]") == len(oracles)
    assert "for positions" in table


def test_bench_writes_report_replay_and_json():
    result = call("bench", *QUICK, "--out", "out", "--spoofer", "ramp:rate_mps=tuned")
    assert result.exit_code == 0, result.output
    answer = result.output[result.output.index("Tightest of 2: ") :]
    lines = [" ".join(line.split()) for line in result.output.splitlines()]
    assert max(map(len, result.output.splitlines())) <= 100
    rows = lines[lines.index("detector spoofer at most 25 % of alarms [m]") + 1 :][:4]
    for row, judge in zip(rows, ("never", "lottery", "snapshot-chi2", "ewma"), strict=True):
        ends = r"\(([\d.]+ to|within) [\d.]+\)"
        assert re.fullmatch(rf"{judge} ramp\(tuned\) [\d.]+ {ends}", row), rows
    answer = " ".join(answer.split())
    assert "m undetected in the mean at 25 % of alarms (worst: ramp(tuned))" in answer
    assert answer.endswith(" Report: out/report.html")
    for name in ("config.json", "report.html", "summary.json", "replay.json"):
        assert Path("out", name).is_file()
    assert "stealthy displacement [m]" in Path("out", "report.html").read_text()
    assert not list(Path("out").rglob("*.part"))
    # a ramp without settings is tuned: the same campaign
    summary = read("bench", *QUICK, "--out", "out", "--spoofer", "ramp", "--json")
    judges = {"never", "lottery", "snapshot-chi2", "ewma"}
    assert {cell["detector"] for cell in summary["cells"]} == judges
    assert {cell["spoofer"] for cell in summary["cells"]} == {"none", "ramp(tuned)"}
    assert summary["runs"] == 4
    written = json.loads(Path("out", "summary.json").read_text())
    assert written == {k: v for k, v in summary.items() if k not in {"folder", "input"}}
    Path("out", "report.html").unlink()
    assert read("report", "out", "--json")["cells"] == summary["cells"]
    assert Path("out", "report.html").is_file()


def test_an_interrupted_bench_is_kept_and_goes_on_and_run_is_a_run_of_it(monkeypatch):
    world = ["--tuning", "matched", "--imu", "tactical", "--errors", "groves", "--seed", "7"]
    world += ["--attack", "false-position:rate_limit_mps=2"]
    original, line = Store.put, ("bench", *QUICK, *TWO, *world, "--out", "out")

    def interrupted(self, cell, result):
        original(self, cell, result)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Store, "put", interrupted)
        result = call(*line)
    assert result.exit_code == 130
    said = "interrupted: 1 of 5 cells are finished in out; the same command goes on"
    assert said in result.stderr
    assert not Path("out", "report.html").exists()
    assert call(*line).exit_code == 0
    cell = CampaignResults.load("out").runs("ewma", "ramp(rate_mps=0.4)")
    assert cell is not None
    played = json.dumps(cell.head["spoofer_settings"])  # with the amplitude that was fitted
    more = ["--spoofer", played, "--run", "2", "--no-picture", "--json"]
    summary = read("run", *SHORT, *world, *more)
    assert summary["final_error_m"] == pytest.approx(cell.records["final_error_m"][2], abs=1e-4)
    assert "other results (config.runs: 4, not 5)" in refused(*line, "--runs", "5")
    config = json.loads(Path("out", "config.json").read_text())["config"]
    receiver, scenario = config["receiver"], config["scenario"]
    assert (receiver["tuning"], receiver["grade"]) == ("matched", "tactical")
    assert (scenario["imu"], scenario["errors"]) == ("tactical", "groves")
    assert config["attack"]["rate_limit_mps"] == 2
    assert (config["entropy"], config["timeline"]["attack_s"]) == (7, 20.0)
    assert call(*line, "--runs", "5", "--overwrite").exit_code == 0


def test_run_draws_one_attack():
    summary = read("run", *SHORT, "--spoofer", "step:size_m=20", "--out", "a.png", "--json")
    assert summary["spoofer"]["size_m"] == 20
    assert summary["largest_error_m"] > 1.0
    assert Path("a.png").is_file()
    assert "undetected_displacement_m" in call("run", *SHORT, "--no-picture").output
    assert not Path("episode.png").exists()


@pytest.mark.nightly
def test_an_animation_of_a_whole_attack_is_small_by_default():
    Image = pytest.importorskip("PIL.Image")
    world = ["--scenario", "zhong2025", "--detector", "ewma"]
    assert call("run", *world, "--out", "run.webp").exit_code == 0
    assert Path("run.webp").stat().st_size < 1_500_000
    with Image.open("run.webp") as picture:
        assert 60 <= picture.n_frames <= 80


def test_epochs_and_runs_are_written_for_matlab_and_as_parquet():
    from pyarrow.parquet import read_table
    from scipy.io import loadmat

    env = ["--env", "spoofgym/Snapshot-v0", "--attack-s", "6"]
    for folder, line in {
        "run": ("run", *env, "--spoofer", "step:size_m=20", "--json", "--out"),
        "report": ("report", "small", "--json", "--out"),
    }.items():
        if folder == "report":
            cells = ("--runs", "3", "--spoofer", "ramp:rate_mps=0.4", "--detector", "raim")
            read("bench", *env, "--nominal", *cells, "--out", "small", "--json", "--threads", "1")
        summary, _ = (read(*line, f"{folder}{ending}") for ending in (".mat", ".parquet"))
        table, found = read_table(f"{folder}.parquet"), loadmat(f"{folder}.mat")
        assert set(table.column_names) == {name for name in found if name[:2] != "__"}
        for name in table.column_names:
            values = found[name]
            if values.dtype == object:  # cells of texts
                values = np.array([each.item() for each in values[:, 0]])
            column = np.array(table[name].to_pylist())
            assert np.array_equal(
                column.reshape(values.shape), values, equal_nan=column.dtype.kind == "f"
            )
        if folder == "run":
            error = found["induced_error_m"][found["time_s"][:, 0] > 0.0]
            assert error.max() >= summary["largest_error_m"] - 1e-4
            assert found["error_ned_m"].shape[1] >= 2
        else:
            mine = CampaignResults.load("small").runs("raim", "ramp(rate_mps=0.4)")
            pairs = zip(*(table[x].to_pylist() for x in ("detector", "spoofer")), strict=True)
            rows = [pair == ("raim", "ramp(rate_mps=0.4)") for pair in pairs]
            column = np.array(table["undetected_displacement_m"])[rows]
            assert mine is not None
            assert np.array_equal(column, mine.displacement_m)
    assert "ending of `--out`" in refused("report", "small", "--out", "small.csv")


def test_the_other_victims_are_played_by_their_environment():
    env = ["--env", "spoofgym/Snapshot-v0", "--set", "satellites=9", "--set", "noise_m=2.0"]
    times = ["--attack-s", "12", "--spoofer", "ramp:rate_mps=0.4"]
    more = [*FIXED[:3], *["--runs", "4", "--out", "small", "--json", "--threads", "1"]]
    report = read("bench", *env, *times, *more)
    assert (report["scenario"], report["missing"]) == ("snapshot", [])
    judges = [row["detector"] for row in report["detectors"]]
    assert judges == ["never", "lottery", "raim", "srv-raim"]
    config = json.loads(Path("small/config.json").read_text())["config"]
    assert (config["settings"]["satellites"], config["settings"]["noise_m"]) == (9, 2.0)
    assert config["timeline"]["attack_s"] == 12.0
    assert config["timeline"]["warmup_s"] == 10.0  # the victim's own, not that of the option
    found = CampaignResults.load("small").runs("srv-raim", "ramp(rate_mps=0.4)")
    assert found is not None
    played = json.dumps(found.head["spoofer_settings"])  # with its amplitude
    how = [*times[:2], "--spoofer", played, "--run", "2", "--json", "--no-picture"]
    told = read("run", *env, *how)
    assert told["detector"]["name"] == "srv-raim"
    mine = found.records["undetected_displacement_m"][2]
    assert told["undetected_displacement_m"] == pytest.approx(mine, abs=1e-4)
    animated = ["--attack-s", "3", "--every", "5", "--out"]
    for name in ("small.gif", "small.webp"):
        assert read("run", *env, *animated, name, "--json")["picture"] == name
        assert Path(name).stat().st_size > 10_000
    few = ["--nominal", *TRAINING[-6:], "--attack-s", "5", *more[3:5], "--out", "fits"]
    few += FIXED[1:3]
    line = ("bench", *env, "--spoofer", "ramp", "--rule", "upper-limit", *few)
    found = read(*line, "--fit-only", "--json")
    for each, name in zip(found[-2:], ("raim", "srv-raim"), strict=True):
        told = {"detector": name, "setting": "rate_mps", "runs": 11, "budget": 0.25}
        assert each.items() >= told.items()
    assert call(*line, "--fit-only").output.count("(chosen)") == 4
    assert read(*line, "--json")["tuning"] == found  # it goes on from there


HOMEMADE = """
from dataclasses import dataclass
from spoofgym.detectors import Ewma
from spoofgym.spoofers import Ramp

@dataclass
class Nervous(Ewma):
    false_alarm: float = 0.5

class Slow(Ramp):
    pass
"""


def test_classes_of_the_user_are_found_in_the_working_directory():
    Path("homemade.py").write_text(HOMEMADE)
    own = ["--detector", "homemade:Nervous", "--spoofer", "homemade:Slow:rate_mps=0.1"]
    try:
        cells = read("bench", *QUICK, "--out", "out", "--json", *own)["cells"]
    finally:
        sys.path.remove(str(Path.cwd()))
    assert {cell["detector"] for cell in cells} == {"Nervous"}
    assert cells[0]["alarm_rate"]["value"] is None  # every clean twin alarms: no run counts
    assert cells[1]["spoofer"] == "Slow(rate_mps=0.1)"


def test_bench_on_a_real_flight(data_folder):
    flight = data_folder / "adsb_flights" / "ajaccio.json.gz"
    broadcast = data_folder / "gnss_broadcast" / "brdc3050.12n"
    line = ["bench", *QUICK, *TWO, "--track", flight, "--ephemeris", broadcast]
    line += ["--duration", "120", "--out", "out"]
    result = call(*line)
    assert result.exit_code == 0, result.output
    page = Path("out", "report.html").read_text()
    for text in ("Only the trajectory is real", "is taken as height above the ellipsoid"):
        assert text in page
    found = read(*line, "--json")
    assert found["input"]["track"]["interpolated"] == 1210
    assert found["input"]["note"].startswith("Only the trajectory is real")
    assert found["input"]["note"] in " ".join(result.output.split())
