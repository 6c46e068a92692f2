"""The environment of the wheeled robot."""

from __future__ import annotations

from typing import ClassVar

from .plant import Plant
from .plant_env import PlantEnv, PlantVectorEnv
from .robot_plant import RobotPlant


class WheeledRobotEnv(PlantEnv):
    """A spoofer against a wheeled robot, whose odometry and GNSS a Kalman filter blends.

    **Description.** A robot drives round a closed course.  Encoders and yaw carry its position on
    between the fixes of GNSS, one a second.  The spoofer moves the fixes by an offset; the detector
    compares them with the dead reckoning, and says which of them the filter may believe.  It is the
    robot of `song2021`.

    **Action.** `Box(-1, 1, (2,), float32)`: rates of the offset north and east, over their limit
    (1 m/s by default).

    **Observation.** `Box` of float32 with finite bounds; every element is scaled and clipped.
    ``env.unwrapped.observation_names`` names them.  What is in it is up to `knowledge`:

    ========  =========================================================================
    blind     own displacement and rate, time since the onset, time left
    tracking  also the target's true position and velocity
    oracle    also the detector's statistic, the weight of the fix, the victim's error
    ========  =========================================================================

    **Reward.** As in `SpoofEnv`: increase of the largest displacement of the victim along the
    target direction [m]; at an alarm, minus what was gained within the time to alert, minus the
    alarm penalty.  ``info["reward_*"]`` are the parts.

    **Start.** No offset, after a clean warm-up.  An alarm there is a false alarm, and shows in
    ``info["warmup_alarm"]``; nothing is drawn again for it.

    **End.** `terminated` after the last command of the attack window, or at an alarm.  `truncated`
    never, unless an end term does it.

    **Arguments.** Those of `PlantEnv` and, by name, the settings of `RobotPlant`.  The detector is
    ``acna`` in its production variant by default.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> env = gym.make("spoofgym/WheeledRobot-v0", knowledge="blind", rate_limit_mps=0.5)
    >>> env.action_space
    Box(-1.0, 1.0, (2,), float32)
    >>> env.close()

    Notes
    -----
    Version history: v0, the first.
    """

    plant_type: ClassVar[type[Plant]] = RobotPlant


class WheeledRobotVectorEnv(PlantVectorEnv):
    """Vector environment of `WheeledRobotEnv`; receiver i is the single one of ``seed + i``.

    **Arguments.** Those of `PlantVectorEnv` and, by name, the settings of `RobotPlant`.
    """

    plant_type: ClassVar[type[Plant]] = RobotPlant
