"""How errors grow, against the printed transition, Groves (2013), eqs. 14.48 to 14.50."""

import numpy as np
import pytest

from spoofgym.core.compile import njit
from spoofgym.core.simd import LANES, load
from spoofgym.earth.wgs84 import geodetic_to_ecef
from spoofgym.receiver._kernels import show_transition
from spoofgym.receiver.states import STATES, TERMS, transition_terms
from spoofgym.truth._kernels import load3

from ..lanes import in_all_lanes, side_by_side
from .reference import transition


@njit
def terms_of(interval, terms):
    """`interval`: rows of C (9), r (3), f (3) and tau."""
    C = load3(interval, 0) + load3(interval, 3) + load3(interval, 6)
    transition_terms(C, load3(interval, 9), load3(interval, 12), load(interval, 15), terms)


def terms_and_interval(intervals):
    """Lane arrays of up to eight (C, r, f, tau); the first fill up."""
    filled = [intervals[i % len(intervals)] for i in range(LANES)]
    interval = side_by_side([np.concatenate([np.ravel(x) for x in each]) for each in filled])
    terms = np.full((TERMS, LANES), np.nan)
    in_all_lanes(terms_of, interval, terms)
    return terms, interval


def transitions(intervals):
    """Matrices of up to eight (C, r, f, tau), each written over the one before."""
    terms, interval = terms_and_interval(intervals)
    Phi, found = np.zeros(STATES * STATES), []
    for i in range(len(intervals)):
        show_transition(terms, float(interval[15, i]), i, Phi)
        found.append(Phi.reshape(STATES, STATES).copy())
    return found


def eight_intervals(rng):
    places = rng.uniform((-1.5, -3.0, -100.0), (1.5, 3.0, 2e4), (8, 3))
    taus = [0.01, 0.5, 3.0, *rng.uniform(0.01, 3.0, 5)]
    turns = np.linalg.qr(rng.standard_normal((8, 3, 3)))[0]
    return [
        (turn, geodetic_to_ecef(*place), rng.normal(0.0, 10.0, 3), tau)
        for turn, place, tau in zip(turns, places, taus, strict=True)
    ]


@pytest.mark.nojit
def test_the_transition_is_the_printed_one():
    intervals = eight_intervals(np.random.default_rng(0))
    for Phi, each in zip(transitions(intervals), intervals, strict=True):
        np.testing.assert_allclose(Phi, transition(*each), rtol=1e-14, atol=1e-18)
