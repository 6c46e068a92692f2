"""A vector environment whose receivers, actions, observations and rewards stay on a device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ..core.registry import check_choice, whole_number
from ..envs._kernels import GAIN, REWARD, TERMINATED
from ..envs.env import HasSpec
from ..envs.factory import DEFAULT_VICTIM, make_core, select_victim
from ..envs.options import (
    TOLERANCE,
    InfoSpec,
    action_space,
    check_vector_settings,
    checked_seed,
    info_keys,
    observation_space,
    parse_autoreset_mode,
)
from ..envs.scoring import MARK_NAMES
from ..envs.terms.observation import (
    GainWeight,
    SatelliteGeometry,
    StatisticRatio,
    TargetDirection,
    TargetMotion,
    Time,
)
from ..simulation.simulator import FilterDiverged
from ..simulation.tight import AFTER_ONSET
from ..truth.sensors import SOURCES
from . import _kernels
from ._lanes import SIMULATED
from .memory import Tensors, put, view_for_kernels
from .pool import Pool, launch
from .supported import check_epochs, check_memory, check_supported, import_torch

PASTS = 16_384
FINAL = "final_obs"


class CudaVectorEnv(HasSpec, VectorEnv[Any, Any, Any]):
    """Receivers on a GPU under attack, with tensors of the device in and out.

    What ``SpoofVectorEnv(device="cuda")`` and ``gymnasium.make_vec(id, device="cuda")`` return.
    It has the score, reward and observation of `SpoofVectorEnv`, and resets in the same step.  An
    episode starts as a copy of one of `pasts` receivers at their onset, which its number, its
    receiver and the seed pick, and has noise of its own from there on.

    Parameters
    ----------
    num_envs : int
        Receivers, at least 1.
    victim : str
        Only ``"tightly-coupled"``.
    device : str
        A CUDA device of PyTorch, such as ``"cuda"`` or ``"cuda:1"``.
    pasts : int
        Warmed-up receivers that episodes start from.
    autoreset_mode : {"same_step"} or AutoresetMode
        There is no other.
    infos : {"all", "none"} or sequence of str
        Which information is handed out, by its keys, and ``"final_obs"``.
    render_mode : None
        There is nothing to render.
    max_episode_steps : int, optional
        Of `gymnasium.make_vec`, from a spec; without effect.
    **settings
        As in `SpoofEnv`; a setting that a device lacks is a ValueError with its name.
    """

    def __init__(
        self,
        num_envs: int = 1,
        victim: str = DEFAULT_VICTIM,
        *,
        device: str = "cuda",
        pasts: int = PASTS,
        autoreset_mode: str | AutoresetMode = AutoresetMode.SAME_STEP,
        infos: InfoSpec = "none",
        render_mode: None = None,
        max_episode_steps: int | None = None,
        **settings: Any,
    ) -> None:
        check_vector_settings(num_envs, render_mode)
        whole_number("`pasts`", pasts, 1)
        if parse_autoreset_mode(autoreset_mode) is not AutoresetMode.SAME_STEP:
            raise ValueError("device='cuda' resets in the same step: `autoreset_mode` 'same_step'")
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
        self.render_mode, self.num_envs = None, num_envs
        check_choice("device", str(device).partition(":")[0], ("cuda",))
        self._torch = torch = import_torch()
        self.device = torch.device("cpu" if SIMULATED else device)
        settings = {**settings, "warm_pool": 0}
        core = make_core(select_victim(victim), pasts, settings, whose=f"victim {victim!r}")
        check_supported(core)
        self.core, self._layout = core, core._fused.layout
        self.observation_names, self.action_names = core.observation_names, core.action_names
        self.single_observation_space, self.single_action_space = (
            observation_space(core),
            action_space(core),
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._keys = info_keys(infos, (*self._layout.names, FINAL))
        with torch.no_grad():
            self._pool = Pool(torch, core, self.device, self._stream)
            self._allocate()
        self._started = False

    @property
    def _stream(self) -> Any:
        """The stream of PyTorch, for numba; the simulator has none."""
        if self.device.type == "cpu":
            return 0
        from numba import cuda

        return cuda.external_stream(self._torch.cuda.current_stream(self.device).cuda_stream)

    def _allocate(self) -> None:
        torch, core, pool, b = self._torch, self.core, self._pool, self.num_envs
        setup, layout = core.setup, pool.layout
        check_epochs(core.engine.simulator.onset, setup.steps, setup.hold, len(setup.epoch_time))
        if self.device.type != "cpu":
            free, _ = torch.cuda.mem_get_info(self.device)
            largest = 8 * (setup.steps + 1 + self._layout.numbers + 3)
            check_memory(b, pool.bytes_each + largest, 0, free)
        arrays: dict[str, Any] = layout.scratch(b)
        alike = [name for name in ("assumed", "constants") if pool.lasting[name].shape[0] == 1]
        for name, past in pool.lasting.items():
            host = past[:1].cpu().numpy()
            host = host.view(np.uint64) if name in pool.words else host
            arrays[name] = host if name in alike else np.zeros((b, *host.shape[1:]), host.dtype)
        self._lasting = [name for name in pool.lasting if name not in alike]
        axes, elements, observed = (
            len(setup.action_names),
            len(self.action_names),
            len(core.observation_names),
        )
        action = np.zeros((b, elements))
        terms = {type(term) for term, _ in core.observer._parts}
        arrays |= {
            "action": action,
            "seen": np.zeros((b, observed), dtype=np.float32),
            "motion": np.zeros((b if TargetMotion in terms else 0, 6), dtype=np.float32),
            "time": np.zeros((b if Time in terms else 0, 2), dtype=np.float32),
            "command": np.zeros((b, axes)),
            **{name: np.zeros(b, dtype=np.int64) for name in ("step_count", "number", "picked")},
            **{name: np.zeros(b, dtype=np.bool_) for name in ("detected", "ended", "no_rows")},
            "undetected": np.zeros(b),
        }
        self._arrays = Tensors(torch, arrays, self.device)
        if core.commands.is_plain:
            self._arrays.views["command"] = self._arrays.views["action"]
        _, rules, per_rate, table = core._fused._fixed
        motion = next((t for t, _ in core.observer._parts if isinstance(t, TargetMotion)), None)
        scales = (1.0, 1.0)
        if motion is not None:
            scales = 1.0 / motion.position_scale_m, 1.0 / motion.velocity_scale_mps
        rows = {
            "largest": np.zeros((setup.steps + 1, b)),
            "values": np.zeros((self._layout.numbers + 3, b)),
            "marks": np.zeros((8, b), dtype=np.bool_),
            "rules": rules,
            "per_rate": np.asarray(per_rate, dtype=np.float64),
            "table": table,
            "following": core.commands._rules,
            "scales": np.array(scales),
            "seed": np.zeros(2, dtype=np.uint64),
            "sources": np.array([SOURCES.index(name) for name in AFTER_ONSET]),
        }
        self._rows = Tensors(torch, rows, self.device, shared=True)
        self._receivers = layout.name_receivers(self._arrays)
        self._shared = pool.shared.name_views(_kernels.Shared)
        views = self._arrays.views | self._rows.views
        self._episodes = _kernels.Episodes(*(views[name] for name in _kernels.Episodes._fields))
        self._copies = [self._pair(name) for name in self._lasting]
        bounds = {"low": core.bounds[0], "high": core.bounds[1]}
        self._bounds = {name: put(torch, each, self.device) for name, each in bounds.items()}
        self._geometry = None
        if SatelliteGeometry in terms:
            table = np.asarray(setup.geometry_table(), dtype=np.float32)
            self._geometry = put(torch, table, self.device, shared=True)

    def _pair(self, name: str) -> tuple[Any, Any]:
        """A lasting quantity of the receivers and of the pasts, with all its columns in one axis."""

        def flatten(tensor: Any) -> Any:
            columns = tensor[0].numel() if tensor.ndim > 1 else 1
            strides = 1, tensor.shape[0]
            flat = tensor.as_strided((tensor.shape[0], columns), strides)
            return view_for_kernels(flat, name in self._pool.words)

        return flatten(self._arrays[name]), flatten(self._pool.lasting[name])

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in every receiver.

        Parameters
        ----------
        seed : int, optional
            Of all episodes from here on; without one the present ones go on with the next.
        options : mapping, optional
            There are none.

        Returns
        -------
        observation : Tensor
            (B, o) float32.
        info : dict
            Empty.
        """
        if options:
            raise ValueError(f"device='cuda' has no options of a reset, got {sorted(options)}")
        super().reset(seed=checked_seed(seed))
        if seed is not None or not self._started:
            words = self.np_random.integers(2**63, size=2, dtype=np.int64)
            self._rows["seed"].copy_(self._torch.from_numpy(words))
            self._arrays["number"].zero_()
        self._arrays["faults"].zero_()
        self._arrays["ended"].fill_(True)
        self._restart()
        self._started = True
        return self._observe(), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Give one command to every receiver, and run one epoch.

        Parameters
        ----------
        actions : Tensor
            (B, a) in [-1, 1], on the device.

        Returns
        -------
        observation : Tensor
            (B, o) float32; of the next episode where one has ended.
        reward : Tensor
            (B,) float64.
        terminated, truncated : Tensor
            (B,) bool; the second is False.
        info : dict
            Tensors (B,) by the keys that have been requested; ``"final_obs"`` (B, o) is what was
            observed before the reset.

        Raises
        ------
        RuntimeError
            Before the first reset.
        TypeError, ValueError
            For actions that are no tensor of the device, of another shape, or not in [-1, 1].
        FilterDiverged
            When a filter has had no position since the last step.
        """
        if not self._started:
            raise RuntimeError("call reset() before step()")
        torch, arrays, rows = self._torch, self._arrays, self._rows
        self._check(actions)
        with torch.no_grad():
            arrays["action"].copy_(actions)
            rows["marks"].zero_()
            rest = self._pool.layout.attack, self._pool.layout.detector
            known = self._receivers, self._shared, self._episodes
            launch("play", self.num_envs, self._stream, *known, *rest)
            reward = rows["values"][REWARD].clone()
            terminated = rows["marks"][TERMINATED].clone()
            info = self._report()
            self._restart()
            observation = self._observe()
        return observation, reward, terminated, torch.zeros_like(terminated), info

    def check(self) -> None:
        """Raise what kernels have found: `FilterDiverged`, or a verdict that is not finite."""
        faults = self._arrays["faults"]
        if not bool(faults.any()):
            return
        b = int((faults != 0).nonzero()[0])
        if int(faults[b]) & _kernels.DIVERGED:
            raise FilterDiverged(f"the filter of receiver {b} of {self.num_envs} has diverged")
        raise ValueError(f"the detector's verdict on receiver {b} is not finite")

    def _check(self, actions: Any) -> None:
        torch, shape = self._torch, (self.num_envs, len(self.action_names))
        if not isinstance(actions, torch.Tensor) or actions.device.type != self.device.type:
            found = getattr(actions, "device", type(actions).__name__)
            raise TypeError(f"actions must be a tensor on {self.device}, got one on {found}")
        if tuple(actions.shape) != shape:
            names = ", ".join(self.action_names)
            raise ValueError(f"actions must have shape {shape} ({names}), got {actions.shape}")
        inside = (actions.abs() <= 1.0 + TOLERANCE).all()
        if bool(torch.logical_and(inside, ~self._arrays["faults"].any())):
            return
        self.check()
        raise ValueError("actions must be in [-1, 1], and some are not, or are NaN")

    def _report(self) -> dict[str, Any]:
        names, wanted = self._layout.names, self._keys
        numbers = names[: self._layout.numbers]
        keys = (*names, FINAL) if wanted is None else wanted
        info: dict[str, Any] = {}
        for name in keys:
            if name == FINAL:
                info[name] = self._observe()
            elif name in numbers:
                info[name] = self._rows["values"][numbers.index(name)].clone()
            else:
                info[name] = self._rows["marks"][MARK_NAMES.index(name)].clone()
        return info

    def _restart(self) -> None:
        b, stream, words = self.num_envs, self._stream, self._rows.views["seed"]
        launch("pick", b, stream, self._episodes, words, self.core.receivers)
        for to, past in self._copies:
            launch("take", b, stream, to, past, self._episodes.picked)
        sources = self._rows.views["sources"]
        launch("renew", b, stream, self._episodes, self._receivers.keys, words, sources)

    def _observe(self) -> Any:
        arrays, torch, n = self._arrays, self._torch, self._pool.layout.channels
        known = self._receivers, self._shared, self._episodes
        launch("look", self.num_envs, self._stream, *known)
        seen = arrays["seen"]
        for term, part in self.core.observer._parts:
            if isinstance(term, Time):
                seen[:, part] = arrays["time"]
            elif isinstance(term, TargetMotion):
                seen[:, part] = arrays["motion"]
            elif isinstance(term, TargetDirection):
                seen[:, part] = arrays["direction"].to(seen.dtype)
            elif isinstance(term, SatelliteGeometry):
                seen[:, part] = self._geometry[arrays["epochs"]]
            elif isinstance(term, GainWeight):
                seen[:, part] = arrays["weights"][:, :n].to(seen.dtype)
            elif isinstance(term, StatisticRatio):
                ratio = arrays["statistic"] / arrays["threshold"]
                ratio = ratio.amax(dim=1, keepdim=True) if term.largest else ratio
                seen[:, part] = ratio.to(seen.dtype)
            low, high = self._bounds["low"][part], self._bounds["high"][part]
            seen[:, part] = torch.minimum(torch.maximum(seen[:, part], low), high)
        return seen.clone(memory_format=torch.contiguous_format)

    def close_extras(self, **kwargs: Any) -> None:
        self.core.close()
