r"""How plainly given commands can be seen, by a perfect detector, as time goes on.

.. math:: d_t^2 = \sum_{k \le t} |R_k u|^2

with R the whitened map to the analyst's innovations.  It bounds the delay of any detection from
below, and with it the curve of what is still undetected.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .floor import WorldFrontier
from .linear import LinearRun, respond, white

FloatArray = NDArray[np.float64]


def deflection(world: WorldFrontier, commands: FloatArray) -> FloatArray:
    """Deflection of open-loop commands up to every epoch.

    Parameters
    ----------
    world : WorldFrontier
        Of the attack.
    commands : ndarray
        (J,) rates [m/s].

    Returns
    -------
    ndarray
        (K,) d.
    """
    return _accumulated(world.whitened @ commands)


def deflection_of_offsets(analyst: LinearRun, offsets: FloatArray) -> FloatArray:
    """Deflection of what an attack has added to the measurements, whatever commanded it.

    Parameters
    ----------
    analyst : LinearRun
        The analyst's filter of the same sky and flight.
    offsets : ndarray
        (K, m) what was added to pseudoranges and range rates [m], [m/s]; 0 where not visible.

    Returns
    -------
    ndarray
        (K,) d.
    """
    seen = respond(analyst, offsets[:, :, None]).innovation
    return _accumulated(white(analyst.innovation_cov, seen)[:, :, 0])


def _accumulated(y: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.cumsum((y * y).sum(axis=1))))
