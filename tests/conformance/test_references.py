"""Every source that is cited is a key of references.bib."""

from __future__ import annotations

import re

import pytest

from spoofgym.detectors import DETECTORS

from . import sources

KEYS = set(
    re.findall(r"^@\w+\{([^,\s]+),", (sources.CHECKOUT / "references.bib").read_text(), re.M)
)
CITED = re.compile(r"`([a-z]{2,}(?:19|20)\d\d[a-z]?)`")


def test_keys_are_unique():
    text = (sources.CHECKOUT / "references.bib").read_text()
    assert len(re.findall(r"^@\w+\{", text, re.M)) == len(KEYS) > 0


@pytest.mark.parametrize("name", DETECTORS)
def test_the_paper_of_every_detector_is_known(name):
    assert DETECTORS[name].paper in KEYS


@pytest.mark.parametrize("path", sources.files(), ids=sources.name_of)
def test_what_docstrings_cite_is_known(path):
    assert set(CITED.findall(path.read_text())) <= KEYS
