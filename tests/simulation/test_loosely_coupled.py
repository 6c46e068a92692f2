"""The loosely coupled receiver: what an attack moves, an honest filter, clear refusals."""

import numpy as np
import pytest

from spoofgym.simulation import LooselyCoupledSetup

from .support import Weigher, setup_of, step, warm

WHITE = {"horizontal_sd_m": 3.7, "vertical_sd_m": 6.0, "decay": 0.0}


def test_an_attack_meets_the_same_noise_and_moves_the_fix():
    setup = setup_of("loose", detector=Weigher())
    attacked, clean = warm(setup, 4), warm(setup, 4)
    for _ in range(10):
        step(attacked, [1.0, -0.5])
        step(clean)
    np.testing.assert_array_equal(attacked.memory["position_error"], clean.memory["position_error"])
    np.testing.assert_array_equal(attacked.victims.samples, clean.victims.samples)
    np.testing.assert_allclose(attacked.commanded_displacement, [[5.0, -2.5]] * 4)
    moved = (attacked.victims.fix_e - clean.victims.fix_e) @ setup.world.C_el[50]
    np.testing.assert_allclose(moved, [[-2.5, 5.0, 0.0]] * 4, atol=1e-8)
    out = np.empty((4, 6))
    clean.motion(1e-4, 1e-2, out)  # since the onset
    moved = setup.world.C_el[40].T @ (setup.world.position_e[50] - setup.world.position_e[40])
    want = moved[[1, 0, 2]] * [1e-4, 1e-4, -1e-4]
    np.testing.assert_allclose(out[:, :3], [want] * 4, atol=1e-12)


def test_the_filter_is_honest_where_its_noise_is_the_world_s():
    """NIS of 3 a fix, and errors of the size that the covariance says, apart from the factor 3."""
    setup = LooselyCoupledSetup(errors=WHITE, receiver={}, detector="windowed-chi2")
    mine, nis = warm(setup, 200), []
    for _ in range(50):
        step(mine)
        z, S = mine.memory["innovation"], mine.memory["innovation_cov"]
        nis.append(np.einsum("bi,bij,bj->b", z, np.linalg.inv(S), z))
    mean = np.mean(nis)
    assert mean == pytest.approx(3.0, abs=5.0 * np.sqrt(6.0 / np.size(nis)) + 0.05)
    sd = np.sqrt(np.diagonal(mine.memory["covariance"], axis1=1, axis2=2)[:, [7, 6]])
    assert 0.7 < np.sqrt(np.mean((mine.error_n() / sd) ** 2)) < 1.2


def test_a_start_later_in_the_flight_is_at_the_truth_there():
    setup = setup_of("loose", domain={"start_s": (0.0, 50.0)}, errors=WHITE)
    mine = warm(setup, 2, start_s=[0.0, 50.0])
    apart = setup.world.position_e[mine.epochs] - mine.memory["position_e"]
    assert (np.linalg.norm(apart, axis=1) < 30.0).all()
    np.testing.assert_allclose(mine.time_s(), [4.0, 54.0])
    out = np.empty((2, 6))
    mine.motion(1.0, 1.0, out)
    np.testing.assert_allclose(out[:, :3], 0.0, atol=1e-9)
    C_el = setup.world.C_el[mine.epochs]
    velocity = np.einsum("bi,bij->bj", setup.world.velocity_e[mine.epochs], C_el)
    np.testing.assert_allclose(out[:, 3:], velocity[:, [1, 0, 2]] * [1.0, 1.0, -1.0], atol=1e-9)


def test_the_default_warm_up_fills_the_windows():
    mine = warm(LooselyCoupledSetup(), 1)
    assert mine.detector.memory["seen"][0] > mine.detector.covariance_window
    assert not np.allclose(mine.memory["measurement_cov"][0], np.diag([3.7**2, 3.7**2, 36.0]))
    assert mine.time_s() == pytest.approx(20.0)
    assert any(step(mine, 1.0)[0] for _ in range(10))
    other = warm(setup_of("loose", flight="zhong2025"), 1)
    assert other.setup.world.samples == 10
    assert np.isfinite(other.error_n()).all()


def test_what_fits_no_loosely_coupled_receiver_is_refused():
    for settings, message in (
        ({"errors": {"decays": 0.1}}, "`errors` has no setting 'decays'; valid: horizontal_sd_m"),
        ({"receiver": {"window": 1}}, "`receiver` has no setting 'window'"),
        ({"timeline": {"attack_s": 50.0}}, "an episode takes 75.1 s .* 'shadmehri2025' lasts"),
        ({"flight": "shadmehri"}, "unknown flight 'shadmehri'.*did you mean 'shadmehri2025'"),
        ({"detector": "ewma"}, "Ewma measures satellites, but the receiver measures position"),
    ):
        with pytest.raises(ValueError, match=message):
            warm(LooselyCoupledSetup(**settings), 1)
