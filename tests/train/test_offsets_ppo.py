"""PPO on offsets: its rivals, its plan, and a training with few steps."""

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "tyro"):
    pytest.importorskip(name)

from train import offsets_ppo
from train.offsets_ppo import CORRECTED, FEW, Settings, build_table, list_plan, load_line, play

SHORT = {"warmup_s": 8.0, "live_s": 5.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
REACHED = "undetected_displacement_m"


def test_the_searched_attacks_lead_to_where_the_authentic_satellites_see_nothing():
    """The same way against every chart, and in units of the action, none of which is cut."""
    ends = np.array([np.sum(load_line(name), axis=1) for name in ("ewma", "shewhart", "raim")])
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    assert np.abs(ends @ ends.T).min() > 0.99
    assert np.abs(load_line("raim")).max() == 1.0
    assert 0.3 < np.abs(load_line("ewma")).max() < 0.6
    with pytest.raises(ValueError, match="unknown searched attack 'lottery, 5 of 8'"):
        load_line("lottery")


def test_the_plan_has_every_case_of_every_detector_and_its_minutes():
    settings = Settings(detectors=("ewma", "raim"), cases=(FEW, CORRECTED), seeds=(0,))
    names = [each.partition(":")[0] for each in list_plan(settings)]
    assert names == [f"{case}, {name}" for case in settings.cases for name in settings.detectors]


def test_a_training_that_has_diverged_is_a_row_of_no_metres():
    estimate = {"value": 2.0, "low": 1.0, "high": 3.0}
    alarms = {"value": 0.05, "low": 0.0, "high": 0.1}
    good = {"diverged": None, "score": {REACHED: estimate}, "ratio": estimate}
    good |= {"as_trained": {"stealthy_displacement_m": estimate, "alarm_rate": alarms}}
    found = {"rival": {REACHED: estimate}, "seeds": [good, {"diverged": "NaN"}]}
    (row,) = build_table({"cases": {f"{CORRECTED}, ewma": found}}).splitlines()[2:]
    assert row.startswith(
        f"| {CORRECTED} | `ewma` | 2.0 (1.0 to 3.0) | 1.0 [0.0, 2.0] | 1.00 [0.00"
    )


@pytest.mark.nightly
def test_a_seed_is_trained_once_and_scored_beside_its_rival_at_the_budget(tmp_path, monkeypatch):
    monkeypatch.setitem(offsets_ppo.WORLD, "timeline", SHORT)
    monkeypatch.setattr(offsets_ppo, "NUM_ENVS", 4)
    monkeypatch.setattr(offsets_ppo, "PLAIN", {"n_steps": 4, "batch_size": 16, "gamma": 1.0})
    monkeypatch.setattr(offsets_ppo, "load_line", lambda _: load_line("snapshot-chi2"))
    met = {"name": "snapshot-chi2", "thresholds": "nominal"}
    sizes = {"seeds": (3,), "steps": 16, "runs": 80}
    settings = Settings(
        out=tmp_path, detectors=(met,), cases=("satellites", FEW, CORRECTED), **sizes
    )
    results = play(settings)
    rows = build_table(results)
    for name, _, case in settings.pairs():
        found = results["cases"][name]
        (row,) = found["seeds"]
        share = row["score"][REACHED]["value"] / found["rival"][REACHED]["value"]
        assert row["ratio"]["value"] == pytest.approx(share, rel=1e-3)
        assert row["as_trained"]["value"] is None
        assert f"| {case} |" in rows
    assert row["ratio"]["value"] == pytest.approx(1.0, abs=0.2)  # a base that is hardly corrected
    monkeypatch.setattr(offsets_ppo, "train", None)  # it is finished
    assert play(settings) == results
