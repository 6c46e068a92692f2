"""Epochs of receivers that measure a position, to try detectors on."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..detectors import DetectorContext
from ..receiver.epoch import Epoch
from .epochs import INTERVALS, RECEIVERS, Script, with_optional_fields

FloatArray = NDArray[np.float64]

COORDINATES = (2, 3)
"""Of a robot on a plane, and of a position in space."""
STATES = {2: 4, 3: 15}
"""Position and velocity in the plane; attitude, velocity, position and sensor biases in space."""
COUNT = 80
ZERO = 14
OUTLIER = 18
RETURNED = (44, 50)
"""Epochs, ends excluded, in which a jump of some metres comes and goes."""
ATTACKED_FROM = 55


@lru_cache(maxsize=len(COORDINATES))
def position_script(coordinates: int) -> Script:
    """Made-up epochs of a receiver whose measurement is a position.

    There are no channels, n = 0, and m innovations, one a coordinate.  Intervals differ; once all
    innovations are zero, once there is an outlier of a thousand standard deviations; a jump comes
    and goes, and in the end the position drifts away.  Innovations are drawn from the covariance
    that they are said to have; they are the GNSS position minus the predicted one.
    """
    rng = np.random.default_rng(2 + coordinates)
    noise = np.array([1.0, 1.5, 4.0])[:coordinates]
    time = np.zeros(RECEIVERS)
    epochs = []
    for k in range(COUNT):
        interval = INTERVALS[k % len(INTERVALS)]
        time = time + interval
        epochs.append(_made_up(k, time, interval, noise, rng))
    context = DetectorContext(RECEIVERS, 0, 0.5, noise, ())
    name = f"made-up epochs of a position with {coordinates} coordinates"
    return Script(name, context, tuple(epochs))


def _made_up(
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
    innovation = np.einsum("bij,bj->bi", np.linalg.cholesky(belief), rng.standard_normal((b, m)))
    if k == ZERO:
        innovation[:] = 0.0
    if k == OUTLIER:
        innovation[:, 1] += 1e3 * np.sqrt(belief[:, 1, 1])
    if RETURNED[0] <= k < RETURNED[1]:
        innovation += 20.0
    innovation[:, 0] += 0.5 * max(0, k - ATTACKED_FROM)
    position = np.outer(time, [3.0, -4.0, 0.0])
    fix = position.copy()
    fix[:, :m] += innovation
    transition = np.tile(np.eye(s), (b, 1, 1))
    nothing, no_vector = np.zeros((b, 0)), np.zeros((b, 0, 3))
    return with_optional_fields(
        Epoch(
            time=time,
            interval=np.full(b, interval),
            innovation=innovation,
            innovation_variance=np.ascontiguousarray(np.einsum("bii->bi", belief)),
            innovation_cov=np.ascontiguousarray(belief),
            predicted_cov=covariance,
            design=design,
            transition=transition,
            imu_delta=rng.standard_normal((b, 6)) * np.repeat([0.1, 1e-3], 3),
            pseudorange=nothing,
            range_rate=nothing,
            satellite_position=no_vector,
            satellite_velocity=no_vector,
            visible=np.zeros((b, 0), dtype=np.bool_),
            predicted_position=position,
            predicted_velocity=np.tile([3.0, -4.0, 0.0], (b, 1)),
            gnss_position=fix,
        ),
        rng,
    )
