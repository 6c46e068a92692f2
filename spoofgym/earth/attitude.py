"""Attitude: direction cosine matrices and Euler angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def euler_to_dcm(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> NDArray[np.float64]:
    """`C_nb` (S, 3, 3), to local from body axes: yaw first, then pitch, then roll [rad], any shape
    S. Transpose of Groves (2013), eq. 2.22."""
    roll, pitch, yaw = np.broadcast_arrays(roll, pitch, yaw)
    sr, cr = np.sin(roll), np.cos(roll)
    sp, cp = np.sin(pitch), np.cos(pitch)
    sy, cy = np.sin(yaw), np.cos(yaw)
    rows = [
        [cp * cy, -cr * sy + sr * sp * cy, sr * sy + cr * sp * cy],
        [cp * sy, cr * cy + sr * sp * sy, -sr * cy + cr * sp * sy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def dcm_to_euler(
    C_nb: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Roll, pitch and yaw [rad] of `C_nb` (..., 3, 3), to local from body axes; roll and yaw in
    (-pi, pi], pitch in [-pi/2, pi/2]. Groves (2013), eq. 2.23."""
    C = np.asarray(C_nb, dtype=np.float64)
    roll = np.arctan2(C[..., 2, 1], C[..., 2, 2])
    pitch = -np.arcsin(np.clip(C[..., 2, 0], -1.0, 1.0))
    return roll, pitch, np.arctan2(C[..., 1, 0], C[..., 0, 0])
