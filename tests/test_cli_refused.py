"""What the command line refuses."""

import json
from pathlib import Path

import pytest

from .command_line import QUICK, TWO, call, refused

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
        (["bench", "--from", "3"], "there is no --track"),
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
