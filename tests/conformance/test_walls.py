"""Walls between packages that import-linter's layers leave open."""

from . import sources

AUDIT = "audit_worlds.py", "spoofgym.testing.detector"
"""An audit checks the contract of a foreign detector first."""


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
