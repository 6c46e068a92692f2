"""Circumstances that a reset is told, in both forms and in the views of both sides."""

import numpy as np
import pytest

from spoofgym import duel_v0

from .support import BRIEF, SHORT, aec, parallel

DRAWN = {
    **BRIEF,
    "domain": {"start_s": (0.0, 30.0), "turned_deg": (0.0, 360.0), "worlds": 2},
    "target_heading_deg": "random",
}
TOLD = {"start_s": 12.0, "world": 1, "target_heading_deg": 45.0}
RAMP = {"name": "ramp", "heading_deg": "target"}
SINGLE = {
    "aec": lambda: aec(**DRAWN),
    "parallel": lambda: parallel(**DRAWN),
    "spoofer": lambda: duel_v0.SpooferView("never", action="full-command", **DRAWN),
    "detector": lambda: duel_v0.DetectorView(RAMP, **DRAWN),
}
VECTOR = {
    "spoofers": lambda **more: duel_v0.SpooferVectorView(3, "never", **DRAWN, **more),
    "detectors": lambda **more: duel_v0.DetectorVectorView(3, RAMP, **DRAWN, **more),
}


def batch_of(env):
    inner = env.unwrapped
    duel = inner.duel if hasattr(inner, "duel") else getattr(inner.core, "duel", None)
    return (inner.core if duel is None else duel.core).engine.simulator


def circumstances(env):
    """World, time from its begin to the onset, and heading of every receiver."""
    batch = batch_of(env)
    world, epochs = np.divmod(batch.onset, batch.setup.epochs_each)
    return world, epochs * batch.setup.interval_s, np.degrees(batch.heading)


def check_told(env, rows=slice(None)):
    world, begun, heading = circumstances(env)
    assert (set(world[rows]), set(begun[rows])) == ({1}, {12.0 + SHORT["warmup_s"]})
    np.testing.assert_allclose(heading[rows], 45.0)


@pytest.mark.parametrize("name", SINGLE)
def test_a_single_receiver(name):
    env = SINGLE[name]()
    env.reset(seed=3, options={"domain": TOLD})
    check_told(env)
    env.reset(seed=3)
    drawn = circumstances(env)
    env.reset(seed=3, options={"domain": {"world": 1 - drawn[0][0]}})
    world, *others = circumstances(env)
    assert world[0] == 1 - drawn[0][0]
    for told, was in zip(others, drawn[1:], strict=True):  # the rest is drawn as ever
        np.testing.assert_array_equal(told, was)


@pytest.mark.parametrize("name", ["aec", "parallel", "detector"])
def test_what_is_wrong_leaves_the_episode_alone(name):
    env = SINGLE[name]()
    env.reset(seed=1)
    before = batch_of(env).epochs.copy()
    for given, message in (
        ({"options": {"domain": {"wurld": 1}}}, "wurld"),
        ({"options": {"domain": {"start_s": 40.0}}}, "`start_s` must be"),
        ({"options": {"domain": 3}}, "`domain` of a reset must be"),
        ({"seed": -1}, "a seed must be a whole number of at least 0, got -1"),
    ):
        with pytest.raises((ValueError, TypeError), match=message):
            env.reset(**given)
        np.testing.assert_array_equal(batch_of(env).epochs, before)


@pytest.mark.parametrize("name", VECTOR)
def test_a_batch(name):
    envs = VECTOR[name](autoreset_mode="disabled")
    envs.reset(seed=3, options={"domain": {**TOLD, "world": [1, 0, 1]}})
    world, begun, _ = circumstances(envs)
    assert (world.tolist(), set(begun)) == ([1, 0, 1], {32.0})
    envs.reset(seed=3)
    before = circumstances(envs)
    mask = np.array([True, False, True])
    envs.reset(seed=3, options={"domain": TOLD, "reset_mask": mask})
    check_told(envs, mask)
    for now, was in zip(circumstances(envs), before, strict=True):
        assert now[1] == was[1]


def test_both_forms_and_the_views_begin_alike():
    told = {"seed": 8, "options": {"domain": TOLD}}
    observations, _ = SINGLE["parallel"]().reset(**told)
    attack, guard = observations["spoofer_0"], observations["detector_0"]
    aec_form = SINGLE["aec"]()
    aec_form.reset(**told)
    view = duel_v0.DetectorView(RAMP, decision_delay=1, **DRAWN)
    for mine, expected in (
        (aec_form.observe("detector_0"), guard),
        (aec_form.observe("spoofer_0"), attack),
        (SINGLE["spoofer"]().reset(**told)[0], attack),
        (view.reset(**told)[0], guard),
    ):
        np.testing.assert_array_equal(mine, expected)
