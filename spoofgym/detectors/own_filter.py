r"""A filter beside the victim's, which models the world, for monitors that need white innovations.

A victim whose filter does not model its errors believes in more than there is, and a test of its
innovations, or of its separation from coasting solutions, sees little.  What a monitor is shown is
enough to run another filter on the same measurements.  With x the error of the victim's estimate,
and of the other states of `spoofgym.receiver.augmented`,

.. math::
    \tilde z_k = z_k - H_k \Phi_k x_{k-1}, \qquad
    x_k = \Phi_k x_{k-1} + \tilde K_k \tilde z_k - K_k W_k z_k

where the last term is what the victim takes from its own estimate.  Gain and covariance are those
of an `AugmentedFilter` from the switch-on of the victim; its innovations are white, and of the
covariance that it believes in, where the assumed errors are those of the world.

Symbols: z innovation of the victim, H, :math:`\Phi` its design and transition with columns for the
further states, :math:`K = P H^T S^{-1}` its gain, W the weights of its detector; a tilde marks the
filter beside it, which takes no weight off.

Assumptions: both filters are linear in their errors.  The obliquities of a signal follow from the
victim's position, their rates from the last epoch.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from ..core.declared import setting
from ..core.memory import Memory
from ..receiver._augmented_kernels import couple_errors
from ..receiver.augmented import FIRST, IN_RUN, first_covariance
from ..receiver.epoch import Epoch
from ..receiver.states import STATES
from ..truth.signal_errors import MAPPINGS, causal_mappings
from ._own_filter_kernels import advance_filters, compute_feedback, compute_sines, wide_shape
from .base import HAVE_IT, Detector, DetectorContext, FloatArray

VICTIM, AUGMENTED = "victim", "augmented"
NEEDS = "transition", "predicted_cov", "design", "innovation_cov", "imu_delta", "weights"
FOUND = "innovation", "innovation_cov", "innovation_variance"  # of the filter beside
SLOW = frozenset({IN_RUN, "constant", "correlated"})  # states that no obliquity multiplies


def filter_to_test() -> Any:
    return setting(
        default=VICTIM,
        one_of=(VICTIM, AUGMENTED),
        newer=True,
        help="Filter whose innovations are tested: the victim's, or a second one that starts with "
        "it and has states for coloured errors, too (`detectors/own_filter.py`).",
    )


class OwnFilter:
    """Augmented filters beside those of B receivers; all that they remember is in `memory`, of
    symmetric matrices the upper half.

    - `top` (B, 17, c) rows of the transition of the last epoch, 0 beyond; `rest` of the others;
    - `white`, `counts`: responses of the inertial states, as of `advance_filters`.
    """

    def __init__(self, memory: Memory, context: DetectorContext) -> None:
        model, b, n = context.model, context.receivers, context.channels
        if model is None:
            raise ValueError(f"a filter beside the victim's needs a model of its errors; {HAVE_IT}")
        self.model, self.memory, self.fewest = model, memory, context.min_satellites
        P = first_covariance(model.signals, model.covariance, model.grade)
        self.states, self.inertial = len(P), FIRST + model.signals.wandering
        filters = np.zeros((b, *wide_shape(self.states)))
        filters[:, : self.states, : self.states] = P
        memory.declare("filters", filters)  # covariances, and behind them the errors of all states
        memory.declare("feedback", np.zeros((b, STATES, 2 * n)))  # of every weight
        memory.declare("mapping", np.zeros((b, n, MAPPINGS)))  # of the last epoch
        self.rest, driving = np.eye(self.states - STATES), model.signals.driving
        self.rest[FIRST - STATES :, FIRST - STATES :] = model.signals.transition
        self.driven = np.argwhere(driving)
        self.driving = driving[*self.driven.T]
        self.tables = model.signals.tables(context.epoch_interval_s)
        self.white = np.zeros((b, 2 * n, self.inertial + 1))
        self.counts = np.zeros(b, dtype=np.int64)

    def observe(self, epoch: Epoch) -> Epoch:
        """Go on by an epoch of the victim; the same with this filter's innovations and their
        covariances."""
        memory, visible = self.memory, epoch.visible
        Phi, P, H, S, imu_delta, weights = (cast(FloatArray, getattr(epoch, n)) for n in NEEDS)
        self.top = np.zeros((len(Phi), STATES, self.inertial))
        couple_errors(Phi, imu_delta, epoch.interval, self.top)
        z, own_S = np.empty(epoch.innovation.shape), np.empty(S.shape)
        advance_filters(
            memory["filters"],
            memory["feedback"],
            weights,
            self.top,
            self.rest,
            0.5 * epoch.interval[:, None] * self.model.noise_psd,
            self.driven,
            self.driving,
            H,
            self._map_signals(epoch),
            *self.tables,
            visible,
            epoch.innovation,
            self.model.noise_variance,
            self.fewest,
            z,
            own_S,
            self.white,
            self.counts,
        )
        compute_feedback(P, H, epoch.innovation, S, visible, self.fewest, memory["feedback"])
        found: tuple[Any, ...] = z, own_S, own_S.diagonal(axis1=1, axis2=2).copy()
        for array in found:
            array.flags.writeable = False
        return epoch._replace(**dict(zip(FOUND, found, strict=True)))

    def _map_signals(self, epoch: Epoch) -> FloatArray:
        """(B, n, 6) as `compute_mappings` has it, with rates since the last epoch."""
        mapping = self.memory["mapping"]
        if not SLOW.issuperset(self.model.signals.places):
            sine = np.empty(epoch.visible.shape)
            compute_sines(epoch.predicted_position, cast(FloatArray, epoch.design), sine)
            elevation = np.arcsin(np.clip(sine, -1.0, 1.0))
            mapping[:] = causal_mappings(elevation, epoch.visible, epoch.interval, mapping)
        return mapping


class FilterTest(Detector):
    """Base of what tests the innovations of the victim's filter, or of one of its own. A subclass
    is a dataclass with the setting `filter`."""

    filter: str = VICTIM

    def __post_init__(self) -> None:
        if self.filter == AUGMENTED:  # the object's, not the class's
            self.needs = self.needs.union(NEEDS)  # type: ignore[misc]
            self.from_start = self.needs_model = True

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        # the filter of an augmented victim is its own
        beside = self.filter == AUGMENTED and context.states <= STATES
        self._own = OwnFilter(self.memory, context) if beside else None
        # all, and those that move a solution: without the errors of the signals
        self._states, self._inertial = context.states, context.inertial_states
        if self._own is not None:
            self._states, self._inertial = self._own.states, self._own.inertial

    def filter_epoch(self, epoch: Epoch) -> Epoch:
        """Epoch of the filter to test; once per epoch."""
        return epoch if self._own is None else self._own.observe(epoch)
