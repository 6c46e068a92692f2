"""The standard suite: who plays, where, and at which sizes."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import pytest
from typer.testing import CliRunner

from spoofgym.bench.experiments import suite as standard
from spoofgym.bench.experiments.suite import Suite
from spoofgym.cli import app
from spoofgym.cli.suites import standard_suite
from spoofgym.detectors import Shewhart
from spoofgym.tasks import RANGE_RATE_TESTS, get_task


@pytest.fixture(scope="module")
def suite() -> Suite:
    from spoofgym.bench.runs.players import add_tuned_setting

    return standard_suite(
        None, {"spoofers": [add_tuned_setting(name) for name in standard.SPOOFERS]}
    )


def test_it_plays_in_the_world_of_the_task(suite: Suite) -> None:
    task = get_task(standard.TASK)
    given = {
        name: value for name, value in suite.world.settings.items() if name in task.world_kwargs
    }
    assert given == task.world_kwargs
    assert suite.alert_limit_m == (task.alert_limit_m or Suite.alert_limit_m)


def test_everyone_who_suits_plays_at_one_rate_and_the_controls_with_them(suite: Suite) -> None:
    names = {entry.spec["name"] for entry in suite.detector_players}
    specs = [entry.spec for entry in suite.detector_players]
    names_first = ["never", "lottery", "solution-separation"]
    assert [spec["name"] for spec in specs[:3]] == names_first
    first = specs[3 : 3 + len(RANGE_RATE_TESTS)]
    assert [(spec["name"], spec["signals"]) for spec in first] == [
        (spec["name"], "range_rate") for spec in RANGE_RATE_TESTS
    ]
    assert {"lottery", "snapshot-chi2", "ewma", "windowed-chi2", "raim"} <= names
    rates = {entry.spec.get("false_alarms_per_hour") for entry in suite.detector_players[1:]}
    assert rates == {standard.RATE}


def test_named_detectors_play_with_the_controls() -> None:
    named = ["ewma", "tests.bench.test_standard:Mine"]
    suite = standard_suite(named, {"spoofers": []})
    specs = [entry.spec for entry in suite.detector_players]
    assert [spec["name"] for spec in specs] == ["never", "lottery", *named]
    assert {spec.get("false_alarms_per_hour") for spec in specs[1:]} == {standard.RATE}


class Mine(Shewhart):
    """Somebody's own detector."""


def test_the_spoofers_are_fitted(suite: Suite) -> None:
    played = suite.spoofer_players[1:]
    assert [entry.spec.get("label") or entry.spec["name"] for entry in played] == list(
        standard.SPOOFERS
    )
    assert all(entry.tuned for entry in played)


class Seen(Exception):
    """What the command would play."""


def asked_for(*options: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    def seen(detectors: Any, settings: Any) -> Any:
        raise Seen(settings)

    monkeypatch.setattr(import_module("spoofgym.cli.bench"), "standard_suite", seen)
    result = CliRunner().invoke(app, ["bench", "--suite", "standard", *options])
    assert isinstance(result.exception, Seen)
    return dict(result.exception.args[0])


def test_its_sizes_are_defaults(monkeypatch: pytest.MonkeyPatch) -> None:
    found = asked_for(monkeypatch=monkeypatch)
    assert found["runs"] == standard.SIZES["seeds"]
    assert found["tuning"].runs == standard.SIZES["training_seeds"]
    assert found["selection"].runs == standard.SIZES["selection_seeds"]
    assert len(found["spoofers"]) == len(standard.SPOOFERS)


def test_sizes_may_be_given(monkeypatch: pytest.MonkeyPatch) -> None:
    options = ("--seeds", "40", "--training-seeds", "100", "--selection-seeds", "20", "--seed", "3")
    found = asked_for(*options, monkeypatch=monkeypatch)
    sizes = found["runs"], found["tuning"].runs, found["selection"].runs, found["entropy"]
    assert sizes == (40, 100, 20, 3)
