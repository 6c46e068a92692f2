"""Epochs with a real geometry: twelve satellites, white noise, and what a spoofer adds."""

import numpy as np

from spoofgym.detectors import DetectorContext
from spoofgym.earth.wgs84 import STILL, dcm_e_from_n, geodetic_to_ecef, range_and_rate

from .support import epoch

SATELLITES = 12
NOISE = 4.0
HERE = geodetic_to_ecef(0.7, 2.0, 100.0)
ELEVATION = np.radians([75, 60, 55, 48, 40, 38, 33, 28, 22, 18, 14, 11])
AZIMUTH = np.radians([20, 250, 130, 60, 310, 190, 95, 225, 345, 160, 275, 35])
UP = np.column_stack(
    [np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH), -np.sin(ELEVATION)]
)
LINE_OF_SIGHT = UP @ dcm_e_from_n(0.7, 2.0).T
"""(12, 3) unit vectors in ECEF axes; satellites are 22 000 km away along them, but for the Earth's
turn."""
SATELLITE_POSITION = HERE + 2.2e7 * LINE_OF_SIGHT
RANGE = np.array([range_and_rate(s, STILL, HERE, STILL)[0] for s in SATELLITE_POSITION])


def context(receivers):
    variance = np.repeat([NOISE**2, 0.01], SATELLITES)
    ids = tuple(f"G{j:02d}" for j in range(SATELLITES))
    return DetectorContext(receivers, SATELLITES, 1.0, variance, ids)


def sky_epoch(offset, visible=None):
    """Epoch of pseudoranges that are off by (B, 12) metres, with a clock of a millisecond."""
    b = len(offset)
    blank = epoch(np.zeros((b, 2 * SATELLITES)), np.eye(2 * SATELLITES), visible)
    pseudorange = np.where(blank.visible, RANGE + 3e5 + offset, 0.0)
    return blank._replace(
        pseudorange=pseudorange,
        satellite_position=np.tile(SATELLITE_POSITION, (b, 1, 1)),
        predicted_position=np.tile(HERE, (b, 1)),
    )


def spoofed_offset(slots, displacement, receivers=1):
    """(B, 12) offsets of satellites that tell of another position, ECEF, and clock [m]."""
    offset = np.zeros((receivers, SATELLITES))
    offset[:, slots] = -LINE_OF_SIGHT[slots] @ displacement[:3] + displacement[3]
    return offset
