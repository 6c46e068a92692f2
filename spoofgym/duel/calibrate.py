"""Calibration of a frozen detector policy on clean episodes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..calibration.clean_runs import Player
from ..core.declared import check_number
from ..core.registry import require, whole_number
from ..core.settings import compute_digest, describe
from ..detectors import calibration_file as files
from ..detectors.learned import PolicyDetector
from ..policies.contract import DetectorPolicy, as_policy
from .duel import WITHIN, make_duel


def calibrate_policy(
    policy: DetectorPolicy | Callable[[Any], Any],
    *,
    false_alarm: float = 0.05,
    runs: int = 200,
    seed: int = 0,
    receivers: int = 32,
    decision_delay: int = 0,
    store: str | os.PathLike[str] | None = None,
    **settings: Any,
) -> files.Calibration:
    """Clean runs of a frozen detector policy, from which its thresholds are read.

    Clean episodes are played to their end without a threshold, and the largest statistic of each is
    stored.  The weights of the policy are in the loop meanwhile.  An episode begins where it begins
    in the game: with ``onset="within"`` where detectors go live.

    Parameters
    ----------
    policy : DetectorPolicy or callable
        Frozen: what changes needs another calibration.  A function takes (B, o) observations and
        returns (B, a) actions.
    false_alarm : float
        Probability that a clean run alarms, in (0, 1), for which the runs have to be enough.
    runs : int
        Clean episodes, at least 1 / false_alarm - 1.
    seed : int
        Of these episodes.
    receivers : int
        Episodes that are played at once; the threshold does not depend on it.
    decision_delay : {0, 1}
        Of the game that the threshold is for.
    store : path-like, optional
        Folder in which calibrations are stored, by a digest of policy, game and request; a stored
        one is not computed again.
    **settings
        ``scenario``, ``receiver``, ``attack``, ``timeline``, ``statistic``, ``weighs``,
        ``exclusion_s``, ``onset``, as in `spoofgym.duel_v0.env`.

    Returns
    -------
    Calibration
        As that of any detector: `point(per_run=...)` has the threshold as its scale, `interval` the
        confidence interval of it.  The duel takes it as its ``threshold``.

    Raises
    ------
    ValueError
        When the runs are too few, or `store` is given for a policy without a digest.
    """
    check_number("false_alarm", false_alarm, above=0.0, below=1.0)
    runs, seed = whole_number("`runs`", runs), whole_number("`seed`", seed)
    whole_number("`receivers`", receivers, 1)
    if runs < files.compute_min_runs(false_alarm):
        raise ValueError(
            f"`runs` must be at least {files.compute_min_runs(false_alarm)} for `false_alarm` = "
            f"{false_alarm:g}, got {runs}"
        )
    frozen = as_policy(policy)
    duel = make_duel(1, decision_delay=decision_delay, threads=1, **settings)
    setup, agent = duel.setup, duel.agent
    duel.close()
    world = {**setup.conditions.settings, "decision_delay": decision_delay}
    if duel.within:
        world["onset"] = WITHIN
    detector = {"name": "policy", "policy": frozen.digest(), "agent": describe(agent)}
    path = None
    if store is not None:
        if frozen.digest() is None:
            raise ValueError(
                f"{frozen!r} has no digest to store its calibration by: give a FunctionPolicy a "
                "`name`, or override `digest`"
            )
        request = {"false_alarm": false_alarm, "runs": runs, "seed": seed}
        path = Path(store) / f"{compute_digest({**request, 'world': world, **detector})}.json"
        if path.is_file():
            found = files.Calibration.load(path)
            found.check_matches(world, detector, setup.name, rescaled=False)
            require(
                (found.runs, found.entropy) == (runs, seed),
                f"{path} must have {runs} runs of seed {seed}, got {found.runs} of {found.entropy}",
            )
            return found
    judge = PolicyDetector(
        agent.statistic,
        agent.weighs,
        agent.exclusion_s,
        policy=frozen,
        decision_delay=decision_delay,
        quiet_epochs=duel.quiet_epochs,
    )
    player = Player(setup, entropy=seed, threads=1, chunk=min(receivers, runs))
    # its threshold is 1, so that a ratio is a statistic; one of 0 is no alarm at any threshold
    played = player.play([judge], range(runs), in_loop=True)
    before, judged = np.maximum(
        [played.before[:, 0], played.judged[:, 0]], np.finfo(np.float64).tiny
    )
    window_s = setup.window_s
    if duel.within:
        judged = np.maximum(before, judged)
        window_s += float(played.age_s.mean()) - setup.filter_only * setup.interval_s
    ranks = files.list_stored_ranks(runs, window_s, [files.hourly_rate(false_alarm, window_s)])
    found = files.Calibration.from_maxima(
        before,
        judged,
        ranks=ranks,
        largest=np.sort(judged)[::-1][np.array(ranks) - 1],
        world=world,
        detector=detector,
        window_s=window_s,
        entropy=seed,
        seed_name=player.seed_name,
    )
    return found if path is None else found.save(path)
