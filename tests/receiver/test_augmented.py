"""The filter with states for all that is not white: in its own world its innovations are white."""

import copy

import numpy as np
import pytest

from spoofgym.detectors import Never
from spoofgym.receiver import TightlyCoupled, augmented
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.simulator import run_serially
from spoofgym.truth.gnss_errors import ERRORS
from spoofgym.truth.scenario import Scenario

DRAWN = {"turn_on": "drawn", "events": {}}
WANDERING = {"name": "trolley-tactical", "in_run": "wandering"}


class Matrices(Never):
    needs = frozenset({"transition", "predicted_cov", "design", "innovation_cov"})


def begun(scenario, receivers, domain=None, receiver="augmented", seed=7):
    if isinstance(scenario, str):
        scenario = {"name": scenario, "imu_rate_hz": 20.0}
    if isinstance(scenario, dict):
        scenario = {"imu_rate_hz": 20.0, **scenario}
    phases = {"warmup_s": 10.0, "live_s": 5.0, "attack_s": 10.0, "time_to_alert_s": 1.0}
    simulator = TightlyCoupledSetup(
        scenario=scenario, domain=domain, receiver=receiver, detector=Matrices(), timeline=phases
    ).simulator(receivers, run_serially)
    simulator.start_episodes([np.random.default_rng([seed, row]) for row in range(receivers)])
    return simulator


def whitened(simulator, epochs):
    """(K, B, 2n) innovations of some epochs by their belief, NaN where no satellite is seen."""
    found = []
    for _ in range(epochs):
        epoch = simulator.advance()
        factor = np.linalg.cholesky(epoch.innovation_cov)
        y = np.linalg.solve(factor, epoch.innovation[:, :, None])[:, :, 0]
        found.append(np.where(np.hstack([epoch.visible, epoch.visible]), y, np.nan))
        simulator.update(None)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "receivers"),
    [
        ("trolley", 24),
        pytest.param("trolley", 64, marks=pytest.mark.nightly),
        pytest.param("aviation-overbound", 64, marks=pytest.mark.nightly),
    ],
)
def test_in_its_own_world_innovations_are_white_and_of_the_size_that_it_believes(name, receivers):
    settled = whitened(begun(name, receivers, DRAWN), 500)[100:]
    assert np.nanmean(settled**2) == pytest.approx(1.0, abs=0.01)
    assert np.nanmean(settled[1:] * settled[:-1]) == pytest.approx(0.0, abs=0.01)


def test_biases_that_wander_fast_have_states(monkeypatch):
    # as white innovations as without, of sensors that no filter of constants could follow
    sheet = augmented.IMU_GRADES["tactical"]
    restless = {"accel_in_run_ug": 2000.0, "gyro_in_run_deg_per_h": 200.0, "in_run_s": 20.0}
    monkeypatch.setitem(augmented.IMU_GRADES, "tactical", sheet._replace(**restless))
    test_in_its_own_world_innovations_are_white_and_of_the_size_that_it_believes(WANDERING, 24)


@pytest.mark.nightly
@pytest.mark.parametrize("grade", ["aviation", "tactical"])
def test_where_biases_wander_innovations_stay_white_with_age(grade):
    scenario = {**WANDERING, "flight": "airway", "imu": grade, "imu_rate_hz": 10.0}
    simulator, now = begun(scenario, 112, DRAWN), 0
    for age_s in (60, 600, 1000):
        simulator.run_filter_only(2 * age_s - 40 - now)
        now, y = 2 * age_s + 40, whitened(simulator, 80)
        slack = 4.0 / np.sqrt(np.isfinite(y).sum())  # of four standard deviations
        assert np.nanmean(y**2) == pytest.approx(1.0, abs=np.sqrt(2.0) * slack)
        assert np.nanmean(y[1:] * y[:-1]) == pytest.approx(0.0, abs=slack)


def test_the_covariance_is_that_of_the_errors():
    simulator = begun("trolley", 150, DRAWN)
    simulator.run_filter_only(120)
    error, C = simulator.error_n(), simulator.setup.world.C_en[int(simulator.epochs[0])]
    P = C.T @ simulator.buffers.covariance[0][6:9, 6:9] @ C
    ratio = (error**2).mean(axis=0) / np.diag(P)
    np.testing.assert_allclose(ratio, 1.0, atol=5.0 * np.sqrt(2.0 / 150))
    quadratic = np.einsum("bi,ij,bj->b", error, np.linalg.inv(P), error)
    assert quadratic.mean() == pytest.approx(3.0, abs=5.0 * np.sqrt(6.0 / 150))


def test_a_receiver_is_the_same_in_any_batch_and_may_be_copied():
    whole, part = begun("aviation-actual", 9), begun("aviation-actual", 3)
    for simulator in (whole, part):
        simulator.run_filter_only(6)
        simulator.step(np.full((simulator.receivers, 2), 0.3))
    for field in ("position_e", "C_eb", "clock", "packed_covariance"):
        mine, theirs = (each.buffers.fields[field] for each in (part, whole))
        assert mine.tobytes() == theirs[:3].tobytes()
    # what is shown moves with its receiver
    other = begun("aviation-actual", 3, seed=9)
    for simulator in (other, part):
        simulator.advance()
    other.copy_rows(np.array([0]), part, np.array([1]))
    np.testing.assert_array_equal(other.epoch.predicted_cov[0], part.epoch.predicted_cov[1])
    again = copy.deepcopy(other)
    assert not np.shares_memory(again.epoch.design, other.epoch.design)
    np.testing.assert_array_equal(again.epoch.design, other.epoch.design)


def test_the_states_are_those_that_the_errors_need():
    interval, bias = 0.5, np.full(4, 0.85)
    trolley = augmented.signal_model(ERRORS["trolley"], bias, interval)
    assert trolley.places == {"constant": 0, "correlated": 4}
    np.testing.assert_allclose(trolley.first, np.repeat([0.85**2, 0.75**2], 4))
    airborne = augmented.signal_model(ERRORS["aviation-actual"], 0.0 * bias, interval)
    kinds = ["ionosphere", "troposphere", "orbit_clock", "smoothed", "carrier"]
    assert list(airborne.places) == kinds
    for model in (trolley, airborne):  # stationary from the first epoch on
        P = np.diag(model.first)
        kept = model.transition @ P @ model.transition.T + model.driving
        if "carrier" in model.places:
            k = model.places["carrier"]
            kept[k:, k:] = P[k:, k:] = 0.0
        np.testing.assert_allclose(kept, P, rtol=0, atol=1e-12)
    none = augmented.signal_model(ERRORS["white"], 0.0 * bias, interval)
    assert none.first.size == 0


def test_with_too_few_satellites_it_coasts_and_weights_hold_it_back():
    victim = TightlyCoupled(grade="aviation", tuning="augmented", min_satellites=32)
    simulator = begun("trolley", 2, receiver=victim)
    before = simulator.memory["augmented"].copy()
    simulator.run_filter_only(3)
    assert simulator.coasting.all()
    np.testing.assert_array_equal(simulator.memory["augmented"], before)
    assert np.isfinite(simulator.position).all()
    simulator = begun("trolley", 2)
    simulator.run_filter_only(5)
    for weights in (np.zeros_like(simulator.ones), None):
        simulator.advance()
        before = simulator.buffers.fields["clock"].copy()
        simulator.update(weights)
        changed = simulator.buffers.fields["clock"] != before
        assert changed.all() if weights is None else not changed.any()


def test_what_does_not_go_with_it_is_refused():
    with pytest.raises(ValueError, match='`covariance_update` must be "unweighted" with'):
        TightlyCoupled(tuning="augmented", covariance_update="general")
    with pytest.raises(ValueError, match=r"'augmented' takes one grade of inertial sensors"):
        begun(Scenario(errors="trolley"), 1, {"imu": ("aviation", "tactical")})


@pytest.mark.parametrize("name", ["trolley", "aviation-actual", WANDERING])
def test_an_epoch_shows_the_matrices_of_all_states(name):
    simulator = begun(name, 2)
    simulator.run_filter_only(5)
    before, filter_ = simulator.memory["augmented_covariance"].copy(), simulator.augmented
    epoch, size = simulator.advance(), filter_.states
    Phi, P, H = epoch.transition, epoch.predicted_cov, epoch.design
    assert Phi.shape == P.shape == (2, size, size)
    assert H.shape == (2, epoch.innovation.shape[1], size)
    assert filter_.inertial == augmented.FIRST + (6 if name is WANDERING else 0)
    half, driving = np.zeros((2, size, size))
    psd = np.reshape(simulator.buffers.assumed["noise_psd"], (-1, 17))[0]
    half[:17, :17] = np.diag(0.5 * simulator.setup.interval_s * psd)
    driving[augmented.FIRST :, augmented.FIRST :] = filter_.model.driving
    want = Phi @ (before + half) @ Phi.transpose(0, 2, 1) + half + driving
    np.testing.assert_allclose(P, want, rtol=1e-9, atol=1e-12)
    gain = np.linalg.solve(epoch.innovation_cov, H @ P).transpose(0, 2, 1)
    change = (gain @ epoch.innovation[:, :, None])[:, :, 0]
    drift = simulator._predicted.drift
    held, more = simulator.position.copy(), simulator.memory["augmented"].copy()
    simulator.update(None)
    moved = (drift[:, :17] + change[:, :17])[:, 6:9]
    np.testing.assert_allclose(held - simulator.position, moved, atol=1e-8)
    np.testing.assert_allclose(simulator.memory["augmented"] - more, change[:, 17:], atol=1e-12)
