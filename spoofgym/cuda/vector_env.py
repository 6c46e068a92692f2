"""A vector environment whose receivers, actions, observations and rewards stay on a device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from ..attacks.offsets import Offsets
from ..core.devices import SIMULATED, check_free_memory, import_torch
from ..core.registry import check_choice, whole_number
from ..envs import options as opt
from ..envs._kernels import REWARD, TERMINATED
from ..envs.core import SpoofCore
from ..envs.env import HasSpec
from ..envs.factory import DEFAULT_VICTIM, make_core, select_victim
from ..envs.scoring import MARK_NAMES, MARKS
from ..envs.terms import observation
from . import _kernels
from .memory import SCRATCH, Arrays, Tensors, view_for_kernels
from .pool import launch, raise_faults, start_pasts
from .supported import TERMS, check_supported

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
        infos: opt.InfoSpec = "none",
        render_mode: None = None,
        max_episode_steps: int | None = None,
        **settings: Any,
    ) -> None:
        opt.check_vector_settings(num_envs, render_mode)
        whole_number("`pasts`", pasts, 1)
        mode = opt.parse_autoreset_mode(autoreset_mode)
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"device='cuda' needs `autoreset_mode` 'same_step', got {mode.name}")
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.render_mode, self.num_envs = None, num_envs
        check_choice("device", str(device).partition(":")[0], ("cuda",))
        self._torch = torch = import_torch()
        self.device = torch.device("cpu" if SIMULATED else device)
        settings = {**settings, "warm_pool": 0}
        core = make_core(select_victim(victim), pasts, settings, whose=f"victim {victim!r}")
        check_supported(core)
        self.core, self._reports = core, core.setup.attack.reports
        self._names = core._fused.layout.names
        names = *self._names, *self._reports, FINAL
        keys = opt.info_keys(infos, names)
        self._keys = names if keys is None else tuple(key for key in names if key in keys)
        self._allocate()
        self.name_spaces(core, num_envs)
        self._started = self._halfway = False

    def _allocate(self) -> None:
        torch, core, b, device = self._torch, self.core, self.num_envs, self.device
        setup, attack, rows = core.setup, core.setup.attack, core._fused.layout.numbers + 3
        self._fleet = fleet = start_pasts(torch, core, device)
        pasts = fleet.tensors
        each = pasts.bytes_each + 8 * (setup.steps + 1 + 2 * rows)
        check_free_memory(torch.cuda, device, b, each)
        terms = {type(term): term for term, _ in core.observer._parts}
        motion: Any = terms.get(observation.TargetMotion, observation.TargetMotion())
        reports = [x for x in terms.values() if isinstance(x, observation.ReportedPosition)]
        axes, decided = len(setup.action_names), len(core.action_names)
        singles = {"seen": len(core.observation_names), "motion": 6, "time": 2, "reported": 3}
        offsets = np.zeros((b if self._reports else 0, pasts["orders"].shape[1]))
        own: Arrays = {
            **dict.fromkeys(("action", "before", "now"), np.zeros((b, decided))),
            **dict.fromkeys(("step_count", "number", "picked"), np.zeros(b, dtype=np.int64)),
            **dict.fromkeys(("detected", "ended", "no_rows"), np.zeros(b, dtype=np.bool_)),
            **dict.fromkeys(("offsets_m", "requested_offsets_m"), offsets),
            "action_mask": np.zeros((len(offsets), axes), dtype=np.bool_),
            **{name: np.zeros((b, k), dtype=np.float32) for name, k in singles.items()},
            "error": np.zeros((b, 3)),
            "undetected": np.zeros(b),
        }
        self._arrays = pasts.resize(b) | Tensors(torch, own, device)
        shared: Arrays = {
            "largest": np.zeros((setup.steps + 1, b)),
            **dict.fromkeys(("values", "sums"), np.zeros((rows, b))),
            "marks": np.zeros((MARKS, b), dtype=np.bool_),
            **dict(zip(("rules", "per_rate", "table"), core._fused._fixed[1:], strict=True)),
            "following": core.commands._rules,
            "pace": np.array([setup.repeat, setup.between == "linear"], dtype=np.int64),
            "scales": 1.0 / np.array([motion.position_scale_m, motion.velocity_scale_mps]),
            "report_rules": np.ravel([x.rules(setup) for x in reports]),  # of at most one
            "seed": np.zeros(2, dtype=np.uint64),
            "low": core.bounds[0],
            "high": core.bounds[1],
        }
        if observation.SatelliteGeometry in terms:
            shared["geometry"] = np.asarray(setup.geometry_table(), dtype=np.float32)
        if isinstance(attack, Offsets):
            shared["unit_rates"] = attack.unit_rates(setup.world)
            shared["unit_offsets"] = shared["unit_rates"] * attack.span_s
        self._rows = Tensors(torch, shared, device, shared=True)
        both = *self._rows["values"][: rows - 3], *self._rows["marks"][: len(MARK_NAMES)]
        self._infos: dict[str, Any] = dict(zip(self._names, both, strict=True))
        self._infos |= {name: self._arrays[name] for name in self._reports}
        receivers = fleet.name_receivers(self._arrays)
        self._episodes = (self._arrays | self._rows).name_views(_kernels.Episodes)
        self._known = receivers, fleet.shared, self._episodes
        self._pick = self._episodes, receivers.keys, pasts.views["keys"], self._rows.views["seed"]
        own_rows = (name for name, x in pasts.tensors.items() if len(x) == core.receivers)
        self._copies = [
            [view_for_kernels(_flatten(x[name]), name in x.words) for x in (self._arrays, pasts)]
            for name in own_rows
            if name not in ("keys", *SCRATCH) and pasts[name][0].numel()
        ]

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in every receiver; `seed` is that of all from here on, by default the
        one so far. There are no `options`, and no information beside `observation` (B, o)."""
        if options:
            raise ValueError(f"device='cuda' has no options of a reset, got {sorted(options)}")
        super().reset(seed=opt.checked_seed(seed))
        if seed is not None or not self._started:
            words = self.np_random.integers(2**63, size=2, dtype=np.int64)
            self._rows["seed"].copy_(self._torch.from_numpy(words))
            self._arrays["number"].zero_()
        self._arrays["faults"].zero_()
        self._arrays["ended"].fill_(True)
        with opt.whole_reset(self):
            first, self._started = self._restart(), True
        return first, {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Give one command to every receiver, and run the epochs of a decision. `actions` (B, a) in
        [-1, 1]; returns tensors: `observation` (B, o) float32, of the next episode where one has
        ended; `reward` (B,) float64; `terminated`; `truncated`, which is False; information as it
        has been requested. What has diverged is an error of the step after it."""
        if not self._started:
            raise RuntimeError("call reset() before step()")
        if self._halfway:
            raise RuntimeError(opt.HALFWAY)
        self._check(actions)
        with self._torch.no_grad():
            return self.step_unchecked(actions)

    def step_unchecked(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """`step` without a look at actions and faults, which `check` does later: nothing waits for
        the device, so that it may be part of a CUDA graph."""
        self._halfway, arrays, rows, fleet = True, self._arrays, self._rows, self._fleet
        arrays["before"].copy_(arrays["action"])
        arrays["action"].copy_(actions)
        rows["marks"].zero_()
        kinds = fleet.attack, fleet.detector
        launch("play_step", self.num_envs, self.device, *self._known, *kinds)
        reward, terminated = rows["values"][REWARD].clone(), rows["marks"][TERMINATED].clone()
        info, seen = self._report(), self._restart()
        self._halfway = False
        return seen, reward, terminated, self._torch.zeros_like(terminated), info

    def check(self) -> None:
        """Raise what kernels have found: `FilterDiverged`, or a verdict that is not finite."""
        raise_faults(self._arrays["faults"])

    def _check(self, actions: Any) -> None:
        torch, shape = self._torch, (self.num_envs, len(self.action_names))
        device = self._arrays["action"].device  # with its index
        where = isinstance(actions, torch.Tensor) and actions.device
        if where != device:
            found = f"one on {where}" if where else type(actions).__name__
            raise TypeError(f"actions must be a tensor on {device}, got {found}")
        if tuple(actions.shape) != shape:
            names = ", ".join(self.action_names)
            raise ValueError(f"actions must have shape {shape} ({names}), got {actions.shape}")
        inside = (actions.abs() <= 1.0 + opt.TOLERANCE).all()
        if not bool(torch.logical_and(inside, ~self._arrays["faults"].any())):
            self.check()
            raise ValueError("actions must be in [-1, 1], and some are not, or are NaN")

    def _report(self) -> dict[str, Any]:
        final = self._observe() if {FINAL, *self._reports} & {*self._keys} else None
        return {x: final if x == FINAL else self._infos[x].clone() for x in self._keys}

    def _restart(self) -> Any:
        """Start new episodes where they are over; what is observed."""
        launch("pick", self.num_envs, self.device, *self._pick)
        for pair in self._copies:
            launch("take", self.num_envs, self.device, *pair, self._episodes.picked)
        return self._observe()

    def _observe(self) -> Any:
        launch("look", self.num_envs, self.device, *self._known)
        torch, seen, rows = self._torch, self._arrays["seen"], self._rows
        for term, part in self.core.observer._parts:
            values = TERMS[type(term)](self._arrays, rows, term)[:, : part.stop - part.start]
            limits = rows["low"][part], rows["high"][part]
            seen[:, part] = values.to(seen.dtype).clamp(*limits)
        return seen.clone(memory_format=torch.contiguous_format)

    def close_extras(self, **kwargs: Any) -> None:
        self.core.close()


def _flatten(tensor: Any) -> Any:
    """Receivers first, and all else in one axis."""
    return tensor.as_strided((len(tensor), tensor[0].numel()), (1, len(tensor)))
