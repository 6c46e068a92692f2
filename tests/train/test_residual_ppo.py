"""PPO on corrections of attacks with few steps."""

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "tyro"):
    pytest.importorskip(name)

from train import residual_ppo
from train.residual_ppo import Settings, build_table, list_plan, play

SHORT = {"warmup_s": 8.0, "live_s": 5.0, "attack_s": 20.0, "time_to_alert_s": 2.0}


def test_feedback_is_corrected_with_statistics_alone():
    rows = [(case.base, case.knowledge) for case in Settings(detectors=("ewma",)).cases()]
    assert rows == [("open-loop", "blind"), ("open-loop", "statistics"), ("feedback", "statistics")]
    plan = list(list_plan(Settings(seeds=(4, 5), prices_m=(60.0,), knowledge=("blind",))))
    assert plan[2].startswith("ewma, open-loop, blind: 2 trainings, about 3.0 CPU minutes each")
    with pytest.raises(ValueError, match="unknown base 'ramp'"):
        Settings(base=("ramp",))


@pytest.mark.nightly
def test_the_price_is_that_of_the_choice_and_scripts_stand_beside(tmp_path, monkeypatch):
    monkeypatch.setitem(residual_ppo.WORLD, "timeline", SHORT)
    monkeypatch.setattr(residual_ppo, "NUM_ENVS", 4)
    monkeypatch.setattr(residual_ppo, "PLAIN", {"n_steps": 4, "batch_size": 16, "gamma": 1.0})
    monkeypatch.setattr(residual_ppo, "FULL_RATIOS", (0.6, 0.8))
    curve = {"name": "open-loop", "rates_mps": [0.2, 0.4]}
    found = {"spec": curve, "script": {"name": "open-loop"}}
    monkeypatch.setattr(residual_ppo, "find_open_loop", lambda *_: found)
    sizes = {"seeds": (3, 4), "steps": 16, "runs": 160, "knowledge": ("statistics",)}
    settings = Settings(out=tmp_path, detectors=("snapshot-chi2",), **sizes)
    results = play(settings)
    (found,) = results["detectors"].values()
    for row in found["rows"].values():
        best = max(row["trials"], key=lambda each: max(each["choice_m"]))
        assert row["seeds"][0] == best
        assert row["seeds"][1]["price_m"] == row["price_m"] == best["price_m"]
        for each in row["seeds"]:
            assert each["checkpoint"] == each["choice_m"].index(max(each["choice_m"]))
    again = found["rows"]["feedback statistics"]["seeds"][0]
    base = found["scripts"]["feedback, base"]["score"]["undetected_displacement_m"]["value"]
    kept = again["kept"]["score"]["undetected_displacement_m"]["value"]
    assert again["kept"]["feedback"]["value"] == pytest.approx(kept / base, rel=1e-3)
    assert "PPO on feedback | statistics |" in build_table(results)
    monkeypatch.setattr(residual_ppo, "train", None)  # it is finished
    assert play(settings) == results
