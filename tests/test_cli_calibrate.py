"""spoofgym calibrate, and commands that calibrate what they lack."""

import importlib.util
import json
import math
import shlex

import pytest

from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from spoofgym.envs import SpoofEnv
from spoofgym.tasks import TASKS

from .command_line import SHORT, call, read, refused

RATE = ["--false-alarms-per-hour", "20"]
SHORT_RATE = ["calibrate", *SHORT, *RATE]
CHI2 = ["--detector", "snapshot-chi2"]
DEGENERATE = [*SHORT_RATE, "--scenario", "trolley", "--tuning", "matched", "--runs", "40"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "own"))
    return tmp_path / "own"


def test_a_calibration_is_made_shown_and_used(folder):
    line = [*SHORT_RATE, *CHI2, "--runs", "40"]
    found = read(*line, "--hold-out", "40", "--transfer", "groves", "--check", "--json")
    (row,) = found["calibrations"]
    assert (row["detector"], row["runs"], row["false_alarms_per_hour"]) == ("snapshot-chi2", 40, 20)
    assert row["per_run"] == pytest.approx(-math.expm1(-20 * 25 / 3600))
    assert row["file"].startswith(str(folder))
    assert found["notes"] == ["replayed: 1 calibrations hold, to 1e-06 of every maximum"]
    assert found["hold-out"][0]["holds"] is True
    assert found["in groves"][0]["holds"] is None
    again = call(*line)
    assert again.exit_code == 0, again.output
    assert f"{row['scale']:.6g}" in again.stdout
    played = call("run", *SHORT, *RATE, *CHI2, "--no-picture", "--spoofer", "step")
    assert played.exit_code == 0, played.output
    assert "20 false alarms an hour, 13 % of runs of 25 s (40 clean runs" in played.stdout


def test_a_device_that_is_unknown_or_lacks_its_packages_is_refused():
    for line in ([*SHORT_RATE, *CHI2], ["bench", *CHI2]):
        assert "unknown device 'tpu'" in refused(*line, "--device", "tpu")
        if importlib.util.find_spec("numba_cuda") is None:
            assert "spoofgym[cuda]" in refused(*line, "--device", "cuda")


def test_a_degenerate_statistic_that_was_named_is_a_failure_and_rescaled_is_none():
    result = call(*DEGENERATE, "--detector", "cusum", *CHI2, "--json")
    assert result.exit_code == 1, result.output
    found = json.loads(result.stdout)
    assert [row["scale"] is None for row in found["calibrations"]] == [True, False]
    assert "the statistic of cusum is degenerate" in found["notes"][0]
    # of `all` it is left out
    assert call(*DEGENERATE, "--detector", "all").exit_code == 0
    line = [*DEGENERATE, "--rescaled", "--json", "--detector", "all"]
    rows = read(*line)["calibrations"]
    assert sorted(row["detector"] for row in rows) == ["cusum", "lag-cusum"]
    says = "'rescaled' is for detectors with a drift term, which SnapshotChi2 is not"
    assert says in refused(*line, *CHI2)


def test_the_line_of_the_error_is_a_line_that_helps():
    times = {"warmup_s": 10.0, "live_s": 10.0, "attack_s": 20.0}
    asked = {"name": "raim", "confidence": 0.99, "false_alarms_per_hour": 20.0}
    settings = {"detector": asked, "timeline": times, "satellites": 9}
    with pytest.raises(ValueError, match="there is no calibration of raim in snapshot") as told:
        SpoofEnv("snapshot", **settings)
    result = call(*shlex.split(str(told.value).split("`")[1])[1:], "--runs", "60")
    assert result.exit_code == 0, result.output
    assert SpoofEnv("snapshot", **settings).core.setup.detector.point.runs == 60


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            [*CHI2, "--transfer", '{"errors": "trolley"}'],
            " got an unexpected keyword argument 'errors'",
        ),
        ([*CHI2, "--transfer", "zhong2025"], "is the same world: that is what --hold-out"),
        ([*CHI2, "--transfer", "{"], "is not JSON"),
        (["--detector", "snapshot-chi2:calibration=3"], "which this command computes"),
        (["--runs", "5"], "5 clean runs are too few: it takes at least 7"),
        (["--detector", "never"], "one that never alarms has no rate"),
        (["--false-alarms-per-hour", "0"], "must be a number above 0, got 0.0"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_played(folder, arguments, message):
    assert message in refused(*SHORT_RATE, *arguments)
    assert not list(folder.rglob("*.json"))


def test_the_world_may_be_that_of_a_task(monkeypatch):
    short = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 5.0}
    monkeypatch.setitem(TASKS["T3"].settings, "timeline", short)
    line = ["calibrate", "--task", "T3", *CHI2, *RATE]
    assert read(*line, "--runs", "10", "--json")["world"]["scenario"]["errors"] == "trolley"
    assert "--imu can't be given with --task" in refused(*line, "--imu", "tactical")
