"""The environment of the tightly coupled receiver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..attacks import Attack
from ..detectors import Detector
from ..receiver import TightlyCoupled
from ..sim.scenario import Scenario
from .domain import Domain
from .game import Game
from .game_env import GameEnv
from .presets import DEFAULT_ATTACK, WatchSpec, make_game, make_setup
from .rendering import GameRecorder, Recorder
from .setup import Timeline
from .terms import ActionSpec, EndSpec, ObservationSpec, RewardSpec


class SpoofEnv(GameEnv[Game]):
    """A spoofer against a tightly coupled GNSS/INS receiver and its detector.

    **Description.** An aircraft flies with a 17-state tightly coupled GNSS/INS filter, whose
    detector watches the innovations.  After a clean warm-up the spoofer counterfeits the
    satellites, and moves the position they tell, one command a GNSS epoch.  It wants the filter's
    position to go astray without an alarm.  All of it is simulated at the level of measurements.

    **Action.** `Box(-1, 1, (a,), float32)`, one element for every commanded axis or channel: 1 is
    the attack's limit of acceleration (0.05 m/s^2 by default) or of rate (5 m/s).  By default north
    and east.  ``env.unwrapped.action_names`` names them.

    **Observation.** `Box` of float32 with finite bounds; every element is scaled and clipped.
    ``env.unwrapped.observation_names`` names them.  What is in it is up to `knowledge`:

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
        Detectors that judge the same epochs and change nothing; ``info["watch_NAME_alarm"]`` and
        more tell of them.
    alarm_penalty_m : float
        Price of an alarm.
    end_at_alarm : bool
        Whether an alarm ends the episode, where `end` does not say it.
    target_heading_deg : float or {"random", "worst"}
        Direction in which displacement counts, clockwise from north; drawn for every episode, and
        observed; or that in which it is largest.
    domain : mapping or Domain, optional
        What differs from episode to episode beside the noise; nothing by default.
    decision_interval_s : float, optional
        Time between decisions; every epoch by default.
    between : {"hold", "linear"}
        What is commanded between them.
    twin : bool
        Whether a clean twin runs beside the victim, and displacement is the distance from it
        instead of the error less that at the onset.  It takes up to twice the time.
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

    def __init__(
        self,
        *,
        scenario: str | Mapping[str, Any] | Scenario = "zhong2025",
        detector: str | Mapping[str, Any] | Detector | None = None,
        attack: str | Mapping[str, Any] | Attack = DEFAULT_ATTACK,
        receiver: str | Mapping[str, Any] | TightlyCoupled | None = None,
        timeline: Mapping[str, float] | Timeline | None = None,
        knowledge: str = "tracking",
        observation: ObservationSpec | None = None,
        action: ActionSpec | None = None,
        reward: RewardSpec | None = None,
        end: EndSpec | None = None,
        watch: WatchSpec = (),
        alarm_penalty_m: float = 10.0,
        end_at_alarm: bool = True,
        target_heading_deg: float | str = 90.0,
        domain: Mapping[str, Any] | Domain | None = None,
        decision_interval_s: float | None = None,
        between: str = "hold",
        twin: bool = False,
        render_mode: str | None = None,
    ) -> None:
        setup = make_setup(
            scenario=scenario,
            receiver=receiver,
            attack=attack,
            detector=detector,
            timeline=timeline,
            domain=domain,
            target_heading_deg=target_heading_deg,
            decision_interval_s=decision_interval_s,
            between=between,
        )
        game = make_game(
            1,
            setup,
            knowledge=knowledge,
            observation=observation,
            action=action,
            reward=reward,
            end=end,
            watch=watch,
            alarm_penalty_m=alarm_penalty_m,
            end_at_alarm=end_at_alarm,
            threads=1,
            twin=twin,
        )
        self.given_detector: Any = detector
        super().__init__(game, render_mode)

    def _recorder(self) -> Recorder | None:
        """What looks at the receiver."""
        return GameRecorder(self.game)
