"""Whom every detector meets."""

import numpy as np
import pytest

from spoofgym.bench.runs.play import make_bound_spoofer
from spoofgym.bench.runs.world import VICTIMS
from spoofgym.bench.search.attack_suite import (
    FAMILIES,
    ORACLES,
    build_grid,
    list_fitting_attacks,
    list_suite_attacks,
    suite_digest,
)
from spoofgym.envs.factory import make_setup
from spoofgym.envs.spoofer_binding import spoofer_context
from spoofgym.spoofers import make_spoofer
from spoofgym.spoofers.base import sees_statistics


@pytest.mark.parametrize("env", VICTIMS)
def test_every_member_fits_every_victim_over_its_whole_range(env):
    setup = make_setup(VICTIMS[env].setup, {"detector": "never"})
    context = spoofer_context(setup)
    members = list_fitting_attacks(setup, context)
    letters = [member.letter for member in members]
    assert letters == sorted(letters)
    assert {*letters} == {"a", "b", "h", "e"} <= set(FAMILIES)
    assert len({member.player.label for member in members}) == len(members)
    seeing = set()
    for member in members:
        assert member.player.tuned
        assert member.budgeted == (member.letter != "h")
        grid = build_grid(member, context, 4)
        assert grid == sorted(set(grid))
        for value in (grid[0], grid[-1]):
            make_bound_spoofer(member.player.with_value(value), setup, 1)
        if sees_statistics(make_spoofer(member.player.with_value(1.0)).knowledge):
            seeing.add(member.letter)
    assert seeing == set(ORACLES)
    assert all("oracle" in FAMILIES[letter] for letter in ORACLES)


def test_the_digest_follows_the_members_and_profiles_are_smooth_and_within_the_limits():
    setup = make_setup(VICTIMS["spoofgym/TightlyCoupled-v0"].setup, {"detector": "never"})
    context = spoofer_context(setup)
    members = list_suite_attacks(context)
    assert suite_digest(members) == suite_digest(list_suite_attacks(context))
    longer = list_suite_attacks(context._replace(steps=2 * context.steps))
    assert suite_digest(members) not in (suite_digest(members[1:]), suite_digest(longer))
    knot_s = context.steps * context.interval_s / 12.0
    for rates in (
        np.array(each.player.spec["rates_mps"]) for each in members if each.letter == "b"
    ):
        assert (rates >= 0.0).all()
        assert rates.max() <= context.rate_limit_mps
        assert np.diff(rates).max() / knot_s <= context.acceleration_limit_mps2
