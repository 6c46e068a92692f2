"""What pictures show: the history of an episode beside its clean twin."""

from types import SimpleNamespace

import numpy as np
import pytest

from spoofgym.core.plots import figure_class
from spoofgym.envs.rendering import CoreRecorder, RenderHistory
from spoofgym.envs.rendering.panels import NAME_SIZE, FlightMap, place_names
from spoofgym.simulation import TightlyCoupledSetup

from ..support import VICTIMS, victim

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 10.0, "time_to_alert_s": 2.0}


def core_of(kind="Zhong2025", **kwargs):
    settings = {"timeline": SHORT} if kind == "Zhong2025" else {}
    return victim(kind, **{"end_at_alarm": False, **settings, **kwargs}).unwrapped.core


def play(core, action, steps=8):
    """History of some steps."""
    core.reset([np.random.default_rng(3)])
    recorder = CoreRecorder(core)
    history = RenderHistory(recorder.start_episode(), recorder.interval_s)
    history.add(*recorder.frames(), {k: v[0] for k, v in core.reset_info().items()})
    for _ in range(steps):
        result, _ = core.step(np.full((1, len(core.action_names)), action))
        history.add(*recorder.frames(), {k: v[0] for k, v in result.info.items()})
    return history


@pytest.mark.parametrize("kind", VICTIMS)
def test_the_twin_is_a_run_without_attack_and_both_begin_at_the_onset(kind):
    """Bit for bit: same seed, same detector in the loop, zero action."""
    core = core_of(kind)
    attacked, clean = play(core, 0.7), play(core_of(kind), 0.0)
    np.testing.assert_array_equal(attacked.pair("twin_error_ne"), clean.pair("error_ne"))
    np.testing.assert_array_equal(attacked.number("twin_ratio"), clean.number("ratio"))
    assert attacked.number("induced_m")[-1] > 0.01
    np.testing.assert_array_equal(clean.number("induced_m"), 0.0)
    layout, interval_s = attacked.layout, core.setup.interval_s
    np.testing.assert_allclose(attacked.number("time_s"), np.arange(9) * interval_s, atol=1e-9)
    np.testing.assert_array_equal(attacked.pair("position_ne")[0], 0.0)
    np.testing.assert_allclose(attacked.pair("position_ne"), layout.track_ne[:9], atol=1e-9)
    assert len(layout.track_ne) == round((layout.attack_s + layout.hold_s) / interval_s) + 1


def test_over_decisions_the_twin_follows_through_the_time_to_alert_which_does_not_count():
    core = core_of(detector="never", decision_interval_s=5.0)
    attacked, clean = play(core, 1.0, steps=2), play(core, 0.0, steps=2)
    np.testing.assert_array_equal(attacked.pair("twin_error_ne"), clean.pair("error_ne"))
    np.testing.assert_array_equal(clean.number("induced_m"), 0.0)
    assert attacked.number("induced_m")[-1] > 1.0
    np.testing.assert_allclose(attacked.number("counted_s"), [0.0, 5.0, 10.0])
    np.testing.assert_allclose(attacked.number("time_s"), [0.0, 5.0, 12.0])


def test_displacement_error_and_verdict_are_those_of_the_game():
    core = core_of(detector={"name": "ewma", "false_alarm": 1e-9})
    history = play(core, 1.0)
    moved = core.engine.simulator.attack.memory["displacement"][0]
    np.testing.assert_array_equal(history.pair("displacement_ne")[-1], moved)
    verdict = core.engine.simulator.verdict
    assert history.number("ratio")[-1] == (verdict.statistic / verdict.threshold).max()
    east = history.pair("error_ne")[:, 1]
    assert not history.alarm.any()
    most = np.maximum.accumulate(east - east[0])[-1]
    assert most == pytest.approx(core.score.undetected[0])


def test_the_sky_marks_what_is_spoofed_and_names_lie_beside_one_another():
    world = TightlyCoupledSetup(timeline=SHORT).world
    chosen = tuple(name for name in world.satellite_ids if name)[:3]
    core = core_of(attack={"name": "false-position", "channels": chosen})
    assert not play(core, 0.0).sky.spoofed.any()
    sky = play(core, 1.0).sky
    named = [name in chosen for name in sky.names]
    np.testing.assert_array_equal(sky.spoofed, sky.visible & named)
    core = core_of("Snapshot")
    sky = play(core, 1.0).sky
    np.testing.assert_array_equal(sky.spoofed, core.engine.simulator.memory["spoofed"][0])
    assert (sky.elevation > 0.0).all()
    toward = core.engine.simulator.lines_of_sight_n()[0]
    turned = np.cos(sky.elevation) * np.exp(1j * sky.azimuth)
    np.testing.assert_allclose(turned, toward[:, 0] + 1j * toward[:, 1])
    # an attack on channels has no commanded position
    attack = {"name": "per-channel", "control": "rate"}
    history = play(core_of(attack=attack, scenario="trolley-two-constellations"), 0.1, steps=2)
    assert not history.layout.commands_position
    assert np.isnan(history.pair("displacement_ne")).all()
    assert history.layout.title.startswith("trolley-two-constellations: ")
    middles = np.array([[-0.7, 0.0], [0.0, 0.6], [0.0, -0.6], [0.7, 0.1]])
    place = np.concatenate([middles, middles + 0.03]).T  # four pairs

    def shared(corners):
        apart = np.abs(corners[:, None] - corners[None]) - np.array(NAME_SIZE)
        return (apart < -1e-9).all(axis=-1).sum() - len(corners)

    assert shared(place.T) == 8  # all in the upper right
    assert shared(np.array(place_names(place, np.ones(8, dtype=bool)))) == 0
    alone = place_names(np.zeros((2, 1)), np.ones(1, dtype=bool))
    assert alone == [(0.06, 0.04)]


def test_the_map_keeps_its_scale_up_to_an_error_that_is_known():
    core = core_of()
    core.reset([np.random.default_rng(3)])
    layout = CoreRecorder(core).start_episode()

    def list_scales(largest_m):
        ax = figure_class()().subplots()
        flight, scales = FlightMap(ax, layout, largest_m), []
        for error_m in (1.0, 10.0, 40.0, 90.0):
            flight.fit(SimpleNamespace(number=lambda _, x=error_m: np.array([x])))
            scales.append(ax.texts[-1].get_text())
        return scales

    assert len({*list_scales(0.0)}) == 4
    first, *rest = list_scales(40.0)
    assert rest[:2] == [first, first] != rest[1:]
