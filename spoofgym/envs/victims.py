"""The environments that `gymnasium.make` makes: one spoofer against each kind of victim."""

from __future__ import annotations

from typing import Any

from gymnasium.vector import AutoresetMode

from .core import SpoofCore
from .env import CoreEnv, CoreVectorEnv
from .factory import DEFAULT_VICTIM, expand_signature, make_core, select_victim
from .options import InfoSpec, check_vector_settings


class SpoofEnv(CoreEnv[SpoofCore]):
    r"""A spoofer against a receiver and its detector; tightly coupled GNSS/INS by default.

    **Description.** An aircraft flies with a 17-state tightly coupled GNSS/INS filter, whose
    detector tests the innovations.  After a clean warm-up the spoofer counterfeits the
    satellites, and moves the position that they imply, one command per GNSS epoch.  It wants the
    filter's position to go astray without an alarm.  All is simulated at measurement level.

    **Action.** `Box(-1, 1, (1,), float32)`: the wanted rate of the counterfeit displacement along
    the target direction; 1 is 1 m/s. The acceleration follows within the attack's limits, first
    that of the acceleration (0.05 m/s^2 by default), then that of the rate (5 m/s). Where
    `target_heading_deg` is ``"worst"`` it is the rate north and east. An attack that commands
    something else, such as one per channel, takes one element for every channel or axis: 1 is its
    limit of acceleration or of rate. With `control` or `basis` it takes one element for every
    satellite, or axis of the basis: the rate of its pseudorange offset, or the offset. That form,
    and others, can be had by their names, such as ``action="full-command"``.
    ``env.unwrapped.action_names`` names the elements.

    **Observation.** `Box` of float32 with finite bounds; every element is divided by a scale and
    clipped.  ``env.unwrapped.observation_names`` names them.  `knowledge` decides which there are:
    ``"blind"``; ``"tracking"``, which adds what is known of the target; ``"oracle"``, which also
    sees the victim's statistics and error; and each of them with ``"+reported"``, which adds the
    position that the victim itself broadcasts.  The target's motion and the satellites are left out
    as far as they stay the same in the attack window.  The page of each id has the tables of all
    elements, with index, unit, scale and the knowledge that they take.

    **Reward.** With U the undetected displacement so far [m], c the cost and :math:`\kappa` and L
    the settings `alarm_price` and `length_m`, the reward of a step k is

    .. math:: r_k = U_k - U_{k-1} - \kappa L c_k

    U is the largest displacement so far along the target direction; an alarm takes back what was
    gained within the time to alert, and nothing more is gained after it.  The cost is 1 at the
    first alarm; with `twin`, only if the clean twin has not alarmed so far, since that one was
    chance.  The undiscounted return is the undetected displacement less the price of an alarm.
    ``info["reward_*"]`` are the parts, ``info["undetected_displacement_m"]`` is U,
    ``info["cost"]`` c, and ``info["twin_alarm"]`` says whether the twin has alarmed.
    ``info["statistic"]`` and ``info["threshold"]``, after a reset, too, are those of the last epoch
    that the detector has judged, of the channel where their ratio is largest; NaN before the first.

    **Start.** Zero command, after the warm-up.  An alarm in the warm-up is a false alarm, and shows
    in ``info["warmup_alarm"]``; nothing is drawn again for it.

    **End.** `terminated` is set after the last command of the attack window (300 by default), or at
    an alarm. Only an end term sets `truncated`: ``env.spec.max_episode_steps`` is one step more
    than an episode can have.

    **Victim** ``"loosely-coupled"``. An airliner flies with a 15-state filter that is updated by
    positions of GNSS, ten a second, and whose noise tunes itself to the innovations. The spoofer
    shifts those positions; all else, their authentic errors included, stays. The detector watches
    the innovations of the position. It is the receiver of `shadmehri2025`.

    The action is `Box(-1, 1, (2,), float32)`: rates of the offset north and east, over their limit
    (5 m/s by default). Rewards and ends are as above; it starts without an offset. Settings of its
    own are those of `LooselyCoupledSetup`.

    **Victim** ``"snapshot"``. A vehicle goes straight on; its receiver has no filter and no
    inertial sensors. The spoofer has some of the satellites in view, and makes them imply a
    position and a clock that drift away from the true ones; the others stay authentic. The
    detector looks for the satellites that do not fit, and may exclude them from the fix. It is the
    receiver of `wu2024`.

    The action is `Box(-1, 1, (4,), float32)`: rates of the counterfeit displacement north, east,
    down and of the counterfeit clock, over their limits (5 m/s by default). Rewards and ends are as
    above; it starts without a displacement. A fix of one epoch is as noisy as its pseudoranges: the
    largest displacement of an idle spoofer is some metres, or many where satellites are few, so
    compare others with that. The detector is ``srv-raim`` by default. Settings of its own are those
    of `SnapshotSetup`.

    **Victim** ``"wheeled-robot"``. A robot drives round a closed course. Encoders and yaw carry its
    position on between the fixes of GNSS, one a second. The spoofer moves the fixes by an offset;
    the detector compares them with the dead reckoning, and says which of them the filter may
    believe. It is the robot of `song2021`.

    The action is `Box(-1, 1, (2,), float32)`: rates of the offset north and east, over their limit
    (1 m/s by default). Rewards and ends are as above; it starts without an offset. The detector is
    ``acna`` in its production variant by default. Settings of its own are those of
    `WheeledRobotSetup`.

    Parameters
    ----------
    victim : {"tightly-coupled", "loosely-coupled", "snapshot", "wheeled-robot"}
        Kind of receiver, a name in `VICTIMS`; the settings below are those of the first.
    scenario : str, mapping or Scenario
        Flight, errors and sensors: a name in `SCENARIOS`, or a dict of its settings.
    detector : str, mapping or Detector, optional
        A name in `DETECTORS`, a dict with a name and settings, or an object, which is copied; the
        EWMA chart with weights (m = 0.3) by default.
    attack : str, mapping or Attack
        A name in `ATTACKS` or `THREATS`, a dict with name and settings, or an object, copied.
    receiver : str, mapping or TightlyCoupled, optional
        ``"paper"`` or ``"matched"``, or settings of the victim.
    timeline : mapping or Timeline, optional
        Lengths of warm-up, attack window and time to alert.
    knowledge : str
        What the spoofer observes: ``"blind"``, ``"tracking"`` or ``"oracle"``, each alone or with
        ``"+reported"``.
    observation : str, mapping, path, ObservationTerm or sequence of them, optional
        Own list of terms instead of `knowledge`, as `make_terms` takes them.
    action : str, mapping, path, ActionTerm or sequence of them, optional
        Own list of terms instead of the rate set-point.
    reward : str, mapping, path, RewardTerm or sequence of them, optional
        Own list of terms instead of the above.
    end : str, mapping, path, EndTerm or sequence of them, optional
        Own list of terms instead of `end_at_alarm`.
    watch : sequence of str, mapping or Detector
        Passive detectors: they judge the same epochs and change nothing;
        ``info["watch_NAME_alarm"]`` and more report them.
    epoch : bool or sequence of str
        Whether ``info["epochs"]`` has all epochs since the last call, in order, as `Epoch` of one
        receiver each: after a reset those of the monitored start, in the last step also those of
        the time to alert.  True for all fields that the receiver has, or names of the optional ones
        that they are to have; ``"settling"`` adds ``info["settling_epochs"]``, those of the
        filter-only warm-up.
    length_m : float, optional
        Length of the task, in which the price of an alarm is counted: the displacement that
        matters, such as an alert limit; by default the scale of the observed displacement, 40 m of
        a tightly coupled victim.  ``TightlyCoupled-v0`` and ``Offsets-v0`` set 30 m.
    alarm_price : float
        Price of an alarm, in such lengths.
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
    control : {"rate", "offset"}, optional
        Command pseudorange offsets, by their rates or as they are; see
        `spoofgym.attacks.Offsets`.
    basis : {"satellites", "position+clock", "rotated"}, optional
        Axes of these offsets, ``"satellites"`` by default.
    channels : str or sequence of str, optional
        Satellites that are captured, those of the attack by default: ids, a pattern, and with
        offsets ``"5 of 8"``, ``"5 highest"``, ``"5 lowest"`` or ``"5 drawn"``.
    twin : bool
        Whether a clean twin of the victim runs, too: displacement is then the distance from it
        instead of the error less that at the onset, and an alarm costs nothing once the twin has
        alarmed.  It takes up to twice the time.
    warm_pool : int, optional
        Number of receivers that are at their onset; every episode starts as a copy of one of them,
        picked by its seed, with fresh noise from then on. 0: each has a past of its own.  By
        default 256 where the domain draws ages of which any is above five minutes, else 0.  For
        training alone: scores and calibration use every past once.  See `Engine`.
    render_mode : {"human", "rgb_array"}, optional
        Whether a window shows the episode, or `render` returns pictures of it.

    Attributes
    ----------
    observation_names, action_names : tuple of str
        Name of every element.
    detector_setting : object
        Detector that has been set, as it was given; None for the default.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> env = gym.make("spoofgym/TightlyCoupled-v0", knowledge="blind")
    >>> env.unwrapped.observation_names[:2]
    ('own_displacement_along_target', 'own_rate_along_target')
    >>> env.close()
    >>> env = gym.make("spoofgym/Snapshot-v0", knowledge="blind", spoofed=4)
    >>> env.action_space
    Box(-1.0, 1.0, (4,), float32)
    >>> env.close()

    Notes
    -----
    Ids: ``spoofgym/Zhong2025-v0``, ``spoofgym/LooselyCoupled-v0``, ``spoofgym/Snapshot-v0`` and
    ``spoofgym/WheeledRobot-v0`` have the defaults of this class, by victim.
    ``spoofgym/TightlyCoupled-v0`` has the settings of task S1 unless others are given: drawn
    sky, heading and age, a decision every 10 s, and solution separation at 0.2 false alarms an
    hour; ``spoofgym/Offsets-v0`` is the same with offsets of all satellites for an action, by
    rates.  Version history: v0, the first.
    """

    def __init__(
        self, victim: str = DEFAULT_VICTIM, *, render_mode: str | None = None, **settings: Any
    ) -> None:
        core = make_core(select_victim(victim), 1, settings, threads=1, whose=f"victim {victim!r}")
        self.detector_setting: Any = settings.get("detector")
        self.wrapped = False  # whether a wrapper set the detector
        super().__init__(core, render_mode)


class SpoofVectorEnv(CoreVectorEnv[SpoofCore]):
    """Vector environment of `SpoofEnv`; receiver i is the single one seeded with ``seed + i``.

    Parameters
    ----------
    num_envs : int
        Receivers, at least 1.
    victim : str
        As in `SpoofEnv`.
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
    device : {"cpu", "cuda"}, optional
        ``"cuda"``, or ``"cuda:1"``: a `spoofgym.cuda.CudaVectorEnv` is returned instead, with
        tensors of a GPU in and out, and arguments of its own.
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
    >>> envs = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=4)
    >>> envs.single_action_space
    Box(-1.0, 1.0, (1,), float32)
    >>> envs.close()
    """

    def __new__(cls, *given: Any, device: str | None = None, **settings: Any) -> Any:
        """An environment of this class, or on a device."""
        if device in (None, "cpu"):
            return super().__new__(cls)
        from ..cuda import CudaVectorEnv  # the one place that needs its extra

        return CudaVectorEnv(*given, device=device, **settings)

    def __init__(
        self,
        num_envs: int = 1,
        victim: str = DEFAULT_VICTIM,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        infos: InfoSpec = "all",
        threads: int | None = None,
        prefetch: bool | None = None,
        device: str | None = None,
        render_mode: None = None,
        max_episode_steps: int | None = None,
        **settings: Any,
    ) -> None:
        check_vector_settings(num_envs, render_mode)
        kind = select_victim(victim)
        core = make_core(
            kind,
            num_envs,
            settings,
            threads=threads,
            prefetch=kind.threaded if prefetch is None else prefetch,
            whose=f"victim {victim!r}",
        )
        self.detector_setting: Any = settings.get("detector")
        self.wrapped = False
        super().__init__(core, autoreset_mode, infos, max_episode_steps)


# for help(), editors and pages; to a type checker a class has no such attribute
SpoofEnv.__signature__ = expand_signature(SpoofEnv)  # type: ignore[attr-defined]
SpoofVectorEnv.__signature__ = expand_signature(SpoofVectorEnv)  # type: ignore[attr-defined]
