"""spoofgym calibrate, and commands that calibrate what they lack."""

import json
import math

import pytest

from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from spoofgym.tasks import TASKS

from .command_line import SHORT, call, refused

RATE = ["--false-alarms-per-hour", "20"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "own"))
    return tmp_path / "own"


def test_a_calibration_is_made_shown_and_used(folder):
    line = ["calibrate", *SHORT, *RATE, "--detector", "snapshot-chi2", "--runs", "40"]
    made = call(*line, "--hold-out", "40", "--transfer", "groves", "--check", "--json")
    assert made.exit_code == 0, made.output
    found = json.loads(made.stdout)
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
    played = call(
        "run", *SHORT, *RATE, "--detector", "snapshot-chi2", "--no-picture", "--spoofer", "step"
    )
    assert played.exit_code == 0, played.output
    assert "20 false alarms an hour, 13 % of runs of 25 s (40 clean runs" in played.stdout


DEGENERATE = ["--scenario", "trolley", "--tuning", "matched", *RATE, "--runs", "40"]


def test_a_degenerate_statistic_that_was_named_is_a_failure():
    """The others are calibrated all the same, and shown."""
    line = ["calibrate", *SHORT, *DEGENERATE, "--detector", "cusum", "--detector", "snapshot-chi2"]
    result = call(*line, "--json")
    assert result.exit_code == 1, result.output
    found = json.loads(result.stdout)
    assert [row["scale"] is None for row in found["calibrations"]] == [True, False]
    assert "the statistic of cusum is degenerate" in found["notes"][0]
    # also beside `all`, of which it is left out without a word of blame
    everyone = ["calibrate", *SHORT, *DEGENERATE, "--detector", "all"]
    assert call(*everyone, "--detector", "cusum").exit_code == 1
    assert call(*everyone).exit_code == 0


def test_rescaled_takes_of_all_those_that_it_is_for():
    line = ["calibrate", *SHORT, *DEGENERATE, "--rescaled", "--json"]
    result = call(*line, "--detector", "all")
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["calibrations"]
    assert sorted(row["detector"] for row in rows) == ["cusum", "lag-cusum"]
    says = "'rescaled' is for detectors with a drift term, which SnapshotChi2 is not"
    for other in ("cusum", "all"):
        assert says in refused(*line, "--detector", other, "--detector", "snapshot-chi2")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"errors": "trolley"}', '--transfer {"errors": "trolley"} has no argument \'errors\''),
        ("{}", "is the same world: that is what --hold-out counts"),
        ("zhong2025", "is the same world: that is what --hold-out counts"),
        ('{"detector": "ewma"}', "has no argument 'detector'"),
        ("{", "is not JSON"),
        ("grovess", "unknown scenario 'grovess'"),
    ],
)
def test_another_world_that_is_none_is_refused_before_anything_is_played(folder, text, says):
    line = ["calibrate", *SHORT, *RATE, "--detector", "snapshot-chi2", "--runs", "40"]
    assert says in refused(*line, "--transfer", text)
    assert not folder.exists()


@pytest.mark.parametrize(
    "asked", ["thresholds=nominal", "false_alarms_per_hour=3", "calibration=x"]
)
def test_a_detector_can_not_ask_for_thresholds_where_they_are_looked_for(asked):
    line = ["calibrate", *SHORT, *RATE, "--detector", f"snapshot-chi2:{asked}", "--runs", "40"]
    says = f"asks for `{asked.partition('=')[0]}`, but thresholds are what is looked for here"
    assert says in refused(*line)


def test_a_victim_without_scenarios_has_no_other_one():
    line = ["calibrate", *SHORT, *RATE, "--env", "spoofgym/WheeledRobot-v0"]
    assert "has no argument 'scenario'" in refused(*line, "--transfer", "trolley")


def test_the_line_of_the_error_is_a_line_that_helps():
    """What an environment says is run as it stands."""
    import shlex

    from spoofgym.envs import SpoofEnv

    times = {"warmup_s": 10.0, "live_s": 10.0, "attack_s": 20.0}
    asked = {"name": "raim", "confidence": 0.99, "false_alarms_per_hour": 20.0}
    settings = {"detector": asked, "timeline": times, "satellites": 9}
    with pytest.raises(ValueError, match="there is no calibration of raim in snapshot") as told:
        SpoofEnv("snapshot", **settings)
    line = str(told.value).split("`")[1]
    result = call(*shlex.split(line)[1:], "--runs", "60")
    assert result.exit_code == 0, result.output
    assert SpoofEnv("snapshot", **settings).core.setup.detector.point.runs == 60


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--runs", "5"], "5 clean runs are too few: it takes at least 7"),
        (["--detector", "never"], "one that never alarms has no rate"),
        (["--false-alarms-per-hour", "0"], "must be a number above 0, got 0.0"),
        (["--false-alarms-per-hour", "-1"], "must be a number above 0, got -1.0"),
        (["--rescaled"], "'rescaled' is for detectors with a drift term"),
        (["--detector", "ewmo"], "did you mean 'ewma'?"),
    ],
)
def test_wrong_input(arguments, message):
    assert message in refused("calibrate", *SHORT, *RATE, *arguments)


def test_the_world_may_be_that_of_a_task(monkeypatch):
    short = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 5.0}
    monkeypatch.setitem(TASKS["T3"].settings, "timeline", short)
    line = ["calibrate", "--task", "T3", "--detector", "snapshot-chi2", *RATE]
    made = call(*line, "--runs", "10", "--json")
    assert made.exit_code == 0, made.output
    assert json.loads(made.stdout)["world"]["scenario"]["errors"] == "trolley"
    assert "--imu can't be given with --task" in refused(*line, "--imu", "tactical")
