"""Imperfect equipment: delay, power, errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.memory import Memory
from ..core.registry import require
from ..truth.noise import pad_count
from ..truth.run import GroundTruth
from . import _kernels as kernels

CHIP_M = 293.05  # length of a chip of the GPS C/A code [m], c / 1.023 MHz (`is-gps-200`)
MOST_DELAY_S = 10.0


@settings_record(frozen=True, kw_only=True)
class CounterfeitErrors:
    """Errors of the counterfeit signals, in place of the authentic ones.

    A counterfeit signal passes neither the ionosphere nor the satellite's orbit error, nor is it
    reflected where the authentic one was: constants of satellites, and errors that wander, go with
    the capture.  What is left is the noise of the receiver itself, which is that of its world, and
    what the spoofer does not know of each satellite.
    """

    code_sd_m: float | None = setting(
        default=None,
        least=0.0,
        unit="m",
        help="White noise of pseudoranges in place of the receiver's own; None leaves that as the "
        "world has it.",
    )
    range_rate_sd_mps: float | None = setting(
        default=None,
        least=0.0,
        unit="m/s",
        help="White noise of range rates in place of the receiver's own; None leaves that as the "
        "world has it.",
    )
    bias_sd_m: float = setting(
        default=0.0, least=0.0, unit="m", help="Constant of every channel for an episode."
    )
    blend_s: float = setting(
        default=0.0,
        least=0.0,
        unit="s",
        help="Time from the capture of a channel in which the authentic errors fade linearly, and "
        "that constant comes; 0 for a step of their size.  It takes the receiver's own noise.",
    )

    def __post_init__(self) -> None:
        require(
            self.blend_s == 0.0 or (self.code_sd_m is None and self.range_rate_sd_mps is None),
            f"`blend_s` {self.blend_s} takes the receiver's own noise: leave out `code_sd_m` "
            "and `range_rate_sd_mps`",
        )


REPLACED = CounterfeitErrors()  # a step at the capture, to the noise of the receiver alone
QUIET = CounterfeitErrors(blend_s=30.0)  # blended in: no step, and better than authentic


@settings_record(frozen=True, kw_only=True)
class TrackingError:
    r"""How badly a spoofer knows where its target is; it moves the counterfeit position.

    The error along each of three axes is a critically damped second-order Gauss-Markov process,

    .. math:: \ddot x + 2 \beta \dot x + \beta^2 x = w, \qquad
        E[x_t x_{t + \tau}] = \sigma^2 (1 + \beta |\tau|) e^{-\beta |\tau|}, \qquad
        \sigma_{\dot x} = \beta \sigma, \qquad \beta = 1 / T

    so that its rate is finite, and the range rates follow it.
    """

    sd_m: float = setting(
        default=0.0, least=0.0, unit="m", help="Standard deviation along each axis."
    )
    correlation_s: float = setting(default=5.0, above=0.0, unit="s", help="Correlation time T.")
    delay_s: float = setting(
        default=0.0,
        least=0.0,
        most=MOST_DELAY_S,
        unit="s",
        help="Age of the position that the spoofer takes for the present one.",
    )
    bias_m: tuple[float, float, float] = setting(
        default=(0.0, 0.0, 0.0),
        unit="m",
        help="Constant error (3,), north, east, down at the true position of the epoch.",
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "bias_m", checked_vector("bias_m", self.bias_m))


@settings_record(frozen=True, kw_only=True)
class SpooferClock:
    """Clock of the spoofer against that of the authentic signals, common to all its signals."""

    offset_m: float = setting(default=0.0, unit="m", help="Offset at the onset.")
    drift_mps: float = setting(default=0.0, unit="m/s", help="Drift at the onset.")
    offset_sd_m: float = setting(
        default=0.0,
        least=0.0,
        unit="m",
        help="Standard deviation of what is drawn for every episode on top of the offset.",
    )
    drift_sd_mps: float = setting(
        default=0.0,
        least=0.0,
        unit="m/s",
        help="Standard deviation of what is drawn for every episode on top of the drift.",
    )
    phase_psd: float = setting(
        default=0.0, least=0.0, unit="m^2/s", help="Phase noise, as in `ReceiverClock`."
    )
    frequency_psd: float = setting(
        default=0.0, least=0.0, unit="m^2/s^3", help="Frequency noise, as in `ReceiverClock`."
    )


@settings_record(frozen=True, kw_only=True)
class Capture:
    """When the receiver's channels follow the counterfeit signals.

    A channel is captured at the first epoch, not before `delay_s`, at which its satellite is in
    view and the counterfeit code lies within `alignment_m` of the authentic one; it stays captured.
    Until then it measures the authentic signal.
    """

    delay_s: float = setting(
        default=0.0,
        least=0.0,
        unit="s",
        help="Time from the onset of the attack to the first capture.",
    )
    alignment_m: float | None = setting(
        default=0.5 * CHIP_M,
        above=0.0,
        unit="m",
        help="Largest difference of the two pseudoranges at the capture, the errors of single "
        "channels left out; None for no limit.  Half a chip of the GPS C/A code by default.",
    )


def checked_vector(name: str, value: tuple[float, ...]) -> tuple[float, float, float]:
    message = f"`{name}` must be three finite numbers: north, east, down; got {value!r}"
    try:
        numbers = tuple(float(x) for x in value)
    except (TypeError, ValueError):
        raise ValueError(message) from None
    require(len(numbers) == 3 and all(map(math.isfinite, numbers)), message)
    return numbers[0], numbers[1], numbers[2]


FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Equipment:
    """Options of an attack, and their part of its memory.

    The memory holds ``target_error`` (B, 6), what the spoofer's idea of the target's position and
    velocity is wrong by, in ECEF axes; ``captured`` (B, n) bool; ``authentic`` (B, 2n), the part
    of the authentic errors that stays, as in `SensorBuffers`; and what these are made of.

    - `errors`: None where the authentic errors stay;
    - `tracking`: None for a spoofer that knows;
    - `clock`: None for a perfect one;
    - `capture`: None where all channels are captured at the onset, however far.
    """

    errors: CounterfeitErrors | None = None
    tracking: TrackingError | None = None
    clock: SpooferClock | None = None
    capture: Capture | None = None

    @property
    def perfect(self) -> bool:
        return self == Equipment()

    def declare(self, memory: Memory, channels: int) -> None:
        b = memory.receivers
        memory.declare("target_error", np.zeros((b, 6)))
        if self.perfect:
            return
        memory.declare_all(
            wander=np.zeros((b, 3, 2)),
            spoofer_clock=np.zeros((b, 2)),
            counterfeit_bias=np.zeros((b, channels)),
            captured=np.zeros((b, channels), dtype=np.bool_),
            capture_time=np.zeros((b, channels)),
            authentic=np.ones((b, 2 * channels)),
        )

    def start_episodes(
        self,
        memory: Memory,
        world: GroundTruth,
        rows: NDArray[np.intp],
        keys: NDArray[np.uint64],
        onsets: NDArray[np.int64],
    ) -> None:
        if self.perfect:
            return
        tracking, clock = self.tracking or TrackingError(), self.clock or SpooferClock()
        errors = self.errors or CounterfeitErrors()
        sds = (tracking.sd_m, tracking.sd_m / tracking.correlation_s)
        drawn = np.empty((len(rows), 8 + world.channels))
        kernels.first_deviates(keys, onsets, pad_count(drawn.shape[1]), drawn)
        for axis in range(3):
            memory["wander"][rows, axis] = drawn[:, 2 * axis : 2 * axis + 2] * sds
        mean, sd = (clock.offset_m, clock.drift_mps), (clock.offset_sd_m, clock.drift_sd_mps)
        memory["spoofer_clock"][rows] = np.array(mean) + drawn[:, 6:8] * sd
        memory["counterfeit_bias"][rows] = errors.bias_sd_m * drawn[:, 8:]

    def advance(
        self, memory: Memory, world: GroundTruth, epochs: NDArray[np.int64], lo: int, hi: int
    ) -> None:
        if self.tracking is None and self.clock is None:
            return
        tracking, clock = self.tracking or TrackingError(), self.clock or SpooferClock()
        error = float(tracking.sd_m), 1.0 / tracking.correlation_s, float(tracking.delay_s)
        psd, bias = (float(clock.phase_psd), float(clock.frequency_psd)), np.array(tracking.bias_m)
        axes, moved = (world.C_en, world.axes_turning), (memory["wander"], memory["spoofer_clock"])
        truth, written = (epochs, world.epoch_truth), (*moved, memory["target_error"])
        kernels.advance_spoofer_errors(
            memory["key"], *truth, error, psd, bias, axes, *written, lo, hi
        )

    def transmit(
        self,
        memory: Memory,
        world: GroundTruth,
        chosen: NDArray[np.bool_],
        coherent: bool,
        epochs: NDArray[np.int64],
        d_range: FloatArray,
        d_rate: FloatArray,
        lo: int,
        hi: int,
    ) -> None:
        if self.perfect:
            return
        capture, errors = self.capture or Capture(alignment_m=None), self.errors or REPLACED
        # -1: noise of the receiver itself
        sds = [-1.0 if sd is None else sd for sd in (errors.code_sd_m, errors.range_rate_sd_mps)]
        limit = math.inf if capture.alignment_m is None else float(capture.alignment_m)
        size = pad_count(2 * world.channels)
        rules = coherent, self.errors is not None, size, float(capture.delay_s), limit
        names = "spoofer_clock", "counterfeit_bias", "captured", "capture_time", "authentic"
        kernels.transmit(
            *(memory["key"], memory["onset"], epochs, world.epoch_truth, chosen, rules),
            *((np.array(sds), float(errors.blend_s)), tuple(memory[name] for name in names)),
            *(d_range, d_rate, lo, hi),
        )
