"""A vehicle on a straight line under its satellites."""

import numpy as np
import pytest

from spoofgym.truth.run import make_sky
from spoofgym.truth.satellites import CircularConstellation

CONSTELLATION = CircularConstellation(satellites=36)


def test_the_vehicle_moves_along_its_heading_under_the_highest_satellites():
    sky = make_sky(11, 2.0, 8, CONSTELLATION, speed_mps=30.0, heading_deg=90.0)
    moved = (sky.position_e[-1] - sky.position_e[0]) @ sky.C_en
    np.testing.assert_allclose(moved, [0.0, 600.0, 0.0], atol=1e-6)
    velocity = np.diff(sky.position_e, axis=0) / 2.0
    np.testing.assert_allclose(velocity, np.tile(sky.velocity_e, (10, 1)), atol=1e-6)
    with pytest.raises(ValueError, match=r"`satellites` must be at most \d+, .* got 30"):
        make_sky(3, 1.0, 30, CONSTELLATION)
    sky = make_sky(3, 1.0, 5, CONSTELLATION)
    everyone = CONSTELLATION.states(sky.time).position_e[0] - sky.position_e[0]
    up = -(everyone @ sky.C_en[:, 2]) / np.linalg.norm(everyone, axis=1)
    best = sorted(CONSTELLATION.satellite_ids[j] for j in np.argsort(-up)[:5])
    assert list(sky.satellite_ids) == best
    np.testing.assert_array_equal(
        sky.satellite_position_e[0] - sky.position_e[0],
        everyone[[CONSTELLATION.satellite_ids.index(name) for name in best]],
    )
