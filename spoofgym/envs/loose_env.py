"""The environment of the loosely coupled receiver."""

from __future__ import annotations

from typing import ClassVar

from .loose_plant import LoosePlant
from .plant import Plant
from .plant_env import PlantEnv, PlantVectorEnv


class LooselyCoupledEnv(PlantEnv):
    """A spoofer against a loosely coupled GNSS/INS receiver, which takes GNSS for a position.

    **Description.** An airliner flies with a 15-state filter that is updated by positions of GNSS,
    ten a second, and whose noise tunes itself to the innovations.  The spoofer shifts those
    positions; all else, their authentic errors included, stays.  The detector watches the
    innovations of the position.  It is the receiver of `shadmehri2025`.

    **Action.** `Box(-1, 1, (2,), float32)`: rates of the offset north and east, over their limit
    (5 m/s by default).

    **Observation.** `Box` of float32 with finite bounds; every element is scaled and clipped.
    ``env.unwrapped.observation_names`` names them.  What is in it is up to `knowledge`:

    ========  =========================================================================
    blind     own displacement and rate, time since the onset, time left
    tracking  also the target's true position and velocity
    oracle    also the detector's statistic and weights, and the victim's error
    ========  =========================================================================

    **Reward.** As in `SpoofEnv`: increase of the largest displacement of the victim along the
    target direction [m]; at an alarm, minus what was gained within the time to alert, minus the
    alarm penalty.  ``info["reward_*"]`` are the parts.

    **Start.** No offset, after a clean warm-up.  An alarm there is a false alarm, and shows in
    ``info["warmup_alarm"]``; nothing is drawn again for it.

    **End.** `terminated` after the last command of the attack window, or at an alarm.  `truncated`
    never, unless an end term does it.

    **Arguments.** Those of `PlantEnv` and, by name, the settings of `LoosePlant`.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> env = gym.make("spoofgym/LooselyCoupled-v0", knowledge="blind", rate_limit_mps=2.0)
    >>> env.action_space
    Box(-1.0, 1.0, (2,), float32)
    >>> env.close()

    Notes
    -----
    Version history: v0, the first.
    """

    plant_type: ClassVar[type[Plant]] = LoosePlant


class LooselyCoupledVectorEnv(PlantVectorEnv):
    """Vector environment of `LooselyCoupledEnv`; receiver i is the single one of ``seed + i``.

    **Arguments.** Those of `PlantVectorEnv` and, by name, the settings of `LoosePlant`.
    """

    plant_type: ClassVar[type[Plant]] = LoosePlant
