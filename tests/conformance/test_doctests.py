"""The examples of docstrings run as they stand."""

import doctest
from pathlib import Path

import pytest

from tests.nightly import heavy

from . import sources

EXAMPLES = {m.__name__: m for m in sources.modules() if ">>> " in Path(m.__file__).read_text()}
SLOW = ("spoofgym.bench.experiments.audit", "spoofgym.limits.floor", "spoofgym.testing.ages")
"""Seconds each, of what other tests play."""


@pytest.mark.parametrize("name", heavy(EXAMPLES, *SLOW))
def test_examples(name):
    result = doctest.testmod(EXAMPLES[name])
    assert result.attempted > 0
    assert result.failed == 0
