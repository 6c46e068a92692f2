"""PPO that corrects the attacks of the standard suite: its plan, and the policies that ship."""

import json
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "tyro"):
    pytest.importorskip(name)

from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.at_budget import AlarmCurve
from spoofgym.policies import SpooferCard
from spoofgym.sb3 import SpoofVecEnv
from tools.readme_bench import choose_policies, label
from train import suite_ppo
from train.suite_ppo import (
    CAMPAIGN,
    CASES,
    CHOICE,
    SCORES,
    SHIPPED,
    TASK,
    WORLD,
    Settings,
    build_table,
    list_plan,
    play,
)

LARGEST = 200_000


def make_observed(own):
    """Names of what an environment shows."""
    vector = SpoofVecEnv(1, **own)
    vector.close()
    return vector.observation_names


def test_the_plan_has_the_detectors_of_the_readme_and_their_hours():
    cells = json.loads(CAMPAIGN.read_text())["worlds"][TASK]["cells"]
    assert {each for each, _ in CASES.values()} <= {cell["detector"] for cell in cells}
    plan = list(list_plan(Settings(seeds=(0, 1), detectors=("own-filter",))))
    assert plan == ["own-filter: 2 trainings, about 1.00 CPU hours"]
    with pytest.raises(ValueError, match="unknown detector 'raim'"):
        Settings(detectors=("raim",))
    with pytest.raises(ValueError, match="unknown knowledge 'all'"):
        Settings(knowledge="all")


@pytest.mark.parametrize(
    ("knowledge", "seen"),
    [("blind", set()), ("position", {"reported", "report"}), ("statistics", None)],
)
def test_a_correction_sees_what_its_knowledge_says(knowledge, seen):
    curve = {"name": "open-loop", "rates_mps": [0.1] * 15}
    world = {**WORLD, "detector": {"name": "snapshot-chi2", "thresholds": "nominal"}}
    names = [
        set(make_observed({**world, **suite_ppo.make_env(curve, each)}))
        for each in ("blind", knowledge)
    ]
    more = {name.partition("_")[0] for name in names[1] - names[0]}
    assert more == seen if seen is not None else "statistic" in more


@pytest.mark.parametrize(
    ("reached", "price_m"), [([100.0, 110.0, 120.0], 200.0), ([100.0, 110.0, 20.0], 200.0)]
)
def test_the_price_of_an_alarm_breaks_even_at_the_budget(reached, price_m):
    """Ten metres for five alarms of a hundred, also where more of them cost displacement."""
    alarmed = np.arange(100) < np.array([[0], [5], [10]])
    moved = {MEASURES[0]: np.repeat(np.array(reached)[:, None], 100, axis=1)}
    curve = AlarmCurve(np.array([0.9, 1.0, 1.1]), np.ones(100), moved, alarmed, np.zeros(100), 1.0)
    assert suite_ppo.find_price(curve) == pytest.approx(price_m)


@pytest.mark.usefixtures("default_rate")  # as users have it
def test_shipped_policies_are_those_that_are_scored_and_say_what_they_were_chosen_on():
    policies = json.loads(SCORES.read_text())["policies"]
    assert {path.stem for path in SHIPPED.glob("*.onnx")} == {*policies}
    for name, each in policies.items():
        path = SHIPPED / f"{name}.onnx"
        card = SpooferCard.load(path.with_suffix(".json"))
        assert path.stat().st_size < LARGEST
        assert card.training["decided_on"] == [[CHOICE, "evaluation"]]
        assert card.training["choice_m"] == each["choice_m"]
        assert card.training["knowledge"] == each["knowledge"]
        assert label(specify_detector(card.env_kwargs["detector"]).label) == each["detector"]
        assert max(each["choice_m"]) > each["choice_m"][0]  # or it would be its base
        assert each["ratio"]["high"] >= 0.97  # its interval does not lie below
    best = choose_policies({"policies": policies}).values()
    assert {each["knowledge"] for each in best} <= {"statistics"}


@pytest.mark.nightly
def test_what_is_better_on_choice_runs_ships_with_its_card_and_is_scored(tmp_path, monkeypatch):
    line = {"warmup_s": 8.0, "live_s": 5.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
    world = {"scenario": "zhong2025", "timeline": line}
    curve = {"name": "open-loop", "rates_mps": [0.2, 0.4]}
    loud = {"name": "sequential-chi2", "signals": "range_rate", "thresholds": "nominal"}
    tests = {"snapshot-chi2": {"name": "snapshot-chi2"}, "sequential-chi2": loud}
    scores, better = tmp_path / "learned.json", count(1)
    scores.write_text(json.dumps({"runs": 0, "policies": {}, "trained": {}}))
    for name, value in {
        **{"WORLD": world, "SHIPPED": tmp_path / "s1", "SCORES": scores},
        "find_base": lambda *_: {"spec": curve, "choice_m": 0.0, "price_m": 9.0, "log_std": -2.0},
        "PROBES": 8,
        "get_metres": lambda _: float(next(better)),
        "list_specs": lambda: tests,
    }.items():
        monkeypatch.setattr(suite_ppo, name, value)
    sizes = {"steps": 64, "num_envs": 64, "checkpoints": 1, "choice_runs": 160, "runs": 160}
    settings = Settings(out=tmp_path / "out", detectors=("snapshot-chi2",), seeds=(0,), **sizes)
    for rate, alarms in ((0.2, False), (1.0, True)):
        own = suite_ppo.set_env("sequential-chi2", {**curve, "rates_mps": [rate, rate]})
        assert [suite_ppo.explore(own, x) > 0.3 for x in (None, -3.0)] == [alarms, alarms]
    assert play(settings)["snapshot-chi2 0"]["checkpoint"] == 1
    found = play(replace(settings, score=True))
    kept = json.loads(scores.read_text())
    assert kept["policies"] == found
    assert [*kept["trained"]] == ["snapshot-chi2 0"]
    (each,) = found.values()
    measure = "undetected_displacement_m"
    apart = each["score"][measure]["value"] / each["base"][measure]["value"]
    assert each["ratio"]["value"] == pytest.approx(apart, rel=1e-3)
    assert "s1-snapshot-chi2-0 |" in build_table(found)
