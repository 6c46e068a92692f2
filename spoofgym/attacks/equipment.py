"""A spoofer's equipment: what it makes of perfect counterfeit signals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from ..sim.noise import padded
from ..sim.world import World
from . import _equipment_kernels as kernels
from .options import Capture, CounterfeitErrors, SpooferClock, TrackingError

FloatArray = NDArray[np.float64]
_OWN = -1.0
"""As a standard deviation: noise of the receiver itself."""


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

    described_as = "Equipment"
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
        memory.declare("wander", np.zeros((b, 3, 2)))
        memory.declare("spoofer_clock", np.zeros((b, 2)))
        memory.declare("counterfeit_bias", np.zeros((b, channels)))
        memory.declare("captured", np.zeros((b, channels), dtype=np.bool_))
        memory.declare("capture_time", np.zeros((b, channels)))
        memory.declare("authentic", np.ones((b, 2 * channels)))

    def begin(
        self,
        memory: Memory,
        world: World,
        rows: NDArray[np.intp],
        keys: NDArray[np.uint64],
        onsets: NDArray[np.int64],
    ) -> None:
        """Draw what an episode starts with."""
        if self.perfect:
            return
        tracking = self.tracking if self.tracking is not None else TrackingError()
        clock = self.clock if self.clock is not None else SpooferClock()
        errors = self.errors if self.errors is not None else CounterfeitErrors()
        sds = (tracking.sd_m, tracking.sd_m / tracking.correlation_s)
        drawn = np.empty((len(rows), 8 + world.channels))
        kernels.first_deviates(keys, onsets, padded(drawn.shape[1]), drawn)
        for axis in range(3):
            memory["wander"][rows, axis] = drawn[:, 2 * axis : 2 * axis + 2] * sds
        mean, sd = (clock.offset_m, clock.drift_mps), (clock.offset_sd_m, clock.drift_sd_mps)
        memory["spoofer_clock"][rows] = np.array(mean) + drawn[:, 6:8] * sd
        memory["counterfeit_bias"][rows] = errors.bias_sd_m * drawn[:, 8:]

    def advance(
        self, memory: Memory, world: World, epochs: NDArray[np.int64], lo: int, hi: int
    ) -> None:
        """Error of the known position, and clock, at the coming epoch. `epochs` (B,) the epoch that
        each receiver is at."""
        if self.tracking is None and self.clock is None:
            return
        tracking = self.tracking if self.tracking is not None else TrackingError()
        clock = self.clock if self.clock is not None else SpooferClock()
        kernels.advance(
            memory["key"],
            epochs,
            world.epoch_time,
            world.position_e,
            world.velocity_e,
            tracking.sd_m,
            1.0 / tracking.correlation_s,
            tracking.delay_s,
            clock.phase_psd,
            clock.frequency_psd,
            np.array(tracking.bias_m),
            world.C_en,
            world.axes_turning,
            memory["wander"],
            memory["spoofer_clock"],
            memory["target_error"],
            lo,
            hi,
        )

    def transmit(
        self,
        memory: Memory,
        world: World,
        chosen: NDArray[np.bool_],
        coherent: bool,
        epochs: NDArray[np.int64],
        d_range: FloatArray,
        d_rate: FloatArray,
        lo: int,
        hi: int,
    ) -> None:
        """Add clock and errors to the perfect offsets, where channels are captured. `chosen` (n,)
        bool, channels that are counterfeited; `epochs` (B,) the epoch that each receiver is at;
        `d_range`, `d_rate` (B, n), overwritten [m], [m/s]."""
        if self.perfect:
            return
        capture = self.capture if self.capture is not None else Capture(alignment_m=None)
        errors = self.errors if self.errors is not None else CounterfeitErrors()
        sds = errors.code_sd_m, errors.range_rate_sd_mps
        kernels.transmit(
            memory["key"],
            memory["onset"],
            epochs,
            world.epoch_time,
            world.satellites,
            chosen,
            coherent,
            capture.delay_s,
            math.inf if capture.alignment_m is None else capture.alignment_m,
            memory["spoofer_clock"],
            self.errors is not None,
            np.array([_OWN if sd is None else sd for sd in sds]),
            errors.blend_s,
            memory["counterfeit_bias"],
            padded(2 * world.channels),
            memory["captured"],
            memory["capture_time"],
            memory["authentic"],
            d_range,
            d_rate,
            lo,
            hi,
        )
