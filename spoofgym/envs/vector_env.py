"""The vector environment of the tightly coupled receiver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gymnasium.vector import AutoresetMode

from ..attacks import Attack
from ..detectors import Detector
from ..receiver import TightlyCoupled
from ..sim.scenario import Scenario
from .domain import Domain
from .game import Game
from .game_vector_env import GameVectorEnv, autoreset_mode_of, check_vector_settings
from .infos import InfoSpec
from .presets import DEFAULT_ATTACK, WatchSpec, make_game, make_setup
from .setup import Timeline
from .terms import ActionSpec, EndSpec, ObservationSpec, RewardSpec


class SpoofVectorEnv(GameVectorEnv[Game]):
    """Vector environment of `SpoofEnv`; receiver i is the single one seeded with ``seed + i``.

    Parameters
    ----------
    num_envs : int
        Receivers, at least 1.
    autoreset_mode : {"next_step", "same_step", "disabled"} or AutoresetMode
        When a finished receiver begins its next episode; with ``disabled``, when ``reset`` is
        called with ``options={"reset_mask": ...}``.
    infos : {"all", "none"} or sequence of str
        Which information is handed out, by its keys; `final_obs` and `final_info` always are.
    max_episode_steps : int, optional
        Of `gymnasium.make_vec`, from a spec: more than an episode has, and without effect.
    threads : int, optional
        Threads of the engine; as many as processors by default.
    prefetch : bool
        Whether one more thread warms up every receiver's next episode while the present one runs,
        also with ``threads=1``.  The bits are the same, unless those of the detector depend on the
        size of the batch: such a one cannot be reproduced with it; see `Engine`.
    scenario, detector, attack, receiver, timeline, knowledge, observation, action, reward, end
        As in `SpoofEnv`.
    watch, alarm_penalty_m, end_at_alarm, target_heading_deg, render_mode
        As in `SpoofEnv`.
    domain, decision_interval_s, between, twin
        As in `SpoofEnv`.

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
    >>> envs = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=4, detector="never")
    >>> envs.single_action_space
    Box(-1.0, 1.0, (2,), float32)
    >>> envs.close()
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        infos: InfoSpec = "all",
        max_episode_steps: int | None = None,
        threads: int | None = None,
        prefetch: bool = True,
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
        render_mode: None = None,
    ) -> None:
        mode = autoreset_mode_of(autoreset_mode)
        check_vector_settings(num_envs, render_mode)
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
            num_envs,
            setup,
            knowledge=knowledge,
            observation=observation,
            action=action,
            reward=reward,
            end=end,
            watch=watch,
            alarm_penalty_m=alarm_penalty_m,
            end_at_alarm=end_at_alarm,
            threads=threads,
            prefetch=prefetch,
            twin=twin,
        )
        self.given_detector: Any = detector
        super().__init__(game, mode, infos, max_episode_steps)
