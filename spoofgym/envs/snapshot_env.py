"""The environment of the snapshot receiver."""

from __future__ import annotations

from typing import ClassVar

from .plant import Plant
from .plant_env import PlantEnv, PlantVectorEnv
from .snapshot_plant import SnapshotPlant


class SnapshotEnv(PlantEnv):
    """A spoofer against a snapshot receiver, which makes a fix of each epoch by itself.

    **Description.** A vehicle goes straight on; its receiver has no filter and no inertial sensors.
    The spoofer has some of the satellites in view, and lets them tell of a position and a clock
    that drift away from the true ones; the others stay authentic.  The detector looks for
    the satellites that do not fit, and may exclude them from the fix.  It is the receiver of
    `wu2024`.

    **Action.** `Box(-1, 1, (4,), float32)`: rates of the counterfeit displacement north, east, down
    and of the counterfeit clock, over their limits (5 m/s by default).

    **Observation.** `Box` of float32 with finite bounds; every element is scaled and clipped.
    ``env.unwrapped.observation_names`` names them.  What is in it is up to `knowledge`:

    ========  =========================================================================
    blind     own displacement and rate, time since the onset, time left
    tracking  also the target's true motion, the satellites, and which are spoofed
    oracle    also the detector's statistics and weights, and the victim's error
    ========  =========================================================================

    **Reward.** As in `SpoofEnv`: increase of the largest displacement of the victim along the
    target direction [m]; at an alarm, minus what was gained within the time to alert, minus the
    alarm penalty.  ``info["reward_*"]`` are the parts.  A fix of one epoch is as noisy as its
    pseudoranges: the largest displacement of an idle spoofer is some metres, with few satellites
    many, and that is the zero of this scale.

    **Start.** No displacement, after a clean warm-up.  An alarm there is a false alarm, and shows
    in ``info["warmup_alarm"]``; nothing is drawn again for it.

    **End.** `terminated` after the last command of the attack window, or at an alarm.  `truncated`
    never, unless an end term does it.

    **Arguments.** Those of `PlantEnv` and, by name, the settings of `SnapshotPlant`.  The detector
    is ``srv-raim`` by default.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> env = gym.make("spoofgym/Snapshot-v0", knowledge="blind", spoofed=4)
    >>> env.action_space
    Box(-1.0, 1.0, (4,), float32)
    >>> env.close()

    Notes
    -----
    Version history: v0, the first.
    """

    plant_type: ClassVar[type[Plant]] = SnapshotPlant


class SnapshotVectorEnv(PlantVectorEnv):
    """Vector environment of `SnapshotEnv`; receiver i is the single one seeded with ``seed + i``.

    **Arguments.** Those of `PlantVectorEnv` and, by name, the settings of `SnapshotPlant`.
    """

    plant_type: ClassVar[type[Plant]] = SnapshotPlant
