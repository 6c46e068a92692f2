"""Errors of smoothed codes and of carriers: what the signals of an airborne receiver pick up.

The ionosphere delays the code and advances the carrier, by one zenith delay over the receiver that
a satellite sees through the thicker the lower it stands; troposphere, orbit and satellite clock are
the same in both; multipath and the receiver's noise are in the code alone, and wander, since the
code has been smoothed by the carrier.  Range rates are differences of carriers.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.compile import inline_njit, njit
from ..core.declared import check_number, setting, settings_record
from ..core.registry import require
from .noise import normals, pad_count

FloatArray = NDArray[np.float64]
IONOSPHERE_HEIGHT_M = 350_000.0  # height of the thin shell (`do-229`, A.4.4.10.4)
SHELL_RADIUS_M = 6_378_136.3  # radius of the Earth below it, there
MULTIPATH_DEG, NOISE_DEG = 10.0, 6.9  # fall to 1/e there (`do-229`, J.2.4; `wgc2016`)
# What is stored of a line of sight, and that with the rates [1/s] of the first two: obliquity of
# ionosphere and of troposphere, and the two exponentials of multipath and noise.
OBLIQUITIES, MAPPINGS = 4, 6
HALF_LIFE = 2.146193220620583  # of a critically damped process: (1 + x) exp(-x) is 1/e at this x
DRAWN = 1 << 41  # counter of the deviates with which an episode starts
NEVER = 1e18  # as an epoch: after all


def standard_deviation(help: str) -> Any:
    return setting(default=0.0, least=0.0, unit="m", help=help)


def correlation_time(default: float, help: str) -> Any:
    return setting(default=default, above=0.0, unit="s", help=help)


@settings_record(frozen=True, kw_only=True)
class SignalErrors:
    r"""Errors that all signals of a receiver have in common, and those of each signal.

    .. math:: \delta\rho &= M_I I + M_T T + s + m + n, \qquad
        \delta\dot\rho = -\tfrac{d}{dt} M_I I + \tfrac{d}{dt} M_T T + \dot s
        + \frac{\varphi_k - \varphi_{k-1}}{\tau}

    Zenith delays I and T, one of each for the receiver, and s, orbit and clock of each satellite,
    are critically damped second-order Gauss-Markov processes: a first-order one has no rate, and
    its change from epoch to epoch would exceed the carrier's noise many times.  The differences of
    the carrier's white readings :math:`\varphi` are a moving average, with a correlation of -1/2 of
    neighbours, whose sum over any time has the noise of two readings.  Multipath m and noise n of
    the code are first-order, which is what smoothing by a carrier makes of white noise, with

    .. math:: \sigma_m = a_m + b_m e^{-E / 10^\circ}, \qquad \sigma_n = a_n + b_n e^{-E / 6.9^\circ}

    Obliquities and multipath: `do-229`, A.4.4.10.4, A.4.2.4 and J.2.4.
    """

    carrier_sd_m: float = standard_deviation("Noise of a reading of the carrier.")
    ionosphere_sd_m: float = standard_deviation("Delay by the ionosphere, in the zenith.")
    ionosphere_s: float = correlation_time(1800.0, "Time in which its correlation falls to 1/e.")
    troposphere_sd_m: float = standard_deviation("Delay by the troposphere, in the zenith.")
    troposphere_s: float = correlation_time(1800.0, "Time in which its correlation falls to 1/e.")
    orbit_clock_sd_m: float = standard_deviation("Orbit and clock of a satellite.")
    orbit_clock_s: float = correlation_time(7200.0, "Time in which their correlation falls to 1/e.")
    multipath_sd_m: tuple[float, float] = setting(
        default=(0.0, 0.0), unit="m", help="Multipath: a_m and b_m above."
    )
    noise_sd_m: tuple[float, float] = setting(
        default=(0.0, 0.0), unit="m", help="Noise of the code: a_n and b_n above."
    )
    smoothing_s: float = correlation_time(
        100.0, "Smoothing of the code, in which these two lose their correlation."
    )

    def __post_init__(self) -> None:
        for name in ("multipath_sd_m", "noise_sd_m"):
            pair = tuple(getattr(self, name))
            require(len(pair) == 2, f"`{name}` must be two numbers, got {pair}")
            object.__setattr__(self, name, pair)
            for value in pair:
                check_number(name, value, least=0.0)

    def wandering(self, elevation: FloatArray) -> list[tuple[FloatArray, float, bool]]:
        """Standard deviation [m], time [s] and whether second-order, of what wanders in a code.
        `elevation`: any shape [rad]."""
        ionosphere, troposphere, multipath, noise = obliquities(elevation)
        shape = np.ones_like(elevation)
        (a, b), (c, d) = self.multipath_sd_m, self.noise_sd_m
        return [
            (self.ionosphere_sd_m * ionosphere, self.ionosphere_s, True),
            (self.troposphere_sd_m * troposphere, self.troposphere_s, True),
            (self.orbit_clock_sd_m * shape, self.orbit_clock_s, True),
            (a + b * multipath, self.smoothing_s, False),
            (c + d * noise, self.smoothing_s, False),
        ]

    def code_variance(self, elevation: FloatArray) -> FloatArray:
        return np.asarray(sum(sd**2 for sd, _, _ in self.wandering(elevation)))


def correlation(lag_s: FloatArray, time_s: float, second_order: bool) -> FloatArray:
    """Correlation after some time, which is 1/e after `time_s`."""
    x = (HALF_LIFE if second_order else 1.0) * lag_s / time_s
    return np.asarray(np.exp(-x) * (1.0 + x if second_order else 1.0))


def obliquities(elevation: FloatArray) -> tuple[FloatArray, ...]:
    """Obliquities of ionosphere and troposphere, and exponentials of multipath and noise.
    `elevation`: any shape [rad]; below the horizon as at it."""
    E = np.maximum(elevation, 0.0)
    inside = SHELL_RADIUS_M / (SHELL_RADIUS_M + IONOSPHERE_HEIGHT_M) * np.cos(E)
    degrees = np.degrees(E)
    return (
        1.0 / np.sqrt(1.0 - inside**2),
        1.001 / np.sqrt(0.002001 + np.sin(E) ** 2),
        np.exp(-degrees / MULTIPATH_DEG),
        np.exp(-degrees / NOISE_DEG),
    )


def stack_obliquities(elevation: FloatArray) -> FloatArray:
    """(K, n, 4) of true elevations (K, n) [rad]."""
    return np.ascontiguousarray(np.stack(obliquities(elevation), axis=-1))


@inline_njit
def find_neighbours(time: FloatArray, k: int) -> tuple[int, int]:
    """Epochs before and after one; itself where its world begins or ends, and times start again."""
    before = k - 1 if k > 0 and time[k - 1] < time[k] else k
    after = k + 1 if k + 1 < time.shape[0] and time[k] < time[k + 1] else k
    return before, after


@njit
def compute_mappings(table: FloatArray, time: FloatArray, epochs: NDArray[np.int64]) -> FloatArray:
    """(B, n, 6) what is true of every line of sight (`MAPPINGS`) at some epochs (B,), with rates
    from the epochs before and after. `table` (K, n, 4) of `stack_obliquities`, `time` (K,) [s]."""
    found = np.empty((epochs.shape[0], table.shape[1], MAPPINGS))
    for b in range(epochs.shape[0]):
        k = epochs[b]
        before, after = find_neighbours(time, k)
        span = time[after] - time[before]
        for s in range(table.shape[1]):
            for i in range(2):
                found[b, s, 2 * i] = table[k, s, i]
                found[b, s, 2 * i + 1] = (table[after, s, i] - table[before, s, i]) / span
                found[b, s, 4 + i] = table[k, s, 2 + i]
    return found


def causal_mappings(
    elevation: FloatArray, visible: NDArray[np.bool_], interval: FloatArray, last: FloatArray
) -> FloatArray:
    r"""What a monitor can know of every line of sight (`MAPPINGS`), from present and past epochs.

    .. math:: \dot M_k = (M_k - M_{k-1}) / \tau

    in place of the central differences of `compute_mappings`, from which it differs by
    :math:`\tau \ddot M / 2`: up to 4e-6 /s at 2 Hz.  0 where a satellite was not visible before.

    `elevation` (B, n) [rad] and `visible` (B, n) of an epoch; `interval` (B,) since the one before
    [s]; `last`: what was returned there, 0 at the first; returns (B, n, 6), 0 where a satellite is
    not visible.
    """
    now = np.zeros((*elevation.shape, MAPPINGS))
    for column, values in zip((0, 2, 4, 5), obliquities(elevation), strict=True):
        now[..., column] = np.where(visible, values, 0.0)
    both = visible & (last[..., 0] > 0.0)  # obliquities of visible satellites are above 0
    change = np.where(both[..., None], now[..., :4:2] - last[..., :4:2], 0.0)
    now[..., 1:4:2] = change / interval[:, None, None]
    return now


def signal_shapes(channels: int) -> dict[str, tuple[int, ...]]:
    """Shapes of what is stored of each receiver's signals, in the order of the lane array.

    - `processes` (3, 7) of ionosphere, troposphere, orbit and clock: transition of value and rate,
      row by row, and Cholesky factor of the driving noise, 00 10 11, over one interval;
    - `fading` (2,) factor of the smoothed errors over one interval, and of their driving noise;
    - `amplitudes` (4,) a and b of multipath, then of noise [m];
    - `carrier` (2,) standard deviation of a reading [m], and 1 / interval [1/s];
    - `clock_step` (2,) epoch at which the receiver's clock jumps, and by how much [m];
    - `loss` (3,) slot whose satellite is lost, first epoch of the loss, and epoch of its return;
    - `front` (2,) growth per epoch of the delay behind an ionospheric front [m], and its largest
      value [m];
    - `zenith` (4,) delay and its rate of ionosphere, then of troposphere [m], [m/s];
    - `front_arrival` (n,) epoch at which the front comes to each satellite's line of sight;
    - `orbit_clock` (2n,) errors of the satellites [m], then their rates [m/s];
    - `multipath`, `noise` (n,) smoothed errors of codes, of unit variance;
    - `reading` (n,) error of the last carrier reading [m].
    """
    n = channels
    return {
        "processes": (3, 7),
        "fading": (2,),
        "amplitudes": (4,),
        "carrier": (2,),
        "clock_step": (2,),
        "loss": (3,),
        "front": (2,),
        "zenith": (4,),
        "front_arrival": (n,),
        "orbit_clock": (2 * n,),
        "multipath": (n,),
        "noise": (n,),
        "reading": (n,),
    }


@inline_njit
def count_deviates(channels: int) -> int:
    """Standard normal deviates of an epoch: zenith delays, then five of every signal."""
    return 4 + 5 * channels


def process_coefficients(sd: float, time_s: float, interval_s: float) -> list[float]:
    r"""Transition and driving noise of a critically damped process over one interval.

    .. math:: \Phi = e^{-x} \begin{pmatrix} 1 + x & \tau\\ -\beta^2 \tau & 1 - x
        \end{pmatrix}, \qquad Q = P - \Phi P \Phi^T, \qquad P = \sigma^2\, \mathrm{diag}(1, \beta^2)

    with :math:`x = \beta \tau`; Q as its Cholesky factor.
    """
    beta = HALF_LIFE / time_s
    x = beta * interval_s
    a, a2 = math.exp(-x), math.exp(-2.0 * x)
    q11 = sd * sd * _third_order(2.0 * x)
    q12 = 2.0 * sd * sd * beta * a2 * x * x
    q22 = sd * sd * beta * beta * (1.0 - a2 * (x * x + (1.0 - x) ** 2))
    l11 = math.sqrt(q11)
    l21 = q12 / l11 if l11 > 0.0 else 0.0
    l22 = math.sqrt(max(q22 - l21 * l21, 0.0))
    return [a * (1.0 + x), a * interval_s, -a * beta * x, a * (1.0 - x), l11, l21, l22]


def _third_order(y: float) -> float:
    """1 - exp(-y) (1 + y + y^2 / 2), without cancellation: its series from y^3 / 6 on."""
    term, total = math.exp(-y) * y**3 / 6.0, 0.0
    for k in range(4, 200):
        total += term
        term *= y / k
        if term <= 1e-17 * total:
            break
    return total


def start_signals(
    fields_: Any, rows: NDArray[np.intp], errors: SignalErrors, interval_s: float, keys: FloatArray
) -> None:
    """Draw the signals of new episodes, stationary from the first epoch on, without events.
    `fields_`: of `signal_shapes`; `keys`: (b,) of the noise, two arrays."""
    n = fields_.shapes["noise"][0]
    each = (
        (errors.ionosphere_sd_m, errors.ionosphere_s),
        (errors.troposphere_sd_m, errors.troposphere_s),
        (errors.orbit_clock_sd_m, errors.orbit_clock_s),
    )
    fading = math.exp(-interval_s / errors.smoothing_s)
    values: dict[str, Any] = {
        "processes": [process_coefficients(*process, interval_s) for process in each],
        "fading": (fading, math.sqrt(1.0 - fading * fading)),
        "amplitudes": (*errors.multipath_sd_m, *errors.noise_sd_m),
        "carrier": (errors.carrier_sd_m, 1.0 / interval_s),
        "clock_step": (NEVER, 0.0),
        "loss": (-1.0, NEVER, NEVER),
        "front": (0.0, 0.0),
        "front_arrival": NEVER,
    }
    for name, value in values.items():
        fields_.put(name, rows, value)
    drawn, out = np.empty((len(rows), count_deviates(n))), np.empty(pad_count(count_deviates(n)))
    for b, (k0, k1) in enumerate(keys):
        normals(k0, k1, DRAWN, out)
        drawn[b] = out[: drawn.shape[1]]
    sds = [(sd, sd * HALF_LIFE / time) for sd, time in each]
    fields_.put("zenith", rows, drawn[:, :4] * np.ravel(sds[:2]))
    own = drawn[:, 4:].reshape(len(rows), 5, n)
    fields_.put("orbit_clock", rows, (own[:, :2] * np.array(sds[2])[:, None]).reshape(-1, 2 * n))
    # the smoothed errors are stored as standard normal: their size follows the elevation
    fields_.put("multipath", rows, own[:, 2])
    fields_.put("noise", rows, own[:, 3])
    fields_.put("reading", rows, errors.carrier_sd_m * own[:, 4])


SIGNAL_ERRORS: dict[str, SignalErrors] = {
    "aviation-actual": SignalErrors(
        carrier_sd_m=0.0025,
        ionosphere_sd_m=0.5,
        troposphere_sd_m=0.12,
        orbit_clock_sd_m=0.5,
        multipath_sd_m=(0.13, 0.53),
        noise_sd_m=(0.15, 0.0),
    ),
    "aviation-overbound": SignalErrors(
        carrier_sd_m=0.005,
        ionosphere_sd_m=0.91,
        troposphere_sd_m=0.12,
        orbit_clock_sd_m=0.75,
        multipath_sd_m=(0.13, 0.53),
        noise_sd_m=(0.36, 0.0),
    ),
}  # errors of airborne signals; docs/worlds.md has the source of every figure
