"""A monitor's own filter: what it computes beside a victim, and whom it takes; its bank."""

import json

import numpy as np
import pytest

from spoofgym.core.memory import Memory
from spoofgym.core.settings import describe
from spoofgym.detectors import (
    Calibrated,
    DetectorContext,
    PooledDetector,
    SolutionSeparation,
    make_detector,
)
from spoofgym.detectors.base import HAVE_IT
from spoofgym.detectors.build import spec_of_judge
from spoofgym.detectors.calibrated import describe_identity
from spoofgym.detectors.solution_separation import space_equally, space_geometrically
from spoofgym.limits.bounds import WorldSample, zero_alarm_bounds
from spoofgym.limits.no_alarm import check_convex
from spoofgym.receiver.augmented import AugmentedFilter
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.loose import LooselyCoupledSetup
from spoofgym.simulation.robot import WheeledRobotSetup
from spoofgym.simulation.setup import seeds_of_runs
from spoofgym.simulation.simulator import run_serially
from spoofgym.simulation.snapshot import SnapshotSetup

PHASES = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 1.0}
OWN = {"name": "snapshot-chi2", "filter": "augmented", "thresholds": "nominal"}
pytestmark = pytest.mark.filterwarnings("ignore::spoofgym.detectors.base.YoungMemoryWarning")


def setup_of(world="trolley", detector=OWN, receiver="matched", domain=None):
    return TightlyCoupledSetup(
        scenario={"name": world, "imu_rate_hz": 20.0},
        receiver=receiver,
        detector=make_detector(detector),
        timeline=PHASES,
        domain={"turn_on": "drawn", "events": {}} if domain is None else domain,
    )


def started(setup, receivers, seed=3):
    simulator = setup.simulator(receivers, run_serially)
    simulator.start_episodes([np.random.default_rng([seed, row]) for row in range(receivers)])
    return simulator


def whiten(epoch):
    factor = np.linalg.cholesky(epoch.innovation_cov)
    return np.linalg.solve(factor, epoch.innovation[:, :, None])[:, :, 0]


def white_innovations(simulator, epochs, weights=lambda simulator: None):
    """(K, B, m) of the filter that the detector tests, NaN where not visible."""
    found, own = [], simulator.detector._own
    for _ in range(epochs):
        epoch = simulator.advance()
        seen = np.hstack([epoch.visible, epoch.visible])
        found.append(np.where(seen, whiten(epoch if own is None else own.observe(epoch)), np.nan))
        simulator.update(weights(simulator))
    return np.array(found)


@pytest.mark.parametrize("world", ["zhong2025", "trolley", "aviation-overbound"])
def test_its_innovations_are_those_of_an_augmented_receiver_on_the_same_noise(world):
    beside = white_innovations(started(setup_of(world), 3), 60)
    receiver = white_innovations(started(setup_of(world, receiver="augmented"), 3), 60)
    assert np.nanstd(beside - receiver) < (0.05 if world.startswith("aviation") else 0.01)


def move_on(transition, x):
    return (transition @ x[..., None])[..., 0]


@pytest.mark.parametrize("world", ["trolley", "aviation-actual"])
def test_its_kernels_and_those_of_its_bank_are_the_equations(world):
    detector = {**OWN, "name": "solution-separation", "spacing_s": 1.0, "longest_s": 8.0}
    simulator, close = started(setup_of(world, detector), 2), {"rtol": 1e-8, "atol": 1e-9}
    bank, own = simulator.detector, simulator.detector._own
    model, d, (firsts, periods) = own.model, own.inertial, bank._starts
    interval_s, channels = simulator.setup.interval_s, own.white.shape[1] // 2
    plain = AugmentedFilter(Memory(2), model.signals, interval_s, channels)
    plain.start_episodes(np.arange(2), model.covariance, model.grade)
    psd, variance = (np.tile(each, (2, 1)) for each in (model.noise_psd, model.noise_variance))
    x, s, V = np.zeros((2, 17)), np.zeros((len(firsts), 2, d)), np.zeros((len(firsts), 2, d, d))
    for k in range(25):
        epoch = simulator.advance()
        found, Phi, H = bank.filter_epoch(epoch), epoch.transition, epoch.design
        x = move_on(Phi, x)
        z = epoch.innovation - move_on(H, x)
        inertial = Phi, epoch.imu_delta, psd, epoch.interval, H, own.memory["mapping"]
        predicted = plain.predict(*inertial, epoch.visible, z, variance, own.fewest)
        gain = predicted.gain[:, :d] @ np.linalg.inv(predicted.S)
        step, spread = move_on(gain, predicted.innovation), gain @ predicted.gain[:, :d].mT
        x = x + plain.update(predicted, None)
        taken = epoch.predicted_cov @ H.mT @ np.linalg.inv(epoch.innovation_cov)
        x = x - move_on(taken, epoch.innovation)
        np.testing.assert_allclose(found.innovation, predicted.innovation, **close)
        np.testing.assert_allclose(found.innovation_cov, predicted.S, **close)
        bank._advance(found, np.arange(2))
        place, belief = bank._bank[:2]
        F = np.tile(np.eye(d), (2, 1, 1))
        F[:, :17, : own.top.shape[2]], F[:, 17:, 17:] = own.top, own.rest[: d - 17, : d - 17]
        for j in np.flatnonzero(k >= firsts):
            if (k - firsts[j]) % periods[j] == 0:
                s[j], V[j] = 0.0, 0.0
            s[j], V[j] = move_on(F, s[j]) - step, F @ V[j] @ F.mT + spread
            np.testing.assert_allclose(place[..., j], s[j][:, 6:9], **close)
            rounding = 1e-8 * np.abs(V[j]).max()
            np.testing.assert_allclose(belief[..., j], V[j][:, 6:9, 6:9], rtol=0.0, atol=rounding)
        simulator.update(None)


def test_beside_a_matched_victim_innovations_are_white_and_as_large_as_they_should_be():
    y = white_innovations(started(setup_of(), 24), 160)[20:]
    count = np.isfinite(y).sum()
    assert np.nanmean(y**2) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / count))
    assert np.nanmean(y[1:] * y[:-1]) == pytest.approx(0.0, abs=5.0 / np.sqrt(count))


def test_weights_on_the_victim_change_nothing_for_it():
    rng = np.random.default_rng(0)
    plain, weighed = (started(setup_of(), 2) for _ in range(2))
    weights = [rng.random(plain.ones.shape) for _ in range(30)]
    mine = white_innovations(plain, 30)
    theirs = white_innovations(weighed, 30, lambda simulator: weights.pop())
    apart = plain.position - weighed.position
    assert np.abs(apart).max() > 0.1
    assert np.nanmax(np.abs(mine - theirs)) < 0.01


def test_the_filter_of_an_augmented_victim_is_its_own():
    found = []
    for name in ("victim", "augmented"):
        simulator = started(setup_of(detector={**OWN, "filter": name}, receiver="augmented"), 2)
        simulator.run_filter_only(3)
        found.append([simulator.step(attacked=False).statistic for _ in range(5)])
    np.testing.assert_array_equal(*found)


def test_it_sees_every_epoch_since_switch_on_and_only_live_ones_count():
    bank = {**OWN, "name": "solution-separation", "longest_s": 20.0}
    for name, early in (("augmented", True), ("victim", False)):
        simulator = started(setup_of(detector={**bank, "filter": name}), 2)
        setup = simulator.setup
        simulator.run_filter_only(setup.filter_only)
        assert (simulator.detector.memory["epochs"] == early * setup.filter_only).all()
        simulator.live_epochs(setup.live)
        seen = setup.live + early * setup.filter_only
        assert (simulator.detector.memory["epochs"] == seen).all()
    jumpy = started(setup_of(detector={**OWN, "false_alarm": 1.0 - 1e-12}), 2)
    jumpy.run_filter_only(setup.filter_only)
    assert jumpy.verdict is None
    assert jumpy.live_epochs(3).all()


@pytest.mark.parametrize(
    "wrap", [lambda d: Calibrated(d, 2.0), lambda d: PooledDetector(["ewma", d])]
)
def test_what_holds_it_is_shown_the_same(wrap):
    inner = make_detector(OWN)
    whole = wrap(inner)
    assert whole.from_start
    assert whole.needs_model
    assert inner.needs <= whole.needs
    simulator, alone = (started(setup_of(detector=each), 2) for each in (whole, inner))
    for each in (simulator, alone):
        each.run_filter_only(4)
    held = simulator.detector.judges[1] if simulator.detector.judges else simulator.detector
    for name in ("filters", "feedback"):
        assert held.memory[name].tobytes() == alone.detector.memory[name].tobytes()


@pytest.mark.parametrize("world", ["trolley", "aviation-actual"])
def test_a_receiver_is_the_same_in_any_batch_and_may_be_moved(world):
    detector = {**OWN, "name": "solution-separation", "spacing": "geometric", "longest_s": 90.0}
    whole, part = (started(setup_of(world, detector), count) for count in (9, 3))
    other = started(setup_of(world, detector), 3, seed=8)
    for simulator in (whole, part, other):
        simulator.run_filter_only(5)
        simulator.live_epochs(3)
    moved, rows = np.array([0, 2]), np.array([1, 2])
    other.copy_rows(moved, part, rows)
    for _ in range(3):
        found = [each.step(attacked=False).statistic for each in (whole, part, other)]
        assert found[0][:3].tobytes() == found[1].tobytes()
        np.testing.assert_array_equal(found[2][moved], found[1][rows])
    part.detector.reset(np.array([True, False, True]))
    fresh = started(setup_of(world, detector), 3).detector.memory
    for name, array in part.detector.memory.items():
        np.testing.assert_array_equal(array[[0, 2]], fresh[name][[0, 2]])


@pytest.mark.parametrize("kind", [LooselyCoupledSetup, WheeledRobotSetup, SnapshotSetup])
def test_a_victim_without_a_model_is_refused(kind):
    for name in ("windowed-chi2", "solution-separation"):
        detector = make_detector({**OWN, "name": name})
        with pytest.raises(ValueError, match=f"model of the victim's errors, which .* {HAVE_IT}"):
            kind(detector=detector).simulator(1, run_serially)
    bare = DetectorContext(1, 4, 0.5, np.ones(8), ("",) * 4)
    with pytest.raises(ValueError, match=f"needs a model of its errors; {HAVE_IT}"):
        make_detector(OWN).bind(bare)


def test_worlds_with_several_kinds_of_sensors_have_none():
    with pytest.raises(ValueError, match="does not have here; a tightly coupled receiver has one"):
        started(setup_of(domain={"imu": ("aviation", "tactical")}), 1)


def test_stored_texts_know_nothing_of_it():
    plain, own = (make_detector({**OWN, "filter": each}) for each in ("victim", "augmented"))
    for text in (describe_identity, spec_of_judge, describe):
        assert "victim" not in json.dumps(text(plain))
        assert '"filter": "augmented"' in json.dumps(text(own))
    assert "spacing" not in {**describe_identity(SolutionSeparation())}
    assert '"filter": "augmented"' in json.dumps(describe(PooledDetector(["ewma", own])))


# --- banks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("spacing", [1, 4, 40])
@pytest.mark.parametrize("longest", [7, 160, 1200, 3600])
@pytest.mark.parametrize("space", [space_equally, space_geometrically])
def test_every_attack_that_is_covered_has_a_solution_that_is_not_much_older(
    space, longest, spacing
):
    if space is space_equally and longest > 100 * spacing:
        return
    firsts, periods = space(longest, spacing)
    covers = periods.max() - (firsts[1] - firsts[0])
    assert covers >= longest
    if space is space_geometrically:
        assert len(firsts) <= 2 * np.log2(max(longest / spacing, 2)) + 4
    end = int(2.3 * periods.max())
    attack = np.arange(1, covers + 1)
    for k in np.unique(np.linspace(1, end, 400).astype(int)):
        since = k - 1 - firsts
        age = np.sort(np.where(since >= 0, since % periods + 1, 0))
        judged = attack[attack <= k]
        place = np.searchsorted(age, judged)
        assert (place < len(age)).all(), k
        over = age[place] - judged
        allowed = np.maximum(spacing, 2 / 3 * judged) if space is space_geometrically else spacing
        assert (over <= allowed).all(), k


def test_a_bound_is_printed_only_where_the_bank_covers_the_attack():
    def bounds(**settings):
        detector = {"name": "solution-separation", "spacing_s": 5.0, "longest_s": 10.0}
        setup = setup_of(detector={**detector, "thresholds": "nominal", **settings})
        sample = WorldSample(None, None, seeds_of_runs(0, "selection", setup.name, [0])[0])
        return zero_alarm_bounds(setup, setup.detector, [sample])

    short = bounds()
    assert (short.free_m, short.restricted_m, short.kind) == (None, None, "")
    assert short.why.startswith("an attack of 20 s is longer than the 10 s that its bank covers")
    assert bounds(longest_s=20.0).restricted_m > 0.0
    assert bounds(longest_s=20.0, spacing="geometric").restricted_m > 0.0
    own = bounds(longest_s=20.0, filter="augmented")
    assert own.free_m is None
    assert "the filter beside the victim's" in own.why
    with pytest.raises(ValueError, match="no zero-alarm bound for SnapshotChi2: it judges"):
        check_convex(make_detector(OWN))
