"""Actions in metres: offsets by satellite or axis, checked against what is captured and in view."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..attacks import Offsets
from ..simulation.domain import FloatArray
from .factory import composable


def offsets_action(env: Any, wanted: Mapping[str, float] | ArrayLike) -> FloatArray:
    """Action that requests offsets in metres, or rates in metres per second.

    Parameters
    ----------
    env : SpoofEnv, SpoofVectorEnv or SpoofVecEnv
        Wrapped or not, after its first reset, with a `control`: ``"offset"`` takes offsets [m],
        ``"rate"`` rates [m/s].
    wanted : mapping or array_like
        By satellite, as ``{"S05": 12.0}``, or by axis of the basis, as ``{"north": 30.0}``; those
        that are not named get 0; or (a,) or (B, a) values of all axes.

    Returns
    -------
    ndarray
        (a,) of a single environment, (B, a) of a vector; in [-1, 1].

    Raises
    ------
    ValueError
        When a value is no finite number or more than an action can request, when a satellite is
        not captured or not in view, or a name is unknown; it names the value and what is valid.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> from spoofgym.envs import offsets_action
    >>> env = gym.make("spoofgym/Zhong2025-v0", control="offset")
    >>> _ = env.reset(seed=1)
    >>> offsets_action(env, {"S05": 15.0})
    array([0.1, 0. , 0. , 0. , 0. , 0. , 0. , 0. ])
    >>> env.close()
    """
    inner = composable(env, unset=False)
    core = inner.core
    attack = core.setup.attack
    if not (isinstance(attack, Offsets) and core.commands.is_plain) or core.commands.base:
        raise ValueError(
            "actions in metres need an environment with `control` 'rate' or 'offset' and no own "
            f"`action`, got {core.setup.title!r} with {', '.join(core.action_names)}"
        )
    scales, axes = attack.action_scales(core.setup.world), len(core.action_names)
    if isinstance(wanted, Mapping):
        values = np.array([_place(wanted, core, b) for b in range(core.receivers)])
    else:
        given = np.asarray(wanted, dtype=np.float64)
        if given.shape not in ((axes,), (core.receivers, axes)):
            raise ValueError(
                f"offsets must have shape ({axes},) or ({core.receivers}, {axes}), one for each of "
                f"{', '.join(core.action_names)}, got {given.shape}"
            )
        values = np.array(np.broadcast_to(given, (core.receivers, axes)))
    unit = "m" if attack.control == "offset" else "m/s"
    for b, axis in np.argwhere(~(np.abs(values) <= scales)):
        raise ValueError(
            f"{core.action_names[axis]!r} of receiver {b} must be a number from "
            f"{-scales[axis]:g} to {scales[axis]:g} {unit}, got {values[b, axis]:g}"
        )
    action = values / scales
    return action if hasattr(inner, "num_envs") else action[0]


def _place(wanted: Mapping[str, float], core: Any, b: int) -> FloatArray:
    """Values (a,) by names of satellites or axes, for one receiver."""
    setup, simulator = core.setup, core.engine.simulator
    attack, world, epoch = simulator.attack, setup.world, int(simulator.epochs[b])
    axes = {name: i for i, name in enumerate(attack.axis_names(world))}
    order = attack.memory["orders"][b]
    captured = {world.satellite_ids[s]: (i, s) for i, s in enumerate(order.tolist())}
    values = np.zeros(len(axes))
    for name, value in wanted.items():
        by_satellite = attack.basis == "satellites" and name in world.satellite_ids
        if by_satellite and name not in captured:
            raise ValueError(
                f"{name!r} is not captured in receiver {b}; captured: {', '.join(captured)}"
            )
        if by_satellite and not world.visible[epoch, captured[name][1]]:
            seen = [each for each, (_, s) in captured.items() if world.visible[epoch, s]]
            raise ValueError(f"{name!r} is not in view of receiver {b}; in view: {', '.join(seen)}")
        if not by_satellite and name not in axes:
            valid = [*(captured if attack.basis == "satellites" else ()), *axes]
            raise ValueError(f"there is no axis or satellite {name!r}; valid: {', '.join(valid)}")
        values[captured[name][0] if by_satellite else axes[name]] = value
    return values
