"""What a detector may see; memory of the filters."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..core.lanes import LaneFields
from ..core.registry import suggest_name
from ..core.simd import ArrayTable
from ..truth.sensors import SensorBuffers
from .states import INDEX, PACKED, STATES


def receiver_shapes(channels: int) -> dict[str, tuple[int, ...]]:
    """What is stored of every receiver from epoch to epoch, in the order of the lane array.

    - `C_eb` (3, 3) estimated attitude, to ECEF from body axes;
    - `velocity_e`, `position_e` (3,) estimated, ECEF [m/s], [m];
    - `accel_bias_b`, `gyro_bias_b` (3,) estimated sensor biases [m/s^2], [rad/s];
    - `clock` (2,) estimated receiver clock bias [m] and drift [m/s];
    - `imu_delta` (6,) bias-corrected delta-v [m/s] and delta-theta [rad] of the interval;
    - `packed_covariance` in the order of `error_model.INDEX`;
    - `innovation` (2n,) pseudoranges [m] and range rates [m/s] of the epoch as measured, until what
      is predicted of them is taken away; 0 where invisible;
    - `line_of_sight` (n, 3) unit vectors to the satellites, ECEF, 0 where invisible;
    - `visible` (n,) 1 or 0.
    """
    n = channels
    return {
        "C_eb": (3, 3),
        "velocity_e": (3,),
        "position_e": (3,),
        "accel_bias_b": (3,),
        "gyro_bias_b": (3,),
        "clock": (2,),
        "imu_delta": (6,),
        "packed_covariance": (PACKED,),
        "innovation": (2 * n,),
        "line_of_sight": (n, 3),
        "visible": (n,),
    }


def assumed_shapes(channels: int) -> dict[str, tuple[int, ...]]:
    """What every receiver assumes of the noise, in the order of the lane array.

    - `noise_psd` (17,) power spectral density of the noise that drives each state;
    - `noise_variance` (2n,) R, pseudoranges first.
    """
    return {"noise_psd": (STATES,), "noise_variance": (2 * channels,)}


SEEN = (  # fields of an epoch in memory, in the order in which kernels have their places
    "innovation",
    "innovation_variance",
    "innovation_cov",
    "predicted_cov",
    "design",
    "transition",
    "imu_delta",
    "pseudorange",
    "range_rate",
    "satellite_position",
    "satellite_velocity",
    "weights",  # which no kernel writes
)
ALWAYS_SEEN = frozenset({"innovation", "innovation_variance"})


def _seen_shapes(channels: int) -> dict[str, tuple[int, ...]]:
    n = channels
    shapes = [(2 * n,), (2 * n,), (2 * n, 2 * n), (17, 17), (2 * n, 17), (17, 17), (6,)]
    return dict(zip(SEEN, [*shapes, (n,), (n,), (n, 3), (n, 3), (2 * n,)], strict=True))


class ReceiverBuffers:
    """The memory of a batch of receivers.

    - `fields`: of `receiver_shapes`, in lane arrays;
    - `assumed`: of `assumed_shapes`, once where all receivers are `alike`;
    - `time`, `interval` (B,) time of the epoch and time since the last one [s];
    - `position_e`, `velocity_e` (B, 3) estimated, ECEF [m], [m/s], as the last kernel left them;
    - `visible` (B, n) bool; `coasting` (B,) bool, whether the last epoch had no update;
    - `seen`: fields of `SEEN` that are in use, (B, ...) each; `places` (12,) where in
      `seen_floats` each lies, -1 if unused.
    """

    def __init__(
        self, receivers: int, channels: int, wanted: Iterable[str] = (), *, alike: bool = False
    ) -> None:
        self.receivers, self.channels = receivers, channels
        self.fields = LaneFields(receivers, receiver_shapes(channels))
        self.assumed = LaneFields(receivers, assumed_shapes(channels), shared=alike)
        self.assumed["noise_variance"] = 1.0
        self.visible = np.zeros((receivers, channels), dtype=np.bool_)
        self.coasting = np.zeros(receivers, dtype=np.bool_)
        shapes = _seen_shapes(channels)
        chosen = ALWAYS_SEEN | (set(wanted) & set(SEEN))
        self._shapes = {name: (receivers, *shapes[name]) for name in SEEN if name in chosen}
        sizes = [int(np.prod(shape)) for shape in self._shapes.values()]
        firsts = dict(zip(self._shapes, np.cumsum([8 * receivers, *sizes]).tolist(), strict=False))
        self.places = np.array([firsts.get(name, -1) for name in SEEN])
        self.seen_floats = np.zeros(8 * receivers + sum(sizes))
        self._name_arrays()

    def _name_arrays(self) -> None:
        b, floats = self.receivers, self.seen_floats
        self.time, self.interval = floats[:b], floats[b : 2 * b]
        self.position_e = floats[2 * b : 5 * b].reshape(b, 3)
        self.velocity_e = floats[5 * b : 8 * b].reshape(b, 3)
        self.seen = {
            name: floats[place : place + int(np.prod(shape))].reshape(shape)
            for name, shape, place in zip(
                self._shapes, self._shapes.values(), self.places[self.places >= 0], strict=True
            )
        }

    def __getstate__(self) -> dict[str, object]:
        views = ("time", "interval", "position_e", "velocity_e", "seen")
        return {name: value for name, value in self.__dict__.items() if name not in views}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._name_arrays()

    @property
    def covariance(self) -> FloatArray:
        """(B, 17, 17) in the order of `receiver.states`, a copy."""
        return self.fields["packed_covariance"][:, INDEX]

    def put_covariance(self, rows: NDArray[np.intp], covariance: FloatArray) -> None:
        """Write the (17, 17) covariance of some receivers, (b, 17, 17) or one for all."""
        upper = np.triu_indices(STATES)
        self.fields.put("packed_covariance", rows, np.asarray(covariance)[..., *upper])

    def copy_rows(
        self, to: NDArray[np.intp], other: ReceiverBuffers, rows: NDArray[np.intp]
    ) -> None:
        self.fields.copy_rows(to, other.fields, rows)
        self.assumed.copy_rows(to, other.assumed, rows)
        for name in ("time", "interval", "position_e", "velocity_e", "visible", "coasting"):
            getattr(self, name)[to] = getattr(other, name)[rows]
        for name, mine in self.seen.items():
            if name in other.seen:
                mine[to] = other.seen[name][rows]


def kernel_table(
    buffers: ReceiverBuffers, sensors: SensorBuffers, *more: NDArray[Any]
) -> ArrayTable:
    """Arrays of `_kernels.Arrays` as one argument of a kernel. `more`: `run`, `epoch_time`,
    `epoch_end`, `satellites`, `rules`, `signals` and `mappings` there, then what else a kernel
    takes."""
    return ArrayTable(
        [
            buffers.fields.data,
            buffers.assumed.data,
            buffers.seen_floats,
            buffers.places,
            buffers.visible,
            buffers.coasting,
            sensors.fields.data,
            sensors.constants.data,
            sensors.words.data,
            sensors.epoch,
            sensors.range_offset,
            sensors.rate_offset,
            sensors.authentic,
            sensors.in_run.data,
            *more,
        ]
    )


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
        (B,) time of the epoch and time since the last one [s], 0.5 s unless the world says
        otherwise.
    innovation : ndarray
        (B, m) z, measured minus predicted [m], [m/s].
    innovation_variance : ndarray
        (B, m) what the filter believes the variance of each innovation to be, the diagonal of S;
        1 where a slot is invisible.
    visible : ndarray
        (B, n) bool.
    predicted_position, predicted_velocity : ndarray
        (B, 3) before the update, ECEF [m], [m/s].
    innovation_cov : ndarray or None
        (B, m, m) S, with which the normalized innovation squared is z' S^-1 z.
    predicted_cov : ndarray or None
        (B, s, s) P before the update, of the s errors x of the prediction.  A tightly coupled
        receiver has 17, and after them those of `receiver.augmented` where it is tuned so: attitude
        [rad], velocity [m/s], position [m] (ECEF axes), all three estimate minus truth; biases of
        accelerometers [m/s^2] and gyros [rad/s] (body axes), clock bias [m] and drift [m/s], all
        four truth minus estimate.
    design : ndarray or None
        (B, m, s) H, by which these errors shift the innovation: z = H x + noise.
    transition : ndarray or None
        (B, s, s) Phi, by which they grow from the last update to this prediction: x(k, predicted) =
        Phi x(k - 1, updated) + noise.
    imu_delta : ndarray or None
        (B, 6) bias-corrected delta-v [m/s] and delta-theta [rad] of the interval, body axes:
        forward, right, down.
    pseudorange, range_rate : ndarray or None
        (B, n) as measured [m], [m/s].
    satellite_position, satellite_velocity : ndarray or None
        (B, n, 3) from the ephemerides, ECEF [m], [m/s].
    gnss_position : ndarray or None
        (B, 3) GNSS position alone.
    auxiliary_position : ndarray or None
        (B, 3) position by odometry.
    cn0_dbhz : ndarray or None
        (B, n) carrier-to-noise density [dB-Hz]; no receiver here has it: a detector that needs it
        is refused.
    weights : ndarray or None
        (B, m) with which the last epoch was updated, ones before the first: the feedback of the
        filter was P H' S^-1 W z of that epoch.
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
    weights: FloatArray | None = None


OPTIONAL = tuple(Epoch._field_defaults)  # None unless some `needs` names them
FILTER = ("predicted_cov", "design", "transition", "imu_delta")  # what makes a filter's model
ALWAYS = frozenset(Epoch._fields).difference(OPTIONAL)  # the others


class TracedEpoch(Epoch):
    """Epoch that notes in `read_fields` optional fields read by name, in copies too."""

    @property
    def read_fields(self) -> set[str]:
        found: set[str] = self.__dict__.setdefault("read_fields", set())
        return found

    def __getattribute__(self, name: str) -> Any:
        if name in OPTIONAL:
            self.read_fields.add(name)
        return super().__getattribute__(name)

    def __getattr__(self, name: str) -> NoReturn:
        valid, hint = ", ".join(Epoch._fields), suggest_name(name, Epoch._fields)
        raise AttributeError(f"an `Epoch` has no {name!r}; valid: {valid}{hint}")

    def _replace(self, /, **changed: Any) -> TracedEpoch:
        other = super()._replace(**changed)
        other.__dict__["read_fields"] = self.read_fields
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
    return Epoch(**{name: _seal_array(array) for name, array in arrays.items()})


class _Seal:
    """Base of a read-only view, from which no attribute leads to the memory."""

    __slots__ = ("__array_interface__", "__weakref__")
    __array_interface__: dict[str, Any]


_OWNERS: WeakKeyDictionary[_Seal, NDArray[Any]] = WeakKeyDictionary()  # arrays of sealed views


def _seal_array(array: NDArray[Any]) -> NDArray[Any]:
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


def select_receiver(epoch: Epoch, row: int) -> Epoch:
    """Epoch of one receiver, whose fields have no axis of receivers."""
    return Epoch(*(None if array is None else array[row] for array in epoch))  # type: ignore[arg-type]


def stack_receivers(epochs: Sequence[Epoch]) -> Epoch:
    """Epoch of B receivers from as many of one each; the reverse of `select_receiver`."""
    columns = zip(*epochs, strict=True)
    return Epoch(*(None if each[0] is None else frozen(np.stack(each)) for each in columns))  # type: ignore[arg-type]


class EpochMaker:
    """Makes epochs, read-only copies of what is `constant` and of what is given; `fields`: optional
    ones that they have."""

    def __init__(self, fields: Collection[str], constant: Mapping[str, NDArray[Any]]) -> None:
        self._names = ALWAYS.union(fields)
        self._constant = self._frozen(constant)

    def _frozen(self, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        return {name: frozen(array) for name, array in arrays.items() if name in self._names}

    def __call__(self, **arrays: NDArray[Any]) -> Epoch:
        return Epoch(**self._constant, **self._frozen(arrays))


def without_channels(b: int) -> dict[str, NDArray[Any]]:
    """What an epoch of B receivers without channels has, but never changes."""
    nothing, no_vector = np.zeros((b, 0)), np.zeros((b, 0, 3))
    return {
        "pseudorange": nothing,
        "range_rate": nothing,
        "satellite_position": no_vector,
        "satellite_velocity": no_vector,
        "visible": np.zeros((b, 0), dtype=np.bool_),
    }
