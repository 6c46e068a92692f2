"""The page on learned spoofers tells what its stored campaign found, and what is shipped."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from spoofgym.spoofers import card_of, shipped

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "learned_spoofers.md").read_text()
README = (ROOT / "README.md").read_text()
STORED = json.loads((ROOT / "docs" / "learned_spoofers.json").read_text())
ROWS = [
    [cell.strip().strip("`") for cell in line.strip("|").split("|")]
    for line in PAGE.splitlines()
    if re.match(r"\| `(ewma|snapshot-chi2)` \| `", line)
]


def interval(estimate: dict[str, float], scale: float = 1.0, digits: int = 1) -> str:
    value, low, high = (f"{scale * estimate[key]:.{digits}f}" for key in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: "-".join(row[:2]))
def test_a_row_is_what_the_campaign_found(row):
    detector, spoofer, displacement, alarms, excess, over_ramp, over_profile = row
    (cell,) = [c for c in STORED["cells"] if (c["detector"], c["spoofer"]) == (detector, spoofer)]
    assert displacement == interval(cell["undetected_displacement_m"])
    assert alarms == f"{100 * cell['alarm_rate']['value']:.1f}"
    assert excess == interval(cell["alarm_excess"], 100.0)
    assert cell["within_budget"]
    (group,) = [g for g in STORED["rivals"] if g["detector"] == detector]
    found = {r["spoofer"]: r for r in group["comparisons"]}.get(spoofer)
    for text, key in ((over_ramp, "over_ramp"), (over_profile, "over_profile")):
        told = found and found[key]
        assert text == (interval(told["ratio"], digits=3) if told else "-")


def test_the_page_keeps_what_it_promises():
    """At least 95 % of the profile, and 10 % over the ramp against `ewma`."""
    learned = {name for name in shipped() if card_of(name).kind == "onnx-policy"}
    assert learned == {"ewma-blind", "ewma-tracking", "snapshot-chi2-blind"}
    for group in STORED["rivals"]:
        for row in group["comparisons"]:
            if row["spoofer"] in learned and row["spoofer"].startswith(group["detector"]):
                assert row["over_profile"]["ratio"]["value"] >= 0.95
                if group["detector"] == "ewma":
                    assert row["over_ramp"]["ratio"]["low"] >= 1.10


@pytest.mark.parametrize("name", shipped())
def test_every_shipped_spoofer_stands_on_the_page_and_in_the_readme(name):
    assert f"`{name}`" in PAGE
    assert f"| `{name}` |" in README


def test_every_link_to_a_file_leads_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)\)", PAGE):
        assert (ROOT / "docs" / target).exists(), target
