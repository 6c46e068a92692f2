"""The frontier, end to end, with settings that take seconds."""

from __future__ import annotations

import json

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "onnxscript", "tyro", "tensorboard"):
    pytest.importorskip(name)

from spoofgym.spoofers import Card
from train import frontier
from train.frontier import FrontierArguments, draw, play
from train.ppo_spoofer import CONFIG, Arguments, train

from .test_ppo_spoofer import QUICK, quiet


@pytest.fixture(autouse=True)
def torch_threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def arguments(out, **settings):
    return FrontierArguments(
        out=out, **{**QUICK, "steps": 200, "penalties": (5.0, 0.1), "tensorboard": False} | settings
    )


def test_a_frontier_has_a_run_for_each_price_and_goes_on_where_it_was(tmp_path, monkeypatch):
    given = []

    def spied(run, console, rivals):
        given.append(rivals)
        return train(run, console, rivals)

    monkeypatch.setattr(frontier, "train", spied)
    result = play(arguments(tmp_path), quiet())
    assert given[0] is None
    assert given[1] == json.loads((tmp_path / "price-0.1" / CONFIG).read_text())["rivals"]
    assert [point["penalty"] for point in result["points"]] == [0.1, 5.0]
    for point in result["points"]:
        card = Card.load((tmp_path / point["policy"]).with_suffix(".json"))
        told = card.training["arguments"]
        assert (told["penalty"], told["penalty_gain"]) == (point["penalty"], 0.0)
        assert card.training["amplitude"] == 1.0
        assert card.training["price_factor"] == 1.0
        assert (
            point["undetected_displacement_m"]["value"] == card.scores[1].undetected_displacement_m
        )
        assert card.scores[1].runs == point["runs"] == QUICK["final_runs"]
    assert {ramp["spoofer"] for ramp in result["ramps"]} == {
        "ramp(tuned)",
        "accelerating-ramp(tuned)",
    }
    draw(json.loads(json.dumps(result)), tmp_path / "frontier.png")
    assert (tmp_path / "frontier.png").read_bytes().startswith(b"\x89PNG")
    monkeypatch.setattr(frontier, "train", lambda *_: pytest.fail("it is finished"))
    assert play(arguments(tmp_path), quiet()) == result
    with pytest.raises(SystemExit, match="other settings"):
        play(arguments(tmp_path, width=32), quiet())


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"penalties": ()}, "`penalties` must be finite and >= 0"),
        ({"penalties": (1.0, -1.0)}, "`penalties` must be finite and >= 0"),
        ({"penalties": (1.0, 1.0)}, "must differ from each other"),
        ({"penalty": 3.0}, "`penalty` can't be given here"),
        ({"choose": "budget", "penalty_gain": 0.1}, "`penalty_gain` can't be given here"),
    ],
)
def test_what_is_no_frontier(tmp_path, settings, told):
    with pytest.raises(ValueError, match=told):
        arguments(tmp_path, **settings)


def test_a_price_that_follows_a_budget_is_none_to_choose_by(tmp_path):
    with pytest.raises(ValueError, match="`penalty_gain` must be 0 with `choose` = 'price'"):
        Arguments(out=tmp_path / "a", choose="price")
