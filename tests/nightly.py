"""Cases that take so long that `make test-nightly` alone has them."""

from collections.abc import Iterable
from typing import Any

import pytest


def heavy(cases: Iterable[Any], *nightly: Any) -> list[Any]:
    """Cases of a parametrized test, some of which are marked nightly."""
    mark = pytest.mark.nightly
    return [pytest.param(each, marks=mark) if each in nightly else each for each in cases]
