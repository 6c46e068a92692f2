"""Closed forms of the zero-alarm bound, against a solver, a linear filter and each other."""

import cvxpy as cp
import numpy as np
import pytest

from spoofgym.detectors import Ewma, Never, SequentialChi2, Shewhart, SnapshotChi2, WindowedChi2
from spoofgym.limits.linear import respond, white
from spoofgym.limits.no_alarm import judge_run
from spoofgym.limits.restricted import zero_alarm_of
from spoofgym.limits.zero_alarm import (
    energy_cusum_bound,
    energy_cusum_upper,
    ewma_bound,
    sensitivity,
    sequential_bound,
    sequential_sizes,
    sequential_upper,
    sequential_worst_hmi,
    snapshot_bound,
    windowed_upper,
)

from .toy import EAST, TIMING, toy_run

RUN = toy_run()
OF = sensitivity(RUN, 45, EAST)
W = OF.weights
K = len(W)


def shift(run, innovation, epoch, direction=EAST):
    """Displacement that comes of a shift of the innovations, by free propagation."""
    e = np.zeros(9)
    for k in range(epoch + 1):
        e = run.transition[k] @ e - run.gain[k] @ innovation[k]
    return float(np.array([*direction, 0.0]) @ run.axes[epoch].T @ e[6:9])


def best(constraints, energy, weights=W):
    """Largest weighted sum of the roots of some energies."""
    problem = cp.Problem(cp.Maximize(weights @ cp.sqrt(energy)), constraints)
    return problem.solve(solver=cp.CLARABEL)


@pytest.mark.parametrize("direction", [EAST, (1.0, 0.0), (0.6, -0.8)])
@pytest.mark.parametrize("epoch", [0, 20, 49])
def test_backwards_is_what_the_filter_does(epoch, direction):
    run = toy_run(setting=(10, 25))
    offsets = np.random.default_rng(1).standard_normal((50, 8, 3))
    offsets[10:25, [3, 7]] = 0.0
    response = respond(run, offsets)
    found = np.einsum("km,kmj->j", sensitivity(run, epoch, direction).rows, response.innovation)
    wanted = np.array(direction) @ response.position[epoch, :2]
    np.testing.assert_allclose(found, wanted, rtol=1e-10)


def test_sensitivity_names_what_is_out_of_range():
    with pytest.raises(ValueError, match="`epoch` must be 0 to 49, got 50"):
        sensitivity(RUN, 50, EAST)
    with pytest.raises(ValueError, match="`direction` must be a unit vector"):
        sensitivity(RUN, 0, (1.0, 1.0))


def test_snapshot_is_exact_and_attained():
    tau = np.linspace(20.0, 30.0, K)
    bound = snapshot_bound(OF, tau)
    energy = cp.Variable(K, nonneg=True)
    assert bound.value_m == pytest.approx(best([energy <= tau], energy), rel=1e-4)
    assert shift(RUN, bound.innovation, 45) == pytest.approx(bound.value_m)
    u = white(RUN.innovation_cov, bound.innovation[:, :, None])[:, :, 0]
    np.testing.assert_allclose((u * u).sum(axis=1), np.where(W > 0.0, tau, 0.0), rtol=1e-9)


def test_snapshot_is_what_a_solver_with_all_rows_finds():
    u = cp.Variable((K, 8))
    value = cp.sum(cp.multiply(OF.white, u))
    held = [cp.norm(u[k]) <= 5.0 for k in range(K)]
    found = cp.Problem(cp.Maximize(value), held).solve(solver=cp.CLARABEL)
    assert snapshot_bound(OF, 25.0).value_m == pytest.approx(found, rel=1e-4)


@pytest.mark.parametrize("smoothing", [0.1, 0.4, 1.0])
def test_ewma_is_exact_and_attained(smoothing):
    limits = np.sqrt(np.einsum("kii->ki", RUN.innovation_cov)) * np.linspace(0.5, 1.5, K)[:, None]
    bound = ewma_bound(OF, smoothing, limits)
    r, average = cp.Variable((K, 8)), cp.Variable((K + 1, 8))
    held = [average[0] == 0, cp.abs(average[1:]) <= limits]
    held += [average[1:] == smoothing * r + (1.0 - smoothing) * average[:-1]]
    problem = cp.Problem(cp.Maximize(cp.sum(cp.multiply(OF.rows, r))), held)
    assert bound.value_m == pytest.approx(problem.solve(solver=cp.HIGHS), rel=1e-4)
    assert shift(RUN, bound.innovation, 45) == pytest.approx(bound.value_m)


def test_energy_cusum_is_exact_and_below_its_upper_bound():
    energy, total = cp.Variable(K, nonneg=True), cp.Variable(K + 1)
    held = [total[0] == 0, total >= 0, total <= 30.0]
    held += [total[1:] >= total[:-1] + energy - 9.0]
    bound = energy_cusum_bound(OF, 9.0, 30.0)
    assert bound.value_m == pytest.approx(best(held, energy), rel=1e-4)
    assert bound.value_m <= energy_cusum_upper(OF, 9.0, 30.0).value_m
    assert shift(RUN, bound.innovation, 45) == pytest.approx(bound.value_m, rel=1e-5)


@pytest.mark.parametrize("window", [1, 7, 60])
def test_windows_have_an_upper_bound_by_blocks(window):
    tau = np.linspace(60.0, 80.0, K)
    energy = cp.Variable(K, nonneg=True)
    held = [cp.sum(energy[max(k - window + 1, 0) : k + 1]) <= tau[k] for k in range(K)]
    exact = best(held, energy)
    upper = windowed_upper(OF, window, tau)
    assert upper.kind == "upper"
    assert exact * (1.0 - 1e-6) <= upper.value_m <= 1.2 * exact


def test_windows_without_a_verdict_hold_nothing():
    tau = np.full(K, 60.0)
    tau[:4] = np.inf
    assert windowed_upper(OF, 5, tau).value_m == windowed_upper(OF, 5, 60.0).value_m
    assert windowed_upper(OF, 5, np.full(K, np.inf)).kind == "unbounded"


@pytest.mark.parametrize("shape", ["linear", "rising late", "rising early", "falling"])
def test_sequential_is_exact_and_attained(shape):
    n = np.arange(1.0, K + 1)
    tau = {
        "linear": 20.0 + 8.0 * n,
        "rising late": 5.0 + n**2,
        "rising early": 100.0 * np.sqrt(n),
        "falling": 500.0 - 3.0 * n,
    }[shape]
    energy = cp.Variable(K, nonneg=True)
    exact = best([cp.cumsum(energy) <= tau], energy)
    bound = sequential_bound(OF, tau)
    assert bound.value_m == pytest.approx(exact, rel=1e-4)
    assert shift(RUN, bound.innovation, 45) == pytest.approx(bound.value_m)
    assert bound.value_m <= sequential_upper(OF, tau).value_m * (1.0 + 1e-12)
    assert (np.cumsum(sequential_sizes(W, tau) ** 2) <= tau * (1.0 + 1e-12)).all()


def test_worst_hmi_is_what_was_missed_in_simulated_epochs():
    chance, mu = sequential_worst_hmi(OF, 60.0, 40.0, 20.0, 2.0)
    rng = np.random.default_rng(2)
    error = np.linalg.norm(W) * mu + 2.0 * rng.standard_normal(400_000)
    passed = rng.noncentral_chisquare(40.0, mu * mu, 400_000) <= 60.0
    missed = (np.abs(error) > 20.0) & passed
    assert chance == pytest.approx(missed.mean(), abs=5.0 * missed.std() / 632.0)


@pytest.mark.parametrize(
    ("detector", "closed"),
    [
        (SnapshotChi2(), lambda tau: snapshot_bound(OF, tau)),
        (SequentialChi2(signals="both"), lambda tau: sequential_bound(OF, tau)),
        (
            Shewhart(signals="both"),
            lambda q: ewma_bound(
                OF, 1.0, q[:, None] * np.sqrt(np.einsum("kii->ki", RUN.innovation_cov))
            ),
        ),
    ],
    ids=["snapshot", "sequential", "shewhart"],
)
def test_a_detector_has_the_bound_of_its_closed_form(detector, closed):
    bound = zero_alarm_of(detector, RUN, TIMING, epoch=45, direction=EAST)
    limits = judge_run(detector, RUN, TIMING).threshold[:, 0]
    assert bound.kind == "exact"
    assert bound.value_m == pytest.approx(closed(limits).value_m, rel=1e-6)


def test_windows_of_a_detector_are_below_their_upper_bound():
    detector = WindowedChi2(window=10)
    bound = zero_alarm_of(detector, RUN, TIMING, epoch=45, direction=EAST)
    tau = judge_run(detector, RUN, TIMING).threshold[:, 0]
    assert bound.value_m <= windowed_upper(OF, 10, tau).value_m <= 1.2 * bound.value_m


@pytest.mark.parametrize(
    "detector",
    [Never(), Ewma(weight_scale=None), SnapshotChi2(signals="pseudorange"), SequentialChi2()],
    ids=lambda each: type(each).__name__,
)
def test_what_is_not_judged_is_free(detector):
    bound = zero_alarm_of(detector, RUN, TIMING, epoch=45, direction=EAST)
    assert (bound.value_m, bound.kind) == (np.inf, "unbounded")
