"""A spoofer with a factor on what it commands, by which any of them is fitted to a budget."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number
from .base import FloatArray, Spoofer, SpooferContext

AMPLITUDE = "amplitude"
"""Key of a spoofer's spec that is no setting of its class: the factor on its commands."""
SMALLEST, LARGEST = 1e-3, 10.0  # range of a search for an amplitude
OWN = ("own_displacement", "own_rate")  # first words of what a spoofer observes of its own commands


def own_columns(names: tuple[str, ...]) -> list[int]:
    return [k for k, name in enumerate(names) if name.startswith(OWN)]


class Scaled(Spoofer):
    """A spoofer whose actions are multiplied by a factor, and cut to what the attack allows.

    The spoofer inside plans as if there were no factor: of its own displacement and rate it
    observes what it has planned, the commanded ones divided by the factor.  So the same plan
    displaces so many times as far, as long as nothing is cut.

    Parameters
    ----------
    spoofer : Spoofer
        Any that transmits; not scaled already.
    amplitude : float
        Factor, above 0.

    Examples
    --------
    >>> from spoofgym.spoofers import make_spoofer
    >>> make_spoofer({"name": "step", "amplitude": 0.5}).amplitude
    0.5
    """

    tunable: ClassVar[str | None] = AMPLITUDE

    def __init__(self, spoofer: Spoofer, amplitude: float) -> None:
        if isinstance(spoofer, Scaled) or not isinstance(spoofer, Spoofer):
            raise TypeError(f"`spoofer` must be a Spoofer that is not scaled, got {spoofer!r}")
        check_number(AMPLITUDE, amplitude, above=0.0)
        self.spoofer, self.amplitude = spoofer, float(amplitude)
        shared = "knowledge action_terms decision_interval_s between label designed_on transmits"
        for name in shared.split():
            setattr(self, name, getattr(spoofer, name))
        if hasattr(spoofer, "card"):
            self.card = spoofer.card

    def bind(self, context: SpooferContext) -> None:
        self.spoofer.bind(context)
        self.context, self.memory = context, self.spoofer.memory
        self._own = own_columns(context.observation_names)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        self.spoofer.reset(mask)

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        seen = observation
        if self._own and self.amplitude != 1.0:
            seen = observation.copy()
            seen[:, self._own] /= np.float32(self.amplitude)
        action = self.amplitude * np.asarray(self.spoofer.act(seen), dtype=np.float64)
        return np.ascontiguousarray(np.minimum(np.maximum(action, -1.0), 1.0))

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        return SMALLEST, LARGEST


def split_amplitude(spec: Any) -> tuple[Any, float | None]:
    """A spoofer's spec without its amplitude, and that; None where it has none."""
    if not isinstance(spec, Mapping) or AMPLITUDE not in spec:
        return spec, None
    rest = {key: value for key, value in spec.items() if key != AMPLITUDE}
    return rest, spec[AMPLITUDE]
