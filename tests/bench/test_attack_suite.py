"""Whom every detector meets, and the search for the worst of them, within what it may play."""

import numpy as np
import pytest

from spoofgym.bench.runs.panel import play_searches
from spoofgym.bench.runs.play import make_bound_spoofer
from spoofgym.bench.runs.players import specify_spoofer
from spoofgym.bench.runs.record import MEASURES, Aim
from spoofgym.bench.runs.world import World
from spoofgym.bench.search import attack_suite
from spoofgym.envs.context import spoofer_context
from spoofgym.envs.factory import make_setup
from spoofgym.envs.spoofer_binding import SETUPS
from spoofgym.spoofers import SpooferContext, make_spoofer
from spoofgym.spoofers.base import sees_statistics
from spoofgym.spoofers.scaled import LARGEST, SMALLEST

from ..lazily import Lazily


@pytest.mark.parametrize("env", SETUPS)
def test_every_member_fits_every_victim_over_its_whole_range(env):
    setup = make_setup(SETUPS[env], {"detector": "never"})
    context = spoofer_context(setup)
    members = attack_suite.list_fitting_attacks(setup, context)
    letters = [member.letter for member in members]
    assert letters == sorted(letters), "members stand in the order of their letters"
    assert {*letters} == {*attack_suite.FAMILIES} - {*attack_suite.CURVES}
    assert len({member.player.label for member in members}) == len(members)
    seeing = set()
    for member in members:
        assert member.player.tuned
        grid = attack_suite.build_grid(member, context, 4)
        assert grid == sorted(set(grid))
        for value in (grid[0], grid[-1]):
            make_bound_spoofer(member.player.with_value(value), setup, 1)
        if sees_statistics(make_spoofer(member.player.with_value(1.0)).knowledge):
            seeing.add(member.letter)
    assert seeing == set(attack_suite.ORACLES)
    assert all("oracle" in attack_suite.FAMILIES[letter] for letter in attack_suite.ORACLES)


def test_every_member_fits_an_action_that_requests_less_than_the_limits():
    """As in the README's example, whose policies request at most 1 m/s."""
    settings = {"scenario": "zhong2025", "control": "rate", "basis": "rotated"}
    world = World.of(settings={**settings, "receiver": None, "timeline": None, "domain": None})
    assert world.context.largest_rate[1] < world.context.rate_limit_mps
    fitting = attack_suite.list_fitting_attacks(world.setup, world.context)
    assert "b" in {member.letter for member in fitting}


def test_the_digest_follows_the_members_and_profiles_are_smooth_and_within_the_limits():
    context = spoofer_context(make_setup(SETUPS["spoofgym/Zhong2025-v0"], {"detector": "never"}))
    members = attack_suite.list_suite_attacks(context)
    assert attack_suite.suite_digest(members) == attack_suite.suite_digest(
        attack_suite.list_suite_attacks(context)
    )
    longer = attack_suite.list_suite_attacks(context._replace(steps=2 * context.steps))
    assert attack_suite.suite_digest(members) not in (
        attack_suite.suite_digest(members[1:]),
        attack_suite.suite_digest(longer),
    )
    knot_s = context.steps * context.interval_s / 12.0
    for rates in (
        np.array(each.player.spec["rates_mps"]) for each in members if each.letter == "b"
    ):
        assert (rates >= 0.0).all()
        assert rates.max() <= context.rate_limit_mps
        assert np.diff(rates).max() / knot_s <= context.acceleration_limit_mps2


RUNS, FIRST = 120, MEASURES[0]


class FakePanel:
    """Runs at the onset, by formula; under twelve skies."""

    runs = RUNS

    def __init__(self):
        run = np.arange(RUNS)
        self.counts, self.sky = (run % 10 > 1)[:, None], run % 12
        self.context = spoofer_context(World().setup)

    def play(self, attacks, **_):
        return [attack for attack, _ in attacks]


PANEL = Lazily(FakePanel)


class Halving(attack_suite.WorstAttacks):
    by_skies = attack_suite.FamilyAttacks.by_skies
    neighbours, rounds = attack_suite.FamilyAttacks.neighbours, attack_suite.FamilyAttacks.rounds


def member(letter, **spec):
    return attack_suite.SuiteAttack(letter, specify_spoofer(spec))


MEMBERS = (
    member("a", name="ramp", rate_mps="tuned"),
    member("h", name="dash", rate_mps="tuned", last_s=5.0),
)
CURVE = member("c", name="profile", rates_mps=[0.1, 0.2], amplitude="tuned")


@pytest.fixture
def found_by(monkeypatch):
    """Search where a function of spec and number of runs says what an attack displaces."""

    def found(moved, limits=(), kind=attack_suite.WorstAttacks, attacks=MEMBERS):
        monkeypatch.setattr(
            attack_suite.WorstAttacks,
            "measure",
            lambda self, panel, attack: moved(attack.spec, attack.runs),
        )
        search = kind(PANEL, 0, attacks, attack_suite.Selection(runs=RUNS, sift_runs=36, values=9))
        axes = ("east_rate", "north_rate")
        search.context = SpooferContext(1, 0.5, 40, "rate", 1.0, 10.0, axes)
        (winners,) = play_searches(search.panel, [(0, search.winners([*limits]))])
        return search, winners

    return found


def test_each_aim_has_its_worst_attack(found_by):

    def moved(spec, runs):
        run, rate = np.arange(runs), spec["rate_mps"]
        if spec["name"] == "ramp":
            size = 50.0 * np.exp(-abs(np.log(rate / 0.3))) + np.zeros(runs)
        else:
            size = np.where(run % 12 == 7, 500.0 * np.exp(-abs(np.log(rate / 2.0))), 1.0)
        return {FIRST: size, "undetected_total_m": size + 1.0}

    search, found = found_by(moved, [40.0, 200.0])
    by_aim = {aim: (MEMBERS[m].letter, value) for (m, value), aims in found.items() for aim in aims}
    assert by_aim[Aim(FIRST, 0.5)] == ("a", pytest.approx(0.3, rel=0.25))
    # a twelfth of the runs is more than 5 %
    assert by_aim[Aim(FIRST, 0.05)] == ("h", pytest.approx(2.0, rel=0.25))
    assert by_aim[Aim(FIRST, limit_m=40.0)][0] == "a"
    assert by_aim[Aim(FIRST, limit_m=200.0)][0] == "h"
    # the tenth of twelve skies is two of them, by the attack that is worst in half of the runs
    assert len(search.skies) == 2
    assert Aim(FIRST, 0.5, skies=True) in by_aim
    # what is tried next to a winner plays with it, for the interval alone
    beside = [key for key, aims in found.items() if not aims]
    best = [key for key, aims in found.items() if Aim(FIRST, 0.5) in aims]
    assert {m for m, _ in beside} == {0, 1}
    assert min(v for m, v in beside if m == 0) < best[0][1] < max(v for m, v in beside if m == 0)
    # runs that do not count choose nobody
    assert search.counts[:12].tolist() == [False, False, *[True] * 8, False, False]


@pytest.mark.parametrize("peak", [0.11, 4.3, np.inf])
def test_a_found_curve_is_played_beyond_its_range_while_that_is_worse(found_by, peak):
    played = []

    def moved(spec, runs):
        played.append(spec["amplitude"])
        value = spec["amplitude"]
        return {FIRST: (value if np.isinf(peak) else min(value, peak**2 / value)) + np.zeros(runs)}

    _, found = found_by(moved, attacks=(CURVE,))
    ((_, value),) = (key for key, aims in found.items() if aims)
    low, high = attack_suite.AMPLITUDE_RANGE
    assert (min(played) < 0.99 * low, max(played) > 1.01 * high) == (peak < low, peak > high)
    assert SMALLEST <= min(played) <= max(played) <= LARGEST
    assert value == pytest.approx(min(peak, 0.9 * LARGEST), rel=0.1)


@pytest.mark.parametrize("width", [1.03, 1.3])
def test_what_just_passes_an_alert_limit_is_found_between_values_of_the_grid(found_by, width):
    missed = 0
    for limit_m in np.geomspace(8.0, 80.0, 5):
        played, aim = {}, Aim(FIRST, limit_m=limit_m)

        def moved(spec, runs, limit_m=limit_m, played=played):
            run, rate = np.arange(runs), spec["rate_mps"]
            size = 100.0 * rate * (1.0 + 0.02 * np.sin(run)) * (spec["name"] == "ramp")
            unnoticed = (run % 4 == 0) & (100.0 * rate < width * limit_m)
            found = np.where(unnoticed | (size < 0.9 * limit_m), size, 0.0)
            return {FIRST: played.setdefault((runs, spec["name"], rate), found)}

        scores = []
        for kind in (Halving, attack_suite.WorstAttacks):
            search, found = found_by(moved, [limit_m], kind)
            ((attack, value),) = (key for key, aims in found.items() if aim in aims)
            assert MEMBERS[attack].letter == "a" or kind is attack_suite.WorstAttacks
            moves = played[RUNS, MEMBERS[attack].player.spec["name"], value][search.counts]
            scores.append(aim.score_displacement(moves))
        # of the quarter that is not caught, all with the wide range, and most with the narrow one
        silent = (np.arange(RUNS) % 4 == 0)[search.counts].mean()
        fine, coarse = scores
        assert fine == pytest.approx(silent, abs=0.01) if width > 1.1 else fine > 0.5 * silent
        missed += coarse < 0.5 * silent
    assert missed > 1  # which values of the grid alone do not do
