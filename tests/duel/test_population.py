"""Payoffs of populations on paired runs, what is kept of them, and what is refused."""

import json

import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.bench.experiments import game as population
from spoofgym.bench.experiments.game import Game
from spoofgym.bench.experiments.runner import Context
from spoofgym.bench.report.catalogue import find_card
from spoofgym.bench.runs.play import play
from spoofgym.bench.runs.players import make_player, mixture
from spoofgym.bench.runs.record import compute_displacement, mask_valid_runs
from spoofgym.bench.scores.matrix_game import RunPayoff
from spoofgym.detectors import make_detector
from spoofgym.policies import list_shipped, load_card
from spoofgym.simulation.setup import SPLITS
from spoofgym.spoofers import Ramp, make_spoofer
from spoofgym.spoofers.learned import ModelPolicy

from ..detectors.learned.files import edit_card, write_guard
from .support import BRIEF, SHORT

NOMINAL = {"thresholds": "nominal"}
CHI2 = {"name": "snapshot-chi2", **NOMINAL}
CUSUM = {"name": "cusum", "signals": "range_rate", **NOMINAL}
SHARP = {"name": "snapshot-chi2", "signals": "range_rate", "false_alarm": 0.003, **NOMINAL}
EWMA = {"name": "ewma", **NOMINAL}
"""It takes weight off measurements."""
DETECTORS = [CHI2, CUSUM, SHARP, EWMA]
RAMP = {"name": "ramp", "rate_mps": 0.2}
SPOOFERS = ["none", RAMP, {"name": "ramp", "rate_mps": 0.8}, "feedback"]
MINE = make_player(RAMP, "spoofer", label="my")
RUNS = 6


def game(**settings):
    return Game(
        **{"limit_m": 5.0, "runs": RUNS, "scenario": "zhong2025", "timeline": SHORT, **settings}
    )


@pytest.fixture(scope="module")
def played():
    found = game()
    return found, found.matrix(SPOOFERS, DETECTORS, oracles=True)


def test_a_shared_pass_equals_separate_ones_to_the_last_bit(played):
    found, matrix = played
    pairs = found.pairs(SPOOFERS, DETECTORS, oracles=True)
    for j, detector in enumerate(matrix.detectors):
        panel = pairs._panel([detector], True, Context())
        start, (twin,) = panel.start, panel.clean
        assert np.array_equal(
            matrix.counts[j], mask_valid_runs(start.warmup_alarm, twin.first_alarm)
        )
        for i, spoofer in enumerate(matrix.spoofers):
            runs = play(start, spoofer.fixed_spec)
            moved = compute_displacement(start.setup, runs, twin)
            assert np.array_equal(matrix.displacement[i, j], moved)
            assert np.array_equal(matrix.alarmed[i, j], runs.first_alarm > 0)


def test_all_entries_have_the_same_runs_and_a_mixture_is_worth_its_members_average(played):
    _, matrix = played
    never_alarm = [j for j in range(2) if not matrix.alarmed[1, j].any()]
    assert never_alarm == [0, 1]  # so that the next line is about two detectors
    assert np.array_equal(matrix.displacement[1, 0], matrix.displacement[1, 1])
    assert len(np.unique(matrix.displacement[1, 0])) == RUNS  # and about runs that differ
    np.testing.assert_array_equal(matrix.values[0], 0.0)  # nothing is paid for nothing
    assert 0.1 < matrix.values[1:].max() <= 1.0
    assert "'feedback'" in repr(matrix)
    assert "array" not in repr(matrix)
    # a difference of two detectors that never alarm is paired
    same = np.zeros(matrix.values.shape)
    same[1, 0], same[1, 1] = 1.0, -1.0
    assert matrix.contrast(same) == (0.0, 0.0, 0.0)
    spread = matrix.spread(50).value
    assert 0.0 <= spread.low <= spread.value <= spread.high <= 1.0
    # a part of the matrix has the entries of the whole
    part = game().matrix([SPOOFERS[1]], [DETECTORS[2]])
    np.testing.assert_array_equal(part.displacement[0, 0], matrix.displacement[1, 2])
    np.testing.assert_allclose(part.values, matrix.values[1:2, 2:3])
    fewer = game(runs=RUNS - 2).matrix([SPOOFERS[1]], [DETECTORS[2]])
    np.testing.assert_array_equal(fewer.displacement[0, 0], matrix.displacement[1, 2, : RUNS - 2])
    found, matrix = played
    who = mixture("half", [matrix.spoofers[1], matrix.spoofers[2]], [1.0, 1.0])
    whom = mixture("third", [matrix.detectors[0], matrix.detectors[2]], [1.0, 2.0])
    mixed = found.matrix([who, RAMP], [whom, CHI2])
    expected = matrix.values[1:3][:, [0, 2]] @ [1 / 3, 2 / 3]
    np.testing.assert_allclose(mixed.values[0, 0], expected.mean())
    np.testing.assert_allclose(mixed.values[1, 0], expected[0])
    named = found.matrix([{"none": 1.0, "ramp": 3.0}], [CHI2])
    assert named.spoofers[0].label == "1 none + 3 ramp"
    assert named.rows.tolist() == [[0.25, 0.75]]
    with pytest.raises(ValueError, match="mix strategies that are mixes"):
        mixed.mixes(mixed.solve())


def test_payoffs_need_no_budget_and_a_task_brings_its_world_and_its_alert_limit():
    moved = np.array([0.0, 2.0, 9.0, 9.0])
    alarmed = np.array([False, False, False, True])
    stealth, hmi = RunPayoff("stealth", 8.0), RunPayoff("hmi", 8.0)
    np.testing.assert_array_equal(stealth.worth(moved, alarmed), [0.0, 0.25, 1.0, 0.0])
    np.testing.assert_array_equal(hmi.worth(moved, alarmed), [0.0, 0.0, 1.0, 1.0])
    found = Game("T3")
    assert (found.payoff.limit_m, found.setup.name) == (20.0, "trolley")
    for task, limit_m, words in (("T1", None, "limit_m"), ("T3", 0.0, r"limit_m.*got 0")):
        with pytest.raises(ValueError, match=words):
            Game(task, limit_m=limit_m)


def test_an_equilibrium_is_a_pool_for_both_sides_and_an_oracle_is_marked(played):
    _, matrix = played
    spoofers, detectors = matrix.mixes(matrix.solve())
    pool = json.loads(json.dumps(detectors.pool()))
    assert len(make_detector(pool).judges) == len(detectors.members)
    given = json.loads(json.dumps(spoofers.pool()))
    view = duel_v0.DetectorView(**given, **BRIEF, target_heading_deg=90.0)
    view.reset(seed=1)
    view.close()
    assert json.dumps(matrix.as_json(), allow_nan=False)
    assert sum(spoofers.weights) == pytest.approx(1.0)
    assert matrix.seeds in detectors.decided_on
    found, matrix = played
    told = [each.get("knowledge") for each in matrix.as_json()["spoofers"]]
    assert told == ["blind", "blind", "blind", "oracle"]
    with pytest.raises(ValueError, match=r"feedback: an oracle.*`oracles=True` \(--oracles\)"):
        found.matrix(SPOOFERS, [CHI2])
    assert found.matrix(["none", "feedback"], [CHI2]).values.shape == (2, 1)


def test_what_is_finished_is_not_played_again_and_is_the_same(tmp_path, monkeypatch, played):
    _, matrix = played
    game(folder=tmp_path).matrix(SPOOFERS[:2], DETECTORS)
    grown = game(folder=tmp_path).matrix(SPOOFERS, DETECTORS, oracles=True)
    np.testing.assert_array_equal(grown.values, matrix.values)
    monkeypatch.setattr(population, "Panel", None)
    again = game(folder=tmp_path).matrix(SPOOFERS, DETECTORS, oracles=True)
    assert again.as_json() == matrix.as_json()


def test_other_runs_are_other_cells_and_another_world_another_experiment():
    def pairs(**settings):
        return game(**settings).pairs([RAMP], [CHI2])

    same = pairs(payoff="hmi", limit_m=9.0)  # how runs are paid changes none of them
    others = [pairs(entropy=1), pairs(split="evaluation"), pairs(runs=RUNS + 1)]
    assert len({each.key for found in (same, *others) for each in found.cells()}) == 4
    assert [*same.cells()] == [*pairs().cells()]
    assert all(each.config == same.config for each in others)
    assert pairs(timeline={**SHORT, "attack_s": 20.0}).config != same.config


def test_objects_play_and_leave_nothing_in_the_folder(tmp_path):
    found = game(folder=tmp_path)
    model = ModelPolicy(lambda seen: np.full((len(seen), 1), 0.1), label="mine", knowledge="blind")
    matrix = found.matrix([Ramp(rate_mps=0.2), model], [CHI2])
    assert [each.label for each in matrix.spoofers] == ["ramp(rate_mps=0.2)", "mine"]
    assert len(list(tmp_path.glob("cells/*.npz"))) == 1  # a ramp can be described, a function can't
    with pytest.raises(TypeError, match="mine"):
        mixture("mix", matrix.spoofers, [1.0, 1.0]).pool()


def test_nobody_is_scored_on_runs_that_decided_on_it(played):
    found, matrix = played
    chosen = make_player(RAMP, "spoofer", label="chosen", decided_on=[(0, "game")])
    for fresh in (found.on("evaluation"), found.on("game", entropy=1)):
        assert fresh.seeds not in chosen.decided_on
    mix, _ = matrix.mixes(matrix.solve())
    guard = make_player(CHI2, "detector", decided_on=[(0, "game")])
    for spoofer, detector, words in (
        (chosen, CHI2, "trained or chosen on the runs"),
        (mix, CHI2, "spoofers' mix was trained or chosen"),
        (RAMP, mixture("mix", [guard], [1.0]), "trained or chosen"),
    ):
        with pytest.raises(ValueError, match=words):
            found.matrix([spoofer], [detector], oracles=True)


def test_what_is_shipped_says_by_its_card_what_decided_on_it(played, monkeypatch, tmp_path):
    found, _ = played
    for name in list_shipped():
        decided_on = find_card(name).decided_on
        assert decided_on
        assert {split for _, split in decided_on} <= {*SPLITS}
    learned = make_player("hidden-pool-ppo", "spoofer", decided_on=[(4, "search")])
    with pytest.raises(ValueError, match="trained or chosen on the runs of the split 'training'"):
        found.on("training").matrix([learned], [CHI2])
    profile = make_player("ewma-profile", "spoofer").spec
    trained, seen = (0, "training"), (0, "evaluation")
    sets = [(0, "dataset-train"), (0, "dataset-validation")]
    path = write_guard(tmp_path)
    edit_card(path, training={"decided_on": sets})
    guard = {"name": str(path), "threshold": 0.5}
    for side, given, seeds in (
        ("spoofer", profile, [trained]),
        ("spoofer", make_spoofer("ewma-profile"), [trained]),
        ("spoofer", learned.spec, [trained, seen]),
        ("spoofer", {"name": "hidden-pool-ppo", "amplitude": 0.5}, [trained, seen]),
        ("spoofer", {**profile, "rates_mps": [0.0, 0.1]}, []),
        ("detector", guard, sets),
        ("detector", {"name": "pool", "members": [CHI2, guard]}, sets),
        ("detector", CHI2, []),
    ):
        assert make_player(given, side).decided_on == {*seeds}
    assert learned.decided_on == {trained, seen, (4, "search")}
    card = load_card("ewma-profile")
    for wrong in (3, ["training"], [[0]], [["x", "training"]], [[0.9, "training"]], [[-1, "tr"]]):
        told = card.model_copy(update={"training": {"decided_on": wrong}})
        with pytest.raises(ValueError, match=r"card of 'ewma-profile'.*pairs of an entropy"):
            _ = told.decided_on
    monkeypatch.setattr(type(card), "decided_on", frozenset({(0, "trial")}))
    with pytest.raises(ValueError, match="unknown split 'trial'; valid: training"):
        make_player("ewma-profile", "spoofer")


@pytest.mark.parametrize(
    ("spoofers", "detectors", "words"),
    [
        ([], [CHI2], "at least one strategy"),
        ([RAMP], [], "at least one strategy"),
        (["rmap"], [CHI2], "ramp"),
        ([{"ramp": -1.0}], [CHI2], "weights"),
        ([{}], [CHI2], "at least one member"),
        ([{"name": "ramp", "rate_mps": "tuned"}], [CHI2], "fit"),
        (["open-loop"], [CHI2], "fit"),
        ([RAMP], ["oracle-ramp"], "oracle"),
        ([RAMP], ["no-such.onnx"], "no-such.onnx"),
        ([RAMP], [{"name": "pool", "members": [CHI2, "guard.zip"]}], "guard.zip is a pickled file"),
        (
            [MINE, make_player("ramp", "spoofer", label="my")],
            [CHI2],
            "two spoofers are called 'my'",
        ),
        ([RAMP], [MINE], "is a spoofer, and no detector"),
    ],
)
def test_bad_members_are_named(spoofers, detectors, words):
    with pytest.raises((ValueError, OSError), match=words):
        game().matrix(spoofers, detectors)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"limit_m": None}, "limit_m"),
        ({"limit_m": -1.0}, "limit_m"),
        ({"split": "calibration"}, "split"),
        ({"payoff": "gold"}, "must be 'stealth' or 'hmi', got 'gold'"),
        ({"speed": 1.0}, "speed"),
        ({"task": "T3"}, "can't be given with task T3"),
    ],
)
def test_bad_games_are_refused(settings, words):
    with pytest.raises((ValueError, TypeError), match=words):
        game(**settings)


def test_a_detector_that_leaves_no_run_has_no_payoff():
    matrix = game().matrix([RAMP], [CHI2, {"name": "snapshot-chi2", "threshold_scale": 1e-9}])
    assert np.isnan(matrix.values).tolist() == [[False, True]]
    with pytest.raises(ValueError, match=r"ramp\(rate_mps=0.2\) against snapshot-chi2.*no payoff"):
        matrix.solve()
