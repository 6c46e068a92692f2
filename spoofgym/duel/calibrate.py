"""Calibration of a frozen detector policy on clean episodes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._describe import describe, digest_of
from .._registry import is_number, whole_number
from ..detectors import DetectorContext
from .agent import policy_context
from .calibration import Calibration, fewest_runs, quantile_of
from .duel import Duel
from .payoff import FixedThreshold
from .policy import DetectorPolicy, as_policy
from .rules import make_duel

FloatArray = NDArray[np.float64]
CALIBRATION = 1
"""First element of the spawn keys, as in the benchmark: shared with no training and evaluation."""


def calibrate(
    policy: DetectorPolicy | Callable[[Any], Any],
    *,
    false_alarm: float = 0.05,
    runs: int = 200,
    seed: int = 0,
    confidence: float = 0.95,
    receivers: int = 32,
    decision_delay: int = 0,
    store: str | os.PathLike[str] | None = None,
    **settings: Any,
) -> Calibration:
    """Threshold of a frozen detector policy for a run-level false-alarm rate.

    Clean episodes are played to their end without a threshold, and the largest statistic of each is
    kept; see `quantile_of`.  The weights of the policy are in the loop meanwhile.

    Parameters
    ----------
    policy : DetectorPolicy or callable
        Frozen: what changes needs another calibration.  A function takes (B, o) observations and
        returns (B, a) actions.
    false_alarm : float
        Probability that a clean run alarms, in (0, 1).
    runs : int
        Clean episodes, at least 1 / false_alarm - 1.
    seed : int
        Of these episodes.
    confidence : float
        Of the interval, in (0, 1).
    receivers : int
        Episodes that are played at once; the threshold does not depend on it.
    decision_delay : {0, 1}
        Of the game that the threshold is for.
    store : path-like, optional
        Folder in which calibrations are kept, by a digest of policy, game and request: what is
        there is not computed again.
    **settings
        ``scenario``, ``receiver``, ``attack``, ``timeline``, ``statistic``, ``weighs``,
        ``exclusion_s``, as in `spoofgym.duel_v0.env`.

    Returns
    -------
    Calibration
        Can be given as ``threshold``.

    Raises
    ------
    ValueError
        When the runs are too few, or a store is asked for a policy without a digest.
    """
    _check(false_alarm, runs, confidence, receivers)
    frozen = as_policy(policy)
    duel = make_duel(
        min(receivers, runs), decision_delay=decision_delay, attack_probability=0.0, **settings
    )
    duel.threshold = FixedThreshold(np.inf, duel.receivers)
    conditions = digest_of(_conditions(duel))
    seed, runs = whole_number("`seed`", seed), int(runs)
    request = {"false_alarm": false_alarm, "runs": runs, "seed": seed, "confidence": confidence}
    path = None
    if store is not None:
        if frozen.digest() is None:
            raise ValueError(
                f"{frozen!r} has no digest to store its calibration by: give a FunctionPolicy a "
                "`name`, or override `digest`"
            )
        name = digest_of({**request, "detector": frozen.digest(), "settings": conditions})
        path = Path(store) / f"{name}.json"
        if path.is_file():
            return Calibration.load(path)
    largest = largest_statistics(duel, frozen, runs, seed)
    duel.close()
    threshold, low, high = quantile_of(largest, false_alarm, confidence)
    found = Calibration(
        # a statistic of 0 is no alarm, whatever the threshold
        threshold=max(threshold, np.finfo(np.float64).tiny),
        threshold_low=low,
        threshold_high=high,
        confidence=confidence,
        false_alarm=false_alarm,
        runs=runs,
        detector=frozen.digest(),
        settings=conditions,
    )
    if path is not None:
        found.save(path)
    return found


def _check(false_alarm: float, runs: int, confidence: float, receivers: int) -> None:
    """Raise unless the request makes sense."""
    for name, value in (("false_alarm", false_alarm), ("confidence", confidence)):
        if not (is_number(value) and 0.0 < value < 1.0):
            raise ValueError(f"`{name}` must be in (0, 1), got {value!r}")
    for name, count in (("runs", runs), ("receivers", receivers)):
        if not isinstance(count, int | np.integer) or isinstance(count, bool):
            raise ValueError(f"`{name}` must be a whole number, got {count!r}")
    if runs < fewest_runs(false_alarm):
        raise ValueError(
            f"`runs` must be at least {fewest_runs(false_alarm)} for `false_alarm` = "
            f"{false_alarm:g}, got {runs}"
        )
    if receivers < 1:
        raise ValueError(f"`receivers` must be at least 1, got {receivers}")


def _conditions(duel: Duel) -> dict[str, Any]:
    """Everything of a duel that a clean run depends on, JSON-able."""
    setup = duel.setup
    parts = ("scenario", "receiver", "timeline", "detector", "domain")
    found = {name: describe(getattr(setup, name)) for name in parts}
    if setup.repeat > 1:
        # an episode keeps a decision to spare, so that it may have to start earlier
        found["decision_interval_s"] = setup.decision_interval_s
    return {**found, "decision_delay": duel.decision_delay}


def largest_statistics(duel: Duel, policy: DetectorPolicy, runs: int, seed: int) -> FloatArray:
    """Play clean episodes to their end: (runs,) largest statistic of each."""
    policy.bind(_context(duel))
    idle = np.zeros((duel.receivers, len(duel.core.action_names)))
    found: list[FloatArray] = []
    for first in range(0, runs, duel.receivers):
        keys = range(first, first + duel.receivers)
        sequences = [np.random.SeedSequence(seed, spawn_key=(CALIBRATION, run)) for run in keys]
        duel.reset([np.random.default_rng(sequence) for sequence in sequences])
        policy.reset()
        largest = np.zeros(duel.receivers)
        for _ in range(duel.epochs):
            if duel.decision_delay:
                action = policy.decide(duel.observe_detector())
                duel.arrive(idle)
            else:
                duel.arrive(idle)
                action = policy.decide(duel.observe_detector())
            largest = np.maximum(largest, duel.decide(action).info["statistic"])
        found.append(largest)
    return np.concatenate(found)[:runs]


def _context(duel: Duel) -> Any:
    """What a policy knows of a duel."""
    setup = duel.setup
    return policy_context(
        duel.agent,
        DetectorContext(
            duel.receivers,
            setup.world.channels,
            setup.interval_s,
            setup.combinations.largest_variance,
            setup.world.satellite_ids,
        ),
    )
