"""Rotations: order and signs of the Euler angles, round trips."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from spoofgym.earth.attitude import dcm_to_euler, euler_to_dcm

ANGLES = st.floats(-math.pi, math.pi, exclude_min=True)
PITCHES = st.floats(-math.pi / 2, math.pi / 2)


@given(ANGLES, PITCHES, ANGLES)
def test_angles_are_yaw_then_pitch_then_roll_to_a_matrix_and_back(roll, pitch, yaw):
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(euler_to_dcm(roll, pitch, yaw), expected, rtol=0, atol=5e-15)
    C_nb = euler_to_dcm(roll, pitch, yaw)
    found = dcm_to_euler(C_nb)
    # near the vertical only the sum of roll and yaw is told; the matrix comes back anywhere
    np.testing.assert_allclose(euler_to_dcm(*found), C_nb, rtol=0, atol=5e-8)
    if abs(pitch) < 1.5:
        assert found[1] == pytest.approx(pitch, abs=1e-12)
        for angle, given_ in ((found[0], roll), (found[2], yaw)):
            assert math.remainder(angle - given_, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_a_matrix_that_rounding_left_beyond_one_has_a_pitch():
    C_nb = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0 - 1e-15, 0.0, 0.0]])
    assert dcm_to_euler(C_nb)[1] == math.pi / 2
    # of any shape
    assert euler_to_dcm(np.zeros(4), 0.1, np.zeros((3, 1))).shape == (3, 4, 3, 3)
    assert dcm_to_euler(np.tile(C_nb, (2, 5, 1, 1)))[1].shape == (2, 5)
