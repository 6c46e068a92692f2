"""The command line: what it prints, writes and refuses."""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import typer
from typer.testing import CliRunner

from spoofgym import __version__
from spoofgym.bench.experiments import Store
from spoofgym.bench.experiments.campaign import CampaignResults
from spoofgym.cli import app
from spoofgym.cli.options import ENV, WorldOptions, with_options
from spoofgym.detectors import DETECTORS
from spoofgym.policies import list_shipped
from spoofgym.spoofers import SPOOFERS

from .bench.support import small_suite
from .command_line import FIXED, QUICK, SHORT, TRAINING, TWO, call, refused

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_help_of_every_command() -> None:
    text = call("--help").output
    for command in (
        "list",
        "card",
        "run",
        "tune",
        "bench",
        "protect",
        "game",
        "limits",
        "dataset",
        "report",
        "warmup",
    ):
        assert command in text
        page = call(command, "--help")
        assert page.exit_code == 0
        assert "Usage" in page.output
        if command in ("run", "bench", "limits", "dataset"):
            assert "--env" in page.output
            assert "--set" in page.output
    assert call("--version").output.strip() == __version__


def test_the_options_of_the_world_are_those_of_every_command_that_plays() -> None:
    """And the world that a command gets holds what is on its command line."""
    worlds: list[WorldOptions] = []

    @with_options
    def play(*, first: int = 1, options: WorldOptions, last: int = 2) -> None:
        worlds.append(options)
        assert (first, last) == (1, 3)

    small = typer.Typer()
    small.command()(play)
    line = ["--imu", "tactical", "--from", "3", "--set", "a=1", "--set", "b=2", "--last", "3"]
    assert CliRunner().invoke(small, line).exit_code == 0
    (world,) = worlds
    assert (world.imu, world.from_s, world.settings) == ("tactical", 3.0, ["a=1", "b=2"])
    assert (world.env, world.attack_s, world.track) == (ENV, 150.0, None)
    assert world.find_passed(("from_s", "imu", "errors", "last")) == {
        "imu": "--imu",
        "from_s": "--from",
        "last": "--last",
    }
    group = typer.main.get_group(app)
    names = [field.name for field in dataclasses.fields(WorldOptions) if field.name != "context"]
    for command in ("run", "render", "tune", "bench", "limits", "dataset"):
        options = [option.name for option in group.commands[command].params]
        start = options.index("env")
        assert options[start : start + len(names)] == names


def test_it_starts_quickly_and_as_a_module() -> None:
    """By what is imported, since a clock measures how busy the machine is."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "spoofgym", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "bench" in done.stdout
    for slow in ("matplotlib", "pandas", "scipy", "numba"):
        assert f" {slow}\n" not in done.stderr
    assert done.stderr.count("import time:") < 1000


def test_list_names_all_there_is() -> None:
    found = json.loads(call("list", "--json").stdout)
    assert set(found) == {"envs", "scenarios", "attacks", "detectors", "spoofers", "shipped"}
    assert {row["name"] for row in found["detectors"]} == {*DETECTORS, *list_shipped("detector")}
    assert {row["name"] for row in found["spoofers"]} == set(SPOOFERS)
    assert "spoofgym/TightlyCoupled-v0" in {row["name"] for row in found["envs"]}
    assert [row["name"] for row in found["shipped"]] == [
        *list_shipped("spoofer"),
        *list_shipped("detector"),
    ]
    for rows in found.values():
        assert all(row["summary"] for row in rows)
    (ramp,) = [row for row in found["spoofers"] if row["name"] == "ramp"]
    assert ramp["settings"]["rate_mps"] == 0.5
    told = [row["name"] for row in found["detectors"] if row["oracle"]]
    assert told == ["oracle-ramp", "oracle-step"]
    assert (ramp["tunable"], ramp["knowledge"]) == ("rate_mps", "blind")
    settings = {row["name"]: row["settings"] for row in found["envs"]}
    for name, told in settings.items():
        assert told.items() >= json.loads(json.dumps(gym.spec(name).kwargs)).items()
    plain = settings["spoofgym/TightlyCoupled-v0"]
    assert plain["target_heading_deg"] == 90.0
    assert {**plain, **settings["spoofgym/RandomStart-v0"]} == {
        **plain,
        "domain": {"start_s": [0.0, None]},
        "target_heading_deg": "random",
    }
    assert "target_heading_deg=random" in " ".join(call("list", "envs").output.split())
    table = call("list", "detectors").output
    assert "snapshot-chi2" in table
    assert "[oracle, knows what no receiver does]" in " ".join(table.split())
    assert "accelerating-ramp" not in table


def test_list_marks_oracles_and_what_measures_positions(monkeypatch: pytest.MonkeyPatch) -> None:
    told = type("Told", (DETECTORS["ewma"],), {"__doc__": "Knows it.", "oracle": True})
    fixes = type("Fixes", (DETECTORS["ewma"],), {"__doc__": "Fixes.", "measures": "position"})
    monkeypatch.setitem(DETECTORS, "told", told)
    monkeypatch.setitem(DETECTORS, "fixes", fixes)
    rows = json.loads(call("list", "detectors", "--json").stdout)["detectors"]
    assert {row["name"]: row["oracle"] for row in rows}["told"] is True
    assert {row["name"]: row["measures"] for row in rows}["fixes"] == "position"
    lines = call("list", "detectors").output.splitlines()
    by_name = {line.split()[0]: line for line in lines if line.strip()}
    assert "oracle" in by_name["told"]
    assert "for positions" in by_name["fixes"]
    for name in ("ewma", "snapshot-chi2"):
        assert "oracle" not in by_name[name]
        assert "[" not in by_name[name]


def test_bench_writes_table_picture_and_json() -> None:
    result = call("bench", *QUICK, "--out", "out", "--spoofer", "ramp:rate_mps=tuned")
    assert result.exit_code == 0, result.output
    assert "stealthy attacks" in result.output
    for name in ("config.json", "results.md", "summary.json", "campaign.png"):
        assert Path("out", name).is_file()
    assert "| stealthy displacement [m] |" in Path("out", "results.md").read_text()
    assert not list(Path("out").rglob("*.part"))
    # a ramp without settings is tuned, so that this is the same campaign
    again = call("bench", *QUICK, "--out", "out", "--spoofer", "ramp", "--json")
    summary = json.loads(again.stdout)
    judges = {"never", "lottery", "snapshot-chi2", "ewma"}
    assert {cell["detector"] for cell in summary["cells"]} == judges
    assert {cell["spoofer"] for cell in summary["cells"]} == {"none", "ramp(tuned)"}
    assert summary["runs"] == 4
    written = json.loads(Path("out", "summary.json").read_text())
    assert written == {k: v for k, v in summary.items() if k not in {"folder", "input"}}
    Path("out", "results.md").unlink()
    assert json.loads(call("report", "out", "--json").stdout)["cells"] == summary["cells"]
    assert Path("out", "results.md").is_file()


def test_an_interrupted_bench_is_kept_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    original = Store.put

    def interrupted(self: Store, cell: Any, result: Any) -> None:
        original(self, cell, result)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Store, "put", interrupted)
        result = call("bench", *QUICK, *TWO, "--out", "out")
    assert result.exit_code == 130
    assert "interrupted: 1 of 5 cells are finished in out" in result.stderr
    assert call("bench", *QUICK, *TWO, "--out", "out").exit_code == 0
    assert "other results (config.runs: 4, not 5)" in refused(
        "bench", *QUICK, *TWO, "--out", "out", "--seeds", "5"
    )
    assert call("bench", *QUICK, *TWO, "--out", "out", "--seeds", "5", "--overwrite").exit_code == 0


@pytest.mark.slow
def test_the_settings_of_one_name_are_listed_with_what_is_valid() -> None:
    rows = json.loads(call("list", "detectors", "ewma", "--json").stdout)
    assert rows[1] == {
        "name": "false_alarm",
        "needed": False,
        "default": 1e-5,
        "unit": "",
        "valid": "a number above 0 and below 1",
        "help": "Alpha: probability of an alarm of one satellite in one epoch.",
    }
    table = " ".join(call("list", "attacks", "false-position").output.split())
    assert "acceleration_limit_mps2 0.05 m/s^2 a number above 0" in table
    for words, message in (
        (["detectors", "ewmo"], "did you mean 'ewma'?"),
        (["envs", "x"], "unknown kind with settings 'envs'; valid: attacks, detectors, spoofers"),
    ):
        result = call("list", *words)
        assert result.exit_code == 2
        assert message in result.stderr


def test_ctrl_c_keeps_what_is_finished() -> None:
    command = [*QUICK, "--detector", "ewma", "--spoofer", "ramp:rate_mps=0.4", "--out", "out"]
    long = ["bench", *command, "--seeds", "2000", "--attack-s", "100"]
    # a shell starts its background jobs, and so perhaps these tests, deaf to Ctrl-C
    # what comes after the first cell waits for the interrupt, should it be finished before
    listening = """
import signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from spoofgym.bench.experiments import Store
from spoofgym.cli import main
put = Store.put
def put_the_first(store, cell, result):
    while any(store.path.glob("cells/*.npz")):
        time.sleep(0.05)
    put(store, cell, result)
Store.put = put_the_first
main()
"""
    process = subprocess.Popen(
        [sys.executable, "-c", listening, *long], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    deadline = time.monotonic() + 600.0
    while not list(Path("out").glob("cells/*.npz")):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=600.0)
    assert process.returncode == 130
    assert b" of 5 cells are finished in out; the same command goes on" in said
    assert b"Traceback" not in said
    assert b"1 of 5" in said
    assert not Path("out", "results.md").exists()


def test_a_late_run_is_that_of_a_long_campaign() -> None:
    suite = small_suite()
    one = suite.generators("evaluation", 900, 899)
    assert len(one) == 1
    assert one[0].random() == suite.generators("evaluation", 900)[899].random()


def test_run_draws_one_attack() -> None:
    result = call("run", *SHORT, "--spoofer", "step:size_m=20", "--out", "a.png", "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["spoofer"]["size_m"] == 20
    assert summary["largest_error_m"] > 1.0
    assert Path("a.png").is_file()
    named = call("run", *SHORT, "--spoofer", "step:size_m=20", "--out", "run1")
    assert "run1.png" in named.stdout.split()
    assert Path("run1.png").is_file()
    plain = call("run", *SHORT, "--no-picture")
    assert "undetected_displacement_m" in plain.output
    assert not Path("episode.png").exists()


def test_run_is_a_run_of_the_bench() -> None:
    call("bench", *QUICK, *TWO, "--out", "out")
    cell = CampaignResults.load("out").runs("ewma", "ramp(rate_mps=0.4)")
    assert cell is not None
    played = json.dumps(cell.head["spoofer_settings"])  # with the amplitude that was fitted
    result = call("run", *SHORT, "--spoofer", played, "--run", "2", "--no-picture", "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["final_error_m"] == pytest.approx(cell.records["final_error_m"][2], abs=1e-4)


def test_the_other_victims_are_played_by_their_environment() -> None:
    env = ["--env", "spoofgym/Snapshot-v0", "--set", "satellites=9", "--set", "noise_m=2.0"]
    times = ["--attack-s", "12", "--spoofer", "ramp:rate_mps=0.4"]
    bench = call(
        "bench",
        *env,
        *times,
        *FIXED[:3],
        "--seeds",
        "4",
        "--out",
        "small",
        "--json",
        "--threads",
        "1",
    )
    assert bench.exit_code == 0, bench.output
    report = json.loads(bench.stdout)
    assert (report["scenario"], report["missing"]) == ("snapshot", [])
    assert [row["detector"] for row in report["detectors"]] == [
        "never",
        "lottery",
        "raim",
        "srv-raim",
    ]
    config = json.loads(Path("small/config.json").read_text())["config"]
    assert (config["settings"]["satellites"], config["settings"]["noise_m"]) == (9, 2.0)
    assert config["timeline"]["attack_s"] == 12.0
    assert config["timeline"]["warmup_s"] == 10.0  # the victim's own, not that of the option
    assert "satellites=9" in Path("small/results.md").read_text()
    found = CampaignResults.load("small").runs("srv-raim", "ramp(rate_mps=0.4)")
    assert found is not None
    played = json.dumps(found.head["spoofer_settings"])  # with its amplitude
    how = [*times[:2], "--spoofer", played, "--run", "2", "--json", "--no-picture"]
    run = call("run", *env, *how)
    told = json.loads(run.stdout)
    assert told["detector"]["name"] == "srv-raim"
    mine = found.records["undetected_displacement_m"][2]
    assert told["undetected_displacement_m"] == pytest.approx(mine, abs=1e-4)
    drawn = call("render", *env, "--attack-s", "3", "--out", "small.gif")
    assert drawn.exit_code == 0, drawn.output
    assert Path("small.gif").stat().st_size > 10_000
    tuned = call("tune", *env, "--spoofer", "ramp", *TRAINING[-6:], "--attack-s", "5", "--json")
    assert [found["detector"] for found in json.loads(tuned.stdout)] == ["raim", "srv-raim"]


def test_tune_tells_what_it_tried() -> None:
    result = call("tune", *TRAINING, "--detector", "ewma", "--spoofer", "ramp", "--json")
    (found,) = json.loads(result.stdout)
    assert (found["setting"], found["runs"], found["budget"]) == ("rate_mps", 11, 0.25)
    assert len({trial["value"] for trial in found["trials"]}) >= 20
    table = call("tune", *TRAINING, "--detector", "ewma", "--spoofer", "ramp").output
    assert "(chosen)" in table


def test_settings_reach_what_is_run() -> None:
    call(
        "bench",
        *QUICK,
        *TWO,
        "--out",
        "out",
        "--tuning",
        "matched",
        "--imu",
        "tactical",
        "--errors",
        "groves",
        "--attack",
        "false-position:rate_limit_mps=2",
        "--seed",
        "7",
    )
    config = json.loads(Path("out", "config.json").read_text())["config"]
    assert config["receiver"]["tuning"] == "matched"
    assert (config["receiver"]["grade"], config["scenario"]["imu"]) == ("tactical", "tactical")
    assert config["scenario"]["errors"] == "groves"
    assert config["attack"]["rate_limit_mps"] == 2
    assert config["entropy"] == 7
    assert config["timeline"]["attack_s"] == 20.0


def test_classes_of_the_user_are_found_in_the_working_directory() -> None:
    Path("homemade.py").write_text(
        "from dataclasses import dataclass\n"
        "from spoofgym.detectors import Ewma\n"
        "from spoofgym.spoofers import Ramp\n\n"
        "@dataclass\n"
        "class Nervous(Ewma):\n"
        "    false_alarm: float = 0.5\n\n"
        "class Slow(Ramp):\n"
        "    pass\n"
    )
    try:
        result = call(
            "bench",
            *QUICK,
            "--out",
            "out",
            "--json",
            "--detector",
            "homemade:Nervous",
            "--spoofer",
            "homemade:Slow:rate_mps=0.1",
        )
    finally:
        sys.path.remove(str(Path.cwd()))
    assert result.exit_code == 0, result.output
    cells = json.loads(result.stdout)["cells"]
    assert {cell["detector"] for cell in cells} == {"Nervous"}
    assert cells[0]["alarm_rate"]["value"] is None  # every clean twin alarms: no run counts
    assert cells[1]["spoofer"] == "Slow(rate_mps=0.1)"


def test_bench_on_a_real_flight(data_folder: Path) -> None:
    flight = data_folder / "adsb_flights" / "ajaccio.json.gz"
    broadcast = data_folder / "gnss_broadcast" / "brdc3050.12n"
    cut = ["--track", str(flight), "--ephemeris", str(broadcast), "--duration", "120"]
    result = call("bench", *QUICK, *TWO, *cut, "--out", "out")
    assert result.exit_code == 0, result.output
    text = " ".join(result.output.split())
    for part in (
        "of them modulo 256",
        "the barometric altitude is taken as height above the ellipsoid",
        "the time of day is mapped to another day",
        "distance of the fixes: RMS",
    ):
        assert part in text
        assert part in Path("out", "results.md").read_text()
    reports = json.loads(call("bench", *QUICK, *TWO, *cut, "--out", "out", "--json").stdout)[
        "input"
    ]
    assert reports["track"]["interpolated"] == 1210
