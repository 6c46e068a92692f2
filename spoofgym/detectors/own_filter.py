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
from ..earth.wgs84 import dcm_e_from_n, ecef_to_geodetic
from ..receiver.augmented import FIRST, AugmentedFilter, Predicted
from ..receiver.epoch import Epoch
from ..receiver.states import POSITION, STATES
from ..truth.signal_errors import MAPPINGS, causal_mappings
from ._own_filter_kernels import (
    compute_feedback,
    correct_augmented,
    project_augmented,
    propagate_augmented,
)
from .base import HAVE_IT, BoolArray, Detector, DetectorContext, FloatArray

VICTIM, AUGMENTED = "victim", "augmented"
NEEDS = "transition", "predicted_cov", "design", "innovation_cov", "imu_delta", "weights"
SHOWN = frozenset(NEEDS[:3])  # with all states


def filter_to_test() -> Any:
    return setting(
        default=VICTIM,
        one_of=(VICTIM, AUGMENTED),
        newer=True,
        help="Filter whose innovations are tested: the victim's, or one beside it with states for "
        "all that is not white (`spoofgym.detectors.own_filter`), since the victim's switch-on.",
    )


class CompiledFilter(AugmentedFilter):
    """The same filter with a compiled covariance cycle, whose last bits are others."""

    def _propagate(self, P: FloatArray, top: FloatArray, half: FloatArray) -> None:
        size = self.states - STATES
        rest, driving = np.eye(size), np.zeros((size, size))
        rest[FIRST - STATES :, FIRST - STATES :] = self.model.transition
        driving[FIRST - STATES :, FIRST - STATES :] = self.model.driving
        propagate_augmented(P, top, rest, half, driving)

    def _project(
        self, P: FloatArray, H: FloatArray, variance: FloatArray, visible: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        A, S = np.empty(H.shape), np.empty((*H.shape[:2], H.shape[1]))
        project_augmented(P, H, variance, visible, A, S)
        return A.transpose(0, 2, 1), S

    def _correct(self, predicted: Predicted, used: FloatArray) -> FloatArray:
        P, A = self.memory["augmented_covariance"], predicted.gain.transpose(0, 2, 1)
        change = np.empty(P.shape[:2])
        seen, enough = predicted.visible, predicted.enough
        correct_augmented(P, A, predicted.S, used, seen, enough, change)
        return change


class OwnFilter:
    """Augmented filters beside those of B receivers; all that they remember is in `memory`."""

    def __init__(self, memory: Memory, context: DetectorContext) -> None:
        model, b, n = context.model, context.receivers, context.channels
        if model is None:
            raise ValueError(f"a filter beside the victim's needs a model of its errors; {HAVE_IT}")
        self.model, self.memory, self.fewest = model, memory, context.min_satellites
        filter_ = CompiledFilter(memory, model.signals, context.epoch_interval_s, n, SHOWN)
        filter_.start_episodes(np.arange(b), model.covariance, model.grade)
        for name in ("augmented_covariance", "augmented"):
            memory.declare(name, memory[name])  # with which an episode starts
        memory.declare("victim_error", np.zeros((b, STATES)))
        memory.declare("feedback", np.zeros((b, STATES, 2 * n)))  # of every weight
        memory.declare("mapping", np.zeros((b, n, MAPPINGS)))  # of the last epoch
        self.filter = filter_
        self.noise = np.tile(model.noise_psd, (b, 1)), np.tile(model.noise_variance, (b, 1))

    def observe(self, epoch: Epoch) -> Epoch:
        """Go on by an epoch of the victim; the same with this filter's innovations, covariances,
        design and transition. Its error of the victim is in ``victim_error`` of the memory."""
        memory, (psd, variance) = self.memory, self.noise
        Phi, P, H, S, imu_delta, weights = (cast(FloatArray, getattr(epoch, n)) for n in NEEDS)
        x = memory["victim_error"] - np.einsum("bij,bj->bi", memory["feedback"], weights)
        x = (Phi @ x[:, :, None])[:, :, 0]
        z = epoch.innovation - (H @ x[:, :, None])[:, :, 0]
        inertial = Phi, imu_delta, psd, epoch.interval
        signals = H, self._map_signals(epoch), epoch.visible
        predicted = self.filter.predict(*inertial, *signals, z, variance, self.fewest)
        memory["victim_error"] = x + self.filter.update(predicted, None)
        measured = epoch.innovation, S, epoch.visible, predicted.enough
        compute_feedback(P, H, *measured, memory["feedback"])
        found = {
            "innovation": predicted.innovation,
            "innovation_cov": predicted.S,
            "innovation_variance": np.einsum("bii->bi", predicted.S).copy(),
            **self.filter.shown,
        }
        read_only: dict[str, Any] = {name: _protect(array) for name, array in found.items()}
        return epoch._replace(**read_only)

    def _map_signals(self, epoch: Epoch) -> FloatArray:
        """(B, n, 6) as `compute_mappings` has it, with rates since the last epoch."""
        memory, n = self.memory, epoch.visible.shape[1]
        if not {*self.model.signals.places} - {"constant", "correlated"}:
            return memory["mapping"]
        up = -dcm_e_from_n(*ecef_to_geodetic(epoch.predicted_position)[:2])[:, :, 2]
        sight = cast(FloatArray, epoch.design)[:, :n, POSITION : POSITION + 3]
        sine = (sight * up[:, None, :]).sum(axis=2)
        elevation = np.arcsin(np.clip(sine, -1.0, 1.0))
        last = memory["mapping"]
        memory["mapping"] = causal_mappings(elevation, epoch.visible, epoch.interval, last)
        return memory["mapping"]


def _protect(array: FloatArray) -> FloatArray:
    view = array.view()
    view.flags.writeable = False
    return view


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
            self._states, self._inertial = self._own.filter.states, self._own.filter.inertial

    def _filtered(self, epoch: Epoch) -> Epoch:
        """Epoch of the filter to test; once per epoch."""
        return epoch if self._own is None else self._own.observe(epoch)
