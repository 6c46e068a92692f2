"""What learned detectors observe, by name: bounds, names, and what must be true of the values."""

from __future__ import annotations

import json

import numpy as np
import pytest

from spoofgym.detectors import make_detector
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
from spoofgym.testing.epochs import engine_script

SEPARATION = {"name": "classic", "detector": {"name": "solution-separation"}}


@pytest.fixture(scope="module")
def script():
    return engine_script()


def observed(term, script, epochs=None):
    """(K, B, o) what an agent observes of a script by one term, and its names."""
    agent = DetectorAgent(terms=[term])
    agent.bind(script.context)
    seen = []
    for epoch in script.epochs[:epochs]:
        agent.look(epoch)
        seen.append(agent.memory["observation"].copy())
    return np.array(seen), agent.observer.names


@pytest.mark.parametrize("name", DETECTOR_TERMS)
def test_a_term_has_names_bounds_and_the_fields_that_it_names(name, script):
    spec = {"name": name} | ({"exclusion_s": 30.0} if name == "exclusion-left" else {})
    (term,) = make_detector_terms(spec)
    agent = DetectorAgent(terms=[term])
    agent.bind(script.context)
    observer = agent.observer
    assert len({*observer.names}) == len(observer.names) == len(observer.low)
    assert np.isfinite(observer.low).all()
    assert (observer.low < observer.high).all()
    read = set()
    for epoch in script.epochs:
        few = {key: array for key, array in epoch._asdict().items() if key in Epoch._fields[:7]}
        traced = TracedEpoch(**few, **{key: getattr(epoch, key) for key in term.needs})
        agent.look(traced)
        read |= traced.read_fields
        seen = agent.memory["observation"]
        assert (observer.low <= seen).all()
        assert (seen <= observer.high).all()
    assert read == term.needs
    assert np.ptp(seen) > 0.0 or name in ("elapsed", "exclusion-left", "in-view", "chi-square")


def test_terms_are_written_as_they_are_read():
    specs = ["innovation", {"name": "elapsed", "scale_s": 60.0}, SEPARATION, "line-of-sight"]
    terms = make_detector_terms(specs)
    lines = json.loads(json.dumps(written_terms(terms)))
    again = make_detector_terms(lines)
    assert again == terms
    assert lines[1] == {"name": "elapsed", "scale_s": 60.0}
    default = make_detector_terms(written_terms([*ALL_TERMS, ExclusionLeft(30.0)]))
    assert default == (*ALL_TERMS, ExclusionLeft(30.0)) == DetectorAgent().observed_terms


def test_lines_of_sight_are_unit_vectors_in_local_axes(script):
    seen, names = observed("line-of-sight", script)
    n = script.context.channels
    assert names[0] == "sight_north_slot00"
    assert names[-1] == f"sight_down_slot{n - 1:02d}"
    for k, epoch in enumerate(script.epochs):
        vectors = seen[k].reshape(-1, 3, n).transpose(0, 2, 1)
        length = np.linalg.norm(vectors, axis=2)
        np.testing.assert_allclose(length, epoch.visible, atol=1e-6)
        # satellites in view are above the horizon
        assert (vectors[epoch.visible][:, 2] < 0.0).all()
        # turned back into ECEF they are the rows of the design of an unwhitened range
        latitude, longitude, _ = ecef_to_geodetic(epoch.predicted_position)
        C_en = dcm_e_from_n(latitude, longitude)
        away = epoch.satellite_position - epoch.predicted_position[:, None]
        unit = away / np.linalg.norm(away, axis=2, keepdims=True)
        back = np.einsum("bij,bkj->bki", C_en, vectors)
        np.testing.assert_allclose(back[epoch.visible], unit[epoch.visible], atol=1e-6)


@pytest.mark.parametrize(
    "detector",
    [
        "snapshot-chi2",
        "solution-separation",
        "cusum",
        {"name": "ewma", "weight_scale": None, "smoothing": 0.3},
    ],
    ids=str,
)
def test_a_classic_is_its_detectors_statistic(detector, script):
    seen, names = observed({"name": "classic", "detector": detector}, script)
    judge = make_detector(detector)
    judge.bind(script.context)
    assert all(name.startswith("classic_") for name in names)
    assert len(names) == (script.context.channels if judge.scope == "channel" else 1)
    for k, epoch in enumerate(script.epochs):
        verdict = judge.judge(epoch)
        with np.errstate(divide="ignore"):
            wanted = np.log(verdict.statistic / verdict.threshold).clip(-5.0, 5.0)
        np.testing.assert_allclose(seen[k], wanted, rtol=1e-5, atol=1e-6)
    assert seen.std() > 0.0


def test_a_classic_remembers_by_itself(script):
    """Reset and moved by rows, as all that an agent remembers."""
    spec = {"name": "classic", "detector": "cusum", "label": "sum"}
    b = script.context.receivers
    agent, fresh = DetectorAgent(terms=[spec]), DetectorAgent(terms=[spec])
    for each in (agent, fresh):
        each.bind(script.context)
    for epoch in script.epochs[:8]:
        agent.look(epoch)
    mask = np.arange(b) == 1
    agent.reset(mask)
    agent.look(script.epochs[8])
    fresh.look(script.epochs[8])
    mine, theirs = agent.memory["observation"], fresh.memory["observation"]
    np.testing.assert_array_equal(mine[mask], theirs[mask])
    assert (mine[~mask] != theirs[~mask]).any()
    fresh.memory.copy_rows(np.arange(b), agent.memory, np.arange(b)[::-1])
    agent.look(script.epochs[9])
    backwards = Epoch(*(a if a is None else a[::-1].copy() for a in script.epochs[9]))
    fresh.look(backwards)
    np.testing.assert_array_equal(fresh.memory["observation"], agent.memory["observation"][::-1])


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("innovations", r"unknown detector term 'innovations'; valid: .*did you mean 'innovation'"),
        ({"name": "elapsed", "scale": 3.0}, r"no setting 'scale'; valid: scale_s"),
        ({"name": "classic", "detector": "ewna"}, "unknown detector 'ewna'"),
        ({"name": "classic", "detector": "pool"}, "neither a pool nor a learned one"),
        ({"name": "classic", "detector": "oracle-step"}, "must be no oracle, got 'oracle-step'"),
        (
            {"name": "classic", "detector": {"name": "ewma", "false_alarms_per_hour": 0.2}},
            "with its nominal thresholds",
        ),
        ([], "`terms` must name at least one of average-innovation, "),
        (["elapsed", "elapsed"], "`terms` observe the same twice: elapsed"),
        ({"name": "exclusion-left", "exclusion_s": 5.0}, r"must be that of the detector, 30\.0"),
    ],
    ids=str,
)
def test_what_is_no_term_is_refused(spec, message):
    with pytest.raises(ValueError, match=message):
        DetectorObserver(DetectorAgent(terms=spec).observed_terms, 12)


def test_a_classic_that_weighs_is_refused_at_its_first_epoch(script):
    with pytest.raises(ValueError, match=r"must be passive, and \{'name': 'ewma'\} takes weight"):
        observed({"name": "classic", "detector": "ewma"}, script, 1)
