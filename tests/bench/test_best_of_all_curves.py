"""On fresh seeds a blind optimum gets as far as every ramp, profile and zero-alarm shape."""

import numpy as np
import pytest

from spoofgym.bench import Suite, run_campaign
from spoofgym.bench.search.amplitude import RESOLUTION, Tuning

LINE = {"warmup_s": 60.0, "live_s": 40.0, "attack_s": 60.0, "time_to_alert_s": 5.0}
PROFILE = {"name": "profile", "amplitude": "tuned"}
RIVALS = [
    {"name": "ramp", "rate_mps": "tuned"},
    {"name": "accelerating-ramp", "acceleration_mps2": "tuned"},
    {**PROFILE, "rates_mps": (0.0, 0.05, 0.4), "label": "late"},
]


def suite_of(detector, spoofers):
    return Suite(
        scenario="trolley",
        receiver="matched",
        timeline=LINE,
        detectors=({"name": detector, "signals": "range_rate"},),
        spoofers=spoofers,
        runs=256,
        tuning=Tuning(runs=128, sift_runs=8, values=15),
    )


def displacements(suite, path):
    """D_u of every run that counts, by spoofer."""
    folder = run_campaign(suite, path)
    (detector,) = suite.detector_players
    played = [each.label for each in suite.spoofer_players if each.label != "none"]
    cells = [folder.runs(detector.label, label) for label in played]
    return {cell.spoofer: cell.displacement_m[cell.counts] for cell in cells}


@pytest.mark.nightly
@pytest.mark.parametrize("detector", ["snapshot-chi2", "windowed-chi2", "shewhart"])
def test_no_known_curve_gets_farther(detector, tmp_path):
    bare = suite_of(detector, [])
    (entry,) = bare.detector_players
    shape = np.mean(bare.build_bounds().zero_alarm(entry).rates_mps, axis=0)
    zero_alarm = {**PROFILE, "rates_mps": tuple(shape.tolist()), "label": "zero-alarm shape"}
    # in campaigns of their own, so that none of the profiles is among the curves that are fitted
    others = displacements(suite_of(detector, [*RIVALS, zero_alarm]), tmp_path / "others")
    blind = suite_of(detector, [{"name": "blind-optimum", "amplitude": "tuned"}])
    (best,) = displacements(blind, tmp_path / "blind").values()
    assert len(others) == len(RIVALS) + 1
    for name, reached in others.items():
        apart = best - reached
        error = apart.std(ddof=1) / np.sqrt(len(apart))
        # amplitudes are fitted to that ratio, whatever the curve
        unresolved = (RESOLUTION - 1.0) * reached.mean()
        assert apart.mean() + 1.96 * error >= -unresolved, (name, best.mean(), reached.mean())
