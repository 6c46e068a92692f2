"""Pages are read by users, who have calibrated detectors."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _as_users_have_it(default_rate: float) -> None:
    """Detectors without a word on their thresholds are at the default rate of false alarms."""
