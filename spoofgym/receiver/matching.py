"""What a receiver assumes of GNSS noise and of its clock, in a given world."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..sim.gnss import GnssErrors
from .tight import NoiseModel, TightlyCoupled

FloatArray = NDArray[np.float64]


def assumed_noise(
    receiver: TightlyCoupled, errors: GnssErrors, bias_sd: FloatArray, interval_s: float
) -> tuple[FloatArray, NoiseModel]:
    r"""Measurement noise variances and clock of a receiver.

    Parameters
    ----------
    receiver : TightlyCoupled
        Its `noise`, or its `tuning`, says what is assumed.
    errors : GnssErrors
        Of the world.
    bias_sd : ndarray
        (n,) standard deviation of the constant biases [m].
    interval_s : float
        Time between epochs [s].

    Returns
    -------
    variance : ndarray
        (2n,) R, pseudoranges first [m^2], [m^2/s^2].
    clock : NoiseModel
        Process noise of the clock.
    """
    n = len(bias_sd)
    if receiver.tuning == "paper" or receiver.noise is not None:
        model = receiver.noise_model
        return np.repeat([model.pseudorange_sd**2, model.range_rate_sd**2], n), model
    variance = np.concatenate(
        [errors.code_sd_m**2 + bias_sd**2, np.full(n, errors.range_rate_sd_mps**2)]
    )
    clock = NoiseModel(
        clock_phase_psd=errors.clock.phase_psd, clock_frequency_psd=errors.clock.frequency_psd
    )
    return variance, clock
