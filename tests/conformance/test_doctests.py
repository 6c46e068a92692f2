"""The examples of docstrings run as they stand."""

import doctest
from pathlib import Path

import pytest

from . import sources

WITH_EXAMPLES = [
    pytest.param(module, id=module.__name__)
    for module in sources.modules()
    if ">>> " in Path(module.__file__).read_text()
]


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples(module):
    result = doctest.testmod(module)
    assert result.attempted > 0
    assert result.failed == 0
