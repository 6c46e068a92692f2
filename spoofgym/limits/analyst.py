r"""A filter that knows the world: true noise, and states for all that is not white.

The innovations of a filter that believes in other noise than there is are not white, so that a sum
of :math:`\rho^T S^{-1} \rho` over epochs says nothing of how well an attack can be seen.  The
analyst's filter has the noise of the world and states for constant and wandering errors of
satellites, for the clock, and for the constants of the inertial sensors.  Its innovations are white
with covariance :math:`S^*`.  With :math:`\rho^*` the shift that an attack brings to them,

.. math:: d^2 = \sum_k \rho_k^{*T} S_k^{*-1} \rho_k^*

is the deflection of the likelihood-ratio test that knows the attack.  The victim's innovations, by
any gain and any weights, are an invertible function of the same measurements, so that no detector
does better; the victim's gain decides how far it is moved, and not whether it can be seen.

This is for benchmarks alone: no detector may see what the analyst knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..detectors import Never
from ..detectors.base import FloatArray
from ..receiver import TightlyCoupled
from ..receiver.augmented import FIRST
from ..receiver.states import ACCEL_BIAS, STATES
from ..simulation.simulator import Given
from ..simulation.tight import TightlyCoupledSetup, TightlyCoupledSimulator
from ..truth.events import BenignEvents
from .linear import PLACE, LinearRun, as_it_happens, observer, record_from

CONSTANTS = np.r_[ACCEL_BIAS : STATES - 2, STATES:FIRST]
"""States that are the inertial sensors' constants."""


class AnalystRun(NamedTuple):
    r"""The analyst's filter over one run, from the onset on.

    `coasting` (K, 3, 3) is :math:`P_{coast} - P`, north, east, down [m^2]: what a filter that takes
    no measurement since the onset does not know of the position, and this one does.
    """

    linear: LinearRun
    coasting: FloatArray


class Analyst:
    """The filter that knows the world of a setup.

    Parameters
    ----------
    setup : TightlyCoupledSetup
        World, attack and timeline; its receiver and detector do not matter.
    sensors_known : bool
        Whether the constants of the inertial sensors are known, and not drawn for every run.

    Attributes
    ----------
    setup : TightlyCoupledSetup
        Of the analyst's own filter, which is fed the same measurements as the victim's.

    Raises
    ------
    ValueError
        When the domain has several grades or errors, or other constants from world to world.
    """

    def __init__(self, setup: TightlyCoupledSetup, *, sensors_known: bool = False) -> None:
        domain = replace(setup.domain, events=BenignEvents())
        scenario = replace(setup.scenario, assumed=None, events=None)
        self.sensors_known = sensors_known
        self.setup = TightlyCoupledSetup(
            scenario=scenario,
            detector=Never(),
            attack=setup.attack,
            receiver=TightlyCoupled(grade=_grade(setup), tuning="augmented"),
            timeline=setup.timeline,
            domain=replace(domain, imu=()),
            target_heading_deg=setup.target_heading_deg,
            decision_interval_s=setup.decision_interval_s,
            between=setup.between,
        )
        # which refuses worlds that the filter does not fit
        self.setup.combinations.signal_model(self.setup.interval_s)

    def begun(
        self, rngs: Sequence[np.random.Generator], given: Given | None = None
    ) -> TightlyCoupledSimulator:
        simulator = observer(self.setup, len(rngs))
        simulator.begin(rngs, given)
        if self.sensors_known:
            P = simulator.memory["augmented_covariance"]
            P[:, CONSTANTS] = 0.0
            P[:, :, CONSTANTS] = 0.0
        return simulator

    def record(
        self, rngs: Sequence[np.random.Generator], given: Given | None = None
    ) -> list[AnalystRun]:
        """Record the filter over clean runs, from the onset on."""
        simulator = self.begun(rngs, given)
        blind = np.zeros(0)
        kept: list[FloatArray] = []

        def look(epoch: LinearRun) -> None:
            nonlocal blind
            blind = _coasted(simulator, epoch.transition, blind)
            lost = (blind - simulator.memory["augmented_covariance"])[:, PLACE, PLACE]
            kept.append(epoch.axes.transpose(0, 2, 1) @ lost @ epoch.axes)

        simulator.quiet_epochs(self.setup.onset)
        blind = simulator.memory["augmented_covariance"].copy()
        runs = record_from(simulator, look)
        coasting = np.stack(kept, axis=1)
        world = self.setup.world
        return [
            AnalystRun(as_it_happens(run, world), own)
            for run, own in zip(runs, coasting, strict=True)
        ]


def _grade(setup: TightlyCoupledSetup) -> str:
    (grade, *others) = setup.domain.imu or (setup.scenario.imu,)
    if others:
        raise ValueError(
            "limits are known for one grade of inertial sensors at a time, but the domain's `imu` "
            f"has {', '.join(setup.domain.imu)}"
        )
    return grade


def _coasted(
    simulator: TightlyCoupledSimulator, transition: FloatArray, P: FloatArray
) -> FloatArray:
    """Covariance that is propagated by one epoch, without measurements."""
    half = np.zeros((simulator.receivers, P.shape[1]))
    psd = simulator.buffers.assumed["noise_psd"]
    half[:, :STATES] = 0.5 * simulator.buffers.interval[:, None] * psd
    index = np.arange(P.shape[1])
    P = P.copy()
    P[:, index, index] += half
    P = transition @ P @ transition.transpose(0, 2, 1)
    P[:, index, index] += half
    if simulator.augmented is not None:
        P[:, FIRST:, FIRST:] += simulator.augmented.model.driving
    return P
