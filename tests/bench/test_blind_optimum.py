"""The search for a blind optimum: against a known one, its players, and in a campaign."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import special

from spoofgym.bench import CampaignResults, Suite, run_campaign, summarize
from spoofgym.bench.experiments.campaign import list_optima
from spoofgym.bench.report.campaign import markdown
from spoofgym.bench.runs.panel import Panel
from spoofgym.bench.runs.play import WarmStart, play
from spoofgym.bench.runs.players import specify_spoofer
from spoofgym.bench.search import open_loop as optima_module
from spoofgym.bench.search.attack_suite import AMPLITUDE_RANGE, Selection, build_grid
from spoofgym.bench.search.backends import (
    EngineBackend,
    ReplayBackend,
    compute_unit_commands,
    get_rate_limits,
)
from spoofgym.bench.search.open_loop import (
    AIMS,
    ENGINE,
    REPLAY,
    SHAPES,
    ZERO_ALARM,
    OpenLoopOptimizer,
    OpenLoopSearch,
    Optima,
    crossing,
    fit,
)
from spoofgym.detectors import detector_in_world
from spoofgym.envs.factory import make_setup
from spoofgym.limits import Replay
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.setup import make_generators, seed_sequences

from .support import SHORT, small_suite

BLIND = {"name": "blind-optimum", "amplitude": "tuned"}


class Quadratic:
    """A detector whose largest ratio is a weighted length of the curve times each run's noise.

    What is gained grows with the sum of the curve, so that the best of all curves is known.
    """

    def __init__(self, limits: tuple[float, float] = (1.0, math.inf), spread: float = 0.2) -> None:
        self.runs, self.steps, self.limits = 96, 120, limits
        self.noise = np.exp(spread * special.ndtri((np.arange(96) + 0.5) / 96))
        self.t = (np.arange(120) + 0.5) / 120
        self.weight = 40.0 * (1.0 + 4.0 * self.t) / 120
        self.played: list[np.ndarray] = []

    def length(self, curves: np.ndarray) -> np.ndarray:
        return np.sqrt((curves**2 * self.weight).sum(axis=-1))

    def play(self, curves: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.played.append(curves)
        return self.length(curves)[:, None] * self.noise[rows], np.abs(curves.mean(axis=1))

    def allowed(self, share: float) -> float:
        """Length of a curve at which a share of the runs alarm."""
        return float(np.exp(0.2 * special.ndtri(share)))

    def best(self, share: float) -> float:
        n = np.full(self.steps, 1.0 / self.steps)
        return self.allowed(share) * float(np.sqrt((n**2 / self.weight).sum()))

    def of(self, shape: np.ndarray, share: float) -> float:
        return float(shape.mean() / self.length(shape)) * self.allowed(share)


@pytest.mark.parametrize("share", [0.04, 0.5])
def test_the_search_finds_the_best_curve_of_a_known_detector(share: float) -> None:
    player = Quadratic()
    found = OpenLoopOptimizer(player, share, OpenLoopSearch()).search()
    # 0.96 to 0.98 of it over ten seeds; which one comes out depends on the processor, too
    assert 0.94 * player.best(share) <= found.displacement_m <= 1.01 * player.best(share)
    shapes = {name: player.of(shape(player.t), share) for name, shape in SHAPES.items()}
    assert found.start == max(shapes, key=lambda name: shapes[name])
    assert found.start_m == pytest.approx(max(shapes.values()), rel=0.05)
    assert found.displacement_m > 1.05 * max(shapes.values())
    # what it says of the curve is so
    (curve,) = OpenLoopOptimizer(player, share, OpenLoopSearch()).curves(found.rates_mps[None])
    assert player.length(curve) == pytest.approx(player.allowed(share), rel=0.05)
    assert curve.mean() == pytest.approx(found.displacement_m, rel=0.05)


@pytest.mark.parametrize("limits", [(0.05, math.inf), (0.05, 2e-3), (1.0, 4e-4)])
def test_what_is_played_keeps_the_limits_of_the_attack(limits: tuple[float, float]) -> None:
    player = Quadratic(limits)
    found = OpenLoopOptimizer(player, 0.5, OpenLoopSearch(generations=4)).search()
    assert np.abs(found.rates_mps).max() <= limits[0]
    curves = np.concatenate(player.played)
    assert np.abs(curves).max() <= limits[0] * (1.0 + 1e-12)
    change = np.diff(curves, axis=1, prepend=0.0)
    assert np.abs(change).max() <= limits[1] * (1.0 + 1e-12)
    if math.isfinite(limits[1]):
        assert np.abs(change).max() == pytest.approx(limits[1])


def test_the_same_seed_finds_the_same_and_another_one_something_else() -> None:
    first, again, other = (
        OpenLoopOptimizer(Quadratic(), 0.1, OpenLoopSearch(generations=5, seed=seed)).search()
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first.rates_mps, again.rates_mps)
    assert first.displacement_m == again.displacement_m
    assert not np.array_equal(first.rates_mps, other.rates_mps)


def test_an_earlier_curve_is_among_the_first_ones() -> None:
    player, optimizer = Quadratic(), OpenLoopSearch(generations=0)
    t = np.linspace(0.0, 1.0, optimizer.knots)
    best = 1.0 / (1.0 + 4.0 * t)
    found = OpenLoopOptimizer(player, 0.3, optimizer).search({"found before": 0.01 * best})
    assert found.start == "found before"
    assert found.displacement_m == pytest.approx(player.best(0.3), rel=0.03)


def test_where_nothing_alarms_the_search_is_over_at_once() -> None:
    class Deaf(Quadratic):
        def length(self, curves: np.ndarray) -> np.ndarray:
            return 1e-6 * super().length(curves)

    player, ticks = Deaf(), []
    found = OpenLoopOptimizer(player, 0.05, OpenLoopSearch()).search(tick=ticks.append)
    assert found.displacement_m == pytest.approx(1.0)
    assert found.start == "constant"
    assert found.saturated
    assert [len(curves) for curves in player.played] == [1]
    assert sum(ticks) <= 1.0


@pytest.mark.parametrize("runs", [0, 1, 2, 3])
def test_few_runs_that_count_are_searched_as_far_as_they_go(runs: int) -> None:
    player = Quadratic()
    player.runs = runs
    found = OpenLoopOptimizer(player, 0.05, OpenLoopSearch(generations=2)).search()
    assert found.rates_mps.shape == (24,)
    assert np.abs(found.rates_mps).max() > 0.0
    assert (found.displacement_m > 0.0) == (runs > 1)


def test_all_runs_play_before_any_comes_again() -> None:
    player = Quadratic()
    optimizer = OpenLoopOptimizer(player, 0.1, OpenLoopSearch(runs=96, batch=32))
    for again in (0, 3):
        rows = np.concatenate([optimizer._batch(again + k) for k in range(3)])
        np.testing.assert_array_equal(np.sort(rows), np.arange(96))


def test_an_amplitude_is_between_those_that_were_judged() -> None:
    scales = np.geomspace(1e-2, 1.0, 5)
    assert crossing(scales, scales / 0.05) == pytest.approx(0.05)
    assert crossing(scales, (scales / 0.05) ** 2) == pytest.approx(0.05)
    assert crossing(scales, 0.5 * scales) == 1.0
    assert crossing(scales, 500.0 * scales) == 1e-2


# --- players -------------------------------------------------------------------------------------


def players(
    heading_deg: float | str = 90.0, **settings: Any
) -> tuple[ReplayBackend, EngineBackend]:
    setup = make_setup(
        TightlyCoupledSetup,
        {"detector": "snapshot-chi2", "timeline": SHORT, **settings},
    )
    seeds = seed_sequences(0, "training", setup.name, 8)
    replay = Replay(setup, [setup.detector], seeds, threads=1)
    start = WarmStart(setup, make_generators(seed_sequences(0, "training", setup.name, 8)))
    engine = EngineBackend(start, play(start, "none"), heading_deg)
    return ReplayBackend(replay, 0, heading_deg), engine


@pytest.mark.parametrize(
    ("heading_deg", "settings"),
    [
        (90.0, {}),
        (200.0, {"target_heading_deg": 10.0}),
        (90.0, {"target_heading_deg": "random"}),
        ("target", {"target_heading_deg": "random"}),
        (90.0, {"decision_interval_s": 5.0}),
        (90.0, {"attack": {"name": "false-position", "control": "rate"}}),
    ],
)
def test_replay_and_engine_agree(heading_deg: float | str, settings: dict[str, Any]) -> None:
    replay, engine = players(heading_deg, **settings)
    assert (replay.runs, replay.steps, replay.limits) == (engine.runs, engine.steps, engine.limits)
    t = np.linspace(0.0, 1.0, replay.steps + 1)[1:]
    curves = np.array([0.5 * t, 0.4 * t * t])
    rows = np.array([5, 0, 3])
    (peak, reach), (expected, farthest) = (each.play(curves, rows) for each in (replay, engine))
    assert peak.shape == (2, 3)
    np.testing.assert_allclose(peak, expected, rtol=0.02)
    np.testing.assert_allclose(reach, farthest, rtol=0.01)
    clean, _ = engine.play(np.zeros((1, replay.steps)), rows)
    assert (expected > 1.2 * clean).all()  # so that the attack is seen


def test_a_player_moves_as_the_spoofer_does() -> None:
    for heading_deg, settings in (
        (90.0, {}),
        (250.0, {}),
        ("target", {"target_heading_deg": "random"}),
    ):
        _, engine = players(heading_deg, **settings)
        spec = {"name": "blind-optimum", "rates_mps": [0.0, 0.2, 0.5], "heading_deg": heading_deg}
        curve = OpenLoopOptimizer(engine, 0.5, OpenLoopSearch()).curves(
            np.array([spec["rates_mps"]])
        )
        peak, _ = engine.play(curve, np.arange(engine.runs))
        attacked = play(engine.start, spec)
        np.testing.assert_allclose(peak[0], attacked.peak, rtol=1e-6)


def test_attacks_on_single_channels_are_commanded_as_scripted_spoofers_do() -> None:
    setup = make_setup(TightlyCoupledSetup, {"detector": "never", "attack": "per-channel"})
    np.testing.assert_array_equal(
        compute_unit_commands(setup, 90.0, np.zeros(3)), np.ones((1, len(setup.action_names)))
    )
    assert get_rate_limits(setup) == (5.0, 0.05 * setup.interval_s)


# --- in a campaign -------------------------------------------------------------------------------


def blind_suite(**changes: Any) -> Suite:
    return small_suite(**{"spoofers": (BLIND,), "detectors": ("shewhart",), **changes})


FEW = OpenLoopSearch(runs=8, batch=4, knots=4, population=4, generations=2)


@pytest.fixture(autouse=True)
def _few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let searches of campaigns take a second."""
    monkeypatch.setattr(optima_module, "OpenLoopSearch", lambda: FEW)


def searched(suite: Suite) -> dict[str, Any]:
    (detector,) = suite.detector_players
    return suite.optima(threads=1).find(detector, specify_spoofer(BLIND), lambda part: None)


def test_a_passive_detector_is_searched_against_by_replay() -> None:
    found = searched(blind_suite())
    assert found["by"] == REPLAY
    assert found["linear_error"] < 0.02
    assert tuple(found["aims"]) == AIMS
    for aim in found["aims"].values():
        assert len(aim["rates_mps"]) == FEW.knots
        assert aim["displacement_m"] >= 0.9 * aim["start_m"] > 0.0
    assert found["aims"]["half"]["displacement_m"] >= found["aims"]["budget"]["displacement_m"]


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"detectors": ("ewma",)}, "takes weight off"),
        ({"attack": "per-channel"}, "commands S"),
    ],
)
def test_others_are_searched_against_on_the_engine_and_it_is_said_why(
    changes: dict[str, Any], why: str
) -> None:
    found = searched(blind_suite(**changes))
    assert found["by"] == ENGINE
    assert why in found["why"]
    assert found["linear_error"] is None


def test_a_curve_that_the_engine_displaces_otherwise_is_searched_again_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(optima_module, "LINEAR_ERROR", 0.0)
    found = searched(blind_suite())
    assert found["by"] == ENGINE
    assert found["linear_error"] > 0.0
    assert found["why"].startswith("the displacement by replay is off by")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> tuple[Suite, CampaignResults]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(optima_module, "OpenLoopSearch", lambda: FEW)
        suite = blind_suite(selection=Selection(runs=8, sift_runs=4, values=3), runs=8)
        folder = run_campaign(suite, tmp_path_factory.mktemp("blind"), threads=1)
    return suite, folder


def test_the_tuning_has_what_was_found_and_the_cell_plays_it(
    campaign: tuple[Suite, CampaignResults],
) -> None:
    _, folder = campaign
    tuning = folder.search("shewhart", "blind-optimum")
    assert tuning is not None
    assert tuning.found is not None
    assert tuning.found["by"] == REPLAY
    cell = folder.runs("shewhart", "blind-optimum")
    played = cell.head["spoofer_settings"]
    assert played["rates_mps"] == tuning.found["played"]["rates_mps"]
    assert played["amplitude"] == tuning.value


def test_the_curve_that_gets_farthest_on_the_training_runs_is_played(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    profile = {"name": "profile", "rates_mps": (0.0, 0.1, 0.4), "label": "mine"}
    suite = blind_suite(spoofers=(BLIND, profile))
    found = {
        "by": REPLAY,
        "aims": {name: {"rates_mps": [0.3] * 12 + [-0.2] * 12} for name in AIMS},
        "shapes": {ZERO_ALARM: [0.0, 0.1, 0.3]},
    }
    monkeypatch.setattr(Optima, "find", lambda *_: copy.deepcopy(found))
    (detector,) = suite.detector_players
    judges, optima = [detector_in_world(detector.spec)], suite.optima()
    panel = Panel(suite.world.setup, judges, lambda: suite.generators("training", 6), 1)
    (result,) = fit(panel, {0: detector}, specify_spoofer(BLIND), suite.tuning, lambda: optima)
    assert result.found is not None
    fitted = result.found["fitted_m"]
    assert set(fitted) == {"found", "constant", "linear", "mine", ZERO_ALARM}
    assert fitted["found"] < max(fitted.values()) == result.score
    played = result.found["played"]
    assert fitted[played["curve"]] == result.score
    assert played["rates_mps"] == optima.curves_to_fit(found)[played["curve"]]
    # nothing gets farther than the largest rate, where that was found
    limit, _ = get_rate_limits(suite.world.setup)
    fastest = {"aims": {name: {"rates_mps": [limit] * 4} for name in AIMS}}
    assert list(optima.curves_to_fit(fastest)) == ["found"]


def test_a_campaign_that_goes_on_finds_the_same(
    campaign: tuple[Suite, CampaignResults], tmp_path: Path
) -> None:
    suite, folder = campaign
    again = run_campaign(suite, tmp_path, threads=1)
    files = sorted((folder.path / "cells").iterdir())
    assert len(files) == 6
    for file in files:
        assert (tmp_path / "cells" / file.name).read_bytes() == file.read_bytes()
    one, search = (
        again.store.build_path(f"shewhart / blind-optimum / {kind}") for kind in ("runs", "search")
    )
    one.unlink()
    before = search.stat().st_mtime_ns
    run_campaign(suite, tmp_path, threads=1)  # by what the search has, without another one
    assert search.stat().st_mtime_ns == before
    assert one.read_bytes() == (folder.path / "cells" / one.name).read_bytes()


def test_the_blind_optimum_is_a_candidate_of_the_protection(
    campaign: tuple[Suite, CampaignResults], monkeypatch: pytest.MonkeyPatch
) -> None:
    suite, folder = campaign
    (detector,) = suite.detector_players
    members = list_optima(suite, folder, detector)
    tuning = folder.search("shewhart", "blind-optimum")
    assert tuning is not None
    assert tuning.found is not None
    each = tuning.found["played"], *(tuning.found["aims"][name] for name in AIMS)
    curves = [curve["rates_mps"] for curve in each]
    # two aims may have found the same curve, which plays once
    assert [each.player.spec["rates_mps"] for each in members] == [
        curve for k, curve in enumerate(curves) if curve not in curves[:k]
    ]
    for member in members:
        assert member.player.tuned == "amplitude"
        grid = build_grid(member, suite.world.context, 5)
        assert (grid[0], grid[-1]) == pytest.approx(AMPLITUDE_RANGE, rel=1e-3)
    assert summarize(folder)
    assert "blind-optimum" in markdown(folder, summarize(folder))


def test_one_without_rates_must_be_tuned() -> None:
    suite = blind_suite(spoofers=("blind-optimum",))
    with pytest.raises(ValueError, match="a blind optimum is looked for under the alarm budget"):
        suite.check_fit()
