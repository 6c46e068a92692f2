"""A trajectory: a flight and the inertial samples that a perfect sensor measures on it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ._kinematics import invert_samples
from .flight import Flight

LARGEST_ROTATION = 1.0
"""Largest rotation over one sample [rad], up to which the receiver's series are exact."""


@dataclass(frozen=True, eq=False)
class Trajectory(Flight):
    """True motion and true inertial samples.

    - `name`, `time`, `position_e`, `velocity_e`, `C_eb`: as in `Flight`, N+1 states;
    - `specific_force_b` (N, 3) average specific force over (t_i, t_i+1], body axes [m/s^2];
    - `angular_rate_b` (N, 3) average angular rate against inertial space over (t_i, t_i+1], body
      axes [rad/s].
    """

    specific_force_b: NDArray[np.float64]
    angular_rate_b: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Copy and check the histories."""
        super().__post_init__()
        self._settle("specific_force_b", (self.time.size - 1, 3))
        self._settle("angular_rate_b", (self.time.size - 1, 3))


def inverse_kinematics(flight: Flight) -> Trajectory:
    r"""Inertial samples of a flight: the exact inverse of one strapdown step after another.

    .. math::
        C^+ &= R_z(a)\, C^- \left(I + \tfrac{\sin\alpha}{\alpha} A
               + \tfrac{1 - \cos\alpha}{\alpha^2} A^2\right) \\
        f_e &= \left(C^- \left[I + \tfrac{1 - \cos\alpha}{\alpha^2} A
               + \tfrac{1 - \sin\alpha/\alpha}{\alpha^2} A^2\right]
               - \tfrac12 [(0, 0, a) \times] C^-\right) f \\
        v^+ &= v^- + \Delta t\,(f_e + g(r^-) - 2 \omega_{ie} \times v^-) \\
        r^+ &= r^- + \tfrac12 \Delta t\,(v^- + v^+)

    with :math:`\alpha = \omega \Delta t`, :math:`A = [\alpha\times]`,
    :math:`a = \omega_{ie} \Delta t`, :math:`R_z(a)` the turn of the Earth, and :math:`I + A` and
    :math:`I` in place of the brackets for :math:`|\alpha| \le 10^{-8}`.

    Notes
    -----
    Groves (2013), section 5.5, solved for the samples.
    """
    specific_force_b = np.empty((flight.time.size - 1, 3))
    angular_rate_b = np.empty_like(specific_force_b)
    largest = invert_samples(
        flight.step,
        flight.position_e,
        flight.velocity_e,
        flight.C_eb,
        specific_force_b,
        angular_rate_b,
    )
    if largest > LARGEST_ROTATION:
        raise ValueError(
            f"a flight must turn by at most {math.degrees(LARGEST_ROTATION):g} deg in a sample, "
            f"got {math.degrees(largest):.3g} deg"
        )
    return Trajectory(
        flight.name,
        flight.time,
        flight.position_e,
        flight.velocity_e,
        flight.C_eb,
        specific_force_b,
        angular_rate_b,
    )
