"""What actions ask for: how often, and how much an action of 1 is."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from typing import Any

import numpy as np

from spoofgym.envs.core import SpoofCore
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.simulation.setup import Setup

ABOUT_S = 10.0
"""Time between decisions, as far as the attack holds a whole number of them."""
LENGTHS = 4.0
"""How far an action of 1 all through an attack goes, in lengths, by default."""


def for_learning(
    settings: Mapping[str, Any],
    full_scale_mps: float | None = None,
    decision_interval_s: float | None = None,
) -> dict[str, Any]:
    """Settings of a `SpoofVecEnv` with the action that is learned, as the two below have it."""
    with closing(SpoofVecEnv(1, **settings)) as probe:
        return {
            **settings,
            **setpoint_action(probe.core, full_scale_mps),
            **seldom(probe.core.setup, decision_interval_s),
        }


def seldom(setup: Setup, decision_interval_s: float | None) -> dict[str, Any]:
    """Settings of an environment like this one in which decisions are seldom, and linear between.

    `decision_interval_s`: time between them [s]; 0 for one at every epoch, None for some ten
    seconds.  {} where the world has decisions of its own.
    """
    if decision_interval_s == 0.0 or setup.decision_interval_s is not None:
        return {}
    if decision_interval_s is None:
        fitting = [n for n in range(1, setup.steps + 1) if setup.steps % n == 0]
        nearest = min(fitting, key=lambda n: abs(n * setup.interval_s - ABOUT_S))
        decision_interval_s = round(nearest * setup.interval_s, 9)
    return {"decision_interval_s": decision_interval_s, "between": "linear"}


def setpoint_action(core: SpoofCore, full_scale_mps: float | None) -> dict[str, Any]:
    """Setting `action` for an environment like this one; {} where it commands no wanted rate.

    By default the full scale is that of `LENGTHS`, or the attack's limit where that is less.  A
    ValueError where one is asked for that nothing can be done with.
    """
    commands, setup = core.commands, core.setup
    if commands.setpoint_mps is None:
        if full_scale_mps is not None:
            raise ValueError(
                "`full_scale_mps` is that of a wanted rate, and the attack of these settings is "
                f"commanded otherwise ({', '.join(core.action_names)}); got {full_scale_mps}"
            )
        return {}
    if full_scale_mps is None:
        window_s = setup.steps * setup.interval_s
        most = float(np.min(setup.attack.rate_limit_mps))
        full_scale_mps = min(LENGTHS * core.length_m / window_s, most)
    dimensions = {} if commands.along_target else {"dimensions": 2}
    return {
        "action": {"name": "rate-setpoint", "full_scale_mps": full_scale_mps, **dimensions},
    }
