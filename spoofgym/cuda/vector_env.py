"""A vector environment whose receivers, actions, observations and rewards stay on a device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ..core.registry import check_choice, whole_number
from ..envs._kernels import REWARD, TERMINATED
from ..envs.core import SpoofCore
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
from ..envs.scoring import MARK_NAMES, MARKS
from ..simulation.simulator import FilterDiverged
from ..simulation.tight import AFTER_ONSET
from ..truth.sensors import SOURCES
from . import _kernels
from ._lanes import SIMULATED
from .memory import Tensors, view_for_kernels
from .pool import Pool, launch
from .supported import TERMS, check_free_memory, check_supported, import_torch

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

    core: SpoofCore

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
        self.single_observation_space = observation_space(core)
        self.single_action_space = action_space(core)
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
        setup, layout, device = core.setup, pool.layout, self.device
        if device.type != "cpu":
            largest = 8 * (setup.steps + 1 + self._layout.numbers + 3)
            check_free_memory(b, pool.bytes_each + largest, torch.cuda.mem_get_info(device)[0])
        arrays: dict[str, Any] = layout.scratch(b)
        alike = [name for name in ("assumed", "constants") if pool.lasting[name].shape[0] == 1]
        for name, past in pool.lasting.items():
            host = past[:1].cpu().numpy()
            host = host.view(np.uint64) if name in pool.words else host
            arrays[name] = host if name in alike else np.zeros((b, *host.shape[1:]), host.dtype)
        parts = core.observer._parts
        self._parts: list[Any] = [(TERMS[type(term)], term, part) for term, part in parts]
        terms = {kind: term for kind, term, _ in self._parts}
        observed, motion = len(core.observation_names), terms.get("motion")
        arrays |= {
            "action": np.zeros((b, len(self.action_names))),
            "command": np.zeros((b, len(setup.action_names))),
            "seen": np.zeros((b, observed), dtype=np.float32),
            "motion": np.zeros((b if motion else 0, 6), dtype=np.float32),
            "time": np.zeros((b if "time" in terms else 0, 2), dtype=np.float32),
            **{name: np.zeros(b, dtype=np.int64) for name in ("step_count", "number", "picked")},
            **{name: np.zeros(b, dtype=np.bool_) for name in ("detected", "ended", "no_rows")},
            "undetected": np.zeros(b),
        }
        self._arrays = Tensors(torch, arrays, device)
        if core.commands.is_plain:
            self._arrays.views["command"] = self._arrays.views["action"]
        _, rules, per_rate, table = core._fused._fixed
        scales = (motion.position_scale_m, motion.velocity_scale_mps) if motion else (1.0, 1.0)
        rows = {
            "largest": np.zeros((setup.steps + 1, b)),
            "values": np.zeros((self._layout.numbers + 3, b)),
            "marks": np.zeros((MARKS, b), dtype=np.bool_),
            "rules": rules,
            "per_rate": np.asarray(per_rate, dtype=np.float64),
            "table": table,
            "following": core.commands._rules,
            "scales": 1.0 / np.array(scales),
            "seed": np.zeros(2, dtype=np.uint64),
            "sources": np.array([SOURCES.index(name) for name in AFTER_ONSET]),
            "low": core.bounds[0],
            "high": core.bounds[1],
        }
        if "geometry" in terms:
            rows["geometry"] = np.asarray(setup.geometry_table(), dtype=np.float32)
        self._rows = Tensors(torch, rows, device, shared=True)
        self._receivers = layout.name_receivers(self._arrays)
        self._shared = pool.shared.name_views(_kernels.Shared)
        views = self._arrays.views | self._rows.views
        self._episodes = _kernels.Episodes(*(views[name] for name in _kernels.Episodes._fields))
        self._known = self._receivers, self._shared, self._episodes
        self._copies = [self._pair(name) for name in pool.lasting if name not in alike]

    def _pair(self, name: str) -> tuple[Any, Any]:
        """A quantity of the receivers and of the pasts, all its columns in one axis."""

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
            launch("play_step", self.num_envs, self._stream, *self._known, *rest)
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
        numbers, rows = self._layout.names[: self._layout.numbers], self._rows
        info: dict[str, Any] = {}
        for name in (*self._layout.names, FINAL) if self._keys is None else self._keys:
            if name == FINAL:
                info[name] = self._observe()
            elif name in numbers:
                info[name] = rows["values"][numbers.index(name)].clone()
            else:
                info[name] = rows["marks"][MARK_NAMES.index(name)].clone()
        return info

    def _restart(self) -> None:
        b, stream, words = self.num_envs, self._stream, self._rows.views["seed"]
        launch("pick", b, stream, self._episodes, words, self.core.receivers)
        for to, past in self._copies:
            launch("take", b, stream, to, past, self._episodes.picked)
        sources = self._rows.views["sources"]
        launch("renew", b, stream, self._episodes, self._receivers.keys, words, sources)

    def _observe(self) -> Any:
        launch("look", self.num_envs, self._stream, *self._known)
        seen, rows = self._arrays["seen"], self._rows
        for kind, term, part in self._parts:
            values = self._observe_term(kind, term).to(seen.dtype)
            clipped = self._torch.maximum(values, rows["low"][part])
            seen[:, part] = self._torch.minimum(clipped, rows["high"][part])
        return seen.clone(memory_format=self._torch.contiguous_format)

    def _observe_term(self, kind: str, term: Any) -> Any:
        arrays = self._arrays
        if kind == "geometry":
            return self._rows[kind][arrays["epochs"]]
        if kind == "weights":
            return arrays[kind][:, : self._pool.layout.channels]
        if kind != "ratio":
            return arrays[kind]
        ratio = arrays["statistic"] / arrays["threshold"]
        return ratio.amax(dim=1, keepdim=True) if term.largest else ratio

    def close_extras(self, **kwargs: Any) -> None:
        self.core.close()
