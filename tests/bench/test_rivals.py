"""Spoofers compared on equal footing, from cells made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spoofgym.bench.cells import Cell
from spoofgym.bench.metrics import resamples
from spoofgym.bench.rivals import bootstrap_ratio, compare_rivals, footing
from spoofgym.bench.tables import reference_lines

RUNS = 40
SAMPLES = resamples(RUNS, np.random.default_rng(1))
BASE = np.random.default_rng(2).uniform(5.0, 30.0, RUNS)


def cell(
    label: str,
    displacement: Any,
    alarmed: int,
    *,
    kind: str = "",
    tuned: bool | None = None,
    made_for: str | None = None,
    transfer: tuple[str, ...] = (),
) -> Cell:
    """A cell whose first runs alarm."""
    head = {
        "knowledge": {"detector": made_for, "transfer": list(transfer)},
        "detector": "ewma",
        "spoofer": label,
        "spoofer_settings": {"name": kind or label},
        "tuned_within_budget": tuned,
    }
    records = {
        "first_alarm": (np.arange(RUNS) < alarmed).astype(int),
        "undetected_displacement_m": np.broadcast_to(displacement, RUNS).astype(float),
    }
    return Cell(head, records, {})


CLEAN = cell("none", 0.0, 4)


def compared(*cells: Cell, budget: float = 0.05) -> dict[str, Any]:
    (group,) = compare_rivals((CLEAN, *cells), budget, SAMPLES)
    return group


@pytest.mark.parametrize(("alarmed", "within"), [(4, True), (6, True), (7, False), (0, True)])
def test_the_budget_is_an_excess_over_the_clean_rate(alarmed: int, within: bool) -> None:
    found = footing(cell("ramp", BASE, alarmed), CLEAN, 0.05, SAMPLES)
    assert found["within_budget"] is within
    assert found["alarm_rate"]["value"] == alarmed / RUNS
    excess = found["alarm_excess"]
    assert excess["value"] == pytest.approx((alarmed - 4) / RUNS)
    assert excess["low"] <= excess["value"] <= excess["high"]


def test_the_excess_is_paired_run_by_run() -> None:
    same = footing(cell("ramp", BASE, 4), CLEAN, 0.0, SAMPLES)
    assert same["alarm_excess"] == {"value": 0.0, "low": 0.0, "high": 0.0}


def test_nothing_is_known_of_the_budget_before_the_clean_runs() -> None:
    found = footing(cell("ramp", BASE, 4), None, 0.05, SAMPLES)
    assert (found["within_budget"], found["alarm_excess"]) == (None, None)


def test_ratio_and_difference_are_paired_run_by_run() -> None:
    ramp = cell("ramp(tuned)", BASE, 5, kind="ramp", tuned=True)
    profile = cell("curve", BASE - 2.0, 5, kind="profile")
    learned = cell("learned", 2.0 * BASE, 5, kind="onnx-policy")
    shifted = cell("shifted", BASE + 3.0, 5, kind="mine:Own")
    group = compared(ramp, profile, learned, shifted)
    assert group["best_ramp"]["spoofer"] == "ramp(tuned)"
    rows = {row["spoofer"]: row for row in group["comparisons"]}
    assert list(rows) == ["curve", "learned", "shifted"]
    # by unpaired resamples neither interval would be a point
    assert rows["learned"]["over_ramp"]["ratio"] == {"value": 2.0, "low": 2.0, "high": 2.0}
    assert rows["shifted"]["over_ramp"]["difference_m"] == {"value": 3.0, "low": 3.0, "high": 3.0}
    assert rows["shifted"]["over_profile"]["difference_m"]["value"] == 5.0
    assert rows["curve"]["over_profile"] is None


def test_the_better_of_the_ramps_that_were_tuned_within_the_budget_is_the_reference() -> None:
    slow = cell("ramp(tuned)", BASE, 5, kind="ramp", tuned=True)
    # over the budget here, but not when it was tuned: it stays, which favours the ramps
    fast = cell("accelerating", BASE + 1.0, 9, kind="accelerating-ramp", tuned=True)
    failed = cell("failed", BASE + 5.0, 5, kind="ramp", tuned=False)
    by_hand = cell("by hand", BASE + 9.0, 5, kind="ramp")
    learned = cell("learned", BASE, 5, kind="onnx-policy")
    group = compared(slow, fast, failed, by_hand, learned)
    assert group["best_ramp"]["spoofer"] == "accelerating"
    assert group["best_ramp"]["within_budget"] is False
    assert group["best_ramp"]["undetected_displacement_m"]["value"] == pytest.approx(
        BASE.mean() + 1.0
    )
    assert [row["spoofer"] for row in group["comparisons"]] == ["learned"]


def test_a_profile_that_was_made_for_the_detector_stays_the_reference() -> None:
    # over the budget here, but not where it was chosen
    own = cell("own", BASE, 7, kind="profile", made_for="ewma")
    slower = cell("slower", BASE - 1.0, 5, kind="profile", made_for="ewma")
    foreign = cell(
        "foreign", BASE - 4.0, 5, kind="profile", made_for="chi2", transfer=("detector",)
    )
    farther = cell("farther", BASE + 9.0, 5, kind="profile", made_for="ewma", transfer=("attack",))
    by_hand = cell("by hand", BASE + 9.0, 5, kind="profile")
    best = compared(own, slower, foreign, farther, by_hand)["best_profile"]
    assert (best["spoofer"], best["made_for_it"], best["within_budget"]) == ("own", True, False)
    # only without any such profile another one takes its place
    best = compared(foreign)["best_profile"]
    assert (best["spoofer"], best["made_for_it"]) == ("foreign", False)
    lines = reference_lines({"rivals": [compared(own), compared(foreign)]})
    assert lines[1].startswith("Best profile against ewma: own, ")
    assert "not made for it" not in lines[1]
    assert lines[1].endswith(", over budget.")
    assert "foreign, not made for it, " in lines[3]


def test_another_profile_over_the_budget_is_no_reference() -> None:
    bold = cell("bold", BASE + 9.0, 30, kind="profile")
    shy = cell("shy", BASE, 5, kind="profile")
    assert compared(bold, shy)["best_profile"]["spoofer"] == "shy"
    alone = compared(bold)
    assert (alone["best_profile"], alone["best_ramp"]) == (None, None)
    assert alone["comparisons"][0]["within_budget"] is False
    assert alone["comparisons"][0]["over_ramp"] is None


def test_scripted_spoofers_alone_have_nothing_to_be_compared() -> None:
    ramp = cell("ramp(tuned)", BASE, 5, kind="ramp", tuned=True)
    assert compare_rivals((CLEAN, ramp), 0.05, SAMPLES) == []
    learned = cell("learned", BASE, 5, kind="onnx-policy")
    assert compare_rivals((ramp, learned), 0.05, SAMPLES) == []  # no clean runs yet


def test_a_ratio_to_nothing_is_unknown() -> None:
    assert np.isnan(bootstrap_ratio(BASE, np.zeros(RUNS), SAMPLES)).all()
    rare = np.where(np.arange(RUNS) == 0, 1.0, 0.0)  # not in every resample
    assert bootstrap_ratio(rare, rare, SAMPLES) == (1.0, 1.0, 1.0)
