"""The environments that `gymnasium.make` makes: one spoofer against each kind of victim."""

from __future__ import annotations

import inspect
from typing import Any, ClassVar

from gymnasium.vector import AutoresetMode

from ..simulators.loosely_coupled import LooselyCoupledSetup
from ..simulators.setup import Setup
from ..simulators.snapshot_positioning import SnapshotSetup
from ..simulators.tightly_coupled import TightlyCoupledSetup
from ..simulators.wheeled_robot import WheeledRobotSetup
from .core import SpoofCore
from .env import CoreEnv
from .factory import make_core, signature_of
from .options import InfoSpec, autoreset_mode_of, check_vector_settings
from .rendering import CoreRecorder
from .vector_env import CoreVectorEnv


class _Victim:
    """Settings of a kind of victim as arguments of an environment; a subclass names the kind."""

    setup_type: ClassVar[type[Setup]]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Let the signature show all settings."""
        super().__init_subclass__(**kwargs)
        if hasattr(cls, "setup_type"):
            own = inspect.signature(cls.__init__)
            cls.__signature__ = signature_of(cls.setup_type, own)  # type: ignore[attr-defined]


class VictimEnv(_Victim, CoreEnv[SpoofCore]):
    """A spoofer against one receiver; `given_detector` is what was set, None for the default."""

    def __init__(self, *, render_mode: str | None = None, **settings: Any) -> None:
        core = make_core(self.setup_type, 1, settings, threads=1, whose=type(self).__name__)
        self.given_detector: Any = settings.get("detector")
        super().__init__(core, render_mode)

    def _recorder(self) -> CoreRecorder:
        """What pictures are made from."""
        return CoreRecorder(self.core)


class VictimVectorEnv(_Victim, CoreVectorEnv[SpoofCore]):
    """Vector environment of a `VictimEnv`; receiver i is the single one of ``seed + i``."""

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        infos: InfoSpec = "all",
        threads: int | None = None,
        prefetch: bool | None = None,
        render_mode: None = None,
        max_episode_steps: int | None = None,
        **settings: Any,
    ) -> None:
        mode = autoreset_mode_of(autoreset_mode)
        check_vector_settings(num_envs, render_mode)
        core = make_core(
            self.setup_type,
            num_envs,
            settings,
            threads=threads,
            prefetch=self.setup_type.threaded if prefetch is None else prefetch,
            whose=type(self).__name__,
        )
        self.given_detector: Any = settings.get("detector")
        super().__init__(core, mode, infos, max_episode_steps)


class SpoofEnv(VictimEnv):
    """A spoofer against a tightly coupled GNSS/INS receiver and its detector.

    **Description.** An aircraft flies with a 17-state tightly coupled GNSS/INS filter, whose
    detector tests the innovations.  After a clean warm-up the spoofer counterfeits the
    satellites, and moves the position that they imply, one command per GNSS epoch.  It wants the
    filter's position to go astray without an alarm.  All is simulated at measurement level.

    **Action.** `Box(-1, 1, (a,), float32)`, one element for every commanded axis or channel: 1 is
    the attack's limit of acceleration (0.05 m/s^2 by default) or of rate (5 m/s).  By default north
    and east.  ``env.unwrapped.action_names`` names them.

    **Observation.** `Box` of float32 with finite bounds; every element is scaled and clipped.
    ``env.unwrapped.observation_names`` names them.  What is in it depends on `knowledge`:

    ========  ========================================================================
    blind     own commanded displacement and rate, time since the onset, time left
    tracking  also the target's true position and velocity, and the satellites in view
    oracle    also the detector's statistics and weights, and the victim's error
    ========  ========================================================================

    **Reward.** Increase of the largest displacement of the victim along the target direction [m];
    at an alarm, minus what was gained within the time to alert, minus the alarm penalty.  The
    undiscounted return is the undetected displacement minus the penalty.  ``info["reward_*"]`` are
    the parts.

    **Start.** Zero command, after the warm-up.  An alarm in the warm-up is a false alarm, and shows
    in ``info["warmup_alarm"]``; nothing is drawn again for it.

    **End.** `terminated` after the last command of the attack window (300 by default), or at an
    alarm. `truncated` never, unless an end term does it: ``env.spec.max_episode_steps`` is one step
    more than there can be.

    Parameters
    ----------
    scenario : str, mapping or Scenario
        Flight, errors and sensors: a name in `SCENARIOS`, or a dict of its settings.
    detector : str, mapping or Detector, optional
        A name in `DETECTORS`, a dict with a name and settings, or an object, which is copied; the
        EWMA chart with weights (m = 0.3) by default.
    attack : str, mapping or Attack
        A name in `ATTACKS` or `THREATS`, a dict with a name and settings, or an object, which is
        copied.
    receiver : str, mapping or TightlyCoupled, optional
        ``"paper"`` or ``"matched"``, or settings of the victim.
    timeline : mapping or Timeline, optional
        Lengths of warm-up, attack window and time to alert.
    knowledge : {"tracking", "blind", "oracle"}
        What the spoofer observes.
    observation : str, mapping, path, ObservationTerm or sequence of them, optional
        Own list of terms instead of `knowledge`, as `make_terms` takes them.
    action : str, mapping, path, ActionTerm or sequence of them, optional
        Own list of terms instead of the attack's elements.
    reward : str, mapping, path, RewardTerm or sequence of them, optional
        Own list of terms instead of the above.
    end : str, mapping, path, EndTerm or sequence of them, optional
        Own list of terms instead of `end_at_alarm`.
    watch : sequence of str, mapping or Detector
        Passive detectors: they judge the same epochs and change nothing;
        ``info["watch_NAME_alarm"]`` and more report them.
    alarm_penalty_m : float
        Price of an alarm.
    end_at_alarm : bool
        Whether an alarm ends the episode, where `end` does not say it.
    target_heading_deg : float or {"random", "worst"}
        Direction in which displacement counts, clockwise from north; drawn for every episode, and
        observed; or that in which it is largest.
    domain : mapping or Domain, optional
        What differs from episode to episode, apart from the noise; nothing by default.
    decision_interval_s : float, optional
        Time between decisions; every epoch by default.
    between : {"hold", "linear"}
        What is commanded between them.
    imu_rate_hz : float, optional
        Samples of the inertial sensors per second, such as 50, 20 or 10: fewer make a step cheaper;
        those of the scenario by default.  See `Scenario`.
    twin : bool
        Whether a clean twin of the victim runs, too, and displacement is the distance from it
        instead of the error less that at the onset.  It takes up to twice the time.
    warm_pool : int, optional
        Start all episodes as copies of so many receivers that are warmed up once, picked by the
        seed of the episode, with fresh noise from the onset on; by default each has a warm-up of
        its own.  See `Engine`.
    render_mode : {"human", "rgb_array"}, optional
        Whether a window shows the episode, or `render` returns pictures of it.

    Attributes
    ----------
    observation_names, action_names : tuple of str
        Name of every element.
    given_detector : object
        Detector that has been set, as it was given; None for the default.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> env = gym.make("spoofgym/TightlyCoupled-v0", detector="snapshot-chi2", knowledge="blind")
    >>> env.unwrapped.observation_names[:2]
    ('own_displacement_north', 'own_displacement_east')
    >>> env.close()

    Notes
    -----
    Version history: v0, the first.  ``spoofgym/RandomStart-v0`` is the same class, with a receiver
    that is switched on at a random time of the flight, and a target direction that is drawn for
    every episode, and observed.
    """

    setup_type: ClassVar[type[Setup]] = TightlyCoupledSetup


class SpoofVectorEnv(VictimVectorEnv):
    """Vector environment of `SpoofEnv`; receiver i is the single one seeded with ``seed + i``.

    Parameters
    ----------
    num_envs : int
        Receivers, at least 1.
    autoreset_mode : {"next_step", "same_step", "disabled"} or AutoresetMode
        When a finished receiver starts its next episode; with ``disabled``, when ``reset`` is
        called with ``options={"reset_mask": ...}``.
    infos : {"all", "none"} or sequence of str
        Which information is handed out, by its keys; `final_obs` and `final_info` always are.
    threads : int, optional
        Threads of the engine; all useful cores by default.
    prefetch : bool
        Whether every receiver's next episodes are warmed up in the spare time of the threads while
        the present one runs, with ``threads=1`` by one thread more.  The bits are the same, unless
        those of the detector depend on the size of the batch: runs with such a one are then not
        reproducible; see `Engine`.
    render_mode : None
        There is nothing to render.
    max_episode_steps : int, optional
        Of `gymnasium.make_vec`, from a spec: more than an episode has, and without effect.
    **settings
        As in `SpoofEnv`, as are the attributes.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> envs = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=4, detector="never")
    >>> envs.single_action_space
    Box(-1.0, 1.0, (2,), float32)
    >>> envs.close()
    """

    setup_type: ClassVar[type[Setup]] = TightlyCoupledSetup


class LooselyCoupledEnv(VictimEnv):
    """A spoofer against a loosely coupled GNSS/INS receiver, corrected by finished GNSS positions.

    **Description.** An airliner flies with a 15-state filter that is updated by positions of GNSS,
    ten a second, and whose noise tunes itself to the innovations.  The spoofer shifts those
    positions; all else, their authentic errors included, stays.  The detector watches the
    innovations of the position.  It is the receiver of `shadmehri2025`.

    **Action.** `Box(-1, 1, (2,), float32)`: rates of the offset north and east, over their limit
    (5 m/s by default).

    **Observation.** As in `SpoofEnv`, with other elements:

    ========  =========================================================================
    blind     own displacement and rate, time since the onset, time left
    tracking  also the target's true position and velocity
    oracle    also the detector's statistic and weights, and the victim's error
    ========  =========================================================================

    **Reward, start and end.** As in `SpoofEnv`; it starts without an offset.

    **Arguments.** The settings of `LooselyCoupledSetup` and of `SpoofCore`.
    **Version history.** v0, the first.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> env = gym.make("spoofgym/LooselyCoupled-v0", knowledge="blind", rate_limit_mps=2.0)
    >>> env.action_space
    Box(-1.0, 1.0, (2,), float32)
    >>> env.close()
    """

    setup_type: ClassVar[type[Setup]] = LooselyCoupledSetup


class LooselyCoupledVectorEnv(VictimVectorEnv):
    """Vector environment of `LooselyCoupledEnv`; arguments of its own as in `SpoofVectorEnv`."""

    setup_type: ClassVar[type[Setup]] = LooselyCoupledSetup


class SnapshotEnv(VictimEnv):
    """A spoofer against a snapshot receiver, which makes a fix of each epoch by itself.

    **Description.** A vehicle goes straight on; its receiver has no filter and no inertial sensors.
    The spoofer has some of the satellites in view, and makes them imply a position and a clock
    that drift away from the true ones; the others stay authentic.  The detector looks for
    the satellites that do not fit, and may exclude them from the fix.  It is the receiver of
    `wu2024`.

    **Action.** `Box(-1, 1, (4,), float32)`: rates of the counterfeit displacement north, east, down
    and of the counterfeit clock, over their limits (5 m/s by default).

    **Observation.** As in `SpoofEnv`, with other elements:

    ========  =========================================================================
    blind     own displacement and rate, time since the onset, time left
    tracking  also the target's true motion, the satellites, and which are spoofed
    oracle    also the detector's statistics and weights, and the victim's error
    ========  =========================================================================

    **Reward, start and end.** As in `SpoofEnv`; it starts without a displacement.  A fix of one
    epoch is as noisy as its pseudoranges: the largest displacement of an idle spoofer is some
    metres, with few satellites many, and that is the zero of this scale.

    **Arguments.** The settings of `SnapshotSetup` and of `SpoofCore`.  The detector is
    ``srv-raim`` by default.  **Version history.** v0, the first.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> env = gym.make("spoofgym/Snapshot-v0", knowledge="blind", spoofed=4)
    >>> env.action_space
    Box(-1.0, 1.0, (4,), float32)
    >>> env.close()
    """

    setup_type: ClassVar[type[Setup]] = SnapshotSetup


class SnapshotVectorEnv(VictimVectorEnv):
    """Vector environment of `SnapshotEnv`; arguments of its own as in `SpoofVectorEnv`."""

    setup_type: ClassVar[type[Setup]] = SnapshotSetup


class WheeledRobotEnv(VictimEnv):
    """A spoofer against a wheeled robot, whose odometry and GNSS a Kalman filter blends.

    **Description.** A robot drives round a closed course.  Encoders and yaw carry its position on
    between the fixes of GNSS, one a second.  The spoofer moves the fixes by an offset; the detector
    compares them with the dead reckoning, and says which of them the filter may believe.  It is the
    robot of `song2021`.

    **Action.** `Box(-1, 1, (2,), float32)`: rates of the offset north and east, over their limit
    (1 m/s by default).

    **Observation.** As in `SpoofEnv`, with other elements:

    ========  =========================================================================
    blind     own displacement and rate, time since the onset, time left
    tracking  also the target's true position and velocity
    oracle    also the detector's statistic, the weight of the fix, the victim's error
    ========  =========================================================================

    **Reward, start and end.** As in `SpoofEnv`; it starts without an offset.

    **Arguments.** The settings of `WheeledRobotSetup` and of `SpoofCore`.  The detector is
    ``acna`` in its production variant by default.  **Version history.** v0, the first.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> env = gym.make("spoofgym/WheeledRobot-v0", knowledge="blind", rate_limit_mps=0.5)
    >>> env.action_space
    Box(-1.0, 1.0, (2,), float32)
    >>> env.close()
    """

    setup_type: ClassVar[type[Setup]] = WheeledRobotSetup


class WheeledRobotVectorEnv(VictimVectorEnv):
    """Vector environment of `WheeledRobotEnv`; arguments of its own as in `SpoofVectorEnv`."""

    setup_type: ClassVar[type[Setup]] = WheeledRobotSetup
