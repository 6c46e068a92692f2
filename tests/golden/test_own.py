"""The project's own golden run; unlike those of the reference software it never skips."""

import numpy as np

from . import own


def test_the_stored_measurements_replay_to_the_stored_solution():
    initial, recording, stored = own.load()
    solution = own.solve(initial, recording)
    for name, absolute in (
        ("position_e", 0.0),
        ("velocity_e", 1e-9),
        ("C_eb", 1e-9),
        ("clock_bias_m", 0.0),
        ("sd", 0.0),
    ):
        mine = getattr(solution, name)
        np.testing.assert_allclose(mine, stored[name], rtol=1e-9, atol=absolute, err_msg=name)


def test_the_simulation_measures_what_is_stored():
    """World, sensors, noise and attack are those that the file was made with."""
    initial, recording, _ = own.simulate()
    begun, kept, _ = own.load()
    np.testing.assert_allclose(initial.position_e, begun.position_e, rtol=1e-12)
    for name in ("pseudorange", "satellite_position_e", "gnss_time", "imu_time"):
        mine, theirs = getattr(recording, name), getattr(kept, name)
        np.testing.assert_allclose(mine, theirs, rtol=1e-12, err_msg=name)
    np.testing.assert_allclose(recording.range_rate, kept.range_rate, atol=1e-9)
    # quantized samples are the same, but for one that a last bit may move by one level
    for name, level in (("specific_force_b", 1e-2), ("angular_rate_b", 2e-4)):
        off = np.abs(getattr(recording, name) - getattr(kept, name))
        assert off.max() < 1.001 * level
        assert (off > 1e-9).mean() < 1e-3
