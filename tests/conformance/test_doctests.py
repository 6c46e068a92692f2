"""The examples of docstrings run as they stand."""

import doctest
from pathlib import Path

from . import sources


def test_examples():
    for module in sources.modules():
        if ">>> " in Path(module.__file__).read_text():
            result = doctest.testmod(module)
            assert result.attempted > 0, module
            assert result.failed == 0, module
