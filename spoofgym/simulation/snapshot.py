"""Snapshot receivers: a fix of every epoch's pseudoranges by themselves, some of them spoofed.

The spoofer has some of the satellites, which agree on a position and a clock that drift away from
the true ones; satellites that a detector excludes are left out of the fix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number
from ..core.registry import is_number, require
from ..core.settings import describe
from ..detectors import Detector, DetectorContext
from ..receiver.epoch import Epoch, EpochMaker
from ..receiver.snapshot import (
    EXPECTED_CLOCK_SD_M,
    EXPECTED_POSITION_SD_M,
    FIXED,
    expect,
    fix_receivers,
)
from ..truth._kernels import measure_snapshot
from ..truth.noise import pad_count
from ..truth.run import chain_skies, make_sky
from ..truth.satellites import CircularConstellation
from .domain import Choice, Domain, FloatArray
from .loose import RateSimulator
from .setup import RateCommands, Run, Setup, Timeline
from .simulator import SkyData, Written

AXES = ("north", "east", "down", "clock")
STATES = 4  # position and clock of a fix
CLOCK_SD = (1e4, 10.0)  # standard deviation of the receiver's clock offset [m] and drift [m/s]


class SnapshotSetup(Setup):
    """Sky, victim and detector of snapshot receivers in a vehicle that goes straight on.

    Parameters
    ----------
    detector, timeline, domain, target_heading_deg, decision_interval_s, between : optional
        As in `SpoofEnv`; by default 10 s, which only the detector needs, 60 s and 10 s.  A domain
        has `turned_deg`, the vehicle's heading, and `constellation_time_s`, with `worlds` and
        `world_seed`, and `satellites` in view in all worlds.
    satellites : int
        How many are used, the highest ones.
    spoofed : int or sequence of int
        How many satellites are spoofed, others in every episode; or which slots, always the same.
    noise_m : float
        White noise of a pseudorange.
    rate_limit_mps : float or sequence of float
        Rate of the counterfeit displacement that a command of 1 means, one for all axes or north,
        east, down and clock.
    speed_mps, heading_deg : float
        Motion of the vehicle.
    interval_s : float
        Time between epochs.
    time_offset_s : float
        Of the constellation: another geometry.

    Attributes
    ----------
    sky : Sky
        All worlds of the domain, one after the other.

    Notes
    -----
    The target of `wu2024`, tables 5 to 8: 12 satellites and 4 m.  The detector gets raw
    pseudoranges; its prediction is the last fix, with a covariance that makes it worth nothing.
    """

    kind: ClassVar[str] = "snapshot"
    env_id: ClassVar[str] = "spoofgym/Snapshot-v0"
    of_attack: ClassVar[frozenset[str]] = Setup.of_attack | {"spoofed"}
    whose: ClassVar[str] = "a snapshot receiver"
    domain_names: ClassVar[frozenset[str]] = frozenset(
        {"turned_deg", "constellation_time_s", "worlds", "world_seed"}
    )
    usual_timeline: ClassVar[Mapping[str, float] | None] = {
        "warmup_s": 10.0,
        "live_s": 10.0,
        "attack_s": 60.0,
        "time_to_alert_s": 10.0,
    }
    has: ClassVar[frozenset[str]] = Setup.has - {"transition"}  # nothing goes on to the next epoch
    ratio_is_largest: ClassVar[bool] = False
    motion_names = tuple(f"position_{axis}" for axis in AXES[:3])

    def __init__(
        self,
        *,
        detector: str | Mapping[str, Any] | Detector = "srv-raim",
        timeline: Mapping[str, float] | Timeline | None = None,
        satellites: int = 12,
        spoofed: int | Sequence[int] = 6,
        noise_m: float = 4.0,
        rate_limit_mps: float | Sequence[float] = 5.0,
        speed_mps: float = 50.0,
        heading_deg: float = 0.0,
        interval_s: float = 1.0,
        time_offset_s: float = 0.0,
        domain: Mapping[str, Any] | Domain | None = None,
        target_heading_deg: float | str = 90.0,
        decision_interval_s: float | None = None,
        between: str = "hold",
    ) -> None:
        check_number("interval_s", interval_s, above=0.0)
        check_number("noise_m", noise_m, above=0.0)
        require(
            isinstance(satellites, int | np.integer) and satellites >= 4,
            f"`satellites` must be a whole number >= 4, got {satellites!r}",
        )
        check_number("speed_mps", speed_mps)
        check_number("heading_deg", heading_deg)
        self.name = self.kind
        self._flown = {
            "satellites": satellites,
            "speed_mps": speed_mps,
            "heading_deg": heading_deg,
            "time_offset_s": time_offset_s,
        }
        self.noise_m, self.spoofed = float(noise_m), _which(spoofed, satellites)
        self.attack = RateCommands(
            self.kind, tuple(f"{axis}_rate" for axis in AXES), _rates(rate_limit_mps)
        )
        self._aim(target_heading_deg, domain)
        self._phase(detector, timeline, float(interval_s), decision_interval_s, between)
        self.epochs_each = self.length + 1
        skies = [
            make_sky(
                self.epochs_each,
                self.interval_s,
                satellites,
                CircularConstellation(satellites=36, time_offset_s=time_offset_s + time),
                speed_mps=speed_mps,
                heading_deg=heading_deg + turn,
            )
            for turn, time in self.domain.pairs()
        ]
        self.sky, self.epoch_time = chain_skies(skies), np.tile(skies[0].time, len(skies))
        self.true_position = self.sky.position_e
        self.C_en = np.broadcast_to(self.sky.C_en, (len(self.epoch_time), 3, 3))
        self.bounds = self._bounds(len(skies), 1, 1, 0, 0)
        self.weight_names = tuple(f"slot{j:02d}" for j in range(satellites))
        self.geometry_names = (
            *(f"sight_{axis}_{slot}" for slot in self.weight_names for axis in AXES[:3]),
            *(f"spoofed_{slot}" for slot in self.weight_names),
        )

    def world_settings(self) -> dict[str, Any]:
        return {**self._flown, "noise_m": self.noise_m, "domain": describe(self.domain)}

    def simulator(self, receivers: int, run: Run) -> SnapshotSimulator:
        return SnapshotSimulator(self, receivers, run)


def _which(spoofed: int | Sequence[int], satellites: int) -> int | list[int]:
    if isinstance(spoofed, int | np.integer):
        require(
            0 <= spoofed <= satellites,
            f"`spoofed` must be within 0..{satellites}, the number of satellites, got {spoofed}",
        )
        return int(spoofed)
    require(
        not isinstance(spoofed, float | str),
        f"`spoofed` must be a whole number of satellites, or a list of slots, got {spoofed!r}",
    )
    slots = [int(j) for j in spoofed]
    require(
        len(set(slots)) >= len(slots) and all(0 <= j < satellites for j in slots),
        f"`spoofed` must name slots within 0..{satellites - 1}, each once, got {slots}",
    )
    return slots


def _rates(rate_limit_mps: float | Sequence[float]) -> tuple[float, ...]:
    given = np.atleast_1d(np.asarray(rate_limit_mps, dtype=object))
    numbers = all(map(is_number, given.flat))
    limits = np.asarray(rate_limit_mps if numbers else np.nan, dtype=np.float64)
    require(
        limits.shape in ((), (4,)) and (np.isfinite(limits) & (limits > 0.0)).all(),
        "`rate_limit_mps` must be a number above 0, one number or one for each of "
        f"{', '.join(AXES)}, got {rate_limit_mps!r}",
    )
    return tuple(np.broadcast_to(limits, 4).tolist())


class SnapshotSimulator(RateSimulator):
    """B snapshot receivers."""

    setup: SnapshotSetup

    def _allocate(self) -> None:
        super()._allocate()
        b, n = self.receivers, len(self.setup.weight_names)
        self.memory.declare_all(
            keys=np.zeros((b, 2), dtype=np.uint64),
            true_clock=np.zeros((b, 2)),
            spoofed=np.zeros((b, n), dtype=np.bool_),
            position_e=np.tile(self.setup.sky.position_e[0], (b, 1)),
            clock=np.zeros((b, 1)),
            status=np.full(b, FIXED, dtype=np.int64),
        )
        self._deviates = np.empty(pad_count(n))
        self._pseudorange, self._satellites = np.empty((b, n)), np.empty((b, n, 3))
        self._innovation, self._cov = np.empty((b, 2 * n)), np.empty((b, 2 * n, 2 * n))
        self._design = np.empty((b, 2 * n, STATES))
        belief = np.diag(np.square([*[EXPECTED_POSITION_SD_M] * 3, EXPECTED_CLOCK_SD_M]))
        constant = {
            "interval": np.full(b, self.setup.interval_s),
            "predicted_cov": np.tile(belief, (b, 1, 1)),
            "imu_delta": np.zeros((b, 6)),
            "range_rate": np.zeros((b, n)),
            "visible": np.ones((b, n), dtype=np.bool_),
            "predicted_velocity": np.zeros((b, 3)),
        }
        self._epoch = EpochMaker(self.fields, constant)

    def _context(self) -> DetectorContext:
        setup, n = self.setup, len(self.setup.weight_names)
        variance = np.repeat([setup.noise_m**2, 1.0], n)
        ids = setup.sky.satellite_ids
        return DetectorContext(self.receivers, n, setup.interval_s, variance, ids, states=STATES)

    def _seed(self, row: int, episode: np.random.SeedSequence) -> None:
        memory, slots = self.memory, self.setup.spoofed
        super()._seed(row, episode)
        rng = np.random.default_rng(episode.spawn(1)[0])
        memory["true_clock"][row] = rng.standard_normal(2) * CLOCK_SD
        if isinstance(slots, int):
            slots = rng.permutation(len(self.setup.weight_names))[:slots].tolist()
        memory["spoofed"][row, slots] = True

    def _keys(self, episode: np.random.SeedSequence) -> NDArray[np.uint64]:
        return np.asarray(episode.generate_state(2, np.uint64))

    def _start(self, choice: Choice) -> None:
        super()._start(choice)
        self._correct(None)

    def _observe(self) -> None:
        sky, memory = self.setup.sky, self.memory
        drawn = memory["epoch"], memory["keys"], memory["true_clock"]
        spoofing = memory["displacement"], memory["spoofed"]
        world = sky.time, sky.position_e, sky.C_en, sky.satellite_position_e
        written = self._deviates, self._pseudorange, self._satellites
        measure_snapshot(*drawn, *spoofing, *world, self.setup.noise_m, *written)

    def _form_epoch(self) -> Epoch:
        memory = self.memory
        last, written = (memory["position_e"], memory["clock"]), (self._innovation, self._cov)
        variance = self.setup.noise_m**2
        expect(self._pseudorange, self._satellites, *last, variance, *written, self._design)
        return self._epoch(
            time=self.time_s(),
            innovation=self._innovation,
            innovation_variance=self._cov.diagonal(0, 1, 2),
            innovation_cov=self._cov,
            design=self._design,
            pseudorange=self._pseudorange,
            satellite_position=self._satellites,
            satellite_velocity=self.setup.sky.satellite_velocity_e[memory["epoch"]],
            predicted_position=memory["position_e"],
        )

    def _correct(self, weights: FloatArray | None) -> None:
        memory = self.memory
        used = self.ones if weights is None else weights
        written = memory["position_e"], memory["clock"], memory["status"]
        fix_receivers(self._pseudorange, self._satellites, used, *written)

    @property
    def coasting(self) -> NDArray[np.bool_]:
        return np.asarray(self.memory["status"] != FIXED)

    def error_n(self) -> FloatArray:
        sky = self.setup.sky
        error = self.memory["position_e"] - sky.position_e[self.epochs]
        return np.asarray(np.einsum("bi,ij->bj", error, sky.C_en)[:, :2])

    def motion(self, per_position: float, per_velocity: float, out: Written) -> None:
        sky = self.setup.sky
        moved = sky.position_e[self.epochs] - sky.position_e[self.onset]
        out[:] = per_position * np.einsum("bi,ij->bj", moved, sky.C_en)

    def lines_of_sight_n(self) -> FloatArray:
        """(B, n, 3) unit vectors from the true position to the satellites, north, east, down."""
        sky, epochs = self.setup.sky, self.epochs
        apart = sky.satellite_position_e[epochs] - sky.position_e[epochs][:, None]
        apart /= np.sqrt(np.einsum("bni,bni->bn", apart, apart))[:, :, None]
        return np.asarray(np.einsum("bni,ij->bnj", apart, sky.C_en))

    def geometry(self, out: NDArray[np.float32]) -> None:
        n = len(self.setup.weight_names)
        out[:, : 3 * n] = self.lines_of_sight_n().reshape(self.receivers, -1)
        out[:, 3 * n :] = self.memory["spoofed"]

    def _sky(self) -> SkyData:
        toward, n = self.lines_of_sight_n()[0], len(self.setup.weight_names)
        return SkyData(
            names=self.setup.sky.satellite_ids,
            azimuth=np.arctan2(toward[:, 1], toward[:, 0]),
            elevation=np.arcsin(-toward[:, 2]),
            visible=np.ones(n, dtype=np.bool_),
            spoofed=self.memory["spoofed"][0] & self.memory["displacement"][0].any(),
            weight=self.weights[0, :n].copy(),
        )
