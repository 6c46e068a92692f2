"""Best responses, chosen on runs of their own, and both ends of the exploitability."""

import json

import numpy as np
import pytest

from spoofgym.bench.experiments.best_response import (
    AttackBudget,
    best_detector,
    best_spoofer,
    exploitability,
    upper_end,
)
from spoofgym.bench.experiments.game import Game
from spoofgym.bench.runs.players import make_player, mixture
from spoofgym.bench.search.open_loop import OpenLoopSearch

from .test_population import CHI2, EWMA, NOMINAL, RAMP, SHARP, SHORT

SEPARATION = {"name": "solution-separation", **NOMINAL}
SEARCH = OpenLoopSearch(runs=8, batch=4, knots=4, population=4, generations=1)
BUDGET = AttackBudget(runs=6, sift_runs=3, values=4, kept=3, blind=SEARCH)


def game(**settings):
    small = {"limit_m": 5.0, "runs": 6, "scenario": "zhong2025", "timeline": SHORT}
    return Game(**{**small, **settings})


def mix_of(side, *specs):
    members = [make_player(spec, side) for spec in specs]
    return mixture(f"{side}s", members, np.ones(len(members)))


@pytest.fixture(scope="module")
def asked():
    given = make_player({"name": "ramp", "rate_mps": 0.01}, "spoofer", label="slow")
    warm = make_player({"name": "profile", "rates_mps": [0.0, 0.1, 0.4]}, "spoofer", label="curve")
    return {"given": [given], "warm": [warm], "label": "new", "entropy": 3}


@pytest.fixture(scope="module")
def answered(asked):
    mix = mix_of("detector", SHARP, SEPARATION)
    return mix, best_spoofer(game(), mix, BUDGET, **asked)


def test_a_response_is_the_best_of_all_families_and_not_scored_on_the_runs_that_chose_it(answered):
    mix, found = answered
    assert {"slow", "ramp", "accelerating-ramp", "feedback", "open-loop"} <= set(found.best)
    assert set(found.best) == set(found.by_family)
    assert found.value > found.best["slow"]
    assert found.member.label.startswith("new: ")
    assert json.dumps(found.as_json(), allow_nan=False)
    assert found.member.decided_on == {(3, "selection"), (3, "search")}
    with pytest.raises(ValueError, match="trained or chosen on"):
        game(split="selection", entropy=3).matrix([found.member], [mix], oracles=True)
    fresh = game(split="evaluation").matrix([found.member, RAMP], [mix], oracles=True)
    assert np.isfinite(fresh.values).all()


def test_the_same_budget_finds_the_same_response(asked, answered):
    mix, found = answered
    assert best_spoofer(game(), mix, BUDGET, **asked) == found
    digest = BUDGET.as_json()["digest"]
    learned = AttackBudget(further={"ppo_steps": 8}).as_json()
    assert learned["further"] == {"ppo_steps": 8}
    assert AttackBudget(**vars(BUDGET)).as_json()["digest"] == digest
    assert len({digest, learned["digest"], AttackBudget().as_json()["digest"]}) == 3


def test_without_oracles_and_a_search_no_such_spoofer_answers():
    wins = make_player({"name": "ramp", "rate_mps": 0.4}, "spoofer", label="mine")
    few = AttackBudget(runs=3, sift_runs=2, values=2, kept=1, blind=SEARCH, oracles=False)
    found = best_spoofer(game(), mix_of("detector", EWMA), few, entropy=5, given=[wins])
    assert {each.knowledge for each in found.by_family.values()} == {"blind"}
    assert not {"feedback", "open-loop"} & {*found.best}
    (note,) = found.notes
    assert note.startswith("the search for optimized open-loop attacks is without ewma")
    assert note.endswith(": it takes weight off measurements")
    # what was given was chosen on these runs, too
    assert found.by_family["mine"].decided_on == {(5, "selection"), (5, "search")}
    assert found.by_family["mine"].spec == wins.spec


def test_the_best_detector_concedes_the_least_and_what_a_side_gains_is_paired():
    detectors = [make_player(spec, "detector") for spec in (CHI2, SHARP, SEPARATION)]
    mix = mix_of("spoofer", {"name": "ramp", "rate_mps": 0.8})
    found = best_detector(game(), mix, detectors, runs=6, entropy=0)
    assert found.value == min(found.best.values()) < max(found.best.values())
    assert found.member in detectors
    spoofers, detectors = mix_of("spoofer", RAMP), mix_of("detector", SHARP, SEPARATION)
    fresh = game(split="evaluation")
    fast = make_player({"name": "accelerating-ramp"}, "spoofer")
    same = exploitability(fresh, spoofers, detectors, spoofers.members[0], detectors.members[0])
    assert same.spoofer.below == (0.0, 0.0, 0.0)
    found = exploitability(fresh, spoofers, detectors, fast, detectors.members[1])
    matrix = fresh.matrix([spoofers, fast], [detectors, detectors.members[1]])
    (value, conceded), (got, _) = matrix.values
    assert found.value.value == pytest.approx(value)
    assert found.spoofer.below.value == pytest.approx(got - value)
    assert found.detector.below.value == pytest.approx(value - conceded)
    assert found.below.value == pytest.approx(got - conceded)
    assert json.dumps(found.as_json(), allow_nan=False)


def test_the_upper_end_is_the_bounds_weighted_by_the_mix():
    found = game(limit_m=100.0)
    one, why = upper_end(found, mix_of("detector", SEPARATION))
    assert 0.0 < one < 1.0
    assert "solution-separation" in why
    other, _ = upper_end(found, mix_of("detector", SHARP))
    both, _ = upper_end(found, mix_of("detector", SEPARATION, SHARP))
    assert both == pytest.approx((one + other) / 2)
    all_of_it, why = upper_end(game(limit_m=1e-3), mix_of("detector", SEPARATION))
    assert (all_of_it, why.endswith("so that they say nothing")) == (1.0, True)
    # nobody exceeds it
    spoofers = [{"name": "accelerating-ramp", "acceleration_mps2": a} for a in (0.01, 0.03, 0.05)]
    assert found.matrix(spoofers, [SEPARATION]).values.max() <= one
    bound, why = upper_end(game(), mix_of("detector", SEPARATION, EWMA))
    assert bound is None
    assert why.startswith("ewma")
    assert why.endswith(" has no bound: it takes weight off measurements")
    with pytest.raises(ValueError, match="detectors"):
        upper_end(game(), mix_of("spoofer", RAMP))
