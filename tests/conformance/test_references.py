"""Every source that is cited is a key of references.bib."""

import re

from spoofgym.detectors import DETECTORS

from . import sources

KEYS = set(
    re.findall(r"^@\w+\{([^,\s]+),", (sources.CHECKOUT / "references.bib").read_text(), re.M)
)
CITED = re.compile(r"`([a-z]{2,}(?:19|20)\d\d[a-z]?)`")


def test_keys_are_unique():
    text = (sources.CHECKOUT / "references.bib").read_text()
    assert len(re.findall(r"^@\w+\{", text, re.M)) == len(KEYS) > 0


def test_what_detectors_and_docstrings_cite_is_known():
    assert {kind.paper for kind in DETECTORS.values()} <= KEYS
    cited = {key for path in sources.files() for key in CITED.findall(path.read_text())}
    assert cited - KEYS == set()
    assert len(cited) > 20
