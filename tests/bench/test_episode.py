"""One run looked at closely is the run of the campaign."""

import json
import math

import numpy as np
import pytest

from spoofgym.bench.report.figures import play_frames
from spoofgym.bench.runs.episode import TWIN, alarm_intervals, draw_episode, play_episode
from spoofgym.bench.runs.play import WarmStart, induced_error, play
from spoofgym.bench.runs.record import compute_displacement
from spoofgym.detectors import Ewma
from spoofgym.simulation.monitors import PastPositions
from spoofgym.spoofers import Ramp

from .support import small_suite

SPOOFER = {"name": "ramp", "rate_mps": 0.4}


@pytest.fixture(scope="module")
def suite():
    return small_suite(detectors=("ewma",), spoofers=(SPOOFER,))


@pytest.fixture(scope="module")
def episode(suite):
    return play_episode(suite.world, suite.detector_players[0], suite.spoofer_players[1], run=3)


def test_it_is_the_run_of_that_number_with_the_intervals_of_its_alarms(suite, episode):
    setup = suite.setup(suite.detector_players[0])
    start = WarmStart(setup, suite.generators("evaluation", 5), threads=1)
    attacked, clean = play(start, SPOOFER), play(start, "none")
    onset = episode.onset
    np.testing.assert_array_equal(episode.alarm[onset:, 0], attacked.alarm[:, 3])
    np.testing.assert_allclose(episode.induced_error_m, induced_error(setup, attacked, clean)[:, 3])
    summary = episode.summary()
    expected = compute_displacement(setup, attacked, clean)[3]
    assert summary["undetected_displacement_m"] == pytest.approx(expected, abs=1e-4)
    assert summary["warmup_alarm"] == start.warmup_alarm[3]
    assert summary["peak_ratio"] == pytest.approx(attacked.peak[3], abs=1e-4)
    # the twin is not attacked
    np.testing.assert_array_equal(episode.ratio[:onset, 0], episode.ratio[:onset, TWIN])
    assert episode.time[onset - 1] == 0.0
    assert np.abs(episode.error_n[:, TWIN, :2]).max() < 10.0
    assert episode.displacement[-1, 1] > 5.0
    # a number may be one of NumPy
    again = play_episode(suite.world, episode.detector, episode.spoofer, run=np.int64(3))
    assert json.dumps(again.summary()) == json.dumps(summary)
    with pytest.raises(ValueError, match="`run` must be a whole number of at least 0, got -1"):
        play_episode(suite.world, episode.detector, episode.spoofer, run=-1)
    assert episode.intervals == alarm_intervals(episode.alarm[:, 0], episode.time)
    told = episode.summary()["spoofing_intervals_s"]
    assert [onset for onset, _ in told] == [onset for onset, _ in episode.intervals]


def test_it_can_be_drawn(tmp_path):
    some = {"detectors": (Ewma(false_alarm=0.5),), "spoofers": ("step",)}
    suite = small_suite(**some, attack="per-channel")
    drawn = play_episode(suite.world, suite.detector_players[0], suite.spoofer_players[1])
    assert drawn.summary()["alarm"]
    written = draw_episode(drawn, tmp_path / "new" / "picture")
    assert written == tmp_path / "new" / "picture.png"
    assert written.stat().st_size > 10_000


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("......", []),
        ("x.x.x.", [(0.0, 0.5), (1.0, 1.5), (2.0, 2.5)]),
        ("x..xx", [(0.0, 0.5), (1.5, math.inf)]),
        ("xx", [(0.0, math.inf)]),
    ],
)
def test_an_interval_is_from_the_first_alarm_to_the_first_epoch_without(text, found):
    alarm = np.array([letter == "x" for letter in text])
    assert alarm_intervals(alarm, 0.5 * np.arange(len(text))) == found


def test_a_spoofer_of_a_campaign_sees_what_the_victim_reports(monkeypatch, episode):
    monkeypatch.setattr(Ramp, "knowledge", "blind+reported")
    reported = small_suite(detectors=("ewma",), spoofers=(SPOOFER,))
    reported.check_fit()
    judge, none, ramp = (*reported.detector_players, *reported.spoofer_players)
    assert [type(each) for each in reported.setup(judge).monitors] == [PastPositions]
    assert reported.setup(judge, [none]).monitors == ()
    again = play_episode(reported.world, judge, ramp, run=3)
    assert json.dumps(again.summary()) == json.dumps(episode.summary())
    assert len(list(play_frames(reported, judge, ramp, every=1000))) == 2
