"""A vector environment whose receivers, actions, observations and rewards stay on a device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from ..core.registry import check_choice, whole_number
from ..envs._kernels import REWARD, TERMINATED
from ..envs.core import SpoofCore
from ..envs.env import HasSpec
from ..envs.factory import DEFAULT_VICTIM, make_core, select_victim
from ..envs.options import (
    TOLERANCE,
    InfoSpec,
    check_vector_settings,
    checked_seed,
    info_keys,
    parse_autoreset_mode,
)
from ..envs.scoring import MARK_NAMES, MARKS
from ..simulation.tight import AFTER_ONSET
from ..truth.sensors import SOURCES
from . import _kernels
from ._compile import SIMULATED
from .memory import Arrays, Tensors, view_for_kernels
from .pool import launch, raise_faults, start_pasts
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
        self.name_spaces(core, num_envs)
        names = *self._layout.names, *core.setup.attack.reports, FINAL
        keys = info_keys(infos, names)
        self._keys = names if keys is None else tuple(key for key in names if key in keys)
        with torch.no_grad():
            self._allocate()
        self._started = False

    def _allocate(self) -> None:
        torch, core, b, device = self._torch, self.core, self.num_envs, self.device
        setup, attack, rows = core.setup, core.setup.attack, self._layout.numbers + 3
        flight, episodes = start_pasts(torch, core, device)
        pasts, self._flight = flight.tensors | episodes, flight
        if device.type != "cpu":
            each = pasts.bytes_each + 8 * (setup.steps + 1 + 2 * rows)
            check_free_memory(b, each, torch.cuda.mem_get_info(device)[0])
        self._parts = [(TERMS[type(term)], term, part) for term, part in core.observer._parts]
        terms: dict[str, Any] = {kind: term for kind, term, _ in self._parts}
        motion, reported = terms.get("motion"), b if attack.reports else 0
        axes, decided = len(setup.action_names), len(self.action_names)
        offsets = np.zeros((reported, pasts["orders"].shape[1]))
        own: Arrays = {
            **dict.fromkeys(("action", "before", "now"), np.zeros((b, decided))),
            **dict.fromkeys(("step_count", "number", "picked"), np.zeros(b, dtype=np.int64)),
            **dict.fromkeys(("detected", "ended", "no_rows"), np.zeros(b, dtype=np.bool_)),
            **dict.fromkeys(("offsets_m", "requested_offsets_m"), offsets),
            "action_mask": np.zeros((reported, axes), dtype=np.bool_),
            "command": np.zeros((b, axes)),
            "seen": np.zeros((b, len(core.observation_names)), dtype=np.float32),
            "motion": np.zeros((b if motion else 0, 6), dtype=np.float32),
            "time": np.zeros((b if "time" in terms else 0, 2), dtype=np.float32),
            "undetected": np.zeros(b),
        }
        self._arrays = pasts.resize(b) | Tensors(torch, own, device)
        _, rules, per_rate, table = core._fused._fixed
        scales = (motion.position_scale_m, motion.velocity_scale_mps) if motion else (1.0, 1.0)
        shared = {
            "largest": np.zeros((setup.steps + 1, b)),
            "values": np.zeros((rows, b)),
            "sums": np.zeros((rows, b)),
            "marks": np.zeros((MARKS, b), dtype=np.bool_),
            "rules": rules,
            "per_rate": np.asarray(per_rate, dtype=np.float64),
            "table": table,
            "following": core.commands._rules,
            "pace": np.array([setup.repeat, setup.between == "linear"], dtype=np.int64),
            "scales": 1.0 / np.array(scales),
            "seed": np.zeros(2, dtype=np.uint64),
            "sources": np.array([SOURCES.index(name) for name in AFTER_ONSET]),
            "low": core.bounds[0],
            "high": core.bounds[1],
        }
        if "geometry" in terms:
            shared["geometry"] = np.asarray(setup.geometry_table(), dtype=np.float32)
        if "offsets" in terms:
            shared["unit_rates"] = attack.unit_rates(setup.world)
        self._rows = Tensors(torch, shared, device, shared=True)
        receivers = flight.layout.name_receivers(self._arrays)
        views = self._arrays.views | self._rows.views
        self._episodes = _kernels.Episodes(*(views[name] for name in _kernels.Episodes._fields))
        self._known = receivers, flight.shared.name_views(_kernels.Shared), self._episodes
        words = views["seed"], views["sources"]
        self._pick = self._episodes, receivers.keys, pasts.views["keys"], *words
        self._copies = [
            [
                view_for_kernels(_flatten(x[name]), name in pasts.words)
                for x in (self._arrays, pasts)
            ]
            for name in (*flight.gathered, *episodes.tensors)
            if name != "keys" and len(pasts[name]) == core.receivers and pasts[name][0].numel()
        ]

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in every receiver. `seed` is that of all episodes from here on; without
        one the present ones go on with the next. There are no `options`. Returns `observation`
        (B, o) float32, and no information."""
        if options:
            raise ValueError(f"device='cuda' has no options of a reset, got {sorted(options)}")
        super().reset(seed=checked_seed(seed))
        if seed is not None or not self._started:
            words = self.np_random.integers(2**63, size=2, dtype=np.int64)
            self._rows["seed"].copy_(self._torch.from_numpy(words))
            self._arrays["number"].zero_()
        self._arrays["faults"].zero_()
        self._arrays["ended"].fill_(True)
        self._started = True
        return self._restart(), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Give one command to every receiver, and run the epochs of a decision. `actions` (B, a) in
        [-1, 1], on the device; returns tensors: `observation` (B, o) float32, of the next episode
        where one has ended, `reward` (B,) float64, `terminated`, and `truncated`, which is False.
        Information is by the keys that have been requested; ``"final_obs"`` (B, o) is what was
        observed before the reset. A filter that has diverged is an error of the step after it."""
        if not self._started:
            raise RuntimeError("call reset() before step()")
        self._check(actions)
        with self._torch.no_grad():
            return self.step_unchecked(actions)

    def step_unchecked(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """`step` without a look at actions and faults: nothing waits for the device, so that it may
        be part of a CUDA graph. `check` says later what has gone wrong."""
        arrays, rows, layout = self._arrays, self._rows, self._flight.layout
        arrays["before"].copy_(arrays["action"])
        arrays["action"].copy_(actions)
        rows["marks"].zero_()
        kinds = layout.attack, layout.detector
        launch("play_step", self.num_envs, self.device, *self._known, *kinds)
        reward, terminated = rows["values"][REWARD].clone(), rows["marks"][TERMINATED].clone()
        info = self._report()
        return self._restart(), reward, terminated, self._torch.zeros_like(terminated), info

    def check(self) -> None:
        """Raise what kernels have found: `FilterDiverged`, or a verdict that is not finite."""
        raise_faults(self._arrays["faults"])

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
        numbers, info = self._layout.names[: self._layout.numbers], {}
        if set(self._keys) - set(self._layout.names):
            info[FINAL] = self._observe()
        for name in self._keys:
            if name in numbers:
                info[name] = self._rows["values"][numbers.index(name)].clone()
            elif name in MARK_NAMES:
                info[name] = self._rows["marks"][MARK_NAMES.index(name)].clone()
            elif name != FINAL:
                info[name] = self._arrays[name].clone()
        return {name: info[name] for name in self._keys}

    def _restart(self) -> Any:
        """Start new episodes where they are over; what is observed."""
        launch("pick", self.num_envs, self.device, *self._pick)
        for pair in self._copies:
            launch("take", self.num_envs, self.device, *pair, self._episodes.picked)
        return self._observe()

    def _observe(self) -> Any:
        launch("look", self.num_envs, self.device, *self._known)
        seen, rows = self._arrays["seen"], self._rows
        for kind, term, part in self._parts:
            values = self._observe_term(kind, term, part).to(seen.dtype)
            clipped = self._torch.maximum(values, rows["low"][part])
            seen[:, part] = self._torch.minimum(clipped, rows["high"][part])
        return seen.clone(memory_format=self._torch.contiguous_format)

    def _observe_term(self, kind: str, term: Any, part: slice) -> Any:
        arrays, rows, width = self._arrays, self._rows, part.stop - part.start
        if kind == "geometry":
            return rows[kind][arrays["epochs"]]
        if kind == "weights":
            return arrays[kind][:, :width]
        if kind == "offsets":
            scales, span_s = rows["unit_rates"], self.core.setup.attack.span_s
            moved = arrays["displacement"] / (scales * span_s), arrays["rate"] / scales
            known = self._torch.cat([*moved, arrays["action_mask"], arrays["taken"]], dim=1)
            return known[:, :width]
        if kind != "ratio":
            return arrays[kind]
        ratio = arrays["statistic"] / arrays["threshold"]
        return ratio.amax(dim=1, keepdim=True) if term.largest else ratio

    def close_extras(self, **kwargs: Any) -> None:
        self.core.close()


def _flatten(tensor: Any) -> Any:
    """Receivers first, and all else in one axis."""
    size = tensor[0].numel() if tensor.ndim > 1 else 1
    return tensor.as_strided((tensor.shape[0], size), (1, tensor.shape[0]))
