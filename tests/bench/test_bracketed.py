"""The bracket of every detector: floors, the blind optimum, the zero-alarm bound, and marks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from spoofgym.bench import run_campaign, summarize
from spoofgym.bench.report.campaign import (
    ATTACKS,
    DETECTORS,
    attack_rows,
    detector_rows,
    format_bound,
    groups,
    list_limit_notes,
    mark_detector,
    markdown,
)
from spoofgym.bench.report.figures import draw_campaign
from spoofgym.bench.scores.campaign import HALF, STEALTHY, compute_bounds

from .support import small_suite

EXCEEDED = "*Above the zero-alarm bound*: a mean that exceeds it"
POINT = {"detector": "one", "claimed": {"per_run": 0.01}, "footing": "0.2"}


def spread(value: float | None) -> dict[str, float | None]:
    return {"p_d": 0.5, "value": value, "low": value, "high": value}


def limits(**bound: Any) -> dict[str, Any]:
    """Floors 4 m and 1 m at 1 %, half of that at 5 %, and the bounds of a detector."""
    rates = [
        {"p_fa": p_fa, "floor_m": {"half": spread(4.0 * x), "stealthy": spread(1.0 * x)}}
        for p_fa, x in ((0.01, 1.0), (0.05, 0.5))
    ]
    floor = {**rates[0], "worlds": 4, "rates": rates, "assumptions": ["a flat earth"]}
    whole = {"free_m": None, "restricted_m": None, "kind": "", "why": "", **bound}
    return {"floor": floor, "zero_alarm": {"one": whole}}


def cell(spoofer: str, value: float, half: float = 0.1, **changes: Any) -> dict[str, Any]:
    return {
        "detector": "one",
        "spoofer": spoofer,
        "spoofer_settings": {"name": spoofer},
        "within_budget": True,
        "tuned_within_budget": True,
        "stealthy_displacement_m": {"value": value, "low": value - half, "high": value + half},
        **changes,
    }


def protection(value: float, high: float) -> dict[str, Any]:
    row = {"measure": "undetected_displacement_m", "share": 0.5, "worst_skies": False}
    return {"detector": "one", "exceeded": [{**row, "value": value, "low": value, "high": high}]}


def test_the_best_attack_within_the_budget_is_compared_with_its_floor() -> None:
    cells = [
        cell("none", 0.0),
        cell("ramp", 0.5),
        cell("over", 7.0, within_budget=False),
        cell("none-found", 7.0, tuned_within_budget=False),
    ]
    found = compute_bounds(POINT, limits(), cells, protection(3.0, 3.5), [])
    assert found["floor_m"] == {STEALTHY: 1.0, HALF: 4.0}
    assert found["best_attack"]["spoofer"] == "ramp"
    assert found["search_failed"] == [STEALTHY, HALF]
    # the whole interval has to lie below
    wide = [cell("ramp", 0.5, half=0.6)]
    found = compute_bounds(POINT, limits(), wide, protection(3.0, 4.5), [])
    assert found["search_failed"] == []


def test_nothing_within_the_budget_is_a_failed_search() -> None:
    nobody = [cell("ramp", 9.0, tuned_within_budget=False)]
    assert compute_bounds(POINT, limits(), nobody, None, [])["search_failed"] == [STEALTHY]
    # over the budget on these runs alone says nothing
    some = [*nobody, cell("step", 9.0, within_budget=False)]
    assert compute_bounds(POINT, limits(), some, None, [])["search_failed"] == []
    assert compute_bounds(POINT, limits(), [cell("none", 0.0)], None, [])["search_failed"] == []


def test_a_floor_is_of_the_detectors_own_rate() -> None:
    other = {**POINT, "claimed": {"per_run": 0.05}}
    assert compute_bounds(other, limits(), [], None, [])["floor_m"][HALF] == 2.0
    never = {**POINT, "claimed": None, "footing": "any"}
    assert compute_bounds(never, limits(), [], None, [])["floor_m"][HALF] == 4.0
    for point in (
        {**POINT, "claimed": None, "footing": "nominal"},
        {**POINT, "claimed": {"per_run": 0.02}},
    ):
        found = compute_bounds(point, limits(), [cell("ramp", 0.1)], protection(0.1, 0.1), [])
        assert found["floor_m"] == {STEALTHY: None, HALF: None}
        assert found["search_failed"] == []


def test_a_mean_above_the_zero_alarm_bound_is_marked() -> None:
    """By more than two standard errors: the half width of 0.98 m is two of 0.5 m."""
    cells = [cell("ramp", 10.9, half=0.98), cell("blind-optimum", 11.1, half=0.98)]
    found = compute_bounds(
        POINT, limits(free_m=30.0, restricted_m=10.0, kind="exact"), cells, None, []
    )
    assert found["zero_alarm"] == {
        "value": 10.0,
        "kind": "exact",
        "attacker": "restricted",
        "why": "",
    }
    assert [each["spoofer"] for each in found["above_zero_alarm"]] == ["blind-optimum"]
    # as far as the attack's limits allow, to first order
    all_the_way = [cell("ramp", 500.0, half=0.0)]
    bounds = limits(free_m="unbounded", restricted_m=499.8, kind="exact")
    assert compute_bounds(POINT, bounds, all_the_way, None, [])["above_zero_alarm"] == []
    free = compute_bounds(POINT, limits(free_m=30.0, kind="upper"), cells, None, [])
    assert free["zero_alarm"]["attacker"] == "free"
    assert free["above_zero_alarm"] == []
    assert format_bound(free) == "<= 30.0"
    unbounded = limits(free_m="unbounded", restricted_m="unbounded", kind="unbounded")
    found = compute_bounds(POINT, unbounded, cells, None, [])
    assert (format_bound(found), found["above_zero_alarm"]) == ("unbounded", [])
    none = compute_bounds(POINT, limits(why="its weights change the gains"), cells, None, [])
    assert format_bound(none) == "none"


def test_the_blind_optimum_is_that_of_the_search() -> None:
    searches = [
        {
            "spoofer": "blind-optimum",
            "found": {"by": "response replay", "played": {"curve": "linear"}},
        }
    ]
    found = compute_bounds(POINT, limits(), [cell("blind-optimum", 9.0)], None, searches)
    assert found["blind_optimum"]["value"] == 9.0
    assert found["blind_optimum"]["by"] == "response replay"
    assert found["blind_optimum"]["curve"] == "linear"
    assert compute_bounds(POINT, limits(), [cell("ramp", 9.0)], None, [])["blind_optimum"] is None


@pytest.fixture(scope="module")
def weak(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A campaign whose only attack is far too weak."""
    suite = small_suite(
        detectors=("never", "shewhart"), spoofers=({"name": "ramp", "rate_mps": 1e-4},)
    )
    folder = run_campaign(suite, tmp_path_factory.mktemp("weak") / "results", threads=1)
    return folder, summarize(folder)


def test_a_weak_attack_is_a_failed_search_in_a_real_campaign(weak: Any) -> None:
    folder, summary = weak
    never, shewhart = summary["detectors"]
    floor = summary["limits"]["floor"]["floor_m"]["stealthy"]["value"]
    assert never["bracket"]["floor_m"][STEALTHY] == floor
    assert never["bracket"]["best_attack"]["high"] < floor
    assert never["bracket"]["search_failed"] == [STEALTHY]
    assert mark_detector(summary, "never") == f"control; search failed: {STEALTHY}"
    # at nominal thresholds it has no floor, but a bound of its own
    assert shewhart["bracket"]["floor_m"][STEALTHY] is None
    assert (
        shewhart["bracket"]["zero_alarm"]["value"]
        == (summary["limits"]["zero_alarm"]["shewhart"]["restricted_m"])
    )
    text = markdown(folder, summary)
    assert "## The bracket" in text
    assert f"search failed: {STEALTHY}" in text
    for assumption in summary["limits"]["floor"]["assumptions"]:
        assert assumption in text
    (group,) = groups(summary)
    for row in DETECTORS.texts(detector_rows(summary, group)):
        assert len(row) == len(DETECTORS.titles)
    assert EXCEEDED not in text
    assert draw_campaign(folder, summary).stat().st_size > 10_000


def test_the_json_has_what_the_tables_have(weak: Any) -> None:
    _, summary = weak
    again = json.loads(json.dumps(summary, allow_nan=False))
    assert again == summary
    (group,) = groups(summary)
    rows = [DETECTORS.texts(detector_rows(each, group)) for each in (again, summary)]
    assert rows[0] == rows[1]


def test_a_mean_above_its_bound_is_explained_in_the_report(weak: Any) -> None:
    folder, summary = weak
    never, shewhart = summary["detectors"]
    attack = {"spoofer": "ramp(rate_mps=0.0001)", "value": 5.0, "low": 4.0, "high": 6.0}
    bracket = {**shewhart["bracket"], "above_zero_alarm": [attack]}
    changed = {**summary, "detectors": [never, {**shewhart, "bracket": bracket}]}
    assert EXCEEDED in markdown(folder, changed)
    (label,) = {each["spoofer"] for each in summary["cells"]} - {"none"}
    attack["spoofer"] = label
    (group,) = groups(changed)
    rows = {row[0]: row[5] for row in ATTACKS.texts(attack_rows(changed, group))}
    assert rows["shewhart"].endswith("above the zero-alarm bound")
    assert "above" not in rows["never"]


def test_a_victim_without_limits_says_why(tmp_path: Path) -> None:
    suite = small_suite(
        env="spoofgym/Snapshot-v0",
        detectors=("raim",),
        spoofers=({"name": "ramp", "rate_mps": 0.1},),
        timeline=None,
    )
    folder = run_campaign(suite, tmp_path / "results", threads=1)
    summary = summarize(folder)
    (notes,) = list_limit_notes(summary)
    assert notes.startswith("Floor: none, since no limit is known for ")
    (row,) = summary["detectors"]
    assert row["bracket"]["floor_m"] == {STEALTHY: None, HALF: None}
    assert "no limit is known for" in row["bracket"]["zero_alarm"]["why"]
    assert "- No zero-alarm bound of raim: no limit is known" in markdown(folder, summary)
