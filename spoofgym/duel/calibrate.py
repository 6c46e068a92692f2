"""Calibration of a frozen detector policy on clean episodes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..calibration.clean_runs import Player
from ..core.declared import check_number
from ..core.registry import whole_number
from ..core.settings import compute_digest, describe
from ..detectors.calibration_file import compute_min_runs
from ..detectors.learned import DetectorAgent, PolicyDetector
from ..policies.contract import DetectorPolicy, as_policy
from ..simulation.setup import Setup
from .calibration import PolicyCalibration, compute_threshold
from .duel import make_duel


def calibrate_policy(
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
) -> PolicyCalibration:
    """Threshold of a frozen detector policy for a run-level false-alarm rate.

    Clean episodes are played to their end without a threshold, and the largest statistic of each is
    stored; see `compute_threshold`.  The weights of the policy are in the loop meanwhile.

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
        Folder in which calibrations are stored, by a digest of policy, game and request; a stored
        one is not computed again.
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
        When the runs are too few, or `store` is given for a policy without a digest.
    """
    _check(false_alarm, runs, confidence, receivers)
    frozen = as_policy(policy)
    duel = make_duel(1, decision_delay=decision_delay, threads=1, **settings)
    setup, agent = duel.setup, duel.agent
    duel.close()
    judge = PolicyDetector(
        agent.statistic,
        agent.weighs,
        agent.exclusion_s,
        policy=frozen,
        decision_delay=decision_delay,
        quiet_epochs=setup.live,
    )
    conditions = compute_digest(_conditions(setup, agent, decision_delay))
    seed, runs = whole_number("`seed`", seed), int(runs)
    request = {"false_alarm": false_alarm, "runs": runs, "seed": seed, "confidence": confidence}
    path = None
    if store is not None:
        if frozen.digest() is None:
            raise ValueError(
                f"{frozen!r} has no digest to store its calibration by: give a FunctionPolicy a "
                "`name`, or override `digest`"
            )
        name = compute_digest({**request, "detector": frozen.digest(), "settings": conditions})
        path = Path(store) / f"{name}.json"
        if path.is_file():
            return PolicyCalibration.load(path)
    player = Player(setup, entropy=seed, threads=1, chunk=min(receivers, runs))
    # its threshold is 1, so that a ratio is a statistic
    largest = player.play([judge], range(runs), in_loop=True).judged[:, 0]
    threshold, low, high = compute_threshold(largest, false_alarm, confidence)
    found = PolicyCalibration(
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
    check_number("false_alarm", false_alarm, above=0.0, below=1.0)
    check_number("confidence", confidence, above=0.0, below=1.0)
    whole_number("`runs`", runs)
    whole_number("`receivers`", receivers, 1)
    if runs < compute_min_runs(false_alarm):
        raise ValueError(
            f"`runs` must be at least {compute_min_runs(false_alarm)} for `false_alarm` = "
            f"{false_alarm:g}, got {runs}"
        )


def _conditions(setup: Setup, agent: DetectorAgent, decision_delay: int) -> dict[str, Any]:
    """Everything of a duel that a clean run depends on, JSON-able."""
    settings = setup.conditions.settings
    return {**settings, "detector": describe(agent), "decision_delay": decision_delay}
