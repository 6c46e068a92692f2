"""The page on limits: its code runs, its figures are those of the package, its list is complete."""

import re

import pytest

from spoofgym.detectors import DETECTORS, SolutionSeparation
from spoofgym.limits import deflection_for
from spoofgym.limits.no_alarm import check_convex

from .pages import play, text_of

PAGE, BOUNDS = "limits.md", "zero_alarm.md"
KINDS = {
    "weights": "its weights change",
    "exclusion": "it excludes",
    "chance": "comes by chance",
    "oracle": "it is given the attack",
    "pool": "another member",
}
"""What the package says of a detector without a bound, by the word of the page."""


def test_the_code_runs_in_its_order_and_gives_the_figures_of_the_page(monkeypatch):
    page = play(PAGE, monkeypatch)
    assert (round(page.half, 1), round(page.known, 1)) == (4.7, 1.3)
    bound = play(BOUNDS, monkeypatch).bound
    assert (round(bound.free_m), round(bound.restricted_m), bound.kind) == (722, 460, "exact")
    (size,) = page.found.sizes()
    row = re.search(r"\| `zhong2025` \| ([\d.]+) m \| ([\d.]+) m \|", text_of(PAGE))
    assert (float(row[1]), float(row[2])) == (round(size, 2), round(2.0 * size, 1))


@pytest.mark.parametrize("p_d", [1.0 - (1.0 - 0.00885) * 0.95, 0.5, 0.95, 0.999])
def test_the_deflections_are_right(p_d):
    d = deflection_for(0.00885, p_d, heading="unknown")
    assert f"d = {d:.2f}" in text_of(PAGE)


def kind_of(name):
    """Row of the table of bounds that a detector with its own settings belongs to, if any."""
    detector = DETECTORS[name]()
    if isinstance(detector, SolutionSeparation):
        return "upper"
    try:
        check_convex(detector)
    except ValueError as error:
        if "nothing is known" in str(error):
            return None
        (word,) = (word for word, said in KINDS.items() if said in str(error))
        return f"none: {word}"
    return "exact"


def test_every_detector_is_in_the_row_that_it_belongs_to():
    rows = re.findall(r"^\| (exact|upper|none: \w+) \| (.*?) \|", text_of(BOUNDS), re.MULTILINE)
    said = {name: kind for kind, names in rows for name in re.findall(r"`([\w-]+)`", names)}
    kinds = {name: kind_of(name) for name in DETECTORS}
    assert said == {name: kind for name, kind in kinds.items() if kind is not None}, (
        "docs/zero_alarm.md"
    )
