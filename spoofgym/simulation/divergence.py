r"""How far an attack has moved the distribution of the victim's innovations.

With e the shift of the filter's error by the attack, :math:`\rho` that of its innovation and a what
the attack adds to the measurements, the closed loop answers, to first order, with

.. math::
    e_k^- = \Phi_k e_{k-1}, \qquad \rho_k = a_k + H_k e_k^-, \qquad e_k = e_k^- - K_k W_k \rho_k

(`limits`: Tanil, Khanafseh, Joerger and Pervan, 2018).  If the innovations were white with the
filter's covariance S, the divergence of their distribution under attack from the clean one would be

.. math:: \mathrm{KL}_k = \tfrac12 \sum_{j \le k} \rho_j^T S_j^{-1} \rho_j

This is the belief of the victim's own filter.  Where the filter's noise is not the world's, the
belief is wrong by the same measure; it is comparable to the literature, and no bound.

Gain and weights W are those of the run, so no clean twin is needed; that one would have others,
which is not counted.  Where the receiver coasts, e goes on by :math:`\Phi_k` alone, and the
innovations, which detectors see all the same, count.  Errors of the spoofer's own count as if the
analyst knew them; authentic errors that its signals do not have are not counted.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ..core.memory import Memory
from ..core.registry import require
from ..receiver.states import STATES
from ._kernels import shift_response
from .monitors import Monitor, Monitored
from .tight import TightlyCoupledSimulator


def _require_filter(simulator: Monitored) -> TightlyCoupledSimulator:
    if not isinstance(simulator, TightlyCoupledSimulator):
        whose = getattr(getattr(simulator, "setup", None), "whose", repr(simulator))
        raise ValueError(
            "the divergence of an attack needs the filter of a tightly coupled receiver, which "
            f"{whose} does not have"
        )
    return simulator


class Divergence(Monitor):
    """Divergence of the innovations by the belief of tightly coupled filters. `memory`:
    ``divergence`` (B,) accumulated [nats]; ``shift`` (B, 17) e, in the filter's states."""

    needs: ClassVar = frozenset({"transition", "design", "predicted_cov", "innovation_cov"})

    def bind(self, simulator: Monitored) -> None:
        victims = _require_filter(simulator)
        receivers = victims.receivers
        require(
            victims.setup.receiver.tuning != "augmented",
            "the divergence of an attack knows no filter with augmented states",
        )
        self.memory = Memory(receivers)
        self.memory.declare_all(divergence=np.zeros(receivers), shift=np.zeros((receivers, STATES)))

    def update(self, simulator: Monitored) -> None:
        victims = _require_filter(simulator)
        epoch, verdict, sensors = victims.epoch, victims.verdict, victims.sensors
        weights = victims.ones if verdict is None or verdict.weights is None else verdict.weights
        model = epoch.transition, epoch.design, epoch.predicted_cov, epoch.innovation_cov
        used = epoch.visible, weights, victims.setup.receiver.min_satellites
        offsets = sensors.range_offset, sensors.rate_offset
        shift_response(*model, *used, *offsets, self.memory["shift"], self.memory["divergence"])
