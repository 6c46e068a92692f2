"""Many trainings in one command, with settings that take seconds."""

import json
from dataclasses import replace

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
for name in ("torch", "stable_baselines3", "onnxscript", "tyro", "matplotlib"):
    pytest.importorskip(name)

from agents.learning import LENGTHS
from agents.spoofer_table import page
from train import spoofers
from train.spoofers import DETECTORS, PAGE, TABLE, Settings, play


@pytest.fixture
def small(tmp_path, monkeypatch):
    monkeypatch.setitem(DETECTORS, "snapshot-chi2", "snapshot-chi2:thresholds=nominal")
    monkeypatch.setattr(spoofers, "RIVALS", ("ramp",))
    timeline = {"warmup_s": 8, "live_s": 5, "attack_s": 10, "time_to_alert_s": 2}
    world = {"timeline": timeline, "scenario": "zhong2025", "domain": {}}
    few = {"num_envs": 5, "batch_size": 50, "n_epochs": 1, "stages": 1, "threads": 1}
    quick = {"seeds": (0,), "steps": 100, "fit_runs": 80, "runs": 10, "warm_pool": 8}
    further = json.dumps({"settings": json.dumps(world), "decision_interval_s": 2.5, **few})
    return Settings(out=tmp_path, only=("T3", "snapshot-chi2"), further=further, **quick)


def test_all_cells_are_a_hundred_and_eighty_trainings_and_settings_are_checked(tmp_path):
    settings = Settings(out=tmp_path)
    assert len(settings.cells()) * len(settings.seeds) == 180
    names = {settings.folder(*cell).name for cell in settings.cells()}
    assert len(names) == len(settings.cells())
    for given, message in (
        ({"further": "{"}, "`further` is not JSON"),
        ({"further": "[1]"}, "`further` must be an object of JSON"),
        ({"further": '{"stepz": 3}'}, "unknown further setting 'stepz'"),
        ({"only": ("T9",)}, "unknown world, detector or knowledge 'T9'"),
    ):
        with pytest.raises(ValueError, match=message):
            Settings(out=tmp_path, **given)


def test_a_part_is_trained_and_stays_when_another_part_follows(small, monkeypatch):
    blind, oracle = (
        replace(small, only=("T3", "snapshot-chi2", known)) for known in ("blind", "oracle")
    )
    table = play(blind)
    (found,) = table.values()
    assert list(table) == ["T3/snapshot-chi2/blind"]
    assert set(found["rivals"]) == {"ramp", "feedback"}
    assert found["seeds"][0]["untrained"]["knowledge"] == "blind"
    # a finished cell is neither trained nor scored again, and how far the ramp gets is known, too
    trained = []
    monkeypatch.setattr(spoofers, "train", lambda args, _: trained.append(args) or found)
    monkeypatch.setattr(spoofers, "Evaluator", None)
    assert play(blind) == table
    after = play(oracle)
    assert after == {**table, "T3/snapshot-chi2/oracle": found}
    assert json.loads((small.out / TABLE).read_text()) == after
    text = (small.out / PAGE).read_text()
    assert text == page(after)
    assert "| feedback (oracle) | PPO (oracle) |" in text
    assert "| ramp (blind) |" in text
    assert play(replace(blind, seeds=(0, 1))) == table  # beside it
    given = [(args.knowledge, args.rivals, args.seeds) for args in trained]
    assert given == [("oracle", ("ramp",), (0,)), ("blind", ("ramp", "feedback"), (0, 1))]
    with pytest.raises(ValueError, match=r"other results \(config\.steps: 100, not 200"):
        play(replace(blind, steps=200))


@pytest.mark.parametrize(("reach_m", "length_m"), [(12.0, 20.0), (82.0, 41.0), (495.0, 247.5)])
def test_the_full_scale_is_at_least_the_last_rate_of_the_accelerating_ramp(
    tmp_path, reach_m, length_m
):
    args = Settings(out=tmp_path).arguments("T3", "ewma", "blind", reach_m)
    assert args.length_m == length_m
    assert args.full_scale_mps is None
    assert LENGTHS * length_m >= 2.0 * reach_m  # what goes so far accelerates to twice its mean
