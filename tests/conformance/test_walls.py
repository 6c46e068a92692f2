"""Walls between packages that import-linter's layers leave open."""

import pytest

from . import sources


@pytest.mark.parametrize("source", sources.files(), ids=sources.name_of)
def test_nothing_of_the_library_needs_its_own_checks(source):
    """`spoofgym.testing` is for users and tests: it may import, but is not imported."""
    if source.relative_to(sources.ROOT).parts[0] == "testing":
        return
    for module, names in sources.imported(sources.tree_of(source), source):
        assert module.split(".")[:2] != ["spoofgym", "testing"]
        assert module != "spoofgym" or "testing" not in names
