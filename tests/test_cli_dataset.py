"""spoofgym dataset."""

import sys
from pathlib import Path

import pytest

from spoofgym.bench.experiments.dataset import load_dataset
from spoofgym.calibration import thresholds as calibration
from spoofgym.detectors import Calibration
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from spoofgym.tasks import TASKS

from .bench.experiments.support import content
from .command_line import SHORT, call, read, refused

SMALL = ["--train", "3", "--validation", "2", "--test", "2", "--term", "innovation"]
SMALL += ["--term", "in-view", "--threads", "1"]

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_a_data_set_is_written_summed_up_and_gone_on_with():
    more = [*SHORT, *SMALL, "--seed", "3", "--file-runs", "2"]
    found = read("dataset", "data", *more, "--json")
    train = found["splits"]["train"]
    counts = {name: train[name] for name in ("runs", "episodes", "clean", "shards")}
    assert counts == {"runs": 3, "episodes": 6, "clean": 3, "shards": 2}
    assert sum(train["families"].values()) == 3
    data = load_dataset("data")
    assert (data.digest, data.config["entropy"]) == (found["digest"], 3)
    assert data.episodes("train").run.tolist() == [0, 0, 1, 1, 2, 2]
    before = content(Path("data"))
    assert found["digest"] in call("dataset", "data", *more).stdout
    first, _ = (call("dataset", "parts", *more, "--shard", f"{i}/2") for i in (1, 2))
    assert "shard 1/2 is finished; cells left by others" in first.stderr
    assert content(Path("parts")) == before
    other = ["dataset", "data", *SHORT, *SMALL]
    assert "holds other results (config.entropy: 3, not 0" in refused(*other)
    assert call(*other, "--overwrite").exit_code == 0


def test_the_world_of_a_task_has_its_detector_and_its_optima(monkeypatch):
    short = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 5.0}
    monkeypatch.setitem(TASKS["T3"].settings, "timeline", short)
    nominal = ["--detector", "snapshot-chi2:thresholds=nominal", "--json"]
    read("dataset", "data", "--task", "T3", *SMALL, *nominal)
    config = load_dataset("data").config
    assert (config["task"], config["length_m"]) == ("T3", TASKS["T3"].alert_limit_m)
    assert {"feedback", "open-loop"} <= {*config["families"]}
    assert config["detector"]["name"] == "snapshot-chi2"
    assert "--imu can't be given" in refused("dataset", "new", "--task", "T3", "--imu", "tactical")


def test_a_calibration_that_is_missing_is_made_for_who_can_be_watched(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "own"))
    monkeypatch.setattr(calibration, "PASSIVE_RUNS", 60)
    line = ["dataset", "data", *SHORT, *SMALL]
    assert "must be passive" in refused(*line, "--detector", "ewma:false_alarms_per_hour=20")
    assert not (tmp_path / "own").exists()
    line += ["--scenario", "trolley", "--tuning", "matched"]
    made = call(*line, "--detector", "snapshot-chi2:false_alarms_per_hour=20")
    assert made.exit_code == 0, made.output
    (file,) = (tmp_path / "own").rglob("snapshot-chi2-*.json")
    (threshold,) = load_dataset("data").config["threshold"]
    assert threshold[0] == Calibration.load(file).point(20.0).scale


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--family", "meaconer"], "unknown family of attacks 'meaconer'"),
        (["--attack", "quiet"], "held out"),
    ],
)
def test_wrong_input_gets_one_clear_line(more, message):
    assert message in refused("dataset", "data", *SHORT, *SMALL, *more)
    assert not Path("data").exists()


RAMPS = ["--spoofer", "ramp:rate_mps=0.05", "--spoofer", "ramp:rate_mps=1", "--train", "2"]
NAMED = ["dataset", "spoofgym/two-v0", "--format", "minari", *SHORT]
JUDGE = ["--detector", "snapshot-chi2:thresholds=nominal,false_alarm=0.3"]


# Minari's folder of what is not finished goes when nothing holds it any more
@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_episodes_of_spoofers_become_a_data_set_of_minari(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari", reason="minari is not installed: make test-ray")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    line = [*NAMED, *JUDGE, *RAMPS, "--knowledge", "blind", "--seed", "7"]
    found = read(*line, "--json")
    assert (found["episodes"], found["with an alarm"]) == (4, 2)
    data = minari.load_dataset("spoofgym/two-v0")
    env = data.recover_environment()
    assert data.observation_space == env.observation_space
    assert env.unwrapped.observation_names[0] == "own_displacement_along_target"
    alarms = []
    for k, episode in enumerate(data):
        assert all(action in env.action_space for action in episode.actions)
        env.reset(seed=7 + k)
        played = [env.step(action) for action in episode.actions]
        assert [step[1] for step in played] == episode.rewards.tolist()
        alarms.append(played[-1][4]["detected"])
    assert alarms == [False, True, False, True]
    assert "there is a data set spoofgym/two-v0 already" in refused(*line)
    monkeypatch.setattr("spoofgym.bench.experiments.offline.attach", None)  # nothing is played
    assert "end in a version, such as two-v0" in refused(line[0], "two", *line[2:])
    assert "Malformed dataset ID: two:a-v0" in refused(line[0], "two:a-v0", *line[2:])


def test_a_data_set_of_minari_names_what_it_lacks_and_what_it_does_not_take(monkeypatch):
    assert "needs a --spoofer" in refused(*NAMED, *JUDGE)
    for more in (["--term", "innovation"], ["--validation", "3"], ["--jobs", "2"]):
        assert f"{more[0]} can't be given with --format minari" in refused(*NAMED, *RAMPS, *more)
    other = [*NAMED[:3], "epochs", *NAMED[4:], "--knowledge", "blind"]
    assert "--knowledge can't be given with --format epochs" in refused(*other)
    assert "unknown format 'hdf5'" in refused(*NAMED[:3], "hdf5")
    monkeypatch.setitem(sys.modules, "minari", None)
    assert "pip install 'minari[arrow,create]'" in refused(*NAMED, *JUDGE, *RAMPS)
