"""Sources that are cited, and walls between packages that import-linter's layers leave open."""

import re

from spoofgym.detectors import DETECTORS

from . import sources

KEYS = re.findall(r"^@\w+\{([^,\s]+),", (sources.CHECKOUT / "references.bib").read_text(), re.M)
CITED = re.compile(r"`([a-z]{2,}(?:19|20)\d\d[a-z]?)`")
AUDIT = "audit_worlds.py", "spoofgym.testing.detector"
"""An audit checks the contract of a foreign detector first."""


def test_what_detectors_and_docstrings_cite_is_known_by_keys_that_are_unique():
    assert len({*KEYS}) == len(KEYS) > 0
    cited = {key for path in sources.files() for key in CITED.findall(path.read_text())}
    assert cited | {kind.paper for kind in DETECTORS.values()} <= {*KEYS}
    assert len(cited) > 20


def test_nothing_of_the_library_needs_its_own_checks():
    """`spoofgym.testing` is for users and tests: it may import, but is not imported."""
    for path in sources.files():
        if path.relative_to(sources.ROOT).parts[0] == "testing":
            continue
        for module, names in sources.imports_of(path):
            if (path.name, module) == AUDIT:
                continue
            assert module.split(".")[:2] != ["spoofgym", "testing"], path
            assert module != "spoofgym" or "testing" not in names, path
