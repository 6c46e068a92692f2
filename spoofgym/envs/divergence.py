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

The response is that of the gain and weights of the run, W, so no clean twin is needed.  Where the
weights answer to the attack, a clean twin would have others: that difference is not counted.  Where
the receiver coasts, e goes on by :math:`\Phi_k` alone, and the innovations, which detectors see all
the same, count.

What the attack adds is what it has added in this run.  Errors of the spoofer's own, of its tracking
or of its signals, count as if the analyst knew them; authentic errors that its signals do not have
are not counted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._memory import Memory
from ..receiver.error_model import STATES
from ._kernels import shift_response
from .witness import Witness

if TYPE_CHECKING:
    from .engine import Batch


class Divergence(Witness):
    """Divergence of the innovations by the filter's belief, of every receiver.

    `memory`: ``divergence`` (B,) accumulated [nats]; ``shift`` (B, 17) e, in the filter's states.
    """

    def bind(self, batch: Batch) -> None:
        """Prepare for a batch."""
        self.memory = Memory(batch.receivers)
        self.memory.declare("divergence", np.zeros(batch.receivers))
        self.memory.declare("shift", np.zeros((batch.receivers, STATES)))

    def see(self, batch: Batch) -> None:
        """Add the part of an epoch."""
        epoch, verdict, sensors = batch.epoch, batch.verdict, batch.sensors.state
        weights = batch.ones if verdict is None or verdict.weights is None else verdict.weights
        shift_response(
            epoch.transition,
            epoch.design,
            epoch.predicted_cov,
            epoch.innovation_cov,
            epoch.visible,
            weights,
            batch.setup.receiver.min_satellites,
            sensors.range_offset,
            sensors.rate_offset,
            self.memory["shift"],
            self.memory["divergence"],
        )
