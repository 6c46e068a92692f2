"""PPO on the detector's side with few steps, and the scores beside it."""

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "tyro"):
    pytest.importorskip(name)

from train import ppo_detector as module
from train.ppo_detector import KINDS, Settings, build_table, play, score

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
AIME = "aime:signals=range_rate"
RUNS = 19


@pytest.fixture(autouse=True)
def brief(monkeypatch):
    """Short runs with strong attacks, and short rollouts."""
    monkeypatch.setattr(module, "WORLD", {"scenario": "zhong2025", "timeline": SHORT})
    monkeypatch.setattr(module, "POOL", [{"name": "ramp", "rate_mps": 2.0}])
    monkeypatch.setattr(module, "RECEIVERS", 2)
    monkeypatch.setattr(module, "BATCH", 8)
    for kind, (world, given) in KINDS.items():
        monkeypatch.setitem(KINDS, kind, (world, {**given, "n_steps": 4}))


def test_seeds_are_trained_once_and_scored_beside_what_has_not_learned(tmp_path, monkeypatch):
    settings = Settings(out=tmp_path, seeds=(3,), steps=8, runs=RUNS, detectors=(AIME,))
    results = play(settings)
    never, aime = results["others"]["never"], results["others"][AIME]
    assert (never["area"], never["found"]["value"]) == (0.5, 0.0)
    assert (aime["area"], aime["found"]["value"]) == (1.0, 1.0)
    assert aime["mean_m"] < 0.5 * never["mean_m"]
    for kind in KINDS:
        found = results[f"{kind}-3"]
        assert found["diverged"] is None
        assert all(0.0 <= found[when]["area"] <= 1.0 for when in ("before", "after"))
    table = build_table(results)
    assert table.count("\n") == 2 + 1 + 2 * len(KINDS)
    monkeypatch.setattr(module, "train", None)  # it is finished
    assert play(settings) == results
    with pytest.raises(ValueError, match="unknown kind 'fancy'"):
        Settings(out=tmp_path, kinds=("fancy",))


def test_a_statistic_that_tells_attacks_apart_scores_higher():
    """Average innovations of range rates, which a strong ramp shifts, and those of clean runs."""
    rates = lambda seen: 0.1 * abs(seen[:, 36:48]).max(axis=1, keepdims=True) - 1.0  # noqa: E731
    still = lambda seen: 0.0 * seen[:, :1]  # noqa: E731
    (good,), (none,) = (score(each, RUNS, weighs=False) for each in (rates, still))
    assert good["area"] > 0.99
    assert (none["area"], none["found"]["value"]) == (0.5, 0.0)
