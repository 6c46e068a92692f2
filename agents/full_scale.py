"""What an action of 1 asks for, by how far it goes within the attack."""

from __future__ import annotations

from typing import Any

import numpy as np

from spoofgym.envs.core import SpoofCore

LENGTHS = 4.0
"""How far an action of 1 all through an attack goes, in lengths, by default."""


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
