"""Receivers of the engine as a vector environment of stable-baselines3."""

from __future__ import annotations

import inspect
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from ..core.registry import whole_number
from ..detectors.build import DetectorSpec
from ..duel.learner import LearnersSide
from ..envs import options as opt
from ..envs.factory import compose, expand_signature
from ..envs.scoring import PlainResult, StepResult
from ..envs.terms import RewardSpec, make_terms
from ..spoofers.build import SpooferSpec
from ..wrappers.outside import warn_uncalibrated

AT_THE_END = (
    "undetected_displacement_m",
    "detected",
    "warmup_alarm",
    "coasting",
    "cost",
    "attacked",
)
"""What is reported at the end of every episode, with that of passive detectors."""


class SpoofVecEnv(VecEnv):
    """An environment for stable-baselines3; receiver i is the single one seeded ``seed + i``.

    A finished receiver starts its next episode within the same step: what `step` returns is the
    first observation of that episode, and ``infos[i]["terminal_observation"]`` the last one of the
    old.  ``infos[i]`` holds what `infos` requests, and in the step that ends an episode also

    - ``terminal_observation``, and ``TimeLimit.truncated``, which is False unless an end term
      truncates, since the time left is observed and an alarm is an end;
    - ``episode`` with return ``r``, length ``l`` in decisions and seconds since the environment was
      made ``t``, as `VecMonitor` would write it, which is not needed around this;
    - ``undetected_displacement_m``, ``detected``, ``warmup_alarm`` and ``coasting`` of the episode,
      ``cost`` of the step, and ``watch_*`` of the passive detectors.

    Parameters
    ----------
    num_envs : int
        Receivers, at least 1.
    env_id : str, optional
        Id of the environment, for any kind of victim; by default ``spoofgym/TightlyCoupled-v0``, or
        with a `scenario` ``spoofgym/Zhong2025-v0``.
    task : str, optional
        ``"S1"`` to ``"S3"``, or ``"T1"`` to ``"T6"``, in its place.  A `detector` replaces the
        task's: the world is still the task's.
    side : {"spoofer", "detector"}
        Who learns.  A detector learns against a pool of spoofers, as in `DetectorView`.
    pool : list, optional
        Frozen opponents, of which one is drawn for every episode, as `SpooferView` and
        `DetectorView` take them; a spoofer has a single ``detector`` without one.  With a pool, or
        the detector's side, the world is that of the duel unless an id, a task or a ``scenario``
        is given.
    weights : sequence of float, optional
        Probability of each of the pool.
    threads : int, optional
        Threads of the engine; all useful cores by default.
    prefetch : bool
        Whether the next episodes are warmed up in the spare time of the threads, while the policy
        learns, with ``threads=1`` by one thread more.  The bits are the same, unless those of the
        detector depend on the size of the batch: runs with such a one are then not reproducible;
        see `Engine`.
    torch_threads : int or None
        Threads of torch, for the whole process; None leaves them as they are.  Two of them,
        beside other threads on two processors, ran at a seventieth of the speed of one.
    seed : int, optional
        As ``seed(seed)`` before the first reset.
    infos : {"none", "all"} or sequence of str
        Which information of every step is handed out, by its keys, such as ``["cost"]``.
    **settings
        As in the environment, such as `SpoofEnv`.  The defaults shown are those of that class, and
        so of ``spoofgym/Zhong2025-v0``; an id or a task has settings of its own above them, which
        ``spoofgym list ID`` prints.

    Attributes
    ----------
    core : SpoofCore or DetectorCore
        The receivers.
    env_id, env_kwargs : str and dict
        What it was made from, for a card.
    observation_names, action_names : tuple of str
        Name of every element.
    """

    __signature__: ClassVar[inspect.Signature]

    def __init__(
        self,
        num_envs: int,
        *,
        env_id: str | None = None,
        task: str | None = None,
        side: str = "spoofer",
        pool: Any = None,
        weights: Sequence[float] | None = None,
        threads: int | None = None,
        prefetch: bool = True,
        torch_threads: int | None = 1,
        seed: int | None = None,
        infos: opt.InfoSpec = "none",
        **settings: Any,
    ) -> None:
        opt.check_vector_settings(num_envs, None)
        if seed is not None:
            seed = whole_number("`seed`", seed)
        if torch_threads is not None:
            torch_threads = whole_number("`torch_threads`", torch_threads, 1)
            # stable-baselines3 has loaded it; nothing here needs it otherwise
            sys.modules["torch"].set_num_threads(torch_threads)
        made = LearnersSide.of(env_id, task, side, pool, weights, settings)
        self.side, self.env_id, self.env_kwargs = made.side, made.card_id, made.card_kwargs()
        self.detector_setting = settings.get("detector") if made.pool is None else made.pool
        self.wrapped = False
        self._infos = infos
        self.adopt(made.core(num_envs, threads, prefetch, type(self).__name__))
        self.render_mode = None
        self._rngs: list[np.random.Generator] = []
        self._actions: opt.Array | None = None
        self._halfway = False
        self._returns, self._lengths = np.zeros(num_envs), np.zeros(num_envs, dtype=np.int64)
        self._began = time.perf_counter()
        super().__init__(num_envs, self.observation_space, self.action_space)
        if seed is not None:
            self.seed(seed)

    def adopt(self, core: Any) -> None:
        """Take a core that has not started, instead of the present one."""
        self.core = core
        self.observation_names, self.action_names = core.observation_names, core.action_names
        self.observation_space, self.action_space = (
            opt.observation_space(core),
            opt.action_space(core),
        )
        self._keys = opt.info_keys(self._infos, core.info_names)

    @property
    def is_started(self) -> bool:
        """Whether an episode has started."""
        return bool(self._rngs)

    def reset(self) -> opt.Array:
        """Start a new episode in every receiver, seeded as `seed` said since the last: (B, o)."""
        self._rngs = opt.reseed(self._rngs, self._seeds, np.ones(self.num_envs, dtype=np.bool_))
        given = self._read_domain()
        self._reset_seeds()
        self._reset_options()
        with opt.whole_reset(self):
            self.core.reset(self._rngs, given=given)
        self._report_starts(range(self.num_envs))
        self._returns[:] = self._lengths[:] = 0
        self._actions = None
        return np.asarray(self.core.observe())

    def step_async(self, actions: opt.Array) -> None:
        """Take the commands (B, a) in [-1, 1] of the next step."""
        if not self._rngs:
            raise RuntimeError("call reset() before step()")
        if self._halfway:
            raise RuntimeError(opt.HALFWAY)
        shape = (self.num_envs, len(self.action_names))
        self._actions = opt.checked_action(actions, shape, self.action_names)

    def step_wait(self) -> tuple[opt.Array, opt.Array, opt.Array, list[dict[str, Any]]]:
        """Run one decision; where an episode has ended, the next one is observed."""
        if self._actions is None:
            raise RuntimeError("call step_async() before step_wait()")
        self._halfway = True
        result, observations = self.core.step(self._actions)
        self.result = result
        self._actions = None
        self._returns += result.reward
        self._lengths += 1
        infos = self._each(result)
        over = result.terminated | result.truncated
        if over.any():
            observations = self.end_episodes(over, observations, infos)
        self._halfway = False
        return observations, result.reward.astype(np.float32), over, infos

    def end_episodes(
        self, over: opt.Array, observations: opt.Array, infos: list[dict[str, Any]]
    ) -> opt.Array:
        """End the episodes of some receivers, (B,) bool, after a step, and start the next ones.

        A wrapper that ends episodes calls it with what `step_wait` has returned.

        Parameters
        ----------
        over : ndarray
            (B,) bool, which ones.
        observations : ndarray
            (B, o), the last ones.
        infos : list of dict
            Of the step; what an episode's last step has is added.

        Returns
        -------
        ndarray
            (B, o), where an episode is over the first ones of the next.
        """
        rows, info = np.flatnonzero(over), self.result.info
        for row in rows.tolist():
            infos[row] |= self._at_the_end(row, observations, info)
            infos[row]["TimeLimit.truncated"] = bool(self.result.truncated[row])
        self.core.reset([self._rngs[row] for row in rows], rows)
        self._report_starts(rows.tolist())
        self._returns[rows] = self._lengths[rows] = 0
        return np.asarray(self.core.observe())

    def _report_starts(self, rows: Iterable[int]) -> None:
        self.starts = self.core.reset_info()
        for row in rows:
            self.reset_infos[row] = select_receiver_info(self.starts, row)

    def _at_the_end(
        self, row: int, observations: opt.Array, info: dict[str, opt.Array]
    ) -> dict[str, Any]:
        return {
            "terminal_observation": observations[row].copy(),
            "episode": {
                "r": round(float(self._returns[row]), 6),
                "l": int(self._lengths[row]),
                "t": round(time.perf_counter() - self._began, 6),
            },
            **{
                name: info[name][row].item()
                for name in info
                if name in AT_THE_END or name.startswith("watch_")
            },
        }

    def _each(self, result: StepResult | PlainResult) -> list[dict[str, Any]]:
        if self._keys is not None and not self._keys:
            return [{} for _ in range(self.num_envs)]
        wanted = opt.select_info(result.info, self._keys)
        lists = {name: array.tolist() for name, array in wanted.items()}
        return [{name: lists[name][row] for name in lists} for row in range(self.num_envs)]

    def _read_domain(self) -> dict[str, list[Any]] | None:
        for options in self._options:
            opt.warn_unknown(options, ("domain",))
        given = [opt.domain_option(options) or {} for options in self._options]
        names = set(given[0])
        if any(set(each) != names for each in given):
            raise ValueError(
                "the option `domain` must give the same circumstances for every receiver, got "
                f"{given}"
            )
        return {name: [each[name] for each in given] for name in given[0]} or None

    def set_rewards(self, terms: RewardSpec) -> None:
        """Reward by other terms from the next step on, as ``reward=`` of `SpoofEnv` takes them."""
        if self.side == "detector":
            raise ValueError("a detector is paid by the rules of the duel: set its `payoff`")
        self.core.set_rewards(make_terms("reward", terms))

    def close(self) -> None:
        """End the threads."""
        self.core.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Attribute of the environment, the same once for every receiver."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all receivers, which share it."""
        if indices is not None:
            raise ValueError(f"`indices` must be None, receivers share attributes; got {indices!r}")
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environment once; its result once for every receiver."""
        if indices is not None:
            raise ValueError(f"`indices` must be None, receivers are one batch; got {indices!r}")
        return [getattr(self, method_name)(*method_args, **method_kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """False for every receiver: a batch can't be wrapped one by one."""
        return [False for _ in self._get_indices(indices)]


def select_receiver_info(arrays: Mapping[str, opt.Array], row: int) -> dict[str, Any]:
    """Plain values of one receiver, by key."""
    return {name: arrays[name][row : row + 1].tolist()[0] for name in arrays}


SpoofVecEnv.__signature__ = expand_signature(SpoofVecEnv)


class _Composed(VecEnvWrapper):
    """Something that is set in the environment, which steps as before."""

    def reset(self) -> Any:
        """Start a new episode in every receiver."""
        return self.venv.reset()

    def step_wait(self) -> Any:
        """Run one decision."""
        return self.venv.step_wait()


class DetectorWrapper(_Composed):
    """Sets the detector in the loop, as `spoofgym.wrappers.DetectorWrapper` does.

    Parameters
    ----------
    venv : SpoofVecEnv
        Of the spoofer's side without a pool, wrapped or not, not reset yet.
    detector, false_alarms_per_hour
        As there.
    """

    def __init__(
        self, venv: VecEnv, detector: DetectorSpec, *, false_alarms_per_hour: float | None = None
    ) -> None:
        compose(venv, detector=detector, false_alarms_per_hour=false_alarms_per_hour)
        inner: Any = venv.unwrapped
        setup = inner.core.setup
        warn_uncalibrated(detector, setup.detector, false_alarms_per_hour, setup)
        rate = {"false_alarms_per_hour": false_alarms_per_hour} if false_alarms_per_hour else {}
        spec: Any = {"name": detector} if isinstance(detector, str) and rate else detector
        inner.env_kwargs["detector"] = {**spec, **rate} if isinstance(spec, Mapping) else spec
        super().__init__(venv)


class ResidualAction(_Composed):
    """Makes actions corrections of a base attack, as `spoofgym.wrappers.ResidualAction` does.

    Parameters
    ----------
    venv : SpoofVecEnv
        Of the spoofer's side without a pool, wrapped or not, not reset yet.
    spoofer, scale
        As there.
    """

    def __init__(self, venv: VecEnv, spoofer: SpooferSpec, scale: float | None = None) -> None:
        compose(venv, base=spoofer, scale=scale)
        super().__init__(venv)
