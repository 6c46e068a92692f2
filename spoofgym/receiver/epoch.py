"""What a detector may see of an epoch: measurements and beliefs, and no truth."""

from __future__ import annotations

from collections.abc import Collection, Mapping
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
    `innovation_cov`.  A receiver that measures a position has n = 0 and m coordinates.

    The fields after `predicted_velocity` are optional: gathering them costs time, so that each is
    None unless the `needs` of the detector in the loop, of a passive detector or of a monitor names
    it.  A detector must not read what its own `needs` doesn't name, since the others change.

    Attributes
    ----------
    time, interval : ndarray
        (B,) time of the epoch and time since the last one [s].
    innovation : ndarray
        (B, m) [m], [m/s].
    innovation_variance : ndarray
        (B, m) what the filter believes the variance of each innovation to be, the diagonal of S;
        1 where a slot is invisible.
    visible : ndarray
        (B, n) bool.
    predicted_position, predicted_velocity : ndarray
        (B, 3) before the update, ECEF [m], [m/s].
    innovation_cov : ndarray or None
        (B, m, m) S.
    predicted_cov : ndarray or None
        (B, s, s) P before the update; 17 states where the receiver is tightly coupled, and after
        them those of `receiver.augmented` where it is tuned so.
    design : ndarray or None
        (B, m, s) H.
    transition : ndarray or None
        (B, s, s) Phi.
    imu_delta : ndarray or None
        (B, 6) bias-corrected delta-v [m/s] and delta-theta [rad] of the interval, body axes.
    pseudorange, range_rate : ndarray or None
        (B, n) as measured [m], [m/s].
    satellite_position, satellite_velocity : ndarray or None
        (B, n, 3) from the ephemerides, ECEF [m], [m/s].
    gnss_position : ndarray or None
        (B, 3) GNSS position alone.
    auxiliary_position : ndarray or None
        (B, 3) position by odometry.
    cn0_dbhz : ndarray or None
        (B, n) carrier-to-noise density.
    """

    time: FloatArray
    interval: FloatArray
    innovation: FloatArray
    innovation_variance: FloatArray
    visible: NDArray[np.bool_]
    predicted_position: FloatArray
    predicted_velocity: FloatArray
    innovation_cov: FloatArray | None = None
    predicted_cov: FloatArray | None = None
    design: FloatArray | None = None
    transition: FloatArray | None = None
    imu_delta: FloatArray | None = None
    pseudorange: FloatArray | None = None
    range_rate: FloatArray | None = None
    satellite_position: FloatArray | None = None
    satellite_velocity: FloatArray | None = None
    gnss_position: FloatArray | None = None
    auxiliary_position: FloatArray | None = None
    cn0_dbhz: FloatArray | None = None


OPTIONAL = tuple(Epoch._field_defaults)
"""Fields of an epoch that are None unless somebody's `needs` names them."""
ALWAYS = frozenset(Epoch._fields).difference(OPTIONAL)
"""The others."""


class TracedEpoch(Epoch):
    """Epoch that notes in `read` which optional fields are read by their names, in copies too."""

    @property
    def read(self) -> set[str]:
        found: set[str] = self.__dict__.setdefault("read", set())
        return found

    def __getattribute__(self, name: str) -> Any:
        if name in OPTIONAL:
            self.read.add(name)
        return super().__getattribute__(name)

    def _replace(self, /, **changed: Any) -> TracedEpoch:
        other = super()._replace(**changed)
        other.__dict__["read"] = self.read
        return other


def epoch_view(buffers: ReceiverBuffers, shown: Mapping[str, NDArray[Any]] | None = None) -> Epoch:
    """Read-only view of a batch's current epoch, with those of the optional fields that it has.
    `shown`: fields by name that are not those of the buffers."""
    arrays = {
        "time": buffers.time,
        "interval": buffers.interval,
        "visible": buffers.visible,
        "predicted_position": buffers.position_e,
        "predicted_velocity": buffers.velocity_e,
        **buffers.seen,
        **(shown or {}),
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
    A forged address gets at the memory all the same, as ``ctypes`` does."""
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


def frozen_fields(
    arrays: Mapping[str, NDArray[Any]], names: Collection[str]
) -> dict[str, NDArray[Any]]:
    """`frozen` copies of the arrays with these names."""
    return {name: frozen(array) for name, array in arrays.items() if name in names}
