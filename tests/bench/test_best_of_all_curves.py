"""On fresh seeds a blind optimum gets as far as every ramp, profile and zero-alarm shape."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spoofgym.bench import Suite, run_campaign
from spoofgym.bench.search.amplitude import RESOLUTION, Tuning

LINE = {"warmup_s": 60.0, "live_s": 40.0, "attack_s": 60.0, "time_to_alert_s": 5.0}
RIVALS: list[dict[str, Any]] = [
    {"name": "ramp", "rate_mps": "tuned"},
    {"name": "accelerating-ramp", "acceleration_mps2": "tuned"},
    {"name": "profile", "rates_mps": (0.0, 0.05, 0.4), "label": "late", "amplitude": "tuned"},
]
BLIND = {"name": "blind-optimum", "amplitude": "tuned"}


def suite_of(detector: str, spoofers: list[dict[str, Any]]) -> Suite:
    return Suite(
        scenario="trolley",
        receiver="matched",
        timeline=LINE,
        detectors=({"name": detector, "signals": "range_rate"},),
        spoofers=spoofers,
        runs=256,
        tuning=Tuning(runs=128, sift_runs=8, values=15),
    )


def displacements(suite: Suite, path: Path) -> dict[str, np.ndarray]:
    """D_u of every run that counts, by spoofer."""
    folder = run_campaign(suite, path)
    (detector,) = suite.detector_players
    played = [each.label for each in suite.spoofer_players if each.label != "none"]
    cells = [folder.runs(detector.label, label) for label in played]
    return {cell.spoofer: cell.displacement_m[cell.counts] for cell in cells}


@pytest.mark.nightly
@pytest.mark.parametrize("detector", ["snapshot-chi2", "windowed-chi2", "shewhart"])
def test_no_known_curve_gets_farther(detector: str, tmp_path: Path) -> None:
    bare = suite_of(detector, [])
    (entry,) = bare.detector_players
    shape = np.mean(bare.build_bounds().zero_alarm(entry).rates_mps, axis=0)
    zero_alarm = {
        "name": "profile",
        "rates_mps": tuple(shape.tolist()),
        "label": "zero-alarm shape",
        "amplitude": "tuned",
    }
    # in campaigns of their own, so that none of the profiles is among the curves that are fitted
    others = displacements(suite_of(detector, [*RIVALS, zero_alarm]), tmp_path / "others")
    (best,) = displacements(suite_of(detector, [BLIND]), tmp_path / "blind").values()
    assert len(others) == len(RIVALS) + 1
    for name, reached in others.items():
        apart = best - reached
        error = apart.std(ddof=1) / np.sqrt(len(apart))
        # amplitudes are fitted to that ratio, whatever the curve
        unresolved = (RESOLUTION - 1.0) * reached.mean()
        assert apart.mean() + 1.96 * error >= -unresolved, (name, best.mean(), reached.mean())
