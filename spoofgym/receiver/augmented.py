r"""A tightly coupled filter with states for all that is not white, so that its innovations are.

To the 17 states of `receiver.states` come

- the 27 errors of scale, cross coupling and g-dependence of the inertial sensors, constants that
  move attitude and velocity as biases of the size of the motion would,

  .. math:: b_f = M_f f, \qquad b_\omega = M_\omega \omega + G f

- where biases wander, what those of accelerometers and gyros have wandered by, first-order
  Gauss-Markov as in the world;
- for every satellite, as far as its world has them: a constant, an error of the code that wanders,
  orbit and clock with their rate, the smoothed error of the code, and the last two readings of the
  carrier, whose difference is the noise of the range rate;
- the zenith delays of ionosphere and troposphere, with their rates.

All are estimated.  The 17 are fed back to the strapdown as ever; the others stay in the filter,
which takes what they predict out of the innovations and out of the strapdown's errors.  The
covariance belongs to the estimates where the assumed errors are those of the world: innovations
are then white, with the covariance S that the filter believes in.

The measurement update is the textbook's, with Cholesky's or LU factors of S, receiver by receiver;
it is not written for lanes, and costs tens of times as much as that of 17 states.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.memory import Memory
from ..truth.gnss_errors import GnssErrors
from ..truth.sensors import IMU_GRADES, ImuGrade
from ..truth.signal_errors import HALF_LIFE, SignalErrors, process_coefficients
from ._augmented_kernels import KINDS, MATRICES, IntArray, couple_errors, write_signal_rows
from .states import STATES

FloatArray = NDArray[np.float64]
FIRST = STATES + MATRICES  # first state of what has a `SignalModel`
IN_RUN = "in_run"  # the kind of its states that the inertial sensors have: biases that wander


class SignalModel(NamedTuple):
    """States behind the constants, of biases that wander and of the signals: how they go on, and
    what of them is in codes and range rates. `transition`, `driving` (q, q) over one interval;
    `first` (q,) variances at the start; `places`: first state of every kind that there is;
    `smoothed` (4,) amplitudes of multipath and noise."""

    transition: FloatArray
    driving: FloatArray
    first: FloatArray
    places: dict[str, int]
    smoothed: tuple[float, ...]

    @property
    def wandering(self) -> int:
        """How many states are biases of inertial sensors; they come first."""
        return 6 if IN_RUN in self.places else 0

    def tables(self, interval_s: float) -> tuple[IntArray, FloatArray, float]:
        """First state of every kind, -1 for no state, amplitudes, and the rate of epochs, as
        of `append_signals`."""
        first = np.array([self.places.get(kind, -1) for kind in KINDS])
        return first, np.array(self.smoothed), 1.0 / interval_s


def _kinds(errors: GnssErrors, bias_sd: FloatArray, wandering: bool) -> dict[str, int]:
    n, signals = len(bias_sd), errors.signals
    wanted = {
        IN_RUN: (wandering, 6),
        "constant": (bias_sd.any(), n),
        "correlated": (errors.correlated_sd_m > 0.0, n),
    }
    if signals is not None:
        wanted |= {
            "ionosphere": (signals.ionosphere_sd_m > 0.0, 2),
            "troposphere": (signals.troposphere_sd_m > 0.0, 2),
            "orbit_clock": (signals.orbit_clock_sd_m > 0.0, 2 * n),
            "smoothed": (max(*signals.multipath_sd_m, *signals.noise_sd_m) > 0.0, n),
            "carrier": (signals.carrier_sd_m > 0.0, 2 * n),
        }
    return {name: count for name, (there, count) in wanted.items() if there}


def signal_model(
    errors: GnssErrors, bias_sd: FloatArray, interval_s: float, wandering: ImuGrade | None = None
) -> SignalModel:
    """States of the signals for some errors; `bias_sd` (n,) of the constants of satellites [m];
    `wandering`: sensors whose biases wander, which have states, too."""
    counts = _kinds(errors, bias_sd, wandering is not None)
    s = np.arange(len(bias_sd))
    firsts = np.cumsum([0, *counts.values()]).tolist()
    places, q = dict(zip(counts, firsts, strict=False)), firsts[-1]
    signals = SignalErrors() if errors.signals is None else errors.signals
    smoothed = *signals.multipath_sd_m, *signals.noise_sd_m
    model = SignalModel(np.eye(q), np.zeros((q, q)), np.zeros(q), places, smoothed)
    if "constant" in places:
        model.first[places["constant"] + s] = bias_sd**2
    if wandering is not None:
        _put_gauss_markov(
            model, np.arange(6), np.repeat(wandering.in_run, 3), wandering.in_run_s, interval_s
        )
    for name, sd, time_s in (
        ("correlated", errors.correlated_sd_m, errors.correlation_s),
        ("smoothed", 1.0, signals.smoothing_s),
    ):
        if name in places:
            _put_gauss_markov(model, places[name] + s, sd, time_s, interval_s)
    for name, sd, time_s, which in (
        ("ionosphere", signals.ionosphere_sd_m, signals.ionosphere_s, s[:1]),
        ("troposphere", signals.troposphere_sd_m, signals.troposphere_s, s[:1]),
        ("orbit_clock", signals.orbit_clock_sd_m, signals.orbit_clock_s, s),
    ):
        if name in places:
            _put_process(model, places[name] + which, process_coefficients(sd, time_s, interval_s))
            model.first[places[name] + which] = sd**2
            model.first[places[name] + len(which) + which] = (sd * HALF_LIFE / time_s) ** 2
    if "carrier" in places:
        j, k = places["carrier"] + s, places["carrier"] + len(s) + s
        model.transition[j, j], model.transition[k, j], model.transition[k, k] = 0.0, 1.0, 0.0
        model.driving[j, j] = model.first[j] = model.first[k] = signals.carrier_sd_m**2
    return model


def _put_gauss_markov(
    model: SignalModel,
    j: NDArray[np.intp],
    sd: float | FloatArray,
    time_s: float,
    interval_s: float,
) -> None:
    alpha = math.exp(-interval_s / time_s)
    model.transition[j, j], model.first[j] = alpha, sd**2
    model.driving[j, j] = (1.0 - alpha * alpha) * sd**2


def _put_process(model: SignalModel, j: NDArray[np.intp], coefficients: list[float]) -> None:
    """Write second-order processes: values at `j`, as many rates behind them."""
    D, Q, k = model.transition, model.driving, j + len(j)
    f00, f01, f10, f11, l11, l21, l22 = coefficients
    D[j, j], D[j, k], D[k, j], D[k, k] = f00, f01, f10, f11
    Q[j, j], Q[j, k], Q[k, j], Q[k, k] = l11**2, l11 * l21, l11 * l21, l21**2 + l22**2


def matrix_variances(grade: str) -> FloatArray:
    """(27,) variances of the errors of scale, cross coupling and g-dependence of a grade."""
    sheet = IMU_GRADES[grade]
    parts = sheet.accel_matrix - np.eye(3), sheet.gyro_matrix - np.eye(3), sheet.g_dependence
    return np.repeat([float(np.mean(part**2)) for part in parts], 9)


def first_covariance(model: SignalModel, covariance: FloatArray, grade: str) -> FloatArray:
    """(N, N) of all states at the start; `covariance` (17, 17) of those of `receiver.states`."""
    more = np.concatenate([matrix_variances(grade), model.first])
    P = np.diag(np.concatenate([np.zeros(STATES), more]))
    P[:STATES, :STATES] = covariance
    return P


class FilterModel(NamedTuple):
    """What an augmented filter assumes of a world. `signals`: states of the signals; `noise_psd`
    (17,) of the states of `receiver.states`; `noise_variance` (2n,) R; `covariance` (17, 17) at the
    start; `grade` of the inertial sensors, whose constants are states."""

    signals: SignalModel
    noise_psd: FloatArray
    noise_variance: FloatArray
    covariance: FloatArray
    grade: str


class Predicted(NamedTuple):
    """What an update needs of the prediction. `gain` (B, N, m) P H'; `S` (B, m, m); `innovation`
    (B, m); `drift` (B, 17) error of the strapdown that matrices and wandering biases have brought;
    `enough` (B,) bool, satellites for an update; `visible` (B, n) bool."""

    gain: FloatArray
    S: FloatArray
    innovation: FloatArray
    drift: FloatArray
    enough: NDArray[np.bool_]
    visible: NDArray[np.bool_]


class AugmentedFilter:
    """Covariances and estimates of B receivers, in a memory.

    - `memory`: ``augmented_covariance`` (B, N, N) and ``augmented`` (B, N - 17), the estimates that
      are not fed back;
    - `shown`: fields of an epoch that have all N states, as far as they are `wanted`: the error
      that each state is of is truth minus estimate for what is not fed back.
    """

    def __init__(
        self,
        memory: Memory,
        model: SignalModel,
        interval_s: float,
        channels: int,
        wanted: Collection[str] = (),
    ) -> None:
        self.memory, self.model = memory, model
        b, size = memory.receivers, FIRST + len(model.first)
        self.states, self.inertial = size, FIRST + model.wandering
        self._tables = model.tables(interval_s)
        memory.declare("augmented_covariance", np.zeros((b, size, size)))
        memory.declare("augmented", np.zeros((b, size - STATES)))
        shapes = {"predicted_cov": size, "design": 2 * channels, "transition": size}
        self.shown = {
            name: np.zeros((b, rows, size)) for name, rows in shapes.items() if name in wanted
        }
        if "transition" in self.shown:
            self.shown["transition"][:, STATES:FIRST, STATES:FIRST] = np.eye(MATRICES)
            self.shown["transition"][:, FIRST:, FIRST:] = model.transition

    def copy_rows(
        self, to: NDArray[np.intp], other: AugmentedFilter, rows: NDArray[np.intp]
    ) -> None:
        """Take over what is shown of receivers of another batch; the memory is the simulator's."""
        for name, mine in self.shown.items():
            if name in other.shown:
                mine[to] = other.shown[name][rows]

    def start_episodes(self, rows: NDArray[np.intp], covariance: FloatArray, grade: str) -> None:
        """Begin new episodes; `covariance` (17, 17) of the states of `receiver.states`."""
        self.memory["augmented_covariance"][rows] = first_covariance(self.model, covariance, grade)
        self.memory["augmented"][rows] = 0.0

    def predict(
        self,
        transition: FloatArray,
        imu_delta: FloatArray,
        noise_psd: FloatArray,
        tau: FloatArray,
        design: FloatArray,
        mapping: FloatArray,
        visible: NDArray[np.bool_],
        innovation: FloatArray,
        noise_variance: FloatArray,
        fewest: int,
    ) -> Predicted:
        """Go on by one interval, and form the innovations, as arrays of `Epoch` and the filter."""
        P, a = self.memory["augmented_covariance"], self.memory["augmented"]
        D, inertial = self.model.transition, self.inertial
        top = np.zeros((len(tau), STATES, inertial))
        couple_errors(transition, imu_delta, tau, top)
        moved = np.ascontiguousarray(top[:, :, STATES:])
        self._propagate(P, top, 0.5 * tau[:, None] * noise_psd)
        drift = (moved @ a[:, : inertial - STATES, None])[:, :, 0]
        a[:, MATRICES:] = (D @ a[:, MATRICES:, None])[:, :, 0]
        signals = np.zeros((*design.shape[:2], len(D)))
        write_signal_rows(mapping, visible, *self._tables, signals)
        H = np.concatenate([design, np.zeros((*design.shape[:2], MATRICES)), signals], axis=2)
        known = (design @ drift[:, :, None] + signals @ a[:, MATRICES:, None])[:, :, 0]
        self._show(top, H, P)
        gain, S = self._project(P, H, noise_variance, visible)
        enough = visible.sum(axis=1) >= fewest
        return Predicted(gain, S, innovation - known, drift, enough, visible)

    def _propagate(self, P: FloatArray, top: FloatArray, half: FloatArray) -> None:
        """Go on by one interval in place; `top` (B, 17, c) of inertial states, `half` (B, 17) of
        the noise."""
        index, D, inertial = np.arange(STATES), self.model.transition, self.inertial
        P[:, index, index] += half
        P[:, :STATES] = top @ P[:, :inertial]
        P[:, :, :STATES] = P[:, :, :inertial] @ top.transpose(0, 2, 1)
        P[:, index, index] += half
        P[:, FIRST:] = D @ P[:, FIRST:]
        P[:, :, FIRST:] = P[:, :, FIRST:] @ D.T
        P[:, FIRST:, FIRST:] += self.model.driving

    def _project(
        self, P: FloatArray, H: FloatArray, variance: FloatArray, visible: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray]:
        """P H' and S."""
        gain = P @ H.transpose(0, 2, 1)
        S = H @ gain
        rows, seen = np.arange(S.shape[1]), np.hstack([visible, visible])
        S[:, rows, rows] += np.where(seen, variance, 1.0)
        return gain, S

    def _show(self, top: FloatArray, H: FloatArray, P: FloatArray) -> None:
        shown = self.shown
        if "transition" in shown:
            shown["transition"][:, :STATES, : self.inertial] = top
        for name, array in (("design", H), ("predicted_cov", P)):
            if name in shown:
                shown[name][:] = array

    def update(self, predicted: Predicted, weights: FloatArray | None) -> FloatArray:
        z = predicted.innovation
        change = self._correct(predicted, z if weights is None else weights * z)
        a = self.memory["augmented"]
        a += change[:, STATES:]
        return predicted.drift + change[:, :STATES]

    def _correct(self, predicted: Predicted, used: FloatArray) -> FloatArray:
        """Update the covariance; (B, N) change of the estimates by innovations (B, m)."""
        gain, S, _, _, enough, _ = predicted
        P = self.memory["augmented_covariance"]
        solved = np.linalg.solve(S, np.concatenate([used[:, :, None], gain.transpose(0, 2, 1)], 2))
        change = (gain @ solved[:, :, :1])[:, :, 0] * enough[:, None]
        P -= (gain @ solved[:, :, 1:]) * enough[:, None, None]
        P += P.transpose(0, 2, 1).copy()
        P *= 0.5
        return np.asarray(change)
