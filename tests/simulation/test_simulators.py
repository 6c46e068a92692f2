"""What holds for the simulators of all victims: moves, twins, domains."""

import numpy as np
import pytest

from spoofgym.detectors import Never
from spoofgym.simulation import Engine

from .support import DOMAINS, SETUPS, SHORT, rngs, setup_of, step, warm

every_victim = pytest.mark.parametrize("kind", SETUPS)


def commands(setup, receivers, steps=8):
    rng = np.random.default_rng(0)
    return rng.uniform(-1.0, 1.0, (steps, receivers, len(setup.action_names)))


def seen(simulator):
    """What a receiver is and shows, by name, each with a leading axis of receivers."""
    setup, b = simulator.setup, simulator.receivers
    out = {f"detector {name}": array for name, array in simulator.detector.memory.items()}
    out |= dict(simulator.memory)
    for name, width in (("motion", setup.motion_names), ("geometry", setup.geometry_names)):
        out[name] = np.full((b, len(width)), np.nan, dtype=np.float32)
    simulator.motion(1e-4, 1e-2, out["motion"])
    if setup.geometry_names and setup.kind != "tightly-coupled":  # which has a table of it
        simulator.geometry(out["geometry"])
    else:
        del out["geometry"]
    displacement = np.empty(b)
    simulator.displacement(np.zeros((b, 2)), None, displacement)
    out |= {
        "displacement": displacement,
        "commanded": simulator.commanded_displacement,
        "commanded rate": simulator.commanded_rate,
        "error": simulator.error_n(),
        "time": simulator.time_s(),
        "ratio": simulator.ratio(),
        "weights": simulator.observed_weights(),
        "coasting": simulator.coasting,
    }
    return {name: np.array(array) for name, array in out.items()}


def assert_same(mine, theirs, rows=slice(None)):
    others = seen(theirs)
    for name, array in seen(mine).items():
        np.testing.assert_array_equal(array[rows], others[name][rows], err_msg=name)


@every_victim
def test_zero_command_is_the_clean_run(kind):
    setup = setup_of(kind)
    clean, idle, spared, attacked = (warm(setup, 3) for _ in range(4))
    spared.clean = np.array([True, True, False])
    for k, action in enumerate(commands(setup, 3, steps=12)):
        step(clean)
        step(idle, np.zeros_like(action) if k else None)
        step(spared, action)
        step(attacked, action)
        assert_same(clean, idle)
        np.testing.assert_array_equal(spared.error_n()[:2], clean.error_n()[:2])
        assert_same(spared, attacked, [2])
    assert (attacked.error_n() != clean.error_n()).any(axis=1).all()


@every_victim
def test_a_twin_is_the_receiver_without_the_attack(kind):
    setup = setup_of(kind, target_heading_deg="worst")
    engine = Engine(3, setup, twin=True)
    engine.reset(rngs(3))
    apart, origin = np.empty(3), np.zeros((3, 2))
    for _ in range(4):
        engine.step(None)
        assert_same(engine.simulator, engine.twin)
    engine.simulator.displacement(origin, engine.twin, apart)
    assert not apart.any()
    for _ in range(4):
        engine.step(np.ones((3, len(setup.action_names))))
    alone = warm(setup, 3)
    for _ in range(8):
        step(alone)
    assert_same(engine.twin, alone)
    engine.simulator.displacement(origin, engine.twin, apart)
    assert (apart > 0.0).all()
    held, of_twin = engine.hold(np.array([0, 2]))
    assert held.shape == of_twin.shape == (setup.hold, 2)
    assert engine.twin.time_s()[1] < engine.twin.time_s()[0] == engine.simulator.time_s()[0]


@every_victim
@pytest.mark.parametrize("heading", [30.0, "worst"])
def test_the_displacement_is_the_error_along_the_target_since_the_origin(kind, heading):
    mine, out = warm(setup_of(kind, target_heading_deg=heading), 3), np.empty(3)
    origin = mine.origin_ne().copy()
    assert origin.any(axis=1).all()
    mine.displacement(origin, None, out)
    np.testing.assert_allclose(out, 0.0, atol=1e-6)
    for action in commands(mine.setup, 3):
        step(mine, action)
    mine.displacement(origin, None, out)
    north, east = (mine.error_n()[:, :2] - origin).T
    along = north * np.cos(np.radians(30.0)) + east * np.sin(np.radians(30.0))
    expected = np.hypot(north, east) if heading == "worst" else along
    np.testing.assert_allclose(out, expected, rtol=1e-6, atol=1e-6)


@every_victim
def test_decisions_last_and_an_episode_has_an_epoch_in_reserve(kind):
    interval = setup_of(kind).interval_s
    setup = setup_of(kind, decision_interval_s=5.0 * interval, between="linear")
    assert setup.repeat == 5
    assert setup.length == setup_of(kind).length  # so that episodes start at the same times
    engine = Engine(3, setup, twin=True)
    engine.reset(rngs(3))
    for _ in range(setup.steps + setup.hold + 1):
        engine.step(None)
    assert np.isfinite(engine.simulator.error_n()).all()
    np.testing.assert_allclose(engine.simulator.time_s(), setup.length * interval)
    message = "`decision_interval_s` must be a multiple of the interval between epochs"
    with pytest.raises(ValueError, match=message):
        setup_of(kind, decision_interval_s=1.5 * interval)


@every_victim
@pytest.mark.parametrize("drawn", [False, True])
def test_the_onset_is_the_end_of_the_warm_up_wherever_an_episode_starts(kind, drawn):
    setup = setup_of(kind, domain=DOMAINS[kind] if drawn else {})
    mine, motion = warm(setup, 6), np.full((6, len(setup.motion_names)), np.nan)
    assert (len({*mine.memory["first"]}) > 1) == drawn
    np.testing.assert_array_equal(mine.onset, mine.epochs)
    mine.motion(1.0, 1.0, motion)
    np.testing.assert_allclose(motion[:, :2], 0.0, atol=1e-6)  # since the onset
    onset_s, line = mine.time_s().copy(), SHORT[kind]["timeline"]
    assert mine.layout().onset_s == onset_s[0] == setup.epoch_time[mine.epochs[0]]
    step(mine)
    np.testing.assert_allclose(mine.time_s(), onset_s + setup.interval_s)
    np.testing.assert_allclose(mine.epoch.time, mine.time_s())
    assert setup.hold * setup.interval_s == line["time_to_alert_s"]
    if not drawn:
        np.testing.assert_allclose(onset_s, line["warmup_s"])


@every_victim
def test_what_is_observed_has_names_and_scales(kind):
    setup = setup_of(kind)
    mine = warm(setup, 3)
    step(mine, 0.5)
    shown = seen(mine)
    for name, names in (
        ("error", setup.error_names),
        ("weights", setup.weight_names),
        ("motion", setup.motion_names),
        ("commanded", setup.action_names),
    ):
        assert shown[name].shape == (3, len(set(names))), name
        assert np.isfinite(shown[name]).all(), name
    assert {"length_m", "position_m", "velocity_mps"} <= set(setup.scales)
    assert setup.error_names[:2] == ("north", "east")
    layout, frame = mine.layout(), mine.frame()
    assert layout.track_ne.shape == (setup.steps + setup.hold + 1, 2)
    assert layout.has_sky == (frame.sky is not None) == bool(setup.geometry_names)
    np.testing.assert_allclose(frame.position_ne, layout.track_ne[1], atol=1e-6)
    np.testing.assert_allclose(frame.displacement_ne, mine.commanded_displacement[0, :2])
    assert frame.ratio == mine.ratio()[0]


@every_victim
def test_what_fits_no_victim_is_refused(kind):
    for settings, message in (
        ({"target_heading_deg": "north"}, "a finite number, 'random' or 'worst', got"),
        ({"timeline": {"attack_s": 1e9}}, "an episode must have at most 100000 epochs"),
        ({"domain": {"start": 1.0}}, "`domain` has no setting 'start'"),
    ):
        with pytest.raises(ValueError, match=message):
            setup_of(kind, **settings)
    setup, needy, late = setup_of(kind), Never(), Never()
    with pytest.raises(ValueError, match="`receivers` must be a whole number of at least 1"):
        warm(setup, 0)
    with pytest.raises(ValueError, match=r"`start_s` must be 0 to 0, got 1000000\.0"):
        warm(setup, 3, start_s=1e6)
    needy.needs = frozenset({"cn0_dbhz"})
    with pytest.raises(ValueError, match=f"Never needs cn0_dbhz, which {setup.whose} does not"):
        warm(setup_of(kind, detector=needy), 1)
    epochs = setup.live + setup.steps + setup.hold
    late.silent_epochs = epochs - 1
    warm(setup_of(kind, detector=late), 1)
    late.silent_epochs = epochs
    message = f"Never can't alarm in its first {epochs} epochs, and an episode has {epochs} in"
    with pytest.raises(ValueError, match=message):
        warm(setup_of(kind, detector=late), 1)


@pytest.mark.parametrize(
    ("kind", "domain", "message"),
    [
        ("loose", {"worlds": 2, "turned_deg": (0.0, 90.0)}, "`domain` has no 'turned_deg' for a "),
        ("loose", {"start_s": (700.0, 1e5)}, "an episode takes 7.1 s from a start at 100000 s"),
        ("snapshot", {"start_s": (0.0, 5.0)}, "'start_s' for a snapshot receiver; valid: constell"),
        ("robot", {"start_s": (0.0, 1e9)}, "`start_s` must be within 0 and 100000 s, got"),
        ("robot", {"start_s": (0.2, 0.7)}, "`start_s` must hold an epoch, of which there is one"),
    ],
)
def test_a_domain_that_a_victim_does_not_have_is_refused(kind, domain, message):
    with pytest.raises(ValueError, match=message):
        setup_of(kind, domain=domain)


@pytest.mark.parametrize("kind", ["loose", "snapshot", "robot"])
def test_an_episode_ends(kind):
    setup = setup_of(kind)
    mine = warm(setup, 2)
    for _ in range(setup.steps + setup.hold + 1):  # one to spare, for receivers that wait
        step(mine)
    with pytest.raises(RuntimeError, match=rf"at most {setup.length} epochs, .* \[0, 1\] are at"):
        step(mine)
