"""`check_stationary`: the registered detectors that depend on their age are those named here."""

import numpy as np
import pytest

from spoofgym.detectors import DETECTORS, Detector
from spoofgym.detectors.base import compare
from spoofgym.testing import check_stationary
from spoofgym.testing.stationary import AGES_S, ATTACKS, RECEIVERS, add_ramp
from spoofgym.testing.steady import STATE_SD, SteadyEpochs
from tests.nightly import heavy

KNOWN = {
    "innovation-rate": "a ramp of",  # forgets nothing: its gain goes to 0
    "sequential-chi2": "without attack",  # sums up the whole run
    "lottery": "without attack",  # waits for its moment
    "oracle-ramp": "without attack",  # is told when an attack begins
    "oracle-step": "without attack",
}
"""Detectors that depend on their age, by default and on purpose, and how the check says so."""
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


def test_a_detector_of_any_age_passes_and_finds_the_attack_at_each():
    found = check_stationary(Size())
    assert None not in found.rates_mps
    assert found.found.shape == (len(ATTACKS), len(AGES_S))
    assert found.found.min() > 0.9 * RECEIVERS


@pytest.mark.parametrize(
    ("detector", "said"),
    [
        (Tired(), "found in 6. of 64 .* begins 3 min after .* and in 0 when it begins 10 min"),
        (Drifting(), "without attack .* changes with the time since the reset: its medians at 3 m"),
    ],
    ids=["tired", "drifting"],
)
def test_one_that_counts_its_epochs_fails(detector, said):
    with pytest.raises(AssertionError, match=said):
        check_stationary(detector)


@pytest.mark.parametrize("name", heavy(DETECTORS, *SLOW))
def test_registered_detectors_do_not_depend_on_their_age_but_those_that_are_known(name):
    if name in KNOWN:
        with pytest.raises(AssertionError, match=KNOWN[name]):
            check_stationary(name)
    else:
        check_stationary(name)


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
