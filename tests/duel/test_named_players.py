"""Shipped spoofers by their names, in every form of the game."""

import pytest

from spoofgym import duel_v0
from spoofgym.envs import attach
from spoofgym.policies import list_shipped, load_card
from spoofgym.spoofers import make_spoofer

from .support import QUIET

SHIPPED = list_shipped("spoofer")
WORLD = ("scenario", "receiver", "attack", "timeline")
COMMANDS = ("action", "decision_interval_s", "between")
NEVER_ALARMS = {"attack_probability": 1.0, "threshold": 1.0}


@pytest.mark.parametrize("name", SHIPPED)
def test_it_commands_an_agent_of_the_duel_as_it_does_as_an_opponent(name):
    card, own = load_card(name).env_kwargs, make_spoofer(name)
    world = {key: card[key] for key in WORLD if key in card}
    commands = {key: card[key] for key in COMMANDS if key in card}
    duel = duel_v0.parallel_env(**world, **commands, **NEVER_ALARMS, knowledge=own.knowledge)
    spoofer = attach(name, duel, transfer="domain" in card)  # here under one sky
    observations, infos = duel.reset(seed=1)
    idle = spoofer.act(observations["spoofer_0"][None])[0]
    spoofer.reset()
    while duel.agents:
        due = infos["spoofer_0"].get("decides", True)
        action = spoofer.act(observations["spoofer_0"][None])[0] if due else idle
        observations, *_, infos = duel.step({"spoofer_0": action, "detector_0": QUIET})
    moved_m = infos["spoofer_0"]["undetected_displacement_m"]
    assert moved_m > 1.0
    view = duel_v0.DetectorView(name, **world, **NEVER_ALARMS, decision_delay=1)
    view.reset(seed=1)
    assert view.opponent == name
    over = False
    while not over:
        _, _, over, _, info = view.step(QUIET)
    assert info["undetected_displacement_m"] == pytest.approx(moved_m, rel=1e-6)
    view.close()
    duel.close()


def test_a_misfit_is_named_and_a_detector_is_the_other_agent():
    duel = duel_v0.parallel_env(scenario="zhong2025", attack="quiet")
    with pytest.raises(ValueError, match="'ewma-ppo' was made for another environment"):
        attach("ewma-ppo", duel)
    duel.close()


def test_shipped_spoofers_play_a_game_of_populations_by_their_names():
    chi2 = {"name": "snapshot-chi2", "thresholds": "nominal"}
    names = ["ewma-ppo", "snapshot-chi2-ppo"]
    game = duel_v0.Game(scenario="zhong2025", attack="false-position-ideal", limit_m=20.0, runs=2)
    matrix = game.matrix(names, [chi2])
    assert [each.label for each in matrix.spoofers] == names
    assert matrix.values.shape == (2, 1)
