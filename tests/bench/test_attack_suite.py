"""Whom every detector meets."""

from __future__ import annotations

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
from spoofgym.spoofers import SPOOFERS, make_spoofer
from spoofgym.spoofers.base import sees_statistics


@pytest.mark.parametrize("env", VICTIMS)
def test_every_member_fits_every_victim_over_its_whole_range(env: str) -> None:
    setup = make_setup(VICTIMS[env].setup, {"detector": "never"})
    context = spoofer_context(setup)
    members = list_fitting_attacks(setup, context)
    letters = [member.letter for member in members]
    assert letters == sorted(letters)
    wanted = {"a", "b", "h"} | ({"e"} if "feedback" in SPOOFERS else set())
    assert set(letters) == wanted <= set(FAMILIES)
    assert len({member.player.label for member in members}) == len(members)
    for member in members:
        assert member.player.tuned
        assert member.budgeted == (member.letter != "h")
        grid = build_grid(member, context, 4)
        assert grid == sorted(set(grid))
        for value in (grid[0], grid[-1]):
            make_bound_spoofer(member.player.with_value(value), setup, 1)


def test_letters_of_oracles_are_those_of_members_that_see_statistics() -> None:
    setup = make_setup(VICTIMS["spoofgym/TightlyCoupled-v0"].setup, {"detector": "ewma"})
    members = list_fitting_attacks(setup, spoofer_context(setup))
    seeing = {
        member.letter
        for member in members
        if sees_statistics(make_spoofer(member.player.with_value(1.0)).knowledge)
    }
    assert seeing == set(ORACLES)
    assert all("oracle" in FAMILIES[letter] for letter in ORACLES)


def test_the_digest_follows_the_members() -> None:
    setup = make_setup(VICTIMS["spoofgym/TightlyCoupled-v0"].setup, {"detector": "never"})
    context = spoofer_context(setup)
    members = list_suite_attacks(context)
    assert suite_digest(members) == suite_digest(list_suite_attacks(context))
    assert suite_digest(members) != suite_digest(members[1:])
    longer = list_suite_attacks(context._replace(steps=2 * context.steps))
    assert suite_digest(members) != suite_digest(longer)


def test_profiles_are_smooth_and_within_the_limits() -> None:
    setup = make_setup(VICTIMS["spoofgym/TightlyCoupled-v0"].setup, {"detector": "never"})
    context = spoofer_context(setup)
    profiles = [member for member in list_suite_attacks(context) if member.letter == "b"]
    knot_s = context.steps * context.interval_s / 12.0
    for member in profiles:
        rates = np.array(member.player.spec["rates_mps"])
        assert (rates >= 0.0).all()
        assert rates.max() <= context.rate_limit_mps
        assert np.diff(rates).max() / knot_s <= context.acceleration_limit_mps2
