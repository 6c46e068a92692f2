"""Does a detector find an attack on a filter that has settled, as on one that has not?"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from ..bench.runs.play import Runs, WarmStart, play
from ..bench.runs.world import World
from ..detectors import Detector
from ..detectors.build import bare_detector
from ..detectors.calibrated import unwrap
from ..simulation.setup import make_generators
from ..simulation.tight import TightlyCoupledSetup
from .stationary import (
    AGES_S,
    ATTACKS,
    RATES_MPS,
    RECEIVERS,
    WATCHED_S,
    Ages,
    FloatArray,
    find_slowest,
    require_alike,
)

LIVE_AFTER_S = 10.0  # time from switch-on until the detector is live
ENTROPY = 39  # of the seeds
MARGIN = 2.0
"""A filter that has settled follows some attacks less far, so that less of them can be found."""
POSITION = {
    "name": "false-position",
    "control": "rate",
    "rate_limit_mps": MARGIN * RATES_MPS[-1],
}
SUBSET = {**POSITION, "channels": [f"slot{k:02d}" for k in range(0, 12, 2)]}
PLAYED = dict(zip(ATTACKS, (POSITION, SUBSET), strict=True))
"""Attacks by the words of `ATTACKS`."""


def check_ages(
    detector: Detector | Mapping[str, Any] | str, task: str | None = None, **world: Any
) -> Ages:
    """Check that a detector finds an attack whatever the time since its victim was switched on.

    What `check_stationary` requires is required in flight.  64 tightly coupled receivers are
    switched on, their filters settle, and they are attacked 3, 10 and 30 min later, by ramps twice
    as fast as those that are just found at 3 min.  So it finds a detector that takes its age from
    the filter, too, as one does that was trained on attacks of one age.  The runs of the three ages
    have the same seeds, skies and headings.

    By default the world has white errors, which the filter models, and an epoch a second; that
    takes some 10 s.  In a world with other errors statistics may change while a filter settles, and
    it is for you to judge what is reported.

    Parameters
    ----------
    detector : Detector, str or mapping
        What `make_detector` takes, with satellites to measure; its thresholds are the nominal ones,
        and an ``.onnx`` file needs none.  The object itself is left as it is.
    task : str, optional
        Whose world it is flown in.
    **world
        Or settings as `World.of` takes them, but for attack, timeline and ages.

    Returns
    -------
    Ages
        What was found.

    Raises
    ------
    AssertionError
        Says what changes with age.
    ValueError
        Where the detector does not fit the world, or measures positions.

    Examples
    --------
    >>> from spoofgym.testing import check_ages
    >>> check_ages("snapshot-chi2").rates_mps
    (0.2, 0.4)
    """
    unbound = unwrap(bare_detector(detector))
    if not can_fly(unbound):
        raise ValueError(
            f"{type(unbound).__name__} judges what a tightly coupled receiver does not have; "
            "`check_stationary` has epochs for it"
        )
    given = World.of(task, **world) if task or world else World.of(**_default_world(unbound))
    advice = (
        "train and tune with attacks of all ages, as with `--set domain='{\"age_s\":[60,3600]}'`"
    )
    return require_alike(fly_ages(unbound, given), "switch-on", advice)


def can_fly(detector: Detector) -> bool:
    """Whether a tightly coupled receiver has what a detector judges."""
    return detector.measures != "position" and detector.needs <= TightlyCoupledSetup.has


def _default_world(detector: Detector) -> dict[str, Any]:
    card = detector.card
    scenario = {
        "name": "zhong2025-white",
        "flight": "airway",
        "imu_rate_hz": 10.0,
        "epoch_interval_s": (card and card.interval_s) or 1.0,
    }
    scenario |= {"channels": card.channels} if card and card.channels else {}
    skies = {"constellation_time_s": [0.0, 86_400.0], "worlds": 4}
    drawn = {"start_s": [0.0, None], "turn_on": "drawn", **skies}
    return {"scenario": scenario, "receiver": "matched", "domain": drawn}


def fly_ages(unbound: Detector, world: World) -> Ages:
    """Clean statistic, and where the test attacks are found, at every age."""
    clean: FloatArray | None = None
    rates, found = [], []
    for attack in PLAYED.values():
        start = _start(unbound, world, attack)
        if clean is None:
            clean = _by_age(play(start, "none").peak)
        level = float(clean[0].max())
        slowest = find_slowest(partial(_find, start.first(RECEIVERS), level))
        rate = None if slowest is None else MARGIN * slowest
        rates.append(rate)
        none = np.zeros(start.receivers, dtype=np.bool_)
        found.append(_by_age(none if rate is None else _find(start, level, rate)))
    assert clean is not None  # there are attacks
    return Ages(clean, tuple(rates), np.array(found))


def _start(unbound: Detector, world: World, attack: Mapping[str, Any]) -> WarmStart:
    """The receivers of all ages at their onset, those of the first age first."""
    domain = {**world.settings.get("domain", {}), "age_s": [AGES_S[0], AGES_S[-1]]}
    timeline = {
        "warmup_s": AGES_S[0],
        "live_s": AGES_S[0] - LIVE_AFTER_S,
        "attack_s": WATCHED_S,
        "time_to_alert_s": 0.0,
    }
    setup = world.copy_with(domain=domain, timeline=timeline, attack=dict(attack)).setup
    setup = setup.copy_with(detector=copy.deepcopy(unbound))
    seeds = [np.random.SeedSequence([ENTROPY, k]) for k in range(RECEIVERS)] * len(AGES_S)
    given = {"age_s": np.repeat(AGES_S, RECEIVERS)}
    return WarmStart(setup, make_generators(seeds), threads=1, given=given)


def _by_age(values: Any) -> Any:
    return values.reshape(len(AGES_S), RECEIVERS)


def _find(start: WarmStart, level: float, rate_mps: float) -> Any:
    """(R,) in which runs a ramp is found."""
    runs: Runs = play(start, {"name": "ramp", "rate_mps": rate_mps})
    found = runs.peak > level
    return found & runs.alarm.any(axis=0) if start.setup.detector.card is None else found
