"""What attacks make of the measurements: closed forms against the truth, names and settings."""

import numpy as np
import pytest

from spoofgym.attacks import ATTACKS, AttackContext, FalsePosition, PerChannel, make_attack
from spoofgym.earth.wgs84 import ecef_to_geodetic, range_and_rate
from spoofgym.receiver._kernels import first_fix
from spoofgym.truth.scenario import Scenario

ONSET = 30


@pytest.fixture(scope="module")
def world():
    return Scenario().world()


def begin(attack, world, receivers):
    """Bind an attack, and begin an episode in every receiver."""
    attack.bind(AttackContext(receivers, world))
    rows = np.arange(receivers)
    attack.start_episodes(rows, np.ones((receivers, 2), dtype=np.uint64), np.full(receivers, ONSET))


def command(attack, world, actions, start=ONSET):
    """Offsets after each of some commands to one receiver."""
    begin(attack, world, 1)
    epochs = np.array([start])
    for action in actions:
        d_range, d_rate = np.empty((1, world.channels)), np.empty((1, world.channels))
        given = None if action is None else np.array([action], dtype=float)
        attack.command(given, epochs, d_range, d_rate, 0, 1)
        epochs += 1
        yield d_range[0], d_rate[0], int(epochs[0])


@pytest.mark.parametrize("start", [ONSET, ONSET + 400])
def test_a_false_position_has_the_ranges_of_a_displaced_antenna(world, start):
    attack = FalsePosition(axes="ned", control="rate", rate_limit_mps=10.0)
    actions = [(0.6, 0.0, 0.0)] * 5 + [(0.0, -0.5, 0.8)] * 5
    steps = command(attack, world, actions, start)
    displacement = np.zeros(3)
    for action, (d_range, d_rate, k) in zip(actions, steps, strict=True):
        rate = 10.0 * np.array(action)
        displacement = displacement + 0.5 * rate
        r, v, C_en = world.position_e[k], world.velocity_e[k], world.C_en[k]
        speed = v + C_en @ rate + world.axes_turning[k] @ displacement
        for s in np.flatnonzero(world.visible[k]):
            p = world.satellites[k, s, :3], world.satellites[k, s, 3:6]
            there = range_and_rate(*p, r + C_en @ displacement, speed)
            here = range_and_rate(*p, r, v)
            assert d_range[s] == pytest.approx(there[0] - here[0], abs=2e-8)
            assert d_rate[s] == pytest.approx(there[1] - here[1], abs=1e-9)
        assert not d_range[~world.visible[k]].any()
        assert not d_rate[~world.visible[k]].any()


def test_over_half_an_hour_the_counterfeit_keeps_its_height_and_its_bearing():
    """The axes follow the target: 20 m/s to the east in a flight of 360 km.

    In the axes of the onset the counterfeit would come to fly a kilometre too high.
    """
    world = Scenario(flight="airway").world()
    attack = FalsePosition(axes="e", control="rate", rate_limit_mps=20.0)
    steps = list(command(attack, world, [(1.0,)] * 3600))
    ranges, rates = (np.array([step[i] for step in steps]) for i in (0, 1))
    r, k = world.position_e, steps[-1][2]
    measured = np.where(world.visible[k], world.satellites[k, :, 6] + ranges[-1], 0.0)
    measured = np.stack([measured, world.satellites[k, :, 7] + rates[-1]])[None]
    fix, speed, clock = np.empty((1, 3)), np.empty((1, 3)), np.empty((1, 2))
    first_fix(measured, world.satellites, np.array([k]), r[k : k + 1], fix, speed, clock)
    apart = (fix[0] - r[k]) @ world.C_en[k]
    np.testing.assert_allclose(apart, [0.0, 36_000.0, 0.0], atol=1e-3)
    height = ecef_to_geodetic(fix[0])[2] - ecef_to_geodetic(r[k])[2]
    assert height == pytest.approx(36_000.0**2 / (2.0 * 6.38e6), rel=0.02)  # of a straight line
    up = world.C_en[ONSET].T @ (r[k] - r[ONSET])
    assert np.linalg.norm(up[:2]) > 200_000.0
    fixed = r[k] + world.C_en[ONSET] @ [0.0, 36_000.0, 0.0]
    assert abs(ecef_to_geodetic(fixed)[2] - ecef_to_geodetic(fix[0])[2]) > 500.0
    # range rates are the derivatives of the ranges all the way
    seen = world.visible[ONSET + 1 : k + 1].all(axis=0)
    total = 0.25 * (rates[1:] + rates[:-1]).sum(axis=0)
    np.testing.assert_allclose(total[seen], (ranges[-1] - ranges[0])[seen], rtol=0, atol=0.5)


def test_a_push_towards_a_satellite_shortens_its_range(world):
    """Change of range = - u . displacement, and nothing is added to the clock."""
    attack = FalsePosition(axes="e", control="rate", rate_limit_mps=20.0)
    *_, (d_range, d_rate, k) = command(attack, world, [(1.0,)] * 10)
    east = world.C_en[k][:, 1]
    for s in np.flatnonzero(world.visible[k]):
        sight = world.satellites[k, s, :3] - world.position_e[k]
        u = sight / np.linalg.norm(sight)
        assert d_range[s] == pytest.approx(-u @ east * 100.0, abs=2e-3)
        assert d_rate[s] == pytest.approx(-u @ east * 20.0, abs=2e-2)


def test_a_channel_is_offset_by_what_it_was_commanded(world):
    attack = PerChannel(channels=("S11", "S05"), acceleration_limit_mps2=0.2)
    names = attack.action_names(world)
    assert names == ("S05_acceleration", "S11_acceleration")  # in the order of the slots
    slots = [world.satellite_ids.index(name) for name in ("S05", "S11")]
    for count, (d_range, d_rate, _) in enumerate(command(attack, world, [(1.0, -0.5)] * 20), 1):
        t = 0.5 * count
        np.testing.assert_allclose(d_range[slots], [0.1 * t**2, -0.05 * t**2], rtol=1e-12)
        np.testing.assert_allclose(d_rate[slots], [0.2 * t, -0.1 * t], rtol=1e-12)
        others = np.setdiff1d(np.arange(world.channels), slots)
        assert not d_range[others].any()
        assert not d_rate[others].any()


def test_without_coherence_only_the_code_is_moved(world):
    for kind in ATTACKS.values():
        coherent, alone = kind(control="rate"), kind(control="rate", coherent=False)
        actions = [np.full(len(coherent.action_names(world)), 0.1)] * 3
        for both, code in zip(
            command(coherent, world, actions), command(alone, world, actions), strict=True
        ):
            np.testing.assert_array_equal(both[0], code[0])
            assert both[1].any()
            assert not code[1].any()


def test_receivers_at_different_epochs_have_their_own_truth(world):
    attack = FalsePosition(control="rate")
    begin(attack, world, 2)
    epochs = np.array([40, 300])
    d_range, d_rate = np.empty((2, world.channels)), np.empty((2, world.channels))
    attack.command(np.ones((2, 2)), epochs, d_range, d_rate, 0, 2)
    for row, start in enumerate(epochs):
        ((alone, _, _),) = command(FalsePosition(control="rate"), world, [(1.0, 1.0)], start)
        np.testing.assert_array_equal(d_range[row], alone)


def test_labels_tell_the_threat():
    assert FalsePosition().label == "false-position"
    assert FalsePosition(channels=("S05",)).label == "false-position-partial"
    assert PerChannel(coherent=False).label == "per-channel-pseudorange-only"
    assert PerChannel(channels=("S05",), coherent=False).label == (
        "per-channel-partial-pseudorange-only"
    )


def test_names_of_the_actions(world):
    assert FalsePosition().action_names(world) == ("north_acceleration", "east_acceleration")
    assert FalsePosition(axes="de", control="rate").action_names(world) == (
        "down_rate",
        "east_rate",
    )
    assert len(PerChannel().action_names(world)) == sum(bool(n) for n in world.satellite_ids)


def test_an_action_of_one_is_the_limit():
    assert FalsePosition(acceleration_limit_mps2=0.3, rate_limit_mps=7.0).unit_scale == 0.3
    assert FalsePosition(control="rate", rate_limit_mps=7.0).unit_scale == 7.0


@pytest.mark.parametrize(
    ("channels", "said"),
    [
        ("S05", "`channels` must be 'all' or .*satellite ids, got 'S05'"),
        ((), "`channels` must name at least one satellite"),
        (("S05", "S05"), "`channels` must name each satellite once"),
    ],
)
def test_channels_are_satellites_or_patterns(channels, said):
    with pytest.raises(ValueError, match=said):
        PerChannel(channels=channels)


@pytest.mark.parametrize("axes", ["", "x", "nn", "neu", "N"])
def test_axes_are_letters_of_the_local_frame(axes):
    with pytest.raises(ValueError, match="`axes` must be made of 'n', 'e' and 'd'"):
        FalsePosition(axes=axes)


def test_a_satellite_that_is_not_there_is_told_with_those_that_are(world):
    with pytest.raises(ValueError, match="'S31' is not in view on 'zhong2025'; in view: S05, S06"):
        PerChannel(channels=["S05", "S31"]).bind(AttackContext(1, world))


def test_attacks_by_name():
    assert make_attack("false-position") == FalsePosition()
    assert make_attack({"name": "per-channel", "channels": ["S05"]}).channels == ("S05",)
    mine = PerChannel()
    assert make_attack(mine) == mine
    assert make_attack(mine) is not mine
    with pytest.raises(
        ValueError, match=r"unknown attack 'perchannel'.*did you mean 'per-channel'"
    ):
        make_attack("perchannel")
