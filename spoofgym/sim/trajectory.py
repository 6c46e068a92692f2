"""A trajectory: a flight and the inertial samples that a perfect sensor measures on it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._registry import is_number
from ._kinematics import invert_samples
from .flight import Flight, integrate_velocity

LARGEST_ROTATION = math.radians(90.0)
"""Largest rotation over one sample [rad]; beyond, its direction becomes uncertain."""
LARGEST_DECIMATED = 1.0
"""The same over a sample of a lower rate: up to it the series of the receiver are exact."""


@dataclass(frozen=True, eq=False)
class Trajectory(Flight):
    """True motion and true inertial samples.

    - `name`, `time`, `position_e`, `velocity_e`, `C_eb`: as in `Flight`, N+1 states;
    - `specific_force_b` (N, 3) average specific force over (t_i, t_i+1], body axes [m/s^2];
    - `angular_rate_b` (N, 3) average angular rate against inertial space over (t_i, t_i+1], body
      axes [rad/s];
    - `decimation`: samples of the sensors that are summed up in each one here.
    """

    described_as = "Trajectory"
    specific_force_b: NDArray[np.float64]
    angular_rate_b: NDArray[np.float64]
    decimation: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        self._settle("specific_force_b", (self.time.size - 1, 3))
        self._settle("angular_rate_b", (self.time.size - 1, 3))


def trajectory_at(flight: Flight, imu_rate_hz: float | None, epoch_interval_s: float) -> Trajectory:
    """Trajectory whose inertial samples come at another rate; None for that of the flight. Velocity
    and attitude are those of the flight; the position is the integral of that velocity over the
    longer samples, as of any flight, and so differs by millimetres."""
    count = 1
    if imu_rate_hz is not None:
        count = decimation_of(flight.step, imu_rate_hz, epoch_interval_s)
    if count == 1:
        return inverse_kinematics(flight)
    velocity_e = flight.velocity_e[::count]
    longer = Flight(
        flight.name,
        flight.time[::count],
        integrate_velocity(flight.position_e[0], velocity_e, count * flight.step),
        velocity_e,
        flight.C_eb[::count],
    )
    return inverse_kinematics(longer, decimation=count, largest=LARGEST_DECIMATED)


def decimation_of(step: float, rate_hz: float, epoch_interval_s: float) -> int:
    """Samples of `step` [s] in one of `rate_hz`; a ValueError unless epochs fall on samples."""
    per_epoch = max(round(epoch_interval_s / step), 1)
    valid = {count: 1.0 / (count * step) for count in range(1, per_epoch + 1)}
    valid = {count: rate for count, rate in valid.items() if per_epoch % count == 0}
    for count, rate in valid.items():
        if is_number(rate_hz) and abs(rate_hz - rate) <= 1e-6 * rate:
            return count
    raise ValueError(
        f"`imu_rate_hz` must divide the flight's {1.0 / step:g} Hz into whole samples between "
        f"epochs of {epoch_interval_s:g} s: {', '.join(f'{rate:g}' for rate in valid.values())}; "
        f"got {rate_hz!r}"
    )


def inverse_kinematics(
    flight: Flight, *, decimation: int = 1, largest: float = LARGEST_ROTATION
) -> Trajectory:
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

    `decimation`: as in `Trajectory`, done already; `largest`: rotation over a sample [rad].

    Notes
    -----
    Groves (2013), section 5.5, solved for the samples.
    """
    specific_force_b = np.empty((flight.time.size - 1, 3))
    angular_rate_b = np.empty_like(specific_force_b)
    turn = invert_samples(
        flight.step,
        flight.position_e,
        flight.velocity_e,
        flight.C_eb,
        specific_force_b,
        angular_rate_b,
    )
    if turn > largest:
        raise ValueError(
            f"a flight must turn by at most {math.degrees(largest):g} deg in a sample, "
            f"got {math.degrees(turn):.3g} deg"
        )
    return Trajectory(
        flight.name,
        flight.time,
        flight.position_e,
        flight.velocity_e,
        flight.C_eb,
        specific_force_b,
        angular_rate_b,
        decimation,
    )
