"""Shipping: a policy goes to the zoo with the score that it has, or not at all."""

from dataclasses import replace

import pytest

pytest.importorskip("rich")
pytest.importorskip("torch")  # of the laboratory, whose copying is used

from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.policies.card import SpooferCard
from tests.spoofers.policies import TIMELINE, write_policy
from tools.ship_spoofer import main, ship


def test_a_policy_is_shipped_with_its_score_unless_it_is_over_the_budget(tmp_path, monkeypatch):
    detector = {"name": "snapshot-chi2", "thresholds": "nominal"}
    judge = Evaluator(
        detector=detector, scenario="zhong2025", timeline=TIMELINE, runs=40, entropy=3
    )
    source = write_policy(tmp_path, "mine")
    (tmp_path / "zoo").mkdir()
    file = ship(source, "better-name", judge, tmp_path / "zoo")
    assert file.read_bytes() == source.read_bytes()
    card = SpooferCard.load(file.with_suffix(".json"))
    assert (card.name, card.file.name) == ("better-name", "better-name.onnx")
    (score,) = card.scores
    wanted = judge.score(str(source), amplitude=None)
    assert score.undetected_displacement_m == wanted.stealthy_displacement_m.value
    assert score.alarm_rate == wanted.alarm_rate.value
    assert score.clean_alarm_rate == wanted.clean_alarm_rate
    assert (score.runs, score.counted, score.entropy) == (40, wanted.counted, 3)
    assert SpooferCard.load(source.with_suffix(".json")).scores == ()
    loud = replace(wanted, within_budget=False)
    monkeypatch.setattr(judge, "score", lambda *given, **named: loud)
    with pytest.raises(ValueError, match=r"is not shipped: .*over the budget of 5 %"):
        ship(source, "better-name", judge, tmp_path)
    assert not (tmp_path / "better-name.onnx").exists()


def test_bad_arguments_are_told(tmp_path):
    with pytest.raises(SystemExit, match="unknown task 'T9'"):
        main([str(tmp_path / "none.onnx"), "--name", "x", "--task", "T9"])
