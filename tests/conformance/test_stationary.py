"""`check_stationary`, `check_ages`: the registered detectors that depend on their age."""

import numpy as np
import pytest

from spoofgym.detectors import DETECTORS, Detector
from spoofgym.detectors.base import compare
from spoofgym.detectors.build import bare_detector
from spoofgym.testing import check_ages, check_detector, check_stationary
from spoofgym.testing.ages import AGES_S, ATTACKS, RECEIVERS, add_ramp, can_fly
from spoofgym.testing.epochs import STATE_SD, SteadyEpochs
from tests.nightly import heavy

KNOWN = {
    "innovation-rate": "a ramp of",  # forgets nothing: its gain goes to 0
    "sequential-chi2": "without attack",  # sums up the whole run
    "lottery": "without attack",  # waits for its moment
    "oracle-ramp": "without attack",  # is told when an attack begins
    "oracle-step": "without attack",
}
"""Detectors that depend on their age, by default and on purpose, and how the check says so."""
WEIGHING = ("ewma", "joint-chart", "pool")
"""Those whose weights, at nominal thresholds, leave satellites out for ever longer in flight."""
DRIFT_MPS = 4e-4  # standard deviation, reached between 3 and 10 min after switch-on
QUICK = ("innovation-rate", "sequential-chi2", "snapshot-chi2")
SLOW = [name for name in DETECTORS if name not in QUICK]


class Size(Detector):
    """Largest normalized innovation, at any age."""

    paper = "page1954"

    def bind(self, context):
        super().bind(context)
        self.memory.declare("epochs", np.zeros(context.receivers))

    def judge(self, epoch):
        self.memory["epochs"] = self.memory["epochs"] + 1.0
        size = np.abs(epoch.innovation) / np.sqrt(epoch.innovation_variance)
        return self.compare(size.max(axis=1, keepdims=True), self.memory["epochs"][:, None])

    def compare(self, size, epochs):
        return compare(size, 5.0)


class Tired(Size):
    """Has learned the clock: 600 epochs after its reset it alarms no more."""

    def compare(self, size, epochs):
        verdict = compare(size, 5.0)
        return verdict._replace(alarm=verdict.alarm & (epochs < 600.0))


class Drifting(Size):
    """Its statistic grows by 1 % a minute."""

    def compare(self, size, epochs):
        return compare(size * (1.0 + epochs / 12_000.0), 5.0)


class Growing(Size):
    """Its threshold grows by 5 % a minute."""

    def compare(self, size, epochs):
        return compare(size, 5.0 * (1.0 + epochs / 2400.0))


class Settled(Size):
    """Has learned how the filter settles: blind once it knows the drift of its clock well."""

    needs = frozenset({"predicted_cov"})

    def judge(self, epoch):
        verdict = super().judge(epoch)
        unsettled = epoch.predicted_cov[:, 16, 16] > DRIFT_MPS**2
        return verdict._replace(alarm=verdict.alarm & unsettled[:, None])


def test_a_detector_of_any_age_passes_and_finds_the_attack_at_each():
    found = check_stationary(Size())
    assert None not in found.rates_mps
    assert found.found.shape == (len(ATTACKS), len(AGES_S), RECEIVERS)
    assert found.found.mean(axis=2).min() > 0.9


@pytest.mark.parametrize("detector", [Drifting(), Growing()], ids=["drifting", "growing"])
def test_one_that_counts_its_epochs_fails(detector):
    said = "without attack .* changes with the time since the reset: its medians at 3 m"
    with pytest.raises(AssertionError, match=said):
        check_stationary(detector)


def test_one_that_takes_its_age_from_the_filter_fails_in_flight():
    said = "found in 6. of 64 .* begins 3 min after the switch-on, and in 0 when it begins 10 min"
    with pytest.raises(AssertionError, match=said):
        check_ages(Settled())


def test_check_detector_looks_at_the_age_where_it_is_asked_to():
    check_detector(Tired())
    said = "found in 6. of 64 .* begins 3 min after .* and in 0 when it begins 10 min"
    with pytest.raises(AssertionError, match=said):
        check_detector(Tired(), stationary=True)


def test_it_is_attacked_in_flight_under_one_sky_too():
    world = {"name": "zhong2025-white", "flight": "airway", "imu_rate_hz": 10.0}
    found = check_ages("snapshot-chi2", scenario=world, receiver="matched")
    assert found.found.shape == (len(ATTACKS), len(AGES_S), RECEIVERS)
    assert found.found[1].any()


@pytest.mark.parametrize("name", heavy(DETECTORS, *SLOW))
def test_registered_detectors_do_not_depend_on_their_age_but_those_that_are_known(name):
    if name in KNOWN:
        with pytest.raises(AssertionError, match=KNOWN[name]):
            check_stationary(name)
    else:
        check_stationary(name)


@pytest.mark.nightly
@pytest.mark.parametrize("name", DETECTORS)
def test_in_flight_the_same_depend_on_their_age_and_those_that_weigh(name):
    if not can_fly(bare_detector(name)):
        with pytest.raises(ValueError, match="what a tightly coupled receiver does not have"):
            check_ages(name)
    elif name in KNOWN or name in WEIGHING:
        with pytest.raises(AssertionError, match="without attack"):
            check_ages(name)
    else:
        check_ages(name)


@pytest.mark.parametrize(
    "spec",
    [{"name": "innovation-rate", "memory_s": 20.0}, {"name": "sequential-chi2", "window_s": 60.0}],
)
def test_with_a_bounded_memory_they_pass(spec):
    check_stationary(spec)


@pytest.mark.parametrize("channels", [0, 12])
def test_epochs_of_the_steady_state_are_as_the_filter_believes(channels):
    steady = SteadyEpochs(400, channels)
    for number, epoch in zip(range(3), steady, strict=False):
        whitened = np.linalg.solve(
            np.linalg.cholesky(epoch.innovation_cov), epoch.innovation[..., None]
        )
        seen = 16 if channels else 3
        # chi-square of 400 x 16 or 400 x 3 degrees of freedom, within 5 sigma
        mean = (whitened**2).sum() / (400 * seen)
        assert abs(mean - 1.0) < 5.0 * np.sqrt(2.0 / (400 * seen))
        assert epoch.time[0] == 0.5 * (number + 1)
        moved = add_ramp(epoch, ATTACKS[1], 2.0, 3.0)
        assert np.abs(moved.innovation - epoch.innovation).max() == pytest.approx(6.0)
    # P solves the Riccati equation: prediction and update leave it alone
    gain = steady.predicted @ steady.design.T @ np.linalg.inv(steady.belief)
    updated = steady.predicted - gain @ steady.design @ steady.predicted
    again = steady.transition @ updated @ steady.transition.T
    noise = np.diag(STATE_SD[: len(again)] ** 2)
    np.testing.assert_allclose(again + noise, steady.predicted, atol=1e-9)
