r"""What a matched receiver assumes: the noise of the world that it is in, and of its own sensors.

The filter has 17 states and takes everything else for white noise.  Three kinds of error are not
white: satellite biases that last for the whole run, code errors that wander, and what scale-factor
and cross-coupling errors make of manoeuvres.  All are entered as inflated noise, sized so that the
covariance ends up at the spread of the errors.

**Constant biases.**  Over N epochs of the same geometry with white noise :math:`\sigma_w` and
constant biases :math:`\sigma_b`, the averaged pseudoranges have errors of variance
:math:`\sigma_w^2 / N + \sigma_b^2`, and so the best fixed gain leaves

.. math:: P = \left(H^T \mathrm{diag}(\sigma_w^2 / N + \sigma_b^2)^{-1} H\right)^{-1}.

A filter that takes the errors for white of variance R believes in
:math:`(N H^T R^{-1} H)^{-1}` instead.  The two agree at

.. math:: R = \sigma_w^2 + N \sigma_b^2,

with N the number of epochs of the episode, since a filter that has range rates of 2 cm/s forgets
hardly anything of its position within minutes.  The first fix has the same biases once more, and so
must not count: its position and clock offset are taken for unknown to `FIRST_FIX_SD_M`.  The belief
is right at the end of the episode; after k < N epochs its position variance is too large by about
N / k.  The price is in the innovation covariance, where R is alone: it overstates the innovations
of pseudoranges by about :math:`\sqrt{N}`, so that tests of them have hardly any power.  Only states
for the biases would do better.  Range rates have no biases, and keep their variance.

**Correlated code errors.**  The mean of N epochs of a first-order Gauss-Markov error of variance
:math:`\sigma_c^2`, which falls by the factor :math:`\alpha` from one epoch to the next, has the
variance :math:`s_N \sigma_c^2 / N` with

.. math:: s_N = 1 + 2 \sum_{k=1}^{N-1} (1 - k / N)\, \alpha^k
    = \frac{1 + \alpha}{1 - \alpha} - \frac{2 \alpha (1 - \alpha^N)}{N (1 - \alpha)^2},

which lies between 1 (white) and N (constant).  By the same argument as above

.. math:: R = \sigma_w^2 + s_N \sigma_c^2 + N \sigma_b^2 .

For 35 s and epochs of 0.5 s, s is about 140 long before the end, so that this part is right from a
few minutes on.  Range rates come from the carrier, which does not wander, and keep their variance.
What wanders in the signals of an airborne receiver is inflated by the same sum with its own
correlations.  Differences of carriers, whose errors are a moving average, are taken for white of
their variance, which overstates what they leave in the velocity.  Both formulas assume a filter
that remembers the whole run; even with range rates of 8 cm/s, a crystal clock and consumer sensors
it does.

**Manoeuvres.**  A rotation :math:`\int \omega\,dt` leaves an error of attitude of m times its
size, with m a typical scale-factor or cross-coupling error, and a change :math:`\Delta f` of the
specific force moves the effective bias of an accelerometer by :math:`m \Delta f`.  The filter
takes the first for white noise of the gyros and the second for a random walk of the biases,
which over `WINDOW_S` add up to the same variance, in the window of the run where it is largest:

.. math::
    S_\omega = N_\omega^2 + m_\omega^2 \max_t \tfrac1W \Big|\int_t^{t+W} \omega\,dt\Big|^2, \qquad
    S_{ba} = m_f^2 \max_t \tfrac1W |f(t + W) - f(t)|^2

and the same with the g-dependent error for the gyro biases.  With m the root mean square of the
nine elements of the data sheet, initial biases have the variance of the biases and of what the
specific force of 1 g makes of the errors of scale.

**Biases that wander** by a first-order Gauss-Markov process of variance :math:`\sigma^2` and time
T change over a lag t by :math:`2 \sigma^2 (1 - e^{-t / T})` in the mean square.  The filter takes
that for a random walk, whose change is S t, and for a larger constant at the start:

.. math:: S = 2 \sigma^2 / T, \qquad P_0 = \sigma_b^2 + \sigma^2 .

It is right for lags that are short to T, which are those over which a filter with range rates
learns a bias, and bounds the change at all others: over t = T by a factor of 1.6.  A filter that
coasts for longer believes in more error than there is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..earth.wgs84 import STANDARD_GRAVITY
from ..truth.gnss_errors import GnssErrors
from ..truth.run import GroundTruth
from ..truth.sensors import IMU_GRADES
from ..truth.signal_errors import correlation
from .tight import FILTER_GRADES, FilterGrade, NoiseModel, TightlyCoupled

FloatArray = NDArray[np.float64]

# Whole seconds over which manoeuvres are summed, between a turn and a pull-up in length: half
# or twice of it changes the normalized error squared of all 17 states by less than a half.
WINDOW_S = 16
# Of position and clock offset [m]; without biases the first epoch's pseudoranges replace it.
FIRST_FIX_SD_M = 100.0
LEAST_SD = 1e-4  # least noise of a measurement whose noise is a state [m], [m/s]: S can be inverted


class Motion(NamedTuple):
    """How much a vehicle manoeuvres. `turning`: squared rotation by time [rad^2/s]; `forcing`:
    squared change of the specific force by time [m^2/s^5]."""

    turning: float = 0.0
    forcing: float = 0.0


def compute_motion(world: GroundTruth, epochs: int) -> Motion:
    """How much a vehicle manoeuvres where it does so most: within `WINDOW_S`, or all of a shorter
    run; the specific force is averaged over a second."""
    time = world.imu_time[: world.epoch_end[epochs] + 1]
    samples = world.run[:6, : len(time) - 1] * np.diff(time)
    sums = np.concatenate([np.zeros((6, 1)), np.cumsum(samples, axis=1)], axis=1)
    seconds = np.arange(math.floor(time[-1] + 1e-6) + 1.0)
    if len(seconds) < 4:
        return Motion()
    delta_v, turn = np.split(np.stack([np.interp(seconds, time, row) for row in sums]), 2)
    force = np.diff(delta_v, axis=1)
    window = min(WINDOW_S, force.shape[1] - 1)
    return Motion(_largest_change(turn, window), _largest_change(force, window))


def _largest_change(history: FloatArray, window: int) -> float:
    change = history[:, window:] - history[:, :-window]
    return float(np.max(np.sum(change**2, axis=0))) / window


def matched_sensors(grade: str, motion: Motion, wandering: bool = False) -> FilterGrade:
    sheet = IMU_GRADES[grade]
    accel_sd, gyro_sd = sheet.in_run.tolist() if wandering else (0.0, 0.0)
    accel_noise, gyro_noise = sheet.noise[:2]
    accel_scale = _rms(sheet.accel_matrix - np.eye(3))
    gyro_scale = _rms(sheet.gyro_matrix - np.eye(3))
    g_dependence = _rms(sheet.g_dependence)
    return FILTER_GRADES[grade]._replace(
        position_sd=FIRST_FIX_SD_M,
        accel_bias_sd=math.hypot(_rms(sheet.accel_bias), accel_sd, accel_scale * STANDARD_GRAVITY),
        gyro_bias_sd=math.hypot(_rms(sheet.gyro_bias), gyro_sd, g_dependence * STANDARD_GRAVITY),
        gyro_noise_psd=float(gyro_noise**2 + gyro_scale**2 * motion.turning),
        accel_noise_psd=float(accel_noise**2),
        accel_bias_psd=accel_scale**2 * motion.forcing + 2.0 * accel_sd**2 / sheet.in_run_s,
        gyro_bias_psd=g_dependence**2 * motion.forcing + 2.0 * gyro_sd**2 / sheet.in_run_s,
    )


def _rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _augmented_noise(grade: str, errors: GnssErrors) -> NoiseModel:
    """What is left white where a filter has states for the rest: the data sheet's noise."""
    sheet = IMU_GRADES[grade]
    inertial = matched_sensors(grade, Motion())._replace(
        accel_bias_sd=_rms(sheet.accel_bias), gyro_bias_sd=_rms(sheet.gyro_bias)
    )
    return NoiseModel(
        pseudorange_sd=max(errors.code_sd_m, LEAST_SD),
        range_rate_sd=max(errors.range_rate_sd_mps, LEAST_SD),
        clock_phase_psd=errors.clock.phase_psd,
        clock_frequency_psd=errors.clock.frequency_psd,
        inertial=inertial,
    )


def _fixed_noise(receiver: TightlyCoupled, errors: GnssErrors) -> NoiseModel | None:
    """Noise of a receiver that does not depend on how it moves; None for another."""
    if depends_on_motion(receiver):
        return None
    augmented = receiver.tuning == "augmented"
    return _augmented_noise(receiver.grade, errors) if augmented else receiver.noise_model


def depends_on_motion(receiver: TightlyCoupled) -> bool:
    """Whether it matters to what a receiver assumes how the vehicle manoeuvres."""
    return receiver.matches and receiver.tuning != "augmented"


def inflation(alpha: float, epochs: int) -> float:
    """s_N: variance of the mean of a Gauss-Markov error, by that of as many white ones. `alpha`:
    correlation of neighbouring epochs, 0 to below 1."""
    rest = 1.0 - alpha
    return (1.0 + alpha) / rest - 2.0 * alpha * (1.0 - alpha**epochs) / (epochs * rest**2)


def compute_assumed_variance(
    receiver: TightlyCoupled,
    errors: GnssErrors,
    bias_sd: FloatArray,
    elevation: FloatArray,
    interval_s: float,
    epochs: int,
) -> FloatArray:
    """R (2n,) that a receiver assumes, pseudoranges first [m^2], [m^2/s^2]. `bias_sd` (n,) of the
    constant biases [m]; `elevation` (n,) of the satellites when they come into view [rad]."""
    n, fixed = len(bias_sd), _fixed_noise(receiver, errors)
    if fixed is not None:
        return np.repeat([fixed.pseudorange_sd**2, fixed.range_rate_sd**2], n)
    pseudorange = errors.code_sd_m**2 + epochs * bias_sd**2
    if errors.correlated_sd_m > 0.0:
        alpha = math.exp(-interval_s / errors.correlation_s)
        pseudorange += inflation(alpha, epochs) * errors.correlated_sd_m**2
    if errors.signals is not None:
        lag: FloatArray = interval_s * np.arange(1.0, epochs)
        falls = 2.0 * (1.0 - np.arange(1.0, epochs) / epochs)
        for sd, time_s, second_order in errors.signals.wandering(elevation):
            factor = 1.0 + float(np.sum(falls * correlation(lag, time_s, second_order)))
            pseudorange += factor * sd**2
    return np.concatenate([pseudorange, np.full(n, errors.rate_sd(interval_s) ** 2)])


def compute_assumed_noise(
    receiver: TightlyCoupled,
    errors: GnssErrors,
    interval_s: float,
    motion: Callable[[], Motion],
    wandering: bool = False,
) -> NoiseModel:
    """What a receiver assumes of its clock and inertial sensors. `motion` of the world, which a
    matched one knows; `wandering`: whether the biases of the inertial sensors do."""
    fixed = _fixed_noise(receiver, errors)
    if fixed is not None:
        return fixed
    return NoiseModel(
        pseudorange_sd=errors.code_sd_m,
        range_rate_sd=errors.rate_sd(interval_s),
        clock_phase_psd=errors.clock.phase_psd,
        clock_frequency_psd=errors.clock.frequency_psd,
        inertial=matched_sensors(receiver.grade, motion(), wandering),
    )
