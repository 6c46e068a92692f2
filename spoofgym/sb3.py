"""Stable-baselines3's vector environment, straight on the engine.

All receivers are one batch of `Game`; there is no list of environments underneath, and no
dictionary is filled for a receiver before its episode ends.

>>> from stable_baselines3 import PPO
>>> from spoofgym.sb3 import SpoofVecEnv
>>> envs = SpoofVecEnv(8, detector="ewma", knowledge="blind", alarm_penalty_m=40.0)
>>> model = PPO("MlpPolicy", envs, gamma=1.0, n_steps=300, batch_size=2400, device="cpu")
>>> envs.close()

Install it with the extra ``train``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from .attacks import Attack
from .detectors import Detector
from .envs.domain import Domain
from .envs.game_env import told_domain
from .envs.game_vector_env import check_vector_settings
from .envs.infos import InfoSpec, chosen, info_keys
from .envs.played import Turn
from .envs.presets import DEFAULT_ATTACK, WatchSpec, make_game, make_setup
from .envs.recorder import EpochRecorder
from .envs.resets import HALFWAY, warn_unknown, whole_reset
from .envs.setup import Timeline
from .envs.spaces import action_space, checked_action, observation_space
from .envs.tally import Tally
from .envs.terms import ActionSpec, EndSpec, ObservationSpec, RewardSpec, make_terms
from .receiver import TightlyCoupled
from .sim.scenario import Scenario

Array = NDArray[Any]
AT_THE_END = ("undetected_displacement_m", "detected", "warmup_alarm", "coasting", "cost")
"""What is told of every episode, beside the detectors that watch."""


class SpoofVecEnv(VecEnv):
    """`SpoofEnv` for stable-baselines3; receiver i is the single environment seeded ``seed + i``.

    A finished receiver begins its next episode within the same step: what `step` returns is the
    first observation of that episode, and ``infos[i]["terminal_observation"]`` the last one of the
    old.  ``infos[i]`` holds what `infos` asks for, and in the step that ends an episode also

    - ``terminal_observation``, and ``TimeLimit.truncated``, which is False unless an end term
      truncates, since the time left is observed and an alarm is an end;
    - ``episode`` with return ``r``, length ``l`` in decisions and seconds since the environment was
      made ``t``, as `VecMonitor` would write it, which is not needed around this;
    - ``undetected_displacement_m``, ``detected``, ``warmup_alarm`` and ``coasting`` of the episode,
      ``cost`` of the step, and ``watch_*`` of the detectors that watch.

    Parameters
    ----------
    num_envs : int
        Receivers, at least 1.
    threads : int, optional
        Threads of the engine; as many as processors by default.
    prefetch : bool
        Whether one more thread warms up the next episodes while the policy learns, also with
        ``threads=1``.  The bits are the same, unless those of the detector depend on the size of
        the batch: such a one cannot be reproduced with it; see `Engine`.
    torch_threads : int or None
        Threads of torch, for the whole process; None leaves them as they are.  Two of them fought
        with other threads over two processors at a seventieth of the speed of one.
    seed : int, optional
        As ``seed(seed)`` before the first reset.
    infos : {"none", "all"} or sequence of str
        Which information of every step is handed out, by its keys, such as ``["cost"]``.
    scenario, detector, attack, receiver, timeline, knowledge, observation, action, reward, end
        As in `SpoofEnv`.
    watch, alarm_penalty_m, end_at_alarm, target_heading_deg, domain, decision_interval_s, between
        As in `SpoofEnv`.
    twin
        As in `SpoofEnv`.

    Attributes
    ----------
    game : Game
        The receivers.
    observation_names, action_names : tuple of str
        Name of every element.
    """

    def __init__(
        self,
        num_envs: int,
        *,
        threads: int | None = None,
        prefetch: bool = True,
        torch_threads: int | None = 1,
        seed: int | None = None,
        infos: InfoSpec = "none",
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
    ) -> None:
        check_vector_settings(num_envs, None)
        if torch_threads is not None:
            if torch_threads < 1:
                raise ValueError(f"`torch_threads` must be at least 1, got {torch_threads}")
            # stable-baselines3 has loaded it; nothing here needs it otherwise
            sys.modules["torch"].set_num_threads(torch_threads)
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
        self.game = make_game(
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
        self.observation_names = self.game.observer.names
        self.action_names = self.game.action_names
        self._keys = info_keys(infos, self.game.info_names)
        self.render_mode = None
        self._rngs: list[np.random.Generator] = []
        self._actions: Array | None = None
        self._halfway = False
        self._returns = np.zeros(num_envs)
        self._began = time.perf_counter()
        super().__init__(num_envs, observation_space(self.game), action_space(self.game))
        if seed is not None:
            self.seed(seed)

    def reset(self) -> Array:
        """Begin a new episode in every receiver.

        Receivers begin anew where `seed` has been called since the last reset, and go on to their
        next episodes otherwise.

        Returns
        -------
        ndarray
            (B, o) float32.
        """
        if not self._rngs:
            self._rngs = [np.random.default_rng(seed) for seed in self._seeds]
        else:
            self._rngs = [
                rng if seed is None else np.random.default_rng(seed)
                for rng, seed in zip(self._rngs, self._seeds, strict=True)
            ]
        given = self._told()
        self._reset_seeds()
        self._reset_options()
        with whole_reset(self):
            self.game.reset(self._rngs, given=given)
        self._returns[:] = 0.0
        self._actions = None
        return self.game.observe()

    def step_async(self, actions: Array) -> None:
        """Take the commands of the next step.

        Parameters
        ----------
        actions : ndarray
            (B, a) in [-1, 1].
        """
        if not self._rngs:
            raise RuntimeError("call reset() before step()")
        if self._halfway:
            raise RuntimeError(HALFWAY)
        shape = (self.num_envs, len(self.action_names))
        self._actions = checked_action(actions, shape, self.action_names)

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
        """Run one epoch.

        Returns
        -------
        observations : ndarray
            (B, o) float32; the first of the next episode where one has ended.
        rewards : ndarray
            (B,) float32.
        dones : ndarray
            (B,) bool.
        infos : list of dict
            One per receiver.
        """
        if self._actions is None:
            raise RuntimeError("call step_async() before step_wait()")
        self._halfway = True
        turn, observations = self.game.turn(self._actions)
        self._actions = None
        self._returns += turn.reward
        infos = self._each(turn)
        over = turn.terminated | turn.truncated
        if over.any():
            rows, told = np.flatnonzero(over), turn.info
            for row in rows.tolist():
                infos[row] |= self._at_the_end(row, observations, told)
                infos[row]["TimeLimit.truncated"] = bool(turn.truncated[row])
            self.game.reset([self._rngs[row] for row in rows], rows)
            self._returns[rows] = 0.0
            observations = self.game.observe()
        self._halfway = False
        return observations, turn.reward.astype(np.float32), over, infos

    def _at_the_end(self, row: int, observations: Array, info: dict[str, Array]) -> dict[str, Any]:
        return {
            "terminal_observation": observations[row].copy(),
            "episode": {
                "r": round(float(self._returns[row]), 6),
                "l": -(-int(self.game.step_count[row]) // self.game.setup.repeat),
                "t": round(time.perf_counter() - self._began, 6),
            },
            **{name: info[name][row].item() for name in info if _is_of_the_end(name)},
        }

    def _each(self, turn: Turn | Tally) -> list[dict[str, Any]]:
        """Information of every receiver that is asked for."""
        if self._keys is not None and not self._keys:
            return [{} for _ in range(self.num_envs)]
        told = {name: array.tolist() for name, array in chosen(turn.info, self._keys).items()}
        return [{name: told[name][row] for name in told} for row in range(self.num_envs)]

    def _told(self) -> dict[str, list[Any]] | None:
        """Circumstances that `set_options` tells of every receiver."""
        for options in self._options:
            warn_unknown(options, ("domain",))
        told = [told_domain(options) or {} for options in self._options]
        names = set(told[0])
        if any(set(each) != names for each in told):
            raise ValueError(
                "the option `domain` must tell the same circumstances of every receiver, got "
                f"{told}"
            )
        return {name: [each[name] for each in told] for name in told[0]} or None

    def set_rewards(self, terms: RewardSpec) -> None:
        """Reward otherwise from the next step on, such as with another alarm penalty.

        Parameters
        ----------
        terms : str, mapping, path, RewardTerm or sequence of them
            As ``reward=`` of `SpoofEnv`.
        """
        self.game.set_rewards(make_terms("reward", terms))

    def close(self) -> None:
        """End the threads."""
        self.game.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Attribute of the environment, once for every receiver.

        Parameters
        ----------
        attr_name : str
            Its name.
        indices : int or sequence of int, optional
            Which receivers.

        Returns
        -------
        list
            The same value for all, since they share it.
        """
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all receivers.

        Parameters
        ----------
        attr_name : str
            Its name.
        value : object
            For all of them.
        indices : None
            Some of them can't have a value of their own.
        """
        if indices is not None:
            raise ValueError(f"`indices` must be None, receivers share attributes; got {indices!r}")
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environment, once for all receivers.

        Parameters
        ----------
        method_name : str
            Its name.
        *method_args
            Its arguments.
        indices : None
            There is one environment for all of them.
        **method_kwargs
            Its named arguments.

        Returns
        -------
        list
            The result, once for every receiver.
        """
        if indices is not None:
            raise ValueError(f"`indices` must be None, receivers are one batch; got {indices!r}")
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Whether receivers are wrapped.

        Parameters
        ----------
        wrapper_class : type
            Any.
        indices : int or sequence of int, optional
            Which receivers.

        Returns
        -------
        list of bool
            False: a batch can't be wrapped one by one.
        """
        return [False for _ in self._get_indices(indices)]


class RecordEpochs(VecEnvWrapper):
    """Writes every epoch of the commands into Parquet files, one an episode of a receiver.

    The twin of `spoofgym.envs.wrappers.RecordEpochs`, for stable-baselines3.

    Parameters
    ----------
    venv : VecEnv
        A `SpoofVecEnv`, in other wrappers or not.
    folder : str or Path
        Where the files go.

    Raises
    ------
    TypeError
        When there is no `SpoofVecEnv` inside.
    """

    def __init__(self, venv: VecEnv, folder: str | Path) -> None:
        super().__init__(venv)
        inner: Any = venv
        while isinstance(inner, VecEnvWrapper):
            inner = inner.venv
        if not isinstance(inner, SpoofVecEnv):
            raise TypeError(f"this wrapper needs a SpoofVecEnv, wrapped or not, got {inner!r}")
        self.recorder = EpochRecorder(folder, self.num_envs)
        inner.game.listeners.append(self.recorder)

    def reset(self) -> Any:
        """Begin episodes; those that are not over are written as they are.

        Returns
        -------
        ndarray
            (B, o) of the environment.
        """
        self.recorder.finish(np.arange(self.num_envs), complete=False)
        return self.venv.reset()

    def step_wait(self) -> tuple[Any, Array, Array, list[dict[str, Any]]]:
        """Run one step, and write the episodes that it has ended.

        Returns
        -------
        observations, rewards, dones, infos
            Of the environment.
        """
        result: tuple[Any, Array, Array, list[dict[str, Any]]] = self.venv.step_wait()
        if result[2].any():
            self.recorder.finish(np.flatnonzero(result[2]), complete=True)
        return result

    def close(self) -> None:
        """Write episodes that are not over, and close the environment."""
        self.recorder.finish(np.arange(self.num_envs), complete=False)
        super().close()


def _is_of_the_end(name: str) -> bool:
    return name in AT_THE_END or name.startswith("watch_")
