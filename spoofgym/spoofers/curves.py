"""A curve for every element of the action, drawn before the attack: any open-loop attack."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.registry import require
from .base import FloatArray, Spoofer, SpooferContext

FEWEST_KNOTS = 2


@settings_record(kw_only=True)
class ActionCurves(Spoofer):
    r"""Plays a curve of every element of the action over the attack window, whatever happens.

    With values :math:`x_i` at n equally spaced knots, :math:`t_0 = 0` at the onset and
    :math:`t_{n-1} = T` at the end of the window, an element at the time t is on the straight line
    between two of them.  An action of 1 requests what the environment says it does, so that the
    curves belong to its `control`, `basis` and scales.
    """

    described_as = "ActionCurves"
    knowledge = "blind"
    curves: tuple[tuple[float, ...], ...] = setting(
        default=((0.0, 0.1),),
        help="Values (a, n) at the knots, in units of the action, by its elements in their order; "
        "elements after the last one stay 0.",
    )
    label: str | None = setting(default="action-curves", help="Short name in results.")
    designed_on: str = setting(
        default="nothing", help="What the curves were optimised on; or nothing."
    )

    def __post_init__(self) -> None:
        self.curves = tuple(tuple(float(x) for x in each) for each in self.curves)
        sizes = {len(each) for each in self.curves}
        require(
            len(sizes) == 1 and min(sizes) >= FEWEST_KNOTS and bool(np.isfinite(self.curves).all()),
            f"`curves` must be rows of the same number of finite values, {FEWEST_KNOTS} or more, "
            f"got {self.curves!r}",
        )

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        elements = len(context.action_names)
        require(
            len(self.curves) <= elements,
            f"`curves` has {len(self.curves)} rows, and an action of this environment {elements} "
            f"elements: {', '.join(context.action_names)}",
        )
        knots = np.linspace(0.0, 1.0, len(self.curves[0]))
        ends = np.arange(1, context.steps + 1) / context.steps
        self._actions = np.zeros((context.steps, elements))
        for k, curve in enumerate(self.curves):
            self._actions[:, k] = np.interp(ends, knots, curve)
        self.memory.declare("step", np.zeros(context.receivers, dtype=np.int64))

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command the coming interval: (B, a) in [-1, 1]."""
        step = self.memory["step"]
        action = self._actions[np.minimum(step, len(self._actions) - 1)]
        step += 1
        return np.asarray(np.clip(action, -1.0, 1.0))
