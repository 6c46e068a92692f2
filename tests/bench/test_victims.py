"""The benchmark of the small victims: scores, detectors that fit, settings, and what is refused."""

import json
import re

import numpy as np
import pytest

from spoofgym.bench import Suite, Tuning, run_campaign, summarize
from spoofgym.bench.experiments.campaign import describe_knowledge
from spoofgym.bench.report.campaign import list_limit_notes
from spoofgym.bench.report.campaign_page import build_page
from spoofgym.bench.report.page import render_page
from spoofgym.bench.runs.episode import TWIN, play_episode
from spoofgym.bench.runs.play import WarmStart, induced_error, make_bound_spoofer, play
from spoofgym.bench.runs.record import compute_displacement
from spoofgym.bench.scores.campaign import HALF, STEALTHY
from spoofgym.detectors import Ewma
from spoofgym.envs import SpoofCore

from ..nightly import heavy
from .support import RAMP

LOOSE, SNAPSHOT, ROBOT = SMALL = (
    "spoofgym/LooselyCoupled-v0",
    "spoofgym/Snapshot-v0",
    "spoofgym/WheeledRobot-v0",
)
TIGHT = "spoofgym/Zhong2025-v0"
PUSH = {"name": "ramp", "rate_mps": 0.5}


def suite_of(env, **changes):
    settings = {
        "env": env,
        "timeline": {"warmup_s": 12.0, "live_s": 4.0, "attack_s": 12.0, "time_to_alert_s": 3.0},
        "spoofers": (PUSH,),
        "runs": 6,
        "tuning": Tuning(runs=9, sift_runs=2, values=3, refined=2, budget=0.3),
        **changes,
    }
    return Suite(**settings)


@pytest.mark.parametrize("env", heavy(SMALL, LOOSE))
def test_a_campaign_is_scored_tabled_and_drawn(env, tmp_path):
    suite = suite_of(env, spoofers=("step", RAMP))
    suite.check_fit()
    folder = run_campaign(suite, tmp_path, threads=1)
    summary = summarize(folder)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    judges = [entry.label for entry in suite.detector_players]
    assert [row["detector"] for row in summary["detectors"]] == judges
    for judge in judges:
        none, step, ramp = (
            folder.runs(judge, name).records["undetected_displacement_m"]
            for name in ("none", "step", "ramp(tuned)")
        )
        assert not none.any()
        assert (step >= 0.0).all()
        assert ramp.mean() > 0.0
    text = render_page(build_page(folder, summary)).replace("<wbr>", "")
    assert f"<dt>env</dt><dd>{env}</dd>" in text
    assert "nan" not in text
    # and without limits it says why
    (notes,) = list_limit_notes(summary)
    assert notes.startswith("Floor: none, since no limit is known for ")
    assert f"No zero-alarm bound of {', '.join(judges)}: no limit is known" in text
    for row in summary["detectors"]:
        assert row["bracket"]["floor_m"] == {STEALTHY: None, HALF: None}
        assert "no limit is known for" in row["bracket"]["zero_alarm"]["why"]


DOMAIN = {
    "detectors": (Ewma(false_alarm=0.02),),
    "domain": {"start_s": (0.0, 30.0), "turned_deg": (0.0, 360.0), "worlds": 2},
}


@pytest.mark.parametrize(
    ("env", "between", "changes"),
    [
        (SNAPSHOT, "linear", {}),
        (TIGHT, "linear", DOMAIN),
        pytest.param(TIGHT, "hold", DOMAIN, marks=pytest.mark.nightly),
        pytest.param(LOOSE, "linear", {}, marks=pytest.mark.nightly),
        pytest.param(ROBOT, "linear", {}, marks=pytest.mark.nightly),
    ],
)
def test_a_cell_scores_what_the_environment_pays_and_a_run_is_that_of_the_campaign(
    env, between, changes
):
    pace = {"decision_interval_s": 2.0, "between": between}
    suite = suite_of(env, target_heading_deg="worst", **pace, **changes)
    judge, player = suite.detector_players[-1], suite.spoofer_players[-1]
    setup = suite.setup(judge)
    start = WarmStart(setup, suite.generators("evaluation", 5), threads=1)
    attacked, clean = play(start, PUSH), play(start, "none")
    assert not changes or len(set(attacked.onset)) > 2
    own = {"action": "full-command"} if changes else {}
    core = SpoofCore(5, setup, knowledge="blind", end_at_alarm=False, threads=1, twin=True, **own)
    core.reset(suite.generators("evaluation", 5))
    spoofer, *_ = make_bound_spoofer(PUSH, setup, 5)
    for _ in range(core.episode_steps):
        result, _ = core.step(spoofer.act(core.observe()))
    scored = compute_displacement(setup, attacked, clean)
    assert scored.max() > 0.1
    np.testing.assert_allclose(
        result.info["undetected_displacement_m"], scored, rtol=1e-9 if changes else 1e-4, atol=1e-6
    )
    episode = play_episode(suite.world, judge, player, run=2)
    np.testing.assert_array_equal(episode.alarm[episode.onset :, 0], attacked.alarm[:, 2])
    np.testing.assert_array_equal(episode.alarm[episode.onset :, TWIN], clean.alarm[:, 2])
    induced = induced_error(setup, attacked, clean)[:, 2]
    np.testing.assert_allclose(episode.induced_error_m, induced, atol=1e-6)
    assert episode.summary()["scenario"] == setup.name


def test_a_heading_of_a_snapshot_leaves_down_and_clock_alone():
    suite = suite_of(SNAPSHOT)
    spoofer, *_ = make_bound_spoofer(PUSH, suite.setup(suite.detector_players[0]), 1)
    action = spoofer.act(np.zeros((1, 0), dtype=np.float32))
    np.testing.assert_allclose(action, [[0.0, 0.1, 0.0, 0.0]], atol=1e-12)


def test_no_spoofer_of_another_environment_plays_unasked():
    suite = suite_of(ROBOT, spoofers=None)
    labels = [entry.label for entry in suite.spoofer_players]
    assert labels == ["none", "step", "ramp(tuned)", "accelerating-ramp(tuned)", "open-loop"]
    assert suite.left_out == ()
    asked = suite_of(ROBOT, spoofers=("ewma-profile",))
    judge = asked.detector_players[0]
    told = describe_knowledge(asked.spoofer_players[1], asked.setup(judge), judge)
    assert told["transfer"] == ["environment"]


LONG = {"name": "windowed-chi2", "window": 500}


@pytest.mark.parametrize(
    ("env", "detector", "message"),
    [
        (LOOSE, "ewma", "Ewma measures satellites, but the receiver measures position"),
        (SNAPSHOT, "acna", "Acna needs gnss_position, which a snapshot receiver does not have"),
        (ROBOT, LONG, "WindowedChi2 can't alarm in its first 499 epochs, and an episode has 19"),
        (TIGHT, "rio", "Rio needs auxiliary_position, gnss_position, which a tightly coupled rec"),
    ],
)
def test_detectors_that_do_not_fit_are_refused(env, detector, message):
    suite = suite_of(env, detectors=(detector,))
    (entry,) = suite.detector_players
    text = f"detector {entry.label} in {env}: {message}"
    with pytest.raises(ValueError, match=f"^{re.escape(text)}"):
        suite.check_fit()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"settings": {"sats": 8}}, "Snapshot-v0 has no setting 'sats', got 8; valid: t"),
        ({"settings": {"timeline": {}}}, "`settings` has 'timeline', which is given by name, too"),
        ({"settings": {"speed_mps": None, "heading_deg": "n"}}, "must be a finite number, got 'n'"),
        (
            {"settings": {"rate_limit_mps": [1.0, 1.0, 1.0, 9.0]}},
            r"one limit of the rate .* got \(1.0, 1.0, 1.0, 9.0\)",
        ),
    ],
)
def test_wrong_settings_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        suite_of(**{"env": SNAPSHOT, **changes}).check_fit()
