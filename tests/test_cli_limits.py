"""spoofgym limits: its figures are those of the package, its tables those of its JSON."""

import pytest

from spoofgym.bench.report.table import format_number
from spoofgym.detectors import SnapshotChi2
from spoofgym.detectors.calibration_file import run_probability
from spoofgym.limits import compute_frontier, deflection_for
from spoofgym.limits.bounds import draw_worlds, zero_alarm_bounds
from spoofgym.simulation import TightlyCoupledSetup

from .command_line import SHORT, call, read, refused

TIMELINE = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 5.0}
LINE = ["limits", *SHORT, "--set", "domain={}"]

pytestmark = pytest.mark.usefixtures("in_tmp_path")


@pytest.fixture(scope="module")
def setup():
    return TightlyCoupledSetup(scenario="zhong2025", detector="never", timeline=TIMELINE)


def test_the_floors_are_those_of_the_frontier_and_in_the_picture(setup, tmp_path):
    more = ["--nominal", "--sensors", "known", "--alarm-budget", "0.1", "--figure", "floor.svg"]
    record = read(*LINE, *more, "--json")
    frontier = compute_frontier(setup, sensors_known=True)
    p_fa = run_probability(0.2, 25.0)
    assert (record["p_fa"], record["worlds"], record["sensors_known"]) == (p_fa, 1, True)
    asked = {"stealthy": 1.0 - (1.0 - p_fa) * 0.9, "half": 0.5, "few": 0.95, "certain": 0.999}
    for heading in ("known", "unknown"):
        cells = record["floors_m"][heading]
        assert {name: cell["p_d"] for name, cell in cells.items()} == pytest.approx(asked)
        for name, p_d in asked.items():
            floor = frontier.lower_limit_m(p_fa, p_d, heading=heading)
            assert cells[name]["value"] == pytest.approx(floor)
            assert cells[name]["deflection"] == deflection_for(p_fa, p_d, heading=heading)
    assert record["every_channel_free_m"]["value"] == pytest.approx(frontier.sizes(free=True)[0])
    assert record["below_every_channel_free"] is True
    assert record["assumptions"]["floor"] == list(frontier.assumptions)
    assert "zero_alarm" not in record
    picture, course = (tmp_path / record["figure"]).read_text(), record["course"]
    assert "missed in one of a thousand" in picture or "<path" in picture
    assert (len(course["times_s"]), course["times_s"][-1]) == (12, 20.0)
    for purpose in ("half", "certain"):
        floors = course["floors_m"][purpose]["value"]
        assert floors == sorted(floors)
        assert floors[-1] == pytest.approx(record["floors_m"]["unknown"][purpose]["value"])


def test_the_tables_are_those_of_the_json(setup):
    line = [*LINE, "--nominal", "--detector", "snapshot-chi2", "--detector", "raim"]
    record = read(*line, "--spoofer", "ramp", "--json")
    words = " ".join(call(*line, "--spoofer", "ramp").stdout.split())
    for cells in record["floors_m"].values():
        for cell in cells.values():
            assert f"{format_number(cell['value'])}; d = {cell['deflection']:.2f}" in words
    for text in (*record["assumptions"]["floor"], *record["assumptions"]["zero_alarm"]):
        assert f"- {text}" in words
    snapshot, raim = record["zero_alarm"]
    bound = zero_alarm_bounds(setup, SnapshotChi2(), draw_worlds(setup, 1))
    assert snapshot["free_m"] == pytest.approx(bound.free_m)
    assert snapshot["restricted_m"] == pytest.approx(bound.restricted_m, rel=1e-4)
    assert f"{snapshot['free_m']:.1f} {snapshot['restricted_m']:.1f} exact -" in words
    assert raim["free_m"] is raim["restricted_m"] is None
    assert "it excludes satellites or fixes" in raim["why"]
    divergence = record["divergence"]
    assert (divergence["spoofer"], divergence["holds"]) == ("ramp", True)
    for cell in divergence["bounds"].values():
        assert f"{cell['divergence']:.3g}" in words
        assert cell["value"] < record["floors_m"]["known"]["certain"]["value"]
    words = " ".join(call(*LINE, "--nominal", "--spoofer", "feedback").stdout.split())
    assert "feedback: there is no bound by divergence for a spoofer with the knowledge" in words
    asked = read(*LINE, "--false-alarms-per-hour", "20", "--detector", "never", "--json")
    assert asked["p_fa"] == run_probability(20.0, 25.0)
    (never,) = asked["zero_alarm"]
    assert (never["free_m"], never["kind"]) == ("unbounded", "exact")
    assert 0.0 < never["restricted_m"] < 20.0


def test_it_says_beforehand_how_long_the_floor_of_drawn_worlds_takes():
    result = call("limits", *SHORT, "--worlds", "2", "--set", 'domain={"turned_deg": [0, 360]}')
    assert result.exit_code == 0, result.output
    line = "floor of 2 worlds, each from switch-on on: some 1 min of a processor"
    assert line in result.stderr.splitlines()
    assert line not in result.stdout
    assert "floor of" not in call(*LINE).stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--env", "spoofgym/Snapshot-v0"], "limits are known for tightly coupled receivers alone"),
        (["--sensors", "maybe"], "constants 'maybe'; valid: known, unknown"),
        (["--figure", "floor.foo"], "unknown ending of a picture '.foo'; valid: "),
        (["--set", "domain={}", "--false-alarms-per-hour", "1000"], "valid: below 15.6 an hour"),
        (["--false-alarms-per-hour", "1", "--nominal"], "can't both be given"),
        (["--task", "T3", "--detector", "never"], "--detector can't be given with --task, which"),
    ],
)
def test_wrong_input(arguments, message):
    assert message in refused("limits", *arguments)
