"""What a detector may see of an epoch: measurements and beliefs, and no truth."""

from __future__ import annotations

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from .state import ReceiverBuffers

FloatArray = NDArray[np.float64]


class Epoch(NamedTuple):
    """One GNSS epoch of B receivers, between prediction and update.

    Read-only, C-contiguous, and valid only while a detector judges it.  Channels are slots for
    satellites; rows of the innovation are pseudoranges first, then range rates, m = 2n.  An
    invisible slot has innovation 0, a zero row of `design`, and row and column of the identity in
    `innovation_cov`.

    Attributes
    ----------
    time, interval : ndarray
        (B,) time of the epoch and time since the last one [s].
    innovation : ndarray
        (B, m) [m], [m/s].
    innovation_cov : ndarray
        (B, m, m) S.
    predicted_cov : ndarray
        (B, 17, 17) P before the update.
    design : ndarray
        (B, m, 17) H.
    transition : ndarray
        (B, 17, 17) Phi.
    imu_delta : ndarray
        (B, 6) bias-corrected delta-v [m/s] and delta-theta [rad] of the interval, body axes.
    pseudorange, range_rate : ndarray
        (B, n) as measured [m], [m/s].
    satellite_position, satellite_velocity : ndarray
        (B, n, 3) from the ephemerides, ECEF [m], [m/s].
    visible : ndarray
        (B, n) bool.
    predicted_position, predicted_velocity : ndarray
        (B, 3) before the update, ECEF [m], [m/s].
    gnss_position : ndarray or None
        (B, 3) GNSS position alone, where a detector's `needs` names it.
    auxiliary_position : ndarray or None
        (B, 3) position by odometry, where a detector's `needs` names it.
    cn0_dbhz : ndarray or None
        (B, n) carrier-to-noise density, where a detector's `needs` names it.
    """

    time: FloatArray
    interval: FloatArray
    innovation: FloatArray
    innovation_variance: FloatArray
    innovation_cov: FloatArray
    predicted_cov: FloatArray
    design: FloatArray
    transition: FloatArray
    imu_delta: FloatArray
    pseudorange: FloatArray
    range_rate: FloatArray
    satellite_position: FloatArray
    satellite_velocity: FloatArray
    visible: NDArray[np.bool_]
    predicted_position: FloatArray
    predicted_velocity: FloatArray
    gnss_position: FloatArray | None = None
    auxiliary_position: FloatArray | None = None
    cn0_dbhz: FloatArray | None = None


def epoch_view(buffers: ReceiverBuffers) -> Epoch:
    """Read-only view of a batch's current epoch."""
    arrays = {
        "time": buffers.time,
        "interval": buffers.interval,
        "visible": buffers.visible,
        "predicted_position": buffers.position_e,
        "predicted_velocity": buffers.velocity_e,
        **buffers.seen,
    }
    return Epoch(**{name: _sealed(array) for name, array in arrays.items()})


class _Seal:
    """Base of a read-only view, from which no attribute leads to the memory."""

    __slots__ = ("__array_interface__", "__weakref__")
    __array_interface__: dict[str, Any]


_OWNERS: WeakKeyDictionary[_Seal, NDArray[Any]] = WeakKeyDictionary()
"""Arrays that sealed views look at, which keeps them alive as long as the views."""


def _sealed(array: NDArray[Any]) -> NDArray[Any]:
    """View of an array that can't be made writable again: its base is no array, and has no buffer.

    A forged address gets at the memory all the same, as ``ctypes`` does.
    """
    seal, interface = _Seal(), dict(array.__array_interface__)
    interface["data"] = (interface["data"][0], True)
    seal.__array_interface__ = interface
    _OWNERS[seal] = array
    view = np.asarray(seal)
    del seal.__array_interface__
    return view


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """C-contiguous copy in bytes that can't be changed, which costs hardly more than a view."""
    return np.ndarray(array.shape, array.dtype, array.tobytes())
