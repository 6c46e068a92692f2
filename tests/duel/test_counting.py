"""Negative control: a detector that counts its epochs must not gain where the onset is drawn.

It is the same test as another one, but sensitive only at the ages at which attacks begin in a world
where they all begin at the same, as one that has learned from such a world may become.
"""

import numpy as np
import pytest

from spoofgym.duel.views import DetectorCore

RECEIVERS, FALSE_ALARM = 384, 0.1
AGES_S = (12.0, 100.0)
USUAL_S = 60.0
"""Age at the onset in the world that the counting detector knows."""
LINE = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 16.0, "time_to_alert_s": 2.0}
WINDOW_S = LINE["attack_s"] + LINE["time_to_alert_s"]
EPOCHS_PER_S = 2
Z = 2.6
"""Standard errors by which one of two equal shares is above the other in 1 of 200 tests."""


def play(given):
    """Largest normalized average innovation (L, B), age at the onset, and attacked, (B,)."""
    side = DetectorCore(
        RECEIVERS,
        {"name": "ramp", "rate_mps": 1.0, "heading_deg": "target"},
        scenario="zhong2025-white",
        domain={"age_s": AGES_S},
        target_heading_deg="random",
        timeline=LINE,
        onset="within",
        threshold=1.0,
        weighs=False,
        threads=1,
    )
    side.reset([np.random.default_rng(k) for k in range(RECEIVERS)], given=given)
    duel, seen, statistic = side.duel, side.observe(), []
    onset = duel.core.engine.simulator.ages - duel.setup.filter_only
    end, quiet = onset + duel.epochs, np.full((RECEIVERS, len(side.action_names)), -1.0)
    for k in range(int(end.max())):
        statistic.append(np.where(k < end, np.abs(seen[:, 24:36]).max(axis=1), 0.0))
        _, seen = side.step(quiet)
    return np.array(statistic), onset, duel.attacked


def find_detected(statistic, onset, attacked):
    """(n,) attacked runs whose first alarm is after the onset, at the threshold that a share
    `FALSE_ALARM` of the clean runs exceeds, at any time."""
    clean = np.sort(statistic[:, ~attacked].max(axis=0))[::-1]
    alarm = statistic > clean[int(FALSE_ALARM * len(clean))]
    return (np.where(alarm.any(axis=0), alarm.argmax(axis=0), -1) >= onset)[attacked]


@pytest.mark.parametrize(("age_s", "gains"), [(USUAL_S, True), (None, False)])
def test_a_detector_that_counts_gains_only_where_the_onset_is_always_the_same(age_s, gains):
    """Attacks found of 198, by the first and the second test: 168 and 127; 37 and 79."""
    statistic, onset, attacked = play(None if age_s is None else {"age_s": age_s})
    assert (np.ptp(onset) == 0) == gains
    epochs = np.arange(len(statistic))[:, None] / EPOCHS_PER_S + LINE["warmup_s"] - LINE["live_s"]
    counting = np.where((epochs >= USUAL_S) & (epochs < USUAL_S + WINDOW_S), statistic, 0.0)
    found, plain = (find_detected(each, onset, attacked) for each in (counting, statistic))
    difference = found.astype(np.float64) - plain
    error = difference.std() / np.sqrt(len(difference))
    assert (difference.mean() > Z * error) == gains
    assert 0.2 < plain.mean() < 0.9
