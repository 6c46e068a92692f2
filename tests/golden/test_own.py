"""The project's own golden run; unlike those of the reference software it never skips."""

import numpy as np

from . import own


def test_the_file_is_small():
    assert own.FILE.stat().st_size < 200_000


def test_the_stored_measurements_replay_to_the_stored_solution():
    initial, recording, stored = own.load()
    solution = own.solve(initial, recording)
    np.testing.assert_allclose(solution.position_e, stored["position_e"], rtol=1e-9)
    np.testing.assert_allclose(solution.velocity_e, stored["velocity_e"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(solution.C_eb, stored["C_eb"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(solution.clock_bias_m, stored["clock_bias_m"], rtol=1e-9)
    np.testing.assert_allclose(solution.sd, stored["sd"], rtol=1e-9)


def test_the_simulation_measures_what_is_stored():
    """World, sensors, noise and attack are those that the file was made with."""
    initial, recording, stored_recording = (*own.simulate()[:2], own.load()[1])
    np.testing.assert_allclose(initial.position_e, own.load()[0].position_e, rtol=1e-12)
    for name in ("pseudorange", "satellite_position_e", "gnss_time", "imu_time"):
        mine, theirs = getattr(recording, name), getattr(stored_recording, name)
        np.testing.assert_allclose(mine, theirs, rtol=1e-12, err_msg=name)
    np.testing.assert_allclose(recording.range_rate, stored_recording.range_rate, atol=1e-9)
    # quantized samples are the same, but for one that a last bit may move by one level
    for name, level in (("specific_force_b", 1e-2), ("angular_rate_b", 2e-4)):
        off = np.abs(getattr(recording, name) - getattr(stored_recording, name))
        assert off.max() < 1.001 * level
        assert (off > 1e-9).mean() < 1e-3


def test_the_noise_streams_are_those_of_the_first_version():
    _, _, stored = own.load()
    assert own.noise_words() == str(stored["noise_words"])
    np.testing.assert_allclose(own.noise_values(), stored["noise_values"], rtol=0, atol=1e-13)
