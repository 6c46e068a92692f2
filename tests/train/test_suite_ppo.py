"""PPO that corrects the attacks of the standard suite: its plan, and the policies that ship."""

import json

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "tyro"):
    pytest.importorskip(name)

from spoofgym.bench.runs.players import specify_detector
from spoofgym.policies import SpooferCard
from tools.readme_bench import SHOWN, choose_policies, label
from train.suite_ppo import CASES, CHOICE, SCORES, SHIPPED, Settings, list_plan

LARGEST = 200_000


def test_the_plan_has_the_detectors_of_the_readme_and_their_hours():
    assert {each for each, _ in CASES.values()} < {*SHOWN}
    plan = list(list_plan(Settings(seeds=(0, 1), detectors=("own-filter",))))
    assert plan == ["own-filter: 2 trainings, about 2.00 CPU hours"]
    with pytest.raises(ValueError, match="unknown detector 'raim'"):
        Settings(detectors=("raim",))


def test_shipped_policies_are_those_that_are_scored_and_say_what_they_were_chosen_on():
    policies = json.loads(SCORES.read_text())["policies"]
    assert {path.stem for path in SHIPPED.glob("*.onnx")} == {*policies}
    for name, each in policies.items():
        path = SHIPPED / f"{name}.onnx"
        card = SpooferCard.load(path.with_suffix(".json"))
        assert path.stat().st_size < LARGEST
        assert card.training["decided_on"] == [[CHOICE, "evaluation"]]
        assert card.training["choice_m"] == each["choice_m"]
        assert label(specify_detector(card.env_kwargs["detector"]).label) == each["detector"]
        assert max(each["choice_m"]) > each["choice_m"][0]  # or it would be its base
        assert each["ratio"]["low"] >= 0.97
    assert {*choose_policies({"policies": policies})} <= {*SHOWN}
