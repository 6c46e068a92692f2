"""Closed forms of the zero-alarm bound, against a solver, a linear filter and each other."""

import cvxpy as cp
import numpy as np
import pytest

from spoofgym.detectors import Ewma, Never, SequentialChi2, Shewhart, SnapshotChi2
from spoofgym.limits.linear import respond, white
from spoofgym.limits.no_alarm import judge_run
from spoofgym.limits.zero_alarm import ewma_bound, sensitivity, sequential_bound, snapshot_bound

from .toy import EAST, TIMING, bound_of, false_position, toy_run

RUN = toy_run()
OF = sensitivity(RUN, 45, EAST)
W = OF.weights
K = len(W)
SD = np.sqrt(np.einsum("kii->ki", RUN.innovation_cov))


def shift(run, innovation, epoch, direction=EAST):
    """Displacement that comes of a shift of the innovations, by free propagation."""
    e = np.zeros(9)
    for k in range(epoch + 1):
        e = run.transition[k] @ e - run.gain[k] @ innovation[k]
    return float(np.array([*direction, 0.0]) @ run.axes[epoch].T @ e[6:9])


def best(constraints, energy):
    """Largest weighted sum of the roots of some energies."""
    return cp.Problem(cp.Maximize(W @ cp.sqrt(energy)), constraints).solve(solver=cp.CLARABEL)


@pytest.mark.parametrize(("epoch", "direction"), [(0, EAST), (20, (1.0, 0.0)), (49, (0.6, -0.8))])
def test_backwards_is_what_the_filter_does(epoch, direction):
    run = toy_run(setting=(10, 25))
    offsets = np.random.default_rng(1).standard_normal((50, 8, 3))
    offsets[10:25, [3, 7]] = 0.0
    response = respond(run, offsets)
    found = np.einsum("km,kmj->j", sensitivity(run, epoch, direction).rows, response.innovation)
    wanted = np.array(direction) @ response.position[epoch, :2]
    np.testing.assert_allclose(found, wanted, rtol=1e-10)


def test_sensitivity_names_what_is_out_of_range():
    with pytest.raises(ValueError, match="`epoch` must be a whole number from 0 to 49, got 50"):
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


@pytest.mark.parametrize("smoothing", [0.1, 0.4, 1.0])
def test_ewma_is_exact_and_attained(smoothing):
    limits = SD * np.linspace(0.5, 1.5, K)[:, None]
    bound = ewma_bound(OF, smoothing, limits)
    r, average = cp.Variable((K, 8)), cp.Variable((K + 1, 8))
    held = [average[0] == 0, cp.abs(average[1:]) <= limits]
    held += [average[1:] == smoothing * r + (1.0 - smoothing) * average[:-1]]
    problem = cp.Problem(cp.Maximize(cp.sum(cp.multiply(OF.rows, r))), held)
    assert bound.value_m == pytest.approx(problem.solve(solver=cp.HIGHS), rel=1e-4)
    assert shift(RUN, bound.innovation, 45) == pytest.approx(bound.value_m)


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
    u = white(RUN.innovation_cov, bound.innovation[:, :, None])[:, :, 0]
    assert (np.cumsum((u * u).sum(axis=1)) <= tau * (1.0 + 1e-9)).all()


@pytest.mark.parametrize(
    ("detector", "closed"),
    [
        (SnapshotChi2(), lambda tau: snapshot_bound(OF, tau)),
        (SequentialChi2(signals="both"), lambda tau: sequential_bound(OF, tau)),
        (Shewhart(signals="both"), lambda q: ewma_bound(OF, 1.0, q[:, None] * SD)),
    ],
    ids=["snapshot", "sequential", "shewhart"],
)
def test_a_detector_has_the_bound_of_its_closed_form(detector, closed):
    bound = bound_of(detector)
    limits = judge_run(detector, RUN, TIMING).threshold[:, 0]
    assert bound.kind == "exact"
    assert bound.value_m == pytest.approx(closed(limits).value_m, rel=1e-6)


@pytest.mark.parametrize(
    "detector",
    [Never(), Ewma(weight_scale=None), SnapshotChi2(signals="pseudorange"), SequentialChi2()],
    ids=lambda each: type(each).__name__,
)
def test_what_is_not_judged_is_free(detector):
    bound = bound_of(detector)
    assert (bound.value_m, bound.kind) == (np.inf, "unbounded")
    attacker = false_position(RUN, rate=np.inf, change=np.inf)
    bound = bound_of(Never(), attacker=attacker)
    assert (bound.value_m, bound.kind, bound.commands) == (np.inf, "unbounded", None)
