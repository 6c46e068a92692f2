"""Epochs to try detectors on."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..attacks import FalsePosition
from ..detectors import DetectorContext, Never
from ..receiver.epoch import OPTIONAL, Epoch, without_channels
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
