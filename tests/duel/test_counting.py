"""Negative control: a detector that counts its epochs must not gain where the onset is drawn.

It is the same test as another one, but sensitive only at the ages at which attacks begin in a world
where they all begin at the same, as one that has learned from such a world may become.
"""

import numpy as np
import pytest

from spoofgym import duel_v0

RECEIVERS, FALSE_ALARM = 384, 0.1
AGES_S = (12.0, 100.0)
USUAL_S = 60.0
"""Age at the onset in the world that the counting detector knows."""
LINE = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 16.0, "time_to_alert_s": 2.0}
WINDOW_S = LINE["attack_s"] + LINE["time_to_alert_s"]
EPOCHS_PER_S = 2
Z = 2.6
"""Standard errors by which one of two equal shares is above the other in 1 of 200 tests."""


def play(options):
    """Largest normalized average innovation (L, B), age at the onset, and attacked, (B,)."""
    envs = duel_v0.DetectorVectorView(
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
    seen, _ = envs.reset(seed=1, options=options)
    quiet = np.full(envs.action_space.shape, -1.0)
    duel, statistic = envs.core.duel, []
    onset = duel.core.engine.simulator.ages - duel.setup.filter_only
    attacked = duel.attacked.copy()  # of these episodes, not of those that follow
    for _ in range(int(onset.max()) + duel.epochs):
        statistic.append(np.abs(seen[:, 24:36]).max(axis=1))
        seen = envs.step(quiet)[0]
    end = onset + duel.epochs
    past = np.arange(len(statistic))[:, None] >= end
    return np.where(past, 0.0, statistic), onset, attacked


def find_detected(statistic, onset, attacked):
    """(n,) attacked runs whose first alarm is after the onset, at the threshold that a share
    `FALSE_ALARM` of the clean runs exceeds, at any time."""
    clean = np.sort(statistic[:, ~attacked].max(axis=0))[::-1]
    alarm = statistic > clean[int(FALSE_ALARM * len(clean))]
    first = np.where(alarm.any(axis=0), alarm.argmax(axis=0), -1)
    return (first >= onset)[attacked]


@pytest.mark.parametrize(("age_s", "gains"), [(USUAL_S, True), (None, False)])
def test_a_detector_that_counts_gains_only_where_the_onset_is_always_the_same(age_s, gains):
    """Attacks found of 198, by the first and the second test: 168 and 126; 37 and 78."""
    statistic, onset, attacked = play(None if age_s is None else {"domain": {"age_s": age_s}})
    assert (np.ptp(onset) == 0) == gains
    epochs = np.arange(len(statistic))[:, None] / EPOCHS_PER_S + LINE["warmup_s"] - LINE["live_s"]
    usual = (epochs >= USUAL_S) & (epochs < USUAL_S + WINDOW_S)
    counting = np.where(usual, statistic, 0.0)
    found, plain = (find_detected(each, onset, attacked) for each in (counting, statistic))
    difference = found.astype(np.float64) - plain
    error = difference.std() / np.sqrt(len(difference))
    assert (difference.mean() > Z * error) == gains
    assert 0.2 < plain.mean() < 0.9
