"""Where detectors and spoofers meet."""

from __future__ import annotations

from typing import Any

import pytest

from spoofgym.bench import Suite
from spoofgym.bench.runs.world import World
from spoofgym.tasks import get_task

TIMES = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}


def test_a_task_decides_its_world() -> None:
    assert World.of("T3") == World(settings=get_task("T3").world_kwargs)
    with pytest.raises(ValueError, match="`env`, `scenario` can't be given with task T3"):
        World.of("T3", env="spoofgym/Snapshot-v0", scenario="trolley")


def test_settings_by_name_and_further_ones_are_the_same() -> None:
    named = World.of(timeline=TIMES, between="hold", scenario=None)
    assert named == World.of(timeline=TIMES, settings={"between": "hold"})
    assert named.copy_with(between="ramp").settings == {"timeline": TIMES, "between": "ramp"}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"env": "T3"}, "unknown environment of the benchmark 'T3'"),
        ({"settings": {"speed": 1.0}}, "has no setting 'speed', got 1.0"),
        ({"settings": {"detector": "ewma"}}, "has no setting 'detector'"),
        ({"attack": "quiet", "settings": {"attack": "quiet"}}, "given by name, too"),
    ],
)
def test_what_is_no_world_is_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        World.of(**given)


def test_a_campaign_has_its_world_and_its_runs() -> None:
    suite = Suite(timeline=TIMES, entropy=3, detectors=["never"], spoofers=["none"])
    world = World.of(timeline=TIMES)
    assert {name: suite.config[name] for name in world.config} == world.config
    one, few = world.generators(3, "training", 3, first=2), suite.generators("training", 3)
    assert one[0].random() == few[2].random()
