"""A dash waits, and then is as fast as it may be."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.spoofers import Dash

from .test_scaled import CONTEXT, NOTHING


@pytest.mark.parametrize(("last_s", "waits"), [(5.0, 30), (20.0, 0), (1000.0, 0)])
def test_it_begins_so_long_before_the_end(last_s, waits):
    spoofer = Dash(rate_mps=2.0, last_s=last_s)
    spoofer.bind(CONTEXT)
    spoofer.reset()
    east = np.array([spoofer.act(NOTHING)[0, 1] for _ in range(CONTEXT.steps)])
    assert not east[:waits].any()
    # 2 m/s are 80 epochs at the largest acceleration
    np.testing.assert_array_equal(east[waits:], 1.0)
