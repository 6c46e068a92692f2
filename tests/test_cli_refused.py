"""What the command line refuses."""

import errno
import json
import sys
from pathlib import Path

import pytest

from spoofgym.core.files import whole_file

from .command_line import QUICK, SHORT, TWO, call, read, refused

pytestmark = pytest.mark.usefixtures("in_tmp_path")


@pytest.mark.parametrize(
    ("command", "option", "largest"),
    [("run", "--run", 999_999), ("bench", "--runs", 1_000_000), ("limits", "--worlds", 1024)],
)
def test_absurd_numbers_of_runs_end_at_once(command, option, largest):
    result = call(command, option, "99999999999")
    assert result.exit_code == 2
    assert f"Invalid value for '{option}'" in result.stderr
    assert str(largest) in result.stderr
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["list", "spoofer"], "there is no 'spoofer'; `spoofgym list` shows all names; did you me"),
        (["bench", "--budget", "huge"], "unknown budget 'huge'; valid: full, quick, standard"),
        (["bench", "--spoofer", "none", "--fit-only"], "--fit-only needs a spoofer with a setting"),
        (["bench", "--detector", "oracle-step"], "an oracle knows the attack's"),
        (["run", "--detector", "oracle-ramp"], "to play it all the same: `--allow-oracles`"),
        (["run", "--spoofer", "ramp:rate_mps=tuned"], "needs a search"),
        (["run", "--spoofer", "ramp:rate_mps"], "a setting is written `ramp:rate_mps=...`"),
        (["run", "--out", "a.gift"], "unknown ending of a picture '.gift'; valid: "),
        (["bench", "--alarm-budget", "0.001"], "--training-runs must be at least 2995 for a bud"),
        (["bench", "--track", "a.json"], "--track and --ephemeris belong together"),
        (["bench", "--from", "3"], "--from is for a recorded track, and needs --track"),
        (["bench", "--track", "a.json", "--ephemeris", "b.n"], "a.json: No such file"),
        (["report", "nowhere"], "nowhere holds no results: there is no config.json"),
        (
            ["bench", "--env", "spoofgym/Snapshot-v0", "--attack", "paper-ideal"],
            "--attack is an option of spoofgym/TightlyCoupled-v0, not of spoofgym/Snapshot-v0, ",
        ),
        (["bench", "--set", "satellites"], "a setting is written `name=value`, got 'satellites'"),
        (["bench", "--set", "between=a", "--set", "between=b"], "--set between is given twice"),
        (["bench", "--task", "T1", "--set", "worlds=2"], "--set can't be given with --task"),
        (["bench", "--task", "T1", "--detector", "ewma"], "--detector can't be given with --task"),
    ],
)
def test_wrong_input_gets_one_clear_line(arguments, message):
    assert message in refused(*arguments)


OWN = """
from spoofgym.detectors.controls import Never


class Exits(Never):
    def judge(self, epoch):
        raise SystemExit(3)


class Diverges(Never):
    def judge(self, epoch):
        raise ArithmeticError("receiver 0 has diverged")


class Prints(Never):
    def judge(self, epoch):
        print("a word of its own")
        return super().judge(epoch)
"""


def test_own_detectors_and_what_is_missing_on_a_machine(tmp_path, monkeypatch):
    (tmp_path / "own_kinds.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    own = ["run", *SHORT, "--no-picture", "--detector"]
    for name, said in (
        ("own_kinds:Exits", "SystemExit(3)"),
        ("own_kinds:Diverges", "receiver 0 has diverged"),
        ("", "unknown detector ''"),
    ):
        assert said in refused(*own, name)
    assert read(*own, "own_kinds:Prints", "--json")["alarm"] is False
    for name in ("matplotlib", "matplotlib.figure"):
        monkeypatch.setitem(sys.modules, name, None)
    shown = call("run", *SHORT, "--detector", "never")
    assert shown.exit_code == 0, shown.output
    assert "largest_error_m" in shown.stdout
    assert shown.stderr.startswith("no picture: pictures need matplotlib"), shown.stderr


def test_what_is_shipped_needs_no_folder_and_the_rest_names_the_variable(monkeypatch):
    Path("file").touch()
    monkeypatch.setenv("SPOOFGYM_CALIBRATIONS", "file/below")
    shown = call("run", "--no-picture", "--json")
    assert shown.exit_code == 0, shown.output
    few = ["--detector", "ewma", "--runs", "48", "--false-alarms-per-hour", "60"]
    line = refused("calibrate", *SHORT, *few)
    assert "set SPOOFGYM_CALIBRATIONS to a folder that can be written" in line


def test_a_full_disk_names_the_file():
    with pytest.raises(OSError, match="left") as error, whole_file(Path("a.json")):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert error.value.filename == "a.json"
    assert list(Path().iterdir()) == []


def test_a_folder_of_something_else_is_left_alone():
    Path("out").mkdir()
    Path("out", "letter.txt").write_text("dear")
    assert "letter.txt" in refused("bench", *QUICK, *TWO, "--out", "out", "--overwrite")
    assert [path.name for path in Path("out").iterdir()] == ["letter.txt"]


def test_bad_tracks_and_ephemerides_are_refused(data_folder):
    broadcast = data_folder / "gnss_broadcast" / "brdc3050.12n"
    flight = data_folder / "adsb_flights" / "ajaccio.json.gz"
    place = {"longitude": 8.0, "altitude": 10_000.0}
    rows = [
        {"timestamp": 1_515_758_400 + 5 * k, "latitude": 41.0 + 0.005 * k, **place}
        for k in range(3)
    ]
    Path("short.json").write_text(json.dumps(rows))
    assert "at least" in refused("bench", "--track", "short.json", "--ephemeris", broadcast)
    header, _, body = broadcast.read_text().partition("END OF HEADER")
    Path("none.12n").write_text(f"{header}END OF HEADER\n")
    # records of the early morning only, while the flight begins at noon
    early = "\n".join(body.splitlines()[1:9])
    Path("early.12n").write_text(f"{header}END OF HEADER\n{early}\n")
    for ephemeris, more, message in (
        ("none.12n", [], "holds no usable GPS satellite"),
        ("early.12n", [], "must be within 2 h of a healthy record"),
        (broadcast, ["--from", "1e6"], "`from_s` must lie in an airborne stretch"),
        (broadcast, ["--date", "today"], "--date must be YYYY-MM-DD"),
    ):
        assert message in refused("bench", "--track", flight, "--ephemeris", ephemeris, *more)
