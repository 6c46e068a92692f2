"""The search for a profile: it gets farther than ramps, keeps its budget, and goes on."""

import json
import shlex

import numpy as np
import pytest

pytest.importorskip("cmaes")

from typer.testing import CliRunner

from baselines import profile as module
from baselines.profile import SEARCHED, app, build_experiment, make_card
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.search.amplitude import TuningResult
from spoofgym.bench.search.open_loop import OpenLoopSearch
from spoofgym.policies import SpooferCard
from spoofgym.spoofers import Profile, make_spoofer

WORLD = {
    "scenario": "zhong2025",
    "timeline": {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 5.0},
    # fast enough to be noticed within the short window
    "attack": {"name": "false-position", "acceleration_limit_mps2": 0.5},
    "detector": {"name": "ewma", "false_alarm": 1e-4, "thresholds": "nominal"},
}
TINY = shlex.split(
    "--detector ewma:false_alarm=0.0001 --attack false-position:acceleration_limit_mps2=0.5 "
    "--population 4 --knots 8 --runs 8 --batch 4 --select-runs 80 --score-runs 8 --generations 1 "
    "--warmup-s 20 --live-s 10 --attack-s 20 --time-to-alert-s 5 --threads 1"
)


def read(kept):
    return {name: TuningResult.from_dict(each) for name, each in kept.items()}


def test_a_killed_search_goes_on_to_a_card_that_gets_as_far_as_ramps(tmp_path, monkeypatch):
    judge = Evaluator(runs=20, fit_runs=80, threads=1, **WORLD)
    judge.optima.settings = OpenLoopSearch(runs=12, batch=6, knots=8, population=4, generations=2)
    fit, asked = judge.fit, []

    def killed(spec):
        if spec["name"] == SEARCHED:
            raise KeyboardInterrupt
        return fit(spec)

    fits = read(build_experiment(judge, 90.0, {}).play(tmp_path / "whole"))
    monkeypatch.setattr(judge, "fit", killed)
    with pytest.raises(KeyboardInterrupt, match="2 of 3 cells are finished"):
        build_experiment(judge, 90.0, {}).play(tmp_path / "killed")
    monkeypatch.setattr(judge, "fit", lambda spec: asked.append(spec["name"]) or fit(spec))
    assert read(build_experiment(judge, 90.0, {}).play(tmp_path / "killed")) == fits
    assert asked == [SEARCHED]

    assert all(each.within_budget for each in fits.values())
    best = fits[SEARCHED]
    assert best.score >= max(each.score for name, each in fits.items() if name != SEARCHED) > 0.0
    assert best.chosen.alarm_limit <= judge.optima.tuning.budget
    card = make_card(judge, fits, 90.0, "mine", "python")
    spec = {"name": card.kind, **card.settings}
    made = make_spoofer(spec)
    assert isinstance(made, Profile)
    assert (made.label, made.designed_on) == ("mine", card.knowledge.design_time)
    rates = best.value * np.array(best.found["played"]["rates_mps"])
    np.testing.assert_array_equal(made.rates_mps, np.clip(rates, -5.0, 5.0))
    (score,) = card.scores
    again = judge.score(spec, amplitude=None)
    assert score.undetected_displacement_m == again.stealthy_displacement_m.value
    assert score.split == "evaluation"
    assert card.decided_on == {(0, "training"), (0, "search")}
    assert card.rivals[-1]["spoofer"].startswith(SEARCHED)
    loud = TuningResult.from_dict({**best.as_dict(), "within_budget": False})
    with pytest.raises(ValueError, match=r"no profile is within the alarm budget"):
        make_card(judge, {**fits, SEARCHED: loud}, 90.0, "mine", "python")


def called(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.nightly
def test_the_command_of_a_card_makes_it_again(tmp_path, monkeypatch):
    out = tmp_path / "far" / "quick.json"
    result = called(*TINY, "--out", out)
    assert result.exit_code == 0, result.output
    assert "accelerating-ramp" in result.output
    assert [path.name for path in out.parent.iterdir()] == ["quick.json"]
    card = SpooferCard.load(out)
    assert card.name == "quick"
    assert str(tmp_path) not in out.read_text()
    again = called(*TINY, "--out", out)
    assert again.exit_code == 2
    assert "exists; --overwrite replaces it" in again.output
    python, option, name, *words = shlex.split(card.training["command"])
    assert (python, option, name) == ("python", "-m", "baselines.profile")
    assert not {"--threads", "--json"} & set(words)
    monkeypatch.chdir(tmp_path)
    result = called(*words, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / "quick.json").read_text()) == json.loads(out.read_text())
    assert json.loads(result.stdout)["name"] == "quick"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--knots", "1"], "knots` must be "),
        (["--task", "T3"], "--task"),
        (["--out", "card.txt"], "`out` must be a .json file"),
        (["--out", "my profile.json"], "only letters, digits, '.', '_' and '-', got 'my profile"),
    ],
)
def test_bad_options_are_refused_in_one_line(tmp_path, options, message, monkeypatch):
    monkeypatch.setattr(module, "build_experiment", None)
    result = called(*TINY, "--out", tmp_path / "x.json", *options)
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())
    assert len(result.output.strip().splitlines()) == 1
