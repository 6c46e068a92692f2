"""PPO on offsets with few steps."""

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "tyro"):
    pytest.importorskip(name)

from train import offsets_ppo
from train.offsets_ppo import Settings, build_table, play

SHORT = {"warmup_s": 8.0, "live_s": 5.0, "attack_s": 20.0, "time_to_alert_s": 2.0}


@pytest.mark.nightly
def test_a_seed_is_trained_once_and_scored_beside_the_ramp_at_the_budget(tmp_path, monkeypatch):
    monkeypatch.setitem(offsets_ppo.WORLD, "timeline", SHORT)
    monkeypatch.setattr(offsets_ppo, "NUM_ENVS", 4)
    monkeypatch.setattr(offsets_ppo, "PLAIN", {"n_steps": 4, "batch_size": 16, "gamma": 1.0})
    met = {"name": "snapshot-chi2", "thresholds": "nominal"}
    sizes = {"seeds": (3,), "steps": 16, "runs": 80}
    settings = Settings(out=tmp_path, detector=met, cases=("satellites", "5 of 8"), **sizes)
    results = play(settings)
    for case in settings.cases:
        (row,) = results["cases"][case]["seeds"]
        score = row["score"]["undetected_displacement_m"]["value"]
        ramp = results["cases"][case]["ramp"]["undetected_displacement_m"]["value"]
        assert row["ratio"]["value"] == pytest.approx(score / ramp, rel=1e-3)
        assert row["as_trained"]["value"] is None
        assert f"| {case} |" in build_table(results)
    monkeypatch.setattr(offsets_ppo, "train", None)  # it is finished
    assert play(settings) == results
