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
import numba
import pytest
import typer
from typer.testing import CliRunner, Result

from spoofgym import __version__
from spoofgym._jit import CACHE_VARIABLE, cache_parent
from spoofgym.bench.store import ResultsFolder
from spoofgym.cli import app
from spoofgym.cli.options import ENV, World, with_world
from spoofgym.detectors import DETECTORS
from spoofgym.detectors.zoo import path_of
from spoofgym.detectors.zoo import shipped as learned
from spoofgym.spoofers import SPOOFERS, shipped

from .bench.support import small_suite, use_zoo, write_zoo

SHORT = ["--warmup-s", "20", "--live-s", "10", "--attack-s", "20", "--time-to-alert-s", "5"]
TRAINING = [*SHORT, "--training-seeds", "11", "--budget", "0.25", "--threads", "1"]
FIXED = ["--nominal", "--selection-seeds", "0", "--set", "domain={}"]
QUICK = [*TRAINING, *FIXED, "--seeds", "4"]
TWO = ["--detector", "ewma", "--spoofer", "none", "--spoofer", "ramp:rate_mps=0.4"]


def call(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def refused(*arguments: str | Path) -> str:
    """The one line that a wrong command prints."""
    result = call(*arguments)
    assert result.exit_code == 2, result.output
    lines = result.stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("spoofgym: error: ")
    return lines[0]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


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
        "perf",
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
    worlds: list[World] = []

    @with_world
    def play(*, first: int = 1, world: World, last: int = 2) -> None:
        worlds.append(world)
        assert (first, last) == (1, 3)

    small = typer.Typer()
    small.command()(play)
    line = ["--imu", "tactical", "--from", "3", "--set", "a=1", "--set", "b=2", "--last", "3"]
    assert CliRunner().invoke(small, line).exit_code == 0
    (world,) = worlds
    assert (world.imu, world.from_s, world.settings) == ("tactical", 3.0, ["a=1", "b=2"])
    assert (world.env, world.attack_s, world.track) == (ENV, 150.0, None)
    assert world.given(("from_s", "imu", "errors", "last")) == {
        "imu": "--imu",
        "from_s": "--from",
        "last": "--last",
    }
    group = typer.main.get_group(app)
    names = [field.name for field in dataclasses.fields(World) if field.name != "context"]
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
    assert {row["name"] for row in found["detectors"]} == {*DETECTORS, *learned()}
    assert {row["name"] for row in found["spoofers"]} == set(SPOOFERS)
    assert "spoofgym/TightlyCoupled-v0" in {row["name"] for row in found["envs"]}
    assert [row["name"] for row in found["shipped"]] == list(shipped())
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


@pytest.fixture(scope="module")
def zoo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("zoo")
    write_zoo(folder, small_suite())
    return folder


def test_list_and_card_show_what_is_shipped(
    zoo_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_zoo(zoo_folder, monkeypatch)
    rows = json.loads(call("list", "shipped", "--json").stdout)["shipped"]
    assert [row["name"] for row in rows] == ["curve", "push", "track"]
    assert (rows[2]["knowledge"], rows[2]["designed_on"]) == ("tracking", "ewma, by hand")
    assert rows[2]["scores"][0]["undetected_displacement_m"] == 12.5
    table = " ".join(call("list").output.split())
    assert "ewma: 12.5 m (11.0 to 14.0), alarms 20.0 % (clean 18.0 %)" in table
    for name in ("push", str(zoo_folder / "push.onnx"), str(zoo_folder / "push.json")):
        card = call("card", name)
        assert card.exit_code == 0, card.output
        for part in ("python -m by.hand", "40 commands", "12.5 (11.0 to 14.0)", "push.onnx, "):
            assert part in card.output
        assert json.loads(call("card", name, "--json").stdout)["name"] == "push"
    assert "rates_mps" in call("card", "curve").output
    wrong = " ".join(refused("card", "pull").split())
    assert "unknown shipped spoofer or detector 'pull'; valid: curve, push, track" in wrong
    assert "there is no card nowhere.json" in refused("card", "nowhere.onnx")


def test_a_card_of_a_detector_is_shown_by_name_and_by_file() -> None:
    file = path_of("trolley-guard")
    for name in ("trolley-guard", str(file), str(file.with_suffix(".json"))):
        found = call("card", name)
        assert found.exit_code == 0, found.output
        for part in ("detector-policy", "hidden (32)", "12 slots, epochs of 0.5 s", "best_pass"):
            assert part in found.output
        assert json.loads(call("card", name, "--json").stdout)["statistic"] == "receiver"
    damaged = Path("damaged.json")
    damaged.write_text('{"kind": "detector-policy"}')
    assert "card damaged.json" in refused("card", "damaged.json")


def test_bench_and_run_take_learned_and_optimised_spoofers(
    zoo_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_zoo(zoo_folder, monkeypatch)
    inline = '{"name": "profile", "rates_mps": [0, 0.1, 0.2], "label": "inline"}'
    chosen = ["--spoofer", "push", "--spoofer", inline, "--detector", "ewma"]
    played = call("bench", *QUICK, *chosen, "--out", "out", "--json")
    assert played.exit_code == 0, played.output
    summary = json.loads(played.stdout)
    assert [cell["spoofer"] for cell in summary["cells"]] == ["none", "push", "inline"]
    assert all(isinstance(cell["within_budget"], bool) for cell in summary["cells"])
    assert all(cell["spoofer_settings"]["amplitude"] > 0.0 for cell in summary["cells"][1:])
    again = call("report", "out")
    assert "stealthy attacks" in again.output
    for name in ("push", str(zoo_folder / "track.onnx"), inline):
        one = call("run", *SHORT, "--spoofer", name, "--json")
        assert one.exit_code == 0, one.output
        assert json.loads(one.stdout)["largest_error_m"] > 0.0
    assert Path("episode.png").is_file()


def test_shipped_spoofers_that_do_not_fit_are_named(
    zoo_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_zoo(zoo_folder, monkeypatch)
    north = [*QUICK, "--out", "out", "--attack", "false-position:axes=n"]
    assert "needs a command to the east" in refused("bench", *north)
    assert "push does not fit this attack: " in refused("bench", *north, "--spoofer", "push")
    assert not Path("out").exists()
    longer = [*QUICK, "--attack-s", "25", "--detector", "ewma", "--out", "longer"]
    result = call("bench", *longer)
    assert result.exit_code == 0, result.output
    note = "shipped spoofer curve is left out: conditions.steps: 40 on the card, 50 here"
    assert note in result.output
    assert note in Path("longer", "results.md").read_text()


def test_an_interrupted_bench_is_kept_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    original = ResultsFolder.put_cell

    def interrupted(self: ResultsFolder, cell: Any) -> None:
        original(self, cell)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ResultsFolder, "put_cell", interrupted)
        result = call("bench", *QUICK, *TWO, "--out", "out")
    assert result.exit_code == 130
    assert "interrupted: 1 of 2 cells are finished and kept in out" in result.stderr
    assert call("bench", *QUICK, *TWO, "--out", "out").exit_code == 0
    assert "another campaign (different: runs)" in refused(
        "bench", *QUICK, *TWO, "--out", "out", "--seeds", "5"
    )
    assert call("bench", *QUICK, *TWO, "--out", "out", "--seeds", "5", "--overwrite").exit_code == 0


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_finished() -> None:
    command = [*QUICK, "--detector", "ewma", "--spoofer", "ramp:rate_mps=0.4", "--out", "out"]
    long = ["bench", *command, "--seeds", "2000", "--attack-s", "100"]
    # a shell starts its background jobs, and so perhaps these tests, deaf to Ctrl-C
    # the second cell waits for the interrupt, should it be finished before
    listening = """
import signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from spoofgym.bench.store import ResultsFolder
from spoofgym.cli import main
put_cell = ResultsFolder.put_cell
def put_the_first(folder, cell):
    while any(folder.path.glob("cells/*.jsonl")):
        time.sleep(0.05)
    put_cell(folder, cell)
ResultsFolder.put_cell = put_the_first
main()
"""
    process = subprocess.Popen(
        [sys.executable, "-c", listening, *long], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    deadline = time.monotonic() + 600.0
    while not list(Path("out").glob("cells/ewma*--none.jsonl")):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=600.0)
    assert process.returncode == 130
    assert b"interrupted: 1 of 2 cells are finished and kept in out" in said
    assert b"Traceback" not in said
    assert not Path("out", "results.md").exists()
    assert call("report", "out").exit_code == 0
    assert (
        "**Not finished**: ewma(thresholds=nominal) / ramp" in Path("out", "results.md").read_text()
    )


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")
def test_after_warmup_another_process_compiles_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    command = [sys.executable, "-m", "spoofgym", "warmup", "Snapshot-v0", "--json"]
    runs = [
        json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        for _ in range(2)
    ]
    for run in runs:
        assert run["cache"] == str(tmp_path / "cache")
        rows = run["environments"]
        assert [(each["id"], each["form"]) for each in rows] == [
            ("spoofgym/Snapshot-v0", form) for form in ("single", "batch")
        ]
        assert all(each["seconds"] > 0.0 for each in rows)
    compiled = [sum(each["compiled"] for each in run["environments"]) for run in runs]
    assert compiled[0] > 0
    assert compiled[1] == 0


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")
def test_warmup_says_what_it_did_and_where_the_code_is() -> None:
    text = call("warmup", "WheeledRobot-v0", "spoofgym/Snapshot-v0").output
    for word in ("spoofgym/WheeledRobot-v0", "spoofgym/Snapshot-v0", "single", "batch"):
        assert word in text
    assert f"compiled code is in {cache_parent()}" in text


def test_warmup_refuses_what_is_not_there_and_what_cannot_be_compiled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 0)
    said = refused("warmup", "Snapshot-v9")
    assert "unknown environment 'spoofgym/Snapshot-v9'; valid: " in said
    assert "did you mean 'spoofgym/Snapshot-v0'?" in said
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert "NUMBA_DISABLE_JIT is set" in refused("warmup")


@pytest.mark.parametrize(
    ("command", "option", "largest"),
    [
        ("run", "--run", 999_999),
        ("render", "--run", 999_999),
        ("bench", "--seeds", 1_000_000),
        ("tune", "--training-seeds", 1_000_000),
    ],
)
def test_absurd_numbers_of_runs_end_at_once(command: str, option: str, largest: int) -> None:
    result = call(command, option, "99999999999")
    assert result.exit_code == 2
    assert f"Invalid value for '{option}'" in result.stderr
    assert str(largest) in result.stderr
    assert list(Path().iterdir()) == []


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
    cell = ResultsFolder("out").cell("ewma", "ramp(rate_mps=0.4)")
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
    config = json.loads(Path("small/config.json").read_text())
    assert (config["settings"]["satellites"], config["settings"]["noise_m"]) == (9, 2.0)
    assert config["timeline"]["attack_s"] == 12.0
    assert config["timeline"]["warmup_s"] == 10.0  # the victim's own, not that of the option
    assert "satellites=9" in Path("small/results.md").read_text()
    rows = Path("small/cells/srv-raim--ramp-rate_mps=0.4.jsonl").read_text().splitlines()
    played = json.dumps(json.loads(rows[0])["spoofer_settings"])  # with its amplitude
    how = [*times[:2], "--spoofer", played, "--run", "2", "--json", "--no-picture"]
    run = call("run", *env, *how)
    told = json.loads(run.stdout)
    assert told["detector"]["name"] == "srv-raim"
    (mine,) = [row for row in map(json.loads, rows) if row.get("run") == 2]
    assert told["undetected_displacement_m"] == pytest.approx(
        mine["undetected_displacement_m"], abs=1e-4
    )
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
    config = json.loads(Path("out", "config.json").read_text())
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["list", "planes"], "unknown kind 'planes'; valid: attacks, detectors, envs"),
        (["bench", "--detector", "emwa"], "unknown detector 'emwa'; valid: "),
        (["bench", "--detector", "oracle-step"], "an oracle knows the attack's"),
        (["run", "--detector", "oracle-ramp"], "to play it all the same: `--allow-oracles`"),
        (["bench", "--spoofer", "ramp:rate=1"], "spoofer 'ramp' has no setting 'rate'; valid: "),
        (["run", "--scenario", "zhong"], "unknown scenario 'zhong'; valid: "),
        (["run", "--errors", "none"], "unknown errors 'none'; valid: "),
        (["run", "--imu", "toy"], "unknown imu grade 'toy'; valid: "),
        (["run", "--tuning", "loose"], "`tuning` must be one of 'paper', 'matched'"),
        (["run", "--attack", "radio"], "unknown attack 'radio'; valid: "),
        (["run", "--spoofer", "ramp:rate_mps=nan"], "`rate_mps` must be a finite number"),
        (["run", "--spoofer", "ramp:rate_mps=9"], "`rate_mps` = 9 is more than the attack allows"),
        (["run", "--attack-s", "nan"], "`attack_s` must be finite"),
        (["run", "--attack-s", "900"], "an episode takes"),
        (["run", "--detector", "nowhere:Thing"], "there is no module 'nowhere'"),
        (["run", "--spoofer", "ramp:rate_mps=tuned"], "needs a search"),
        (["run", "--spoofer", "ramp:rate_mps"], "a setting is written `ramp:rate_mps=...`"),
        (["run", "--out", "a.gift"], "unknown ending of a picture '.gift'; valid: "),
        (["render", "--out", "a.avi"], "unknown ending of an animation '.avi'; valid: "),
        (["render", "--fps", "0"], "`fps` must be above 0 and at most 100, got 0.0"),
        (["bench", "--budget", "0.001"], "--training-seeds must be at least 2995 for a budget of"),
        (["tune", "--budget", "2"], "--budget must be in (0, 1), got 2.0"),
        (["tune", "--spoofer", "none"], "spoofer 'none' can't be tuned; tunable: nothing"),
        (["bench", "--spoofer", "nowhere.onnx"], "there is no ONNX file nowhere.onnx"),
        (["card", "nowhere.json"], "there is no card nowhere.json"),
        (["bench", "--seed", "-1"], "`entropy` must be a whole number"),
        (["bench", "--track", "a.json"], "--track and --ephemeris belong together"),
        (["bench", "--from", "3"], "there is no --track"),
        (["bench", "--track", "a.json", "--ephemeris", "b.n"], "a.json: No such file"),
        (["report", "nowhere"], "nowhere holds no results of a campaign"),
        (["bench", "--env", "Snapshot-v0"], "unknown environment of the benchmark 'Snapshot-v0'"),
        (
            ["bench", "--env", "spoofgym/Snapshot-v0", "--attack", "paper-ideal"],
            "--attack is an option of spoofgym/TightlyCoupled-v0, not of spoofgym/Snapshot-v0, "
            "whose settings are given with --set",
        ),
        (
            ["run", "--env", "spoofgym/WheeledRobot-v0", "--detector", "ewma"],
            "detector ewma does not fit a wheeled robot (spoofgym/WheeledRobot-v0): ",
        ),
        (["bench", "--set", "satellites"], "a setting is written `name=value`, got 'satellites'"),
        (["bench", "--set", "between=a", "--set", "between=b"], "--set between is given twice"),
        (["run", "--set", "satellites=9"], "TightlyCoupled-v0 has no setting 'satellites', got 9"),
        (["bench", "--task", "T1", "--set", "worlds=2"], "--set can't be given with --task"),
        (["bench", "--suite", "mine"], "unknown suite 'mine'; valid: standard"),
        (["bench", "--suite", "standard", "--task", "T1"], "--task can't be given with --suite"),
        (["bench", "--suite", "standard", "--nominal"], "--nominal can't be given with --suite"),
        (
            ["bench", "--suite", "standard", "--spoofer", "ramp"],
            "--spoofer can't be given with --suite",
        ),
        (
            ["bench", "--suite", "standard", "--budget", "0.1"],
            "--budget can't be given with --suite",
        ),
    ],
)
def test_wrong_input_gets_one_clear_line(arguments: list[str], message: str) -> None:
    assert message in refused(*arguments)


def test_a_folder_of_something_else_is_left_alone() -> None:
    Path("out").mkdir()
    Path("out", "letter.txt").write_text("dear")
    assert "letter.txt" in refused("bench", *QUICK, *TWO, "--out", "out", "--overwrite")
    assert [path.name for path in Path("out").iterdir()] == ["letter.txt"]


def rows(count: int) -> list[dict[str, float]]:
    return [
        {
            "timestamp": 1_515_758_400 + 5 * k,
            "latitude": 41.0 + 0.005 * k,
            "longitude": 8.0,
            "altitude": 10_000.0,
        }
        for k in range(count)
    ]


def test_bad_tracks_and_ephemerides_are_refused(data_folder: Path) -> None:
    broadcast = data_folder / "gnss_broadcast" / "brdc3050.12n"
    flight = data_folder / "adsb_flights" / "ajaccio.json.gz"
    for name, content, message in (
        ("empty.json", [], "a track must have rows, got none"),
        ("backwards.json", rows(50)[::-1], "time must not run backwards"),
        ("short.json", rows(3), "at least"),
    ):
        Path(name).write_text(json.dumps(content))
        assert message in refused("bench", "--track", name, "--ephemeris", broadcast)
    header, _, body = broadcast.read_text().partition("END OF HEADER")
    Path("none.12n").write_text(f"{header}END OF HEADER\n")
    assert "holds no usable GPS satellite" in refused(
        "bench", "--track", flight, "--ephemeris", "none.12n"
    )
    # records of the early morning only, while the flight begins at noon
    early = "\n".join(body.splitlines()[1:9])
    Path("early.12n").write_text(f"{header}END OF HEADER\n{early}\n")
    assert "must be within 2 h of a healthy record" in refused(
        "bench", "--track", flight, "--ephemeris", "early.12n"
    )
    assert "`from_s` must lie in an airborne stretch" in refused(
        "bench", "--track", flight, "--ephemeris", broadcast, "--from", "1e6"
    )
    assert "--date must be YYYY-MM-DD" in refused(
        "bench", "--track", flight, "--ephemeris", broadcast, "--date", "today"
    )


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
