"""GNSS position errors: a first-order Gauss-Markov process for each axis.

A receiver that hands out positions smooths them, and the atmosphere and the satellites' orbits
change over minutes, so that one error is much like the next.  How much decides what a monitor of
the innovations can see: white noise of 3.7 m hides an offset of some decimetres, correlated noise
of the same size does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined


@dataclass(frozen=True, kw_only=True)
class PositionErrors:
    r"""Gauss-Markov GNSS position errors.

    .. math:: e_k = \beta e_{k-1} + \sigma \sqrt{1 - \beta^2} \, n_k, \qquad
        e_0 = \sigma n_0, \qquad n_k \sim N(0, 1)

    - `horizontal_sd_m`: standard deviation of the errors to the east and to the north [m];
    - `vertical_sd_m`: standard deviation of the error upwards [m];
    - `decay`: :math:`\beta`, correlation of one epoch's error with the next one's, in [0, 1); 0 for
      white noise.

    Notes
    -----
    The defaults are those of the receiver model that `shadmehri2025` names, 1.6 m, 3 m and 0.999 at
    each sample; the paper does not say whether it changed them.
    """

    described_as = "PositionErrors"
    horizontal_sd_m: float = 1.6
    vertical_sd_m: float = 3.0
    decay: float = 0.999

    def __post_init__(self) -> None:
        for name in ("horizontal_sd_m", "vertical_sd_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"`{name}` must be finite and >= 0, got {value}")
        if not 0.0 <= self.decay < 1.0:
            raise ValueError(f"`decay` must be in [0, 1), got {self.decay}")

    @property
    def sd(self) -> NDArray[np.float64]:
        """(3,) standard deviations to the east, to the north and upwards [m]."""
        return np.array([self.horizontal_sd_m, self.horizontal_sd_m, self.vertical_sd_m])


@inlined
def gauss_markov_step(error: float, decay: float, sd: float, deviate: float) -> float:
    r"""Next error of one axis.

    .. math:: e_k = \beta e_{k-1} + \sigma \sqrt{1 - \beta^2} \, n_k

    `error`: last error [m]; `sd`: standard deviation sigma, the same at all epochs [m]; returns the
    error [m].
    """
    return decay * error + sd * math.sqrt(1.0 - decay * decay) * deviate
