"""What learned detectors observe, by name: bounds, names, and what must be true of the values."""

import json

import numpy as np
import pytest

from spoofgym.bench.runs.world import World
from spoofgym.detectors import make_detector
from spoofgym.detectors._own_filter_kernels import whiten_shifts
from spoofgym.detectors.learned import DetectorAgent
from spoofgym.detectors.observation import (
    ALL_TERMS,
    DETECTOR_TERMS,
    DetectorObserver,
    ExclusionLeft,
    make_detector_terms,
    written_terms,
)
from spoofgym.earth.wgs84 import dcm_e_from_n, ecef_to_geodetic
from spoofgym.receiver.epoch import Epoch, TracedEpoch
from spoofgym.simulation.monitors import PassiveDetectors
from spoofgym.testing.epochs import engine_script

SETTINGS = {
    "exclusion-left": {"exclusion_s": 30.0},
    "filter-shift": {"detector": {"name": "solution-separation"}},  # the script has no model
}
RUNS = 3


@pytest.fixture(scope="module")
def script():
    return engine_script()


@pytest.fixture(scope="module")
def bound(script):
    def make(term):
        agent = DetectorAgent(terms=[term])
        agent.bind(script.context)
        return agent

    return make


def look(agent, epoch):
    agent.look(epoch)
    return agent.memory["observation"].copy()


@pytest.mark.parametrize("name", DETECTOR_TERMS)
def test_a_term_has_names_bounds_and_the_fields_that_it_names(name, script, bound):
    spec = {"name": name} | SETTINGS.get(name, {})
    (term,) = make_detector_terms(spec)
    agent = bound(term)
    observer = agent.observer
    assert len({*observer.names}) == len(observer.names) == len(observer.low)
    assert np.isfinite(observer.low).all()
    assert (observer.low < observer.high).all()
    read = set()
    for epoch in script.epochs:
        few = {key: array for key, array in epoch._asdict().items() if key in Epoch._fields[:7]}
        traced = TracedEpoch(**few, **{key: getattr(epoch, key) for key in term.needs})
        seen = look(agent, traced)
        read |= traced.read_fields
        assert (observer.low <= seen).all()
        assert (seen <= observer.high).all()
    assert read == term.needs
    assert np.ptp(seen) > 0.0 or name in ("elapsed", "exclusion-left", "in-view", "chi-square")


def test_terms_are_written_as_they_are_read():
    elapsed = {"name": "elapsed", "scale_s": 60.0}
    separation = {"name": "classic", "detector": {"name": "solution-separation"}}
    terms = make_detector_terms(["innovation", elapsed, separation, "line-of-sight"])
    lines = json.loads(json.dumps(written_terms(terms)))
    assert make_detector_terms(lines) == terms
    assert lines[1] == elapsed
    default = make_detector_terms(written_terms([*ALL_TERMS, ExclusionLeft(30.0)]))
    assert default == (*ALL_TERMS, ExclusionLeft(30.0)) == DetectorAgent().observed_terms


def test_lines_of_sight_are_unit_vectors_in_local_axes(script, bound):
    agent, n = bound("line-of-sight"), script.context.channels
    names = agent.observer.names
    assert (names[0], names[-1]) == ("sight_north_slot00", f"sight_down_slot{n - 1:02d}")
    for epoch in script.epochs:
        vectors = look(agent, epoch).reshape(-1, 3, n).transpose(0, 2, 1)
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=2), epoch.visible, atol=1e-6)
        # satellites in view are above the horizon
        assert (vectors[epoch.visible][:, 2] < 0.0).all()
        # turned back into ECEF they lead to the satellites
        latitude, longitude, _ = ecef_to_geodetic(epoch.predicted_position)
        away = epoch.satellite_position - epoch.predicted_position[:, None]
        unit = away / np.linalg.norm(away, axis=2, keepdims=True)
        back = np.einsum("bij,bkj->bki", dcm_e_from_n(latitude, longitude), vectors)
        np.testing.assert_allclose(back[epoch.visible], unit[epoch.visible], atol=1e-6)


@pytest.mark.parametrize(
    "detector",
    ["solution-separation", "cusum", {"name": "ewma", "weight_scale": None, "smoothing": 0.3}],
    ids=str,
)
def test_a_classic_is_its_detectors_statistic(detector, script, bound):
    agent, judge = bound({"name": "classic", "detector": detector}), make_detector(detector)
    judge.bind(script.context)
    names, seen = agent.observer.names, []
    assert all(name.startswith("classic_") for name in names)
    assert len(names) == (script.context.channels if judge.scope == "channel" else 1)
    for epoch in script.epochs:
        verdict = judge.judge(epoch)
        with np.errstate(divide="ignore"):
            wanted = np.log(verdict.statistic / verdict.threshold).clip(-5.0, 5.0)
        seen.append(look(agent, epoch))
        np.testing.assert_allclose(seen[-1], wanted, rtol=1e-5, atol=1e-6)
    assert np.std(seen) > 0.0


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"name": "classic", "detector": "pool"}, "neither a pool nor a learned one"),
        ({"name": "classic", "detector": "oracle-step"}, "must be no oracle, got 'oracle-step'"),
        ({"name": "classic", "detector": {"name": "ewma", "threshold_scale": 2.0}}, "its nominal"),
        ({"name": "filter-shift", "detector": "ewma"}, "must be solution-separation, got"),
        ([], "`terms` must name at least one of average-innovation, "),
        (["elapsed", "elapsed"], "`terms` observe the same twice: elapsed"),
        ({"name": "exclusion-left", "exclusion_s": 5.0}, r"must be that of the detector, 30\.0"),
    ],
    ids=str,
)
def test_what_is_no_term_is_refused(spec, message):
    with pytest.raises(ValueError, match=message):
        DetectorObserver(DetectorAgent(terms=spec).observed_terms, 12)


def test_a_shift_is_white_and_blind_to_height_and_clock_by_algebra():
    rng, n = np.random.default_rng(5), 9
    design, root = rng.standard_normal((2, 2 * n, 17)), rng.standard_normal((2, 2 * n, 2 * n))
    S = root @ root.transpose(0, 2, 1) + np.eye(2 * n)
    place = np.array([[4.0e6, 1.0e6, 4.8e6], [-2.5e6, 5.0e6, -3.0e6]])
    C_en = dcm_e_from_n(*ecef_to_geodetic(place)[:2])

    def respond(columns):
        """(2, 4, k) shifts of innovations that are the columns (2, m, k)."""
        found = np.empty((2, 4, columns.shape[2]))
        for k in range(columns.shape[2]):
            z = np.ascontiguousarray(columns[:, :, k])
            whiten_shifts(design, z, S, seen, place, 4, each)
            found[:, :, k] = each
        return found

    each, seen = np.empty((2, 4)), np.ones((2, n), dtype=np.bool_)
    W = respond(np.broadcast_to(np.eye(2 * n), S.shape))
    np.testing.assert_allclose(W @ S @ W.transpose(0, 2, 1), [np.eye(4)] * 2, atol=1e-9)
    velocity, position = design[:, :, 3:6] @ C_en, design[:, :, 6:9] @ C_en
    np.testing.assert_allclose(respond(design[:, :, 15:17]), 0.0, atol=1e-9)
    for axes in (velocity, position):
        np.testing.assert_allclose(respond(axes[:, :, 2:]), 0.0, atol=1e-9)
    # what tells of the position knows nothing of the velocity
    moved, shifted = respond(velocity[:, :, :2]), respond(position[:, :, :2])
    np.testing.assert_allclose(moved[:, 2:], 0.0, atol=1e-9)
    # a root of the information is symmetric, so that the heading of a shift is kept
    for found in (moved[:, :2], shifted[:, 2:]):
        np.testing.assert_allclose(found, found.transpose(0, 2, 1), atol=1e-9)
        assert (np.linalg.eigvalsh(found) > 0.0).all()
    seen[0, 3:] = False
    whiten_shifts(design, np.ones((2, 2 * n)), S, seen, place, 4, each)
    assert (each == 0.0).all(axis=1).tolist() == [True, False]


def test_a_filter_of_its_own_sees_the_filter_only_warm_up():
    """Or it would begin at the switch-on of the detector, with what is believed at the victim's."""
    reference = {"name": "solution-separation", "filter": "augmented", "spacing": "geometric"}
    terms = [{"name": "classic", "detector": reference, "label": "own"}, "filter-shift"]
    agent, judge = DetectorAgent(weighs=False, terms=terms), make_detector(reference)
    assert (agent.from_start, agent.needs_model) == (True, True)
    times = {"warmup_s": 12.0, "live_s": 4.0, "attack_s": 4.0, "time_to_alert_s": 1.0}
    world = World.of(scenario="trolley", receiver="matched", timeline=times).setup
    world = world.copy_with(detector=judge, monitors=[PassiveDetectors([agent])])
    simulator = world.simulator(RUNS, lambda work, n: work(0, n))
    simulator.switch_on([np.random.default_rng(seed) for seed in range(RUNS)])
    (observer,) = simulator.monitor(PassiveDetectors).detectors
    for _ in range(world.live):
        verdict = simulator.step(attacked=False)
        seen = observer.memory["observation"]
        with np.errstate(divide="ignore"):
            wanted = np.log(verdict.statistic[:, 0] / verdict.threshold[:, 0]).clip(-5.0)
        np.testing.assert_allclose(seen[:, 0], wanted, rtol=1e-5, atol=1e-5)
        np.testing.assert_array_equal(seen[:, 0], seen[:, 1])
        assert (np.abs(seen[:, 2:]) < 6.0).all()
    assert np.ptp(seen[:, 2:]) > 0.0


def test_a_classic_that_weighs_is_refused_at_its_first_epoch(script, bound):
    with pytest.raises(ValueError, match=r"must be passive, and \{'name': 'ewma'\} takes weight"):
        bound({"name": "classic", "detector": "ewma"}).look(script.epochs[0])
