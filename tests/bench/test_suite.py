"""What a campaign runs, and where its chance comes from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.players import DEFAULT_DETECTORS
from spoofgym.bench.search.amplitude import Tuning
from spoofgym.bench.search.attack_suite import Selection
from spoofgym.core.settings import compute_digest
from spoofgym.detectors import DETECTORS
from spoofgym.simulation.setup import SPLITS, seed_sequences

from .support import small_suite


def words(seed: np.random.SeedSequence) -> tuple[int, ...]:
    return tuple(int(word) for word in seed.generate_state(4))


def test_runs_share_no_noise_between_splits_scenarios_runs_and_campaigns() -> None:
    found = {
        words(seed)
        for entropy in (0, 1)
        for split in SPLITS
        for scenario in ("zhong2025", "groves")
        for seed in seed_sequences(entropy, split, scenario, 5)
    }
    assert len(found) == 2 * len(SPLITS) * 2 * 5


def test_spoofers_that_ignore_a_target_that_is_drawn_are_warned_of() -> None:
    drawn = {"target_heading_deg": "random", "detectors": ("never",)}
    with pytest.warns(UserWarning, match=r"push Ramp \(heading_deg=90\), Step \(heading_deg=90\);"):
        small_suite(spoofers=("ramp", "step"), **drawn).check_fit()
    small_suite(spoofers=({"name": "step", "heading_deg": "target"},), **drawn).check_fit()


def test_more_runs_begin_with_the_same_ones() -> None:
    few = [words(seed) for seed in seed_sequences(3, "evaluation", "zhong2025", 4)]
    many = [words(seed) for seed in seed_sequences(3, "evaluation", "zhong2025", 9)]
    assert many[:4] == few


def test_the_digest_follows_everything_that_results_depend_on() -> None:
    digests = [
        small_suite(**changes).digest
        for changes in (
            {},
            {"runs": 6},
            {"entropy": 1},
            {"scenario": "groves"},
            {"receiver": {"tuning": "matched"}},
            {"attack": {"name": "false-position", "coherent": False}},
            {"detectors": ("ewma",)},
            {"spoofers": ("step",)},
            {"tuning": Tuning(budget=0.1)},
            {"selection": Selection(runs=7)},
        )
    ]
    assert len(set(digests)) == len(digests)
    assert small_suite().digest == digests[0]
    # a default that is written out changes nothing
    written_out = small_suite(detectors=("snapshot-chi2", {"name": "ewma", "smoothing": 0.1}))
    assert compute_digest(written_out.config) == digests[0]
    assert small_suite(entropy=np.int64(1)).digest == digests[2]
    assert small_suite(runs=np.int64(6)).digest == digests[1]
    assert small_suite(tuning=Tuning(budget=0.1, runs=np.int64(Tuning.runs))).digest == digests[8]


def test_the_rate_of_the_inertial_sensors_is_named_in_results() -> None:
    own, keyword = small_suite(), small_suite(settings={"imu_rate_hz": 20})
    mapping = small_suite(scenario={"name": "zhong2025", "imu_rate_hz": 20})
    assert "imu_rate_hz" not in own.config["scenario"]
    assert keyword.config["scenario"]["imu_rate_hz"] == 20
    assert keyword.config["scenario"]["name"] == "zhong2025@20Hz"
    assert keyword.digest == mapping.digest != own.digest


def test_the_clean_twin_is_always_played_first() -> None:
    suite = small_suite(spoofers=("step", "none"))
    assert [entry.label for entry in suite.spoofer_players] == ["none", "step"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"detectors": ()}, "at least one detector"),
        ({"detectors": ("ewma", "ewma")}, "listed twice: ewma"),
        ({"detectors": ("emwa",)}, "unknown detector 'emwa'; valid: .*did you mean 'ewma'"),
        ({"spoofers": ("rmap",)}, "unknown spoofer 'rmap'"),
    ],
)
def test_bad_suites_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Suite(**changes)


def test_a_search_needs_runs_that_can_show_its_budget() -> None:
    with pytest.raises(ValueError, match=r"`runs` must be at least 59 for a budget of 0.05: .* 58"):
        Tuning(runs=58)


def test_oracles_are_refused_unless_they_are_asked_for() -> None:
    assert not any(DETECTORS[spec["name"]].oracle for spec in DEFAULT_DETECTORS)
    oracles = ("ewma", {"name": "oracle-ramp", "rate_mps": 0.2})
    with pytest.raises(ValueError, match=r"oracle-ramp\(rate_mps=0.2\): an oracle knows the"):
        Suite(detectors=oracles)
    suite = Suite(detectors=oracles, allow_oracles=True)
    (note,) = suite._oracle_notes
    assert note == "oracle-ramp(rate_mps=0.2) is an oracle: it knows the attack"
    assert note in suite.config["notes"]
    assert (
        Suite(detectors=("ewma",), allow_oracles=True).digest == Suite(detectors=("ewma",)).digest
    )
