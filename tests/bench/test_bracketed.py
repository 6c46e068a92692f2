"""The bracket of every detector: floors, the open-loop attack, the zero-alarm bound, and marks."""

import json

import pytest

from spoofgym.bench import run_campaign, summarize
from spoofgym.bench.report import campaign as report
from spoofgym.bench.report.campaign_page import build_page
from spoofgym.bench.report.page import render_page
from spoofgym.bench.scores.campaign import HALF, STEALTHY, compute_bounds

from .support import small_suite

POINT = {"detector": "one", "claimed": {"per_run": 0.01}, "footing": "0.2"}


def limits(**bound):
    """Floors 4 m and 1 m at 1 %, half of that at 5 %, and the bounds of a detector."""
    rates = [
        {"p_fa": p_fa, "floor_m": {"half": {"value": 4.0 * x}, "stealthy": {"value": 1.0 * x}}}
        for p_fa, x in ((0.01, 1.0), (0.05, 0.5))
    ]
    whole = {"free_m": None, "restricted_m": None, "kind": "", "why": "", **bound}
    return {"floor": {**rates[0], "rates": rates}, "zero_alarm": {"one": whole}}


def cell(spoofer, value, half=0.1, **changes):
    return {
        "detector": "one",
        "spoofer": spoofer,
        "spoofer_settings": {"name": spoofer},
        "within_budget": True,
        "tuned_within_budget": True,
        "stealthy_displacement_m": {"value": value, "low": value - half, "high": value + half},
        **changes,
    }


def bounds(*cells, point=POINT, high=None, searches=(), **bound):
    """Bracket by some cells; `high` end of the protection's interval."""
    row = {"measure": "undetected_displacement_m", "share": 0.5, "worst_skies": False}
    protection = None if high is None else {"exceeded": [{**row, "high": high}]}
    return compute_bounds(point, limits(**bound), cells, protection, searches)


def test_the_best_attack_is_compared_with_its_floor_and_the_open_loop_is_that_of_the_search():
    found = bounds(
        cell("none", 0.0),
        cell("ramp", 0.5),
        cell("over", 7.0, within_budget=False),
        cell("none-found", 7.0, tuned_within_budget=False),
        high=3.5,
    )
    assert found["floor_m"] == {STEALTHY: 1.0, HALF: 4.0}
    assert (found["best_attack"]["spoofer"], found["search_failed"]) == ("ramp", [STEALTHY, HALF])
    # the whole interval has to lie below
    assert bounds(cell("ramp", 0.5, half=0.6), high=4.5)["search_failed"] == []
    # nothing within the budget is a failed search; over it on these runs alone says nothing
    nobody = cell("ramp", 9.0, tuned_within_budget=False)
    assert bounds(nobody)["search_failed"] == [STEALTHY]
    assert bounds(nobody, cell("step", 9.0, within_budget=False))["search_failed"] == []
    assert bounds(cell("none", 0.0))["search_failed"] == []
    search = {"by": "response replay", "unbeaten_start": "ramp"}
    searches = [{"spoofer": "open-loop", "found": search}]
    found = bounds(cell("open-loop", 9.0), searches=searches)["open_loop"]
    assert found.items() >= {"value": 9.0, **search}.items()
    assert bounds(cell("ramp", 9.0))["open_loop"] is None


@pytest.mark.parametrize(
    ("changes", "floors"),
    [
        ({"claimed": {"per_run": 0.05}}, {STEALTHY: 0.5, HALF: 2.0}),
        ({"claimed": None, "footing": "any"}, {STEALTHY: 1.0, HALF: 4.0}),
        ({"claimed": None, "footing": "nominal"}, {STEALTHY: None, HALF: None}),
        ({"claimed": {"per_run": 0.02}}, {STEALTHY: None, HALF: None}),
    ],
)
def test_a_floor_is_of_the_detectors_own_rate(changes, floors):
    found = bounds(cell("ramp", 0.1), point={**POINT, **changes}, high=0.1)
    assert found["floor_m"] == floors
    assert found["search_failed"] == [score for score, floor in floors.items() if floor]


def test_a_mean_above_the_zero_alarm_bound_is_marked():
    cells = [cell("ramp", 10.9, half=0.98), cell("open-loop", 11.1, half=0.98)]
    found = bounds(*cells, free_m=30.0, restricted_m=10.0, kind="exact")
    zero_alarm = {"value": 10.0, "kind": "exact", "attacker": "restricted", "why": ""}
    assert found["zero_alarm"] == zero_alarm
    assert [each["spoofer"] for each in found["above_zero_alarm"]] == ["open-loop"]
    # as far as the attack's limits allow, to first order
    far = cell("ramp", 500.0, half=0.0)
    found = bounds(far, free_m="unbounded", restricted_m=499.8, kind="exact")
    assert found["above_zero_alarm"] == []
    free = bounds(*cells, free_m=30.0, kind="upper")
    assert free["zero_alarm"]["attacker"] == "free"
    unbounded = bounds(*cells, free_m="unbounded", restricted_m="unbounded", kind="unbounded")
    none = bounds(*cells, why="its weights change the gains")
    for each, text in ((free, "<= 30.0"), (unbounded, "unbounded"), (none, "none")):
        assert (report.format_bound(each), each["above_zero_alarm"]) == (text, [])


def test_a_weak_attack_is_a_failed_search_and_one_too_strong_is_explained(tmp_path):
    suite = small_suite(
        detectors=("never", "shewhart"), spoofers=({"name": "ramp", "rate_mps": 1e-4},)
    )
    folder = run_campaign(suite, tmp_path, threads=1)
    summary = summarize(folder)
    never, shewhart = summary["detectors"]
    found, floor = never["bracket"], summary["limits"]["floor"]
    assert found["floor_m"][STEALTHY] == floor["floor_m"]["stealthy"]["value"]
    assert found["best_attack"]["high"] < found["floor_m"][STEALTHY]
    assert found["search_failed"] == [STEALTHY]
    assert report.mark_detector(summary, "never") == f"control; search failed: {STEALTHY}"
    # at nominal thresholds it has no floor, but a bound of its own
    found, bound = shewhart["bracket"], summary["limits"]["zero_alarm"]["shewhart"]
    assert found["floor_m"][STEALTHY] is None
    assert found["zero_alarm"]["value"] == bound["restricted_m"]
    text = render_page(build_page(folder, summary))
    for part in (f"search failed: {STEALTHY}", *floor["assumptions"]):
        assert part in text
    above = ", above the zero-alarm bound"
    assert above not in text
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    # as if it got farther than the bound
    (label,) = {each["spoofer"] for each in summary["cells"]} - {"none"}
    found["above_zero_alarm"] = [{"spoofer": label, "value": 5.0, "low": 4.0, "high": 6.0}]
    assert above in render_page(build_page(folder, summary))
    (group,) = report.groups(summary)
    rows = {row[0]: row[5] for row in report.ATTACKS.texts(report.attack_rows(summary, group))}
    assert rows["shewhart"].endswith("above the zero-alarm bound")
    assert "above" not in rows["never"]
