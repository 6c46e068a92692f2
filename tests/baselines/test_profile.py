"""The search for a profile: it improves, keeps its budget, and goes on where it was killed."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cmaes")

from typer.testing import CliRunner

from baselines.profile import app
from baselines.profile_choice import choose
from baselines.profile_run import Bounds, ProfileRun, RunSettings
from baselines.profile_search import ProfileSearch, profile_at, soft_alarms
from baselines.profile_settings import SearchSettings, Start
from baselines.profile_start import best_start, resampled
from baselines.runs import Outcome, RunPool
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.play import displacement_of, play
from spoofgym.bench.scores.scores import counted, stealth_of
from spoofgym.bench.scores.statistics import most_alarms
from spoofgym.bench.search.amplitude import Trial, TuningResult
from spoofgym.detectors import Ewma
from spoofgym.spoofers import Card, Profile, make_spoofer
from spoofgym.spoofers.profile import sampled
from tests.bench.support import QUICK, small_suite

SEARCH = SearchSettings(knots=8, population=6, batch=4, budget=0.6)
SETTINGS = RunSettings(search=SEARCH, runs=8, select_runs=8)
START = Start([0.1] * 8, 1.0)


def suite_of(**changes: Any) -> Suite:
    settings = {
        "detectors": (Ewma(false_alarm=1e-3),),
        # fast enough to be noticed within the short window
        "attack": {"name": "false-position", "acceleration_limit_mps2": 0.5},
        "spoofers": (
            {"name": "ramp", "rate_mps": "tuned"},
            {"name": "accelerating-ramp", "acceleration_mps2": "tuned"},
        ),
        "tuning": replace(QUICK, runs=8),
        **changes,
    }
    return small_suite(**settings)


def pool_of(first: int, last: int) -> RunPool:
    suite = suite_of()
    setup = suite.setup(suite.detector_entries[0])
    return RunPool(setup, suite.generators("training", last)[first:], threads=1)


@pytest.fixture(scope="module")
def pool() -> RunPool:
    return pool_of(8, 16)


@pytest.fixture(scope="module")
def chosen() -> RunPool:
    return pool_of(0, 8)


def run_of(out: Path, **changes: Any) -> ProfileRun:
    settings = {"threads": 1, **changes}
    run_settings = settings.pop("settings", SETTINGS)
    return ProfileRun(settings.pop("suite", suite_of()), run_settings, out, **settings)


def silent(part: float, now: str) -> None:
    assert 0.0 <= part <= 1.0
    assert now


@pytest.mark.parametrize("across", [(), (0.1, -0.1)])
def test_side_by_side_is_as_one_after_the_other(pool: RunPool, across: tuple[float, ...]) -> None:
    profiles = [
        Profile(rates_mps=(v, 2.0 * v), cross_rates_mps=across, heading_deg=40.0)
        for v in (0.05, 0.2, 0.6)
    ]
    rows = np.array([1, 5, 6])
    outcome = pool.play(profiles, rows)
    assert outcome.displacement_m.shape == outcome.alarm.shape == (3, 3)
    for k, profile in enumerate(profiles):
        alone = play(pool.start.take(rows), profile)
        displacement = displacement_of(pool.setup, alone, pool.clean.take(rows))
        np.testing.assert_array_equal(outcome.displacement_m[k], displacement)
        np.testing.assert_array_equal(outcome.alarm[k], alone.alarm.any(axis=0))


def test_a_large_population_is_played_in_parts(
    pool: RunPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    profiles = [Profile(rates_mps=(v, v)) for v in (0.1, 0.3, 0.5)]
    whole = pool.play(profiles)
    monkeypatch.setattr("baselines.runs.MOST_RECEIVERS", 16)
    for one, other in zip(whole, pool.play(profiles), strict=True):
        np.testing.assert_array_equal(one, other)


def test_runs_that_came_close_count_in_part() -> None:
    outcome = Outcome(
        displacement_m=np.zeros((2, 3)),
        alarm=np.array([[True, False, False], [False, False, False]]),
        peak=np.array([[1.2, 0.5, 0.9], [0.99, 0.5, 0.9]]),
        counts=np.array([True, True, False]),
    )
    alarmed, close = soft_alarms(outcome)
    assert 0.8 / 2.0 < close < 1.0 / 2.0 < alarmed < 1.1 / 2.0
    np.testing.assert_allclose(outcome.alarm_rate, [0.5, 0.0])


@pytest.mark.parametrize("count", [1, 2])
def test_candidates_are_shortened_to_the_limit_of_the_rate(count: int) -> None:
    settings = replace(SEARCH, cross=count == 2)
    rng = np.random.default_rng(5)
    for _ in range(50):
        profile = profile_at(settings, rng.normal(0.0, 40.0, 8 * count), 5.0)
        along, across = profile.rates_mps, profile.cross_rates_mps or (0.0,) * 8
        assert np.hypot(sampled(along, 300), sampled(across, 300)).max() <= 5.0 * (1.0 + 1e-12)
        assert np.hypot(along, across).max() > 3.5
    slow = rng.uniform(-1.0, 1.0, 8 * count)
    profile = profile_at(settings, slow, 5.0)
    np.testing.assert_array_equal([*profile.rates_mps, *profile.cross_rates_mps], slow)


class HillPool:
    """Displacement by formula: the nearer to a target curve, the farther; never an alarm."""

    target = np.linspace(0.3, 0.0, 8)

    def __init__(self, pool: RunPool) -> None:
        self.setup, self.runs = pool.setup, pool.runs
        self.played: list[list[int]] = []

    def play(self, profiles: list[Profile], rows: np.ndarray) -> Outcome:
        self.played.append(rows.tolist())
        off = np.array([np.linalg.norm(p.rates_mps - self.target) for p in profiles])
        shape = (len(profiles), len(rows))
        return Outcome(
            np.repeat(10.0 - off[:, None], len(rows), axis=1),
            np.zeros(shape, dtype=np.bool_),
            np.full(shape, 0.1),
            np.ones(len(rows), dtype=np.bool_),
        )


def test_the_search_climbs_to_the_top(pool: RunPool) -> None:
    hill: Any = HillPool(pool)
    search = ProfileSearch(hill, SEARCH, START)
    for _ in range(60):
        search.step()
    found = search.profile(search.shapes()["mean"])
    np.testing.assert_allclose(found.rates_mps, HillPool.target, atol=0.03)
    # eight runs in two parts: every two generations all have had their turn
    for one, other in zip(hill.played[::2], hill.played[1::2], strict=True):
        assert sorted(one + other) == list(range(8))


def test_a_search_that_has_converged_begins_again_or_is_over(pool: RunPool) -> None:
    hill: Any = HillPool(pool)
    search = ProfileSearch(hill, replace(SEARCH, restarts=1), START)
    while not search.finished and len(search.generations) < 1000:
        search.step()
    once = ProfileSearch(hill, SEARCH, START)
    while not once.finished and len(once.generations) < 1000:
        once.step()
    assert once.finished
    assert search.finished
    assert len(search.generations) > len(once.generations)
    assert search.generations[: len(once.generations)] == once.generations


def test_alarms_become_dearer_while_there_are_too_many(pool: RunPool) -> None:
    search = ProfileSearch(pool, SEARCH, Start([3.0] * 8, 1.0))
    first = search.price
    for _ in range(3):
        assert search.step().alarm_rate > SEARCH.budget
    assert search.price > first


def test_the_search_gets_farther_than_it_began(pool: RunPool) -> None:
    curves = [np.full(8, 0.1)]
    start = best_start(pool, SEARCH, curves)
    search = ProfileSearch(pool, SEARCH, start)
    for _ in range(8):
        search.step()
    choice = choose(search, pool, search.settings.budget)
    alone = pool.play([Profile(rates_mps=tuple(start.rates_mps))])
    assert alone.alarm_rate[0] <= SEARCH.budget
    assert choice.fit.stealthy_displacement_m > 1.2 * alone.mean_m[0]


def test_what_is_chosen_keeps_to_the_budget_when_played(pool: RunPool, chosen: RunPool) -> None:
    search = ProfileSearch(pool, SEARCH, Start([0.3] * 8, 3.0))
    search.step()
    choice = choose(search, chosen, search.settings.budget)
    alone = play(chosen.start, choice.profile)
    counts = counted(chosen.start.warmup_alarm, chosen.clean.first_alarm)
    displacement = displacement_of(chosen.setup, alone, chosen.clean)
    found = stealth_of(displacement, alone.first_alarm > 0, counts)
    assert found.keeps(SEARCH.budget)
    assert found.alarm_rate == choice.fit.alarm_rate
    np.testing.assert_array_equal(choice.displacement_m, displacement[counts])
    kept = [fit for fit in choice.fits if fit.within_budget]
    assert len(kept) < len(choice.fits)
    assert choice.fit.stealthy_displacement_m == max(fit.stealthy_displacement_m for fit in kept)


def test_nothing_within_the_budget_is_said(pool: RunPool, chosen: RunPool) -> None:
    search = ProfileSearch(pool, SEARCH, Start([4.0] * 8, 1.0))
    search.step()
    with pytest.raises(ValueError, match=r"no profile of the search is within the alarm budget"):
        choose(search, chosen, search.settings.budget)


def test_the_same_seed_gives_the_same_search_and_another_one_another(pool: RunPool) -> None:
    def two_generations(seed: int) -> Any:
        search = ProfileSearch(pool, replace(SEARCH, seed=seed), START)
        return [search.step(), search.step()]

    assert two_generations(1) == two_generations(1)
    assert two_generations(1)[0].points != two_generations(2)[0].points


@pytest.mark.parametrize("cross", [False, True])
def test_a_killed_search_goes_on_to_the_identical_result(tmp_path: Path, cross: bool) -> None:
    class KilledError(Exception):
        pass

    def kill(part: float, now: str) -> None:
        if now.startswith("generation 2"):
            raise KilledError

    settings = replace(SETTINGS, search=replace(SEARCH, cross=cross))
    whole = run_of(tmp_path / "whole.json", settings=settings).play(Bounds(None, 4), silent)
    with pytest.raises(KilledError):
        run_of(tmp_path / "part.json", settings=settings).play(Bounds(None, 4), kill)
    resumed = run_of(tmp_path / "part.json", settings=settings)
    assert len(resumed.generations) == 2
    assert len(resumed.ramps) == 2
    choice = resumed.play(Bounds(None, 4), silent)
    assert choice.profile == whole.profile
    assert choice.fits == whole.fits
    assert bool(choice.profile.cross_rates_mps) is cross
    records = [
        json.loads((tmp_path / f"{name}.search.json").read_text()) for name in ("whole", "part")
    ]
    for record in records:
        del record["elapsed_s"]
    assert records[0] == records[1]


def test_a_record_of_another_search_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "a.json"
    run_of(out).play(Bounds(None, 1), silent)
    other = replace(SETTINGS, search=replace(SEARCH, seed=3))
    with pytest.raises(ValueError, match=r"another search \(different: search\.search\.seed\)"):
        run_of(out, settings=other)
    with pytest.raises(ValueError, match=r"another search \(different: entropy\)"):
        run_of(out, suite=suite_of(entropy=1))
    assert run_of(out, settings=other, resume=False).generations == []
    path = tmp_path / "a.search.json"
    content = json.loads(path.read_text())
    content["generations"][0]["points"][0][0] += 1e-3
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match="generation 0 of the record is not what this search"):
        run_of(out).play(Bounds(None, 2), silent)
    path.write_text(path.read_text()[:-20])
    with pytest.raises(ValueError, match=r"a\.search\.json is no record of a search"):
        run_of(out)


def test_another_number_of_knots_keeps_the_curve() -> None:
    rates = (0.1, 0.4, 0.2, 0.5)
    np.testing.assert_allclose(resampled(rates, 4), rates, rtol=1e-12)
    more = resampled(rates, 16)
    assert len(more) == 16
    np.testing.assert_allclose(more[1:], sampled(rates, 15))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"knots": 7}, "`knots` must be 8 to 16, got 7"),
        ({"knots": 17}, "`knots` must be 8 to 16, got 17"),
        ({"population": 3}, "`population` must be at least 4, got 3"),
        ({"budget": 0.0}, "`budget` must be above 0 and below 1, got 0"),
        ({"restarts": -1}, "`restarts` must be at least 0, got -1"),
    ],
)
def test_bad_settings_of_the_search_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(SEARCH, **changes)


TINY = shlex.split(
    "--detector ewma:false_alarm=0.001 --attack false-position:acceleration_limit_mps2=0.5 "
    "--population 4 --knots 8 --runs 6 --batch 3 --select-runs 6 --budget 0.6 "
    "--warmup-s 20 --live-s 10 --attack-s 20 --time-to-alert-s 5 --threads 1 --generations 1"
)


def test_the_command_writes_a_card_that_makes_the_profile(tmp_path: Path) -> None:
    out = tmp_path / "quick.json"
    result = CliRunner().invoke(app, [*TINY, "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "accelerating-ramp" in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["quick.json"]
    card = Card.load(out)
    assert card.name == "quick"
    assert str(tmp_path) not in out.read_text()
    made = make_spoofer({"name": card.kind, **card.settings})
    assert isinstance(made, Profile)
    assert made.label == "quick"
    assert made.designed_on == card.knowledge.design_time != "nothing"
    assert card.training["generations"] == 1
    assert card.decided_on == {(card.training["seed"], "training")}
    (score,) = card.scores
    assert score.alarm_rate <= 0.45
    assert score.counted is not None
    assert [row["spoofer"].split(":")[0] for row in card.rivals][-1] == "profile"
    again = CliRunner().invoke(app, [*TINY, "--out", str(out)])
    assert again.exit_code == 2
    assert "exists; --overwrite replaces it" in again.output
    begun = tmp_path / "begun.json"
    result = CliRunner().invoke(app, [*TINY, "--start", str(out), "--out", str(begun), "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["name"] == "begun"
    assert str(tmp_path) not in result.stdout
    assert "--start quick.json" in told["training"]["command"]


def test_the_command_of_a_card_makes_it_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "far" / "away.json"
    result = CliRunner().invoke(app, [*TINY, "--cross", "--json", "--out", str(out)])
    card = json.loads(result.stdout)
    python, module, name, *words = shlex.split(card["training"]["command"])
    assert (python, module, name) == ("python", "-m", "baselines.profile")
    assert "--cross" in words
    assert not {"--threads", "--json"} & set(words)
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    again = json.loads((tmp_path / "away.json").read_text())
    for found in (card, again):
        del found["training"]["wall_s"]
    assert again == card


def test_the_search_aims_at_what_the_choice_will_keep(tmp_path: Path) -> None:
    def ramp(counted: int) -> TuningResult:
        trial = Trial(1.0, 400, counted, 0.01, 0.03, 5.0, True)
        more = {"runs": 400, "counted": counted, "clean_alarm_rate": 0.0, "warmup_alarms": 0}
        told = {"value": 1.0, "within_budget": True, "budget": 0.05, "trials": (trial,), **more}
        return TuningResult("ewma", "ramp", "rate_mps", **told)

    run = run_of(
        tmp_path / "a.json", settings=replace(SETTINGS, search=replace(SEARCH, budget=0.05))
    )
    run.ramps = [ramp(400), ramp(300)]
    assert run.aim == most_alarms(300, 0.05) / 300


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--detector", "ewmaa"], "did you mean 'ewma'"),
        (["--knots", "4"], "`knots` must be 8 to 16, got 4"),
        (["--seconds", "0"], "`seconds` must be finite and > 0, got 0"),
        (["--batch", "7"], "`runs` must be at least `batch` = 7, got 6"),
        (["--start", "nowhere.json"], "there is no card nowhere.json"),
        (["--out", "card.txt"], "`out` must be a .json file"),
        (["--out", "my profile.json"], "only letters, digits, '.', '_' and '-', got 'my profile"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    tmp_path: Path, options: list[str], message: str
) -> None:
    result = CliRunner().invoke(app, [*TINY, "--out", str(tmp_path / "x.json"), *options])
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())
    assert len(result.output.strip().splitlines()) == 1
