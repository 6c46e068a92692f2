"""Epochs to try detectors on: scripts with difficult cases, and a filter in steady state."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from ..attacks import FalsePosition
from ..detectors import Detector, DetectorContext, Never
from ..receiver.epoch import OPTIONAL, Epoch, EpochMaker, without_channels
from ..simulation import Engine, TightlyCoupledSetup, Timeline
from ..truth.scenario import Scenario

FloatArray = NDArray[np.float64]
RECEIVERS = 5


class Script(NamedTuple):
    """Epochs that a detector sees, in order, with all optional fields."""

    name: str
    context: DetectorContext
    epochs: tuple[Epoch, ...]

    def epoch(
        self, number: int, rows: NDArray[np.intp], needs: Collection[str]
    ) -> dict[str, NDArray[Any]]:
        return {
            name: np.ascontiguousarray(array[rows])
            for name, array in self.epochs[number]._asdict().items()
            if name not in OPTIONAL or name in needs
        }


@lru_cache(maxsize=1)
def engine_script() -> Script:
    timeline = Timeline(warmup_s=5.0, live_s=5.0, attack_s=10.0, time_to_alert_s=0.0)
    setup = TightlyCoupledSetup(
        scenario=Scenario(), attack=FalsePosition(), detector=Never(), timeline=timeline
    )
    setup.fields = setup.has
    engine = Engine(RECEIVERS, setup, threads=1)
    engine.reset([np.random.default_rng(seed) for seed in range(RECEIVERS)])
    rng = np.random.default_rng(1)
    action = np.linspace(-1.0, 1.0, 2 * RECEIVERS).reshape(RECEIVERS, 2)
    epochs = []
    for _ in range(setup.steps):
        epoch = engine.predict(action)
        epochs.append(with_optional_fields(epoch, rng))
        engine.update(engine.judge())
    context = DetectorContext(
        RECEIVERS,
        setup.world.channels,
        setup.interval_s,
        setup.combinations.largest_variance,
        setup.world.satellite_ids,
        model=setup.combinations.filter_model,
    )
    return Script("a run of the default scenario", context, tuple(epochs))


def with_optional_fields(epoch: Epoch, rng: np.random.Generator) -> Epoch:
    """Copy of an epoch, with optional fields that are None made up."""
    b, n = epoch.visible.shape
    fields = {name: np.array(array) for name, array in epoch._asdict().items()}
    made_up = {
        "gnss_position": epoch.predicted_position + 2.0 * rng.standard_normal((b, 3)),
        "auxiliary_position": epoch.predicted_position + 5.0 * rng.standard_normal((b, 3)),
        "cn0_dbhz": 45.0 + rng.standard_normal((b, n)),
        "weights": np.ones(epoch.innovation.shape),
    }
    for name in OPTIONAL:
        if getattr(epoch, name) is None:
            fields[name] = made_up[name]
    return Epoch(**fields)


CHANNELS = 7
COUNT = 60
INTERVALS = (0.5, 0.5, 1.0, 0.1, 0.5, 5.0)  # times between made-up epochs, over and over [s]
_EMPTY = CHANNELS - 1
ALL_MISSING = (24, 25)
ZERO = 14
OUTLIER = 18
ATTACKED_FROM = 35


@lru_cache(maxsize=2)
def trying_script(channels: int = CHANNELS) -> Script:
    """Synthetic epochs with difficult cases; slots after the first `CHANNELS` stay empty, too.

    Satellites appear and disappear, one slot stays empty, at two epochs nothing is in view;
    intervals differ; once all innovations are zero, once there is an outlier of a thousand standard
    deviations; at the end one satellite drifts away.  Innovations are drawn from the covariance
    that the epoch states for them.
    """
    rng = np.random.default_rng(2)
    noise = np.repeat([6.25, 0.01], channels)
    time = np.zeros(RECEIVERS)
    epochs = []
    for k in range(COUNT):
        interval = INTERVALS[k % len(INTERVALS)]
        time = time + interval
        epochs.append(_draw_epoch(k, time, interval, _visible(k, channels), noise, rng))
    ids = (*(f"G{j:02d}" for j in range(1, CHANNELS)), *[""] * (channels - _EMPTY))
    context = DetectorContext(RECEIVERS, channels, 0.5, noise, ids)
    return Script("made-up epochs", context, tuple(epochs))


def _visible(k: int, channels: int) -> NDArray[np.bool_]:
    visible = np.ones((RECEIVERS, channels), dtype=np.bool_)
    visible[:, _EMPTY:] = False
    visible[:, 2] = k >= 8  # rises
    visible[:, 4] = k < 30  # sets
    visible[1:3, 3] = k % 7 != 0  # flickers
    visible[3] &= not 20 <= k < 23  # one receiver in the dark
    if k in ALL_MISSING:
        visible[:] = False
    return visible


def _innovation(
    k: int, belief: FloatArray, attacked_from: int, rng: np.random.Generator
) -> FloatArray:
    """(B, m) drawn from the covariance (B, m, m) that it is said to have, and what happens then."""
    root = np.linalg.cholesky(belief)
    innovation: FloatArray = np.einsum("bij,bj->bi", root, rng.standard_normal(belief.shape[:2]))
    if k == ZERO:
        innovation[:] = 0.0
    if k == OUTLIER:
        innovation[:, 1] += 1e3 * np.sqrt(belief[:, 1, 1])
    innovation[:, 0] += 0.5 * max(0, k - attacked_from)
    return innovation


def _draw_epoch(
    k: int,
    time: NDArray[np.float64],
    interval: float,
    visible: NDArray[np.bool_],
    noise: NDArray[np.float64],
    rng: np.random.Generator,
) -> Epoch:
    b, n = visible.shape
    azimuth = 2.0 * np.pi * np.arange(n) / n + 0.001 * k
    elevation = 0.3 + 0.15 * np.arange(n)
    u = np.column_stack(
        [
            np.sin(elevation),
            np.cos(elevation) * np.sin(azimuth),
            np.cos(elevation) * np.cos(azimuth),
        ]
    )
    root = rng.standard_normal((b, 17, 17)) * np.repeat([1e-4, 0.05, 1.0, 1e-3, 1e-6, 0.5], 3)[:17]
    covariance = np.einsum("bki,bkj->bij", root, root)
    seen = np.hstack([visible, visible])
    design = np.zeros((b, 2 * n, 17))
    design[:, :n, 6:9], design[:, :n, 15] = u, 1.0
    design[:, n:, 3:6], design[:, n:, 16] = u, 1.0
    design *= seen[:, :, None]
    belief = np.einsum("bik,bkl,bjl->bij", design, covariance, design)
    belief += np.where(seen, noise, 1.0)[:, :, None] * np.eye(2 * n)
    innovation = _innovation(k, belief, ATTACKED_FROM, rng)
    innovation[~seen] = 0.0
    position = np.array([6_378_137.0, 0.0, 0.0]) + np.outer(time, [0.0, 100.0, 0.0])
    satellites = position[:, None, :] + 2.2e7 * u
    return with_optional_fields(
        Epoch(
            time=time,
            interval=np.full(b, interval),
            innovation=innovation,
            innovation_variance=np.ascontiguousarray(np.einsum("bii->bi", belief)),
            innovation_cov=belief,
            predicted_cov=covariance,
            design=design,
            transition=np.tile(np.eye(17), (b, 1, 1)),
            imu_delta=rng.standard_normal((b, 6)) * np.repeat([0.1, 1e-3], 3),
            pseudorange=np.where(visible, 2.2e7 + 1e4 + innovation[:, :n], 0.0),
            range_rate=np.where(visible, 100.0 + innovation[:, n:], 0.0),
            satellite_position=satellites,
            satellite_velocity=np.tile([0.0, 100.0, 0.0], (b, n, 1)),
            visible=visible,
            predicted_position=position,
            predicted_velocity=np.tile([0.0, 100.0, 0.0], (b, 1)),
        ),
        rng,
    )


COORDINATES = (2, 3)  # of a robot on a plane, and of a position in space
STATES = {2: 4, 3: 15}
"""Position and velocity in the plane; attitude, velocity, position and sensor biases in space."""
POSITION_COUNT = 80
RETURNED = (44, 50)  # epochs, ends excluded, in which a jump of some metres comes and goes
POSITION_ATTACKED_FROM = 55


@lru_cache(maxsize=len(COORDINATES))
def position_script(coordinates: int) -> Script:
    """Made-up epochs of a receiver whose measurement is a position: no channels, m innovations.

    As in `trying_script`; a jump comes and goes, and in the end the position drifts away.  The
    innovations are the GNSS position minus the predicted one.
    """
    rng = np.random.default_rng(2 + coordinates)
    noise = np.array([1.0, 1.5, 4.0])[:coordinates]
    time = np.zeros(RECEIVERS)
    epochs = []
    for k in range(POSITION_COUNT):
        interval = INTERVALS[k % len(INTERVALS)]
        time = time + interval
        epochs.append(_draw_position_epoch(k, time, interval, noise, rng))
    context = DetectorContext(RECEIVERS, 0, 0.5, noise, ())
    name = f"made-up epochs of a position with {coordinates} coordinates"
    return Script(name, context, tuple(epochs))


def _draw_position_epoch(
    k: int, time: FloatArray, interval: float, noise: FloatArray, rng: np.random.Generator
) -> Epoch:
    b, m = len(time), len(noise)
    s = STATES[m]
    # the position is behind the velocity in space, and comes first in the plane
    first = 6 if m == 3 else 0
    root = 0.3 * rng.standard_normal((b, s, s))
    covariance = np.einsum("bki,bkj->bij", root, root)
    design = np.zeros((b, m, s))
    design[:, np.arange(m), first + np.arange(m)] = 1.0
    belief = covariance[:, first : first + m, first : first + m] + noise * np.eye(m)
    innovation = _innovation(k, belief, POSITION_ATTACKED_FROM, rng)
    if RETURNED[0] <= k < RETURNED[1]:
        innovation += 20.0
    position = np.outer(time, [3.0, -4.0, 0.0])
    fix = position.copy()
    fix[:, :m] += innovation
    return with_optional_fields(
        Epoch(
            time=time,
            interval=np.full(b, interval),
            innovation=innovation,
            innovation_variance=np.ascontiguousarray(np.einsum("bii->bi", belief)),
            innovation_cov=np.ascontiguousarray(belief),
            predicted_cov=covariance,
            design=design,
            transition=np.tile(np.eye(s), (b, 1, 1)),
            imu_delta=rng.standard_normal((b, 6)) * np.repeat([0.1, 1e-3], 3),
            **without_channels(b),
            predicted_position=position,
            predicted_velocity=np.tile([3.0, -4.0, 0.0], (b, 1)),
            gnss_position=fix,
        ),
        rng,
    )


VISIBLE = 8
INTERVAL_S = 0.5
GRAVITY_MPS2 = 9.8
STATE_SD = np.repeat([1e-6, 2e-3, 1e-2, 1e-5, 1e-8, 0.05], 3)[:17]
"""Noise of an interval on attitude, velocity, position, sensor biases, clock [rad, m, s]."""
MEMORY = np.repeat([0.999, 1.0, 1.0, 0.999, 0.999, 1.0], 3)[:17]
"""What is left of each state after an interval: those that are hardly observed forget."""
_START = np.array([6_378_137.0, 0.0, 0.0])
_VELOCITY = np.array([0.0, 100.0, 0.0])
_RANGE_M = 2.2e7


class SteadyEpochs:
    """Clean epochs without end, of B receivers that have run for ever; the same at every iteration.

    Innovations are white, with the covariance S = H P H' + R of the filter, whose P solves the
    Riccati equation of a strapdown receiver that flies straight on.  Satellites stand still above
    it; a receiver that measures a position has 15 states, and its three coordinates.
    """

    def __init__(
        self, receivers: int, channels: int = VISIBLE, interval_s: float = INTERVAL_S
    ) -> None:
        self.receivers, self.channels, self.interval_s = receivers, channels, interval_s
        self.visible = np.arange(channels) < VISIBLE
        self.sight = _lines_of_sight(channels)
        self.design = self._measure()
        s = self.design.shape[1]
        self.noise = np.repeat([6.25, 0.01], channels) if channels else np.array([1.0, 1.5, 4.0])
        seen = np.abs(self.design).sum(axis=1) > 0.0
        self.transition = _propagate(s, interval_s)
        self.predicted = solve_discrete_are(
            self.transition.T,
            self.design[seen].T,
            np.diag(STATE_SD[:s] ** 2),
            np.diag(self.noise[seen]),
        )
        self.belief = self.design @ self.predicted @ self.design.T
        self.belief += np.diag(np.where(seen, self.noise, 1.0))
        self._root = np.linalg.cholesky(self.belief) * seen[:, None]
        ids = (f"G{j + 1:02d}" if j < VISIBLE else "" for j in range(channels))
        self.context = DetectorContext(
            receivers, channels, interval_s, self.noise, tuple(ids), states=s
        )

    @classmethod
    def of(cls, detector: Detector, receivers: int) -> SteadyEpochs:
        """Epochs of what a detector measures; with the slots and the interval of its card."""
        if detector.measures == "position":
            return cls(receivers, channels=0)
        card = detector.card
        if card is None:
            return cls(receivers)
        return cls(receivers, card.channels or VISIBLE, card.interval_s or INTERVAL_S)

    def __iter__(self) -> Iterator[Epoch]:
        rng, k = np.random.default_rng(3), 0
        make = EpochMaker(Epoch._field_defaults, self._constant())
        while True:
            k += 1
            yield make(**self._draw(k * self.interval_s, rng))

    def _measure(self) -> FloatArray:
        n = self.channels
        if not n:
            design = np.zeros((3, 15))
            design[:, 6:9] = np.eye(3)
            return design
        design = np.zeros((2 * n, 17))
        design[:n, 6:9], design[:n, 15] = self.sight, 1.0
        design[n:, 3:6], design[n:, 16] = self.sight, 1.0
        return design * np.hstack([self.visible, self.visible])[:, None]

    def _constant(self) -> dict[str, NDArray[Any]]:
        b, n = self.receivers, self.channels
        per_receiver = {
            "innovation_variance": np.diag(self.belief),
            "innovation_cov": self.belief,
            "predicted_cov": self.predicted,
            "design": self.design,
            "transition": self.transition,
            "predicted_velocity": _VELOCITY,
        }
        tiled = {name: np.tile(a, (b, *(1,) * np.ndim(a))) for name, a in per_receiver.items()}
        tiled["interval"] = np.full(b, self.interval_s)
        if not n:
            return {**without_channels(b), "cn0_dbhz": np.zeros((b, 0)), **tiled}
        return {
            **tiled,
            "visible": np.tile(self.visible, (b, 1)),
            "satellite_velocity": np.tile(_VELOCITY, (b, n, 1)),
        }

    def _draw(self, time_s: float, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
        b, n = self.receivers, self.channels
        innovation = rng.standard_normal((b, len(self._root))) @ self._root.T
        position = np.tile(_START + _VELOCITY * time_s, (b, 1))
        fix = 2.0 * rng.standard_normal((b, 3)) if n else innovation
        drawn = {
            "time": np.full(b, time_s),
            "innovation": innovation,
            "imu_delta": rng.standard_normal((b, 6)) * np.repeat([0.1, 1e-3], 3),
            "predicted_position": position,
            "gnss_position": position + fix,
            "auxiliary_position": position + 5.0 * rng.standard_normal((b, 3)),
        }
        if not n:
            return drawn
        return {
            **drawn,
            "pseudorange": np.where(self.visible, _RANGE_M + 1e4 + innovation[:, :n], 0.0),
            "range_rate": np.where(self.visible, 100.0 + innovation[:, n:], 0.0),
            "satellite_position": position[:, None, :] + _RANGE_M * self.sight,
            "cn0_dbhz": 45.0 + rng.standard_normal((b, n)),
        }


def _lines_of_sight(n: int) -> FloatArray:
    """(n, 3) with the vertical first, around the horizon and up to the zenith."""
    azimuth = 2.4 * np.arange(n)
    elevation = 0.2 + 1.2 * (np.arange(n) * 0.618 % 1.0)
    east, north = np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth)
    return np.column_stack([np.sin(elevation), east, north])


def _propagate(s: int, interval_s: float) -> FloatArray:
    """(s, s) attitude tilts gravity, biases accelerate and turn, velocity moves, the clock runs."""
    phi = np.diag(MEMORY[:s])
    phi[0:3, 12:15] = phi[3:6, 9:12] = phi[6:9, 3:6] = interval_s * np.eye(3)
    phi[4, 2], phi[5, 1] = GRAVITY_MPS2 * interval_s, -GRAVITY_MPS2 * interval_s
    if s > 15:
        phi[15, 16] = interval_s
    return phi
