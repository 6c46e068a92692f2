"""Offsets by satellite, by position and clock, and rotated: geometry, limits, masks, capture."""

from dataclasses import replace

import numpy as np
import pytest

from spoofgym.attacks import AttackContext, FalsePosition, Offsets, as_offsets, make_attack

from .support import ONSET, WORLD, begin, default_world, offsets

FREE = {"acceleration_limit_mps2": 1e4, "rate_limit_mps": 1e4}
TAU = 0.5
SIZE = {"satellites": 8, "position+clock": 4, "rotated": 8}
AXES = {"n": 0, "e": 1, "d": 2}


def design(epoch, world=WORLD):
    """(8, 4) rows of the captured satellites: -u in north, east, down, and 1."""
    sight = world.satellites[epoch, :8, :3] - world.position_e[epoch]
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    return np.column_stack([-sight @ world.C_en[epoch], np.ones(8)])


def played(attack, actions, world=WORLD, receivers=1):
    """(K, n) offsets of pseudoranges and of range rates of the first receiver."""
    ranges, rates = offsets(attack, actions, receivers=receivers, world=world)
    return ranges[:, 0], rates[:, 0]


@pytest.mark.parametrize("control", ["rate", "offset"])
@pytest.mark.parametrize("basis", ["position+clock", "rotated"])
@pytest.mark.parametrize("letter", AXES)
def test_a_ramp_of_300_m_along_an_axis_is_a_false_position(letter, basis, control):
    epochs, rate = 300, 2.0
    attack = Offsets(basis=basis, control=control, scales_mps=(rate, 0.25, 0.05), **FREE)
    actions = np.zeros((epochs, SIZE[basis]))
    actions[:, AXES[letter]] = 1.0 if control == "rate" else np.arange(1.0, epochs + 1.0) / epochs
    ranges, rates = played(attack, actions)
    truth = FalsePosition(axes=letter, control="rate", rate_limit_mps=rate)
    exact, exact_rates = played(truth, np.ones((epochs, 1)))
    assert np.abs(ranges - exact).max() < 0.01
    assert np.abs(rates - exact_rates).max() < 1e-6
    frozen = 300.0 * design(ONSET)[:, AXES[letter]]  # of the geometry at the onset
    assert np.abs(frozen - exact[-1, :8]).max() > 0.1


def test_offsets_of_satellites_make_the_same_ramp():
    exact, _ = played(FalsePosition(axes="e", control="rate", rate_limit_mps=2.0), [[1.0]] * 300)
    attack = Offsets(control="offset", span_s=300.0, **FREE)
    ranges, _ = played(attack, exact[:, :8] / 300.0)
    np.testing.assert_allclose(ranges, exact, rtol=0, atol=1e-9)


def test_rotated_axes_span_what_satellites_do_and_residuals_are_no_position():
    epochs = 200
    attack = Offsets(basis="rotated", control="offset", scales_mps=(1.0, 1.0, 1.0), **FREE)
    units = []
    for axis in range(8):
        ranges, _ = played(attack, np.tile(np.eye(8)[axis] / 150.0, (epochs, 1)))
        units.append(ranges[:, :8])
    axes = np.array(units)  # (8, K, 8), of an amplitude of 1 m
    for k in range(0, epochs, 40):
        here, G = axes[:, k], design(ONSET + 1 + k)
        np.testing.assert_allclose(here[:4], G.T, atol=1e-5)  # but for the Earth's rotation
        np.testing.assert_allclose(here[4:] @ G, 0.0, atol=1e-6)
        np.testing.assert_allclose(here[4:] @ here[4:].T, np.eye(4), atol=1e-12)
        assert np.linalg.cond(here) < 10.0
    turned = np.abs(np.diff(axes, axis=1)).max()
    assert 0.0 < turned < 1e-3  # with the geometry of every epoch, and never at once


@pytest.mark.parametrize("basis", SIZE)
def test_a_limit_shortens_the_whole_vector(basis):
    attack = Offsets(basis=basis, acceleration_limit_mps2=0.4, rate_limit_mps=0.5)
    action = np.linspace(1.0, -0.4, SIZE[basis])
    want = action * attack.unit_rates(WORLD)
    rates = offsets(attack, [action] * 8, watch="rate")[:, 0]
    along = rates @ want / (want @ want)
    np.testing.assert_allclose(rates, along[:, None] * want, atol=1e-12)
    sizes = [attack.measure_size(rate) for rate in rates]
    np.testing.assert_allclose(sizes, np.minimum(0.2 * np.arange(1, 9), 0.5), rtol=1e-12)
    limited, _ = played(attack, [action] * 8)
    assert np.abs(np.diff(limited, axis=0)).max() <= 0.5 * TAU * (1.0 + 1e-6)


def test_an_offset_is_reached_at_once_without_limits_and_a_ramp_from_rest_does_not_oscillate():
    attack = Offsets(control="offset", **FREE)
    ramp = 0.3 * TAU * np.arange(1.0, 9.0)
    actions = ramp[:, None] * np.ones(8) / 150.0
    np.testing.assert_allclose(offsets(attack, actions, watch="rate")[:, 0], 0.3, rtol=1e-9)


@pytest.mark.parametrize("tau_a", [0.05, 0.5])
def test_an_offset_is_approached_by_a_braking_law(tau_a):
    attack = Offsets(control="offset", acceleration_limit_mps2=tau_a / TAU, rate_limit_mps=1.5)
    action = np.array([20.0, -10.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0]) / 150.0
    moved = offsets(attack, [action] * 120, watch="displacement")[:, 0]
    rate = np.diff(np.vstack([np.zeros(8), moved]), axis=0) / TAU
    change = np.abs(np.diff(np.vstack([np.zeros(8), rate]), axis=0)).max()
    assert change <= tau_a * (1.0 + 1e-9)
    assert np.abs(rate).max() <= 1.5 + 1e-9
    assert moved.max() <= 20.0 + 1e-9
    np.testing.assert_allclose(moved[-1], 150.0 * action, atol=0.02)
    np.testing.assert_allclose(moved[:, 1], -0.5 * moved[:, 0], atol=1e-9)  # coherent on the way
    fastest = 20.0 / 1.5 + 1.5 * TAU / tau_a
    near = np.flatnonzero(moved[:, 0] > 19.5)[0] * TAU
    assert near < fastest + 2.0


def test_requests_are_reported_beside_what_was_played():
    attack = Offsets(basis="position+clock", acceleration_limit_mps2=0.01)
    offsets(attack, [[0.0, 0.0, 0.0, 1.0]] * 10)
    found = attack.report(np.array([ONSET + 10]))
    np.testing.assert_allclose(found["requested_offsets_m"], 0.25 * 5.0, rtol=1e-12)
    np.testing.assert_allclose(found["offsets_m"], 0.005 * TAU * 55.0, rtol=1e-12)
    assert found["action_mask"].all()


@pytest.mark.parametrize("basis", SIZE)
def test_a_satellite_out_of_view_is_masked_and_comes_back_coherent(basis):
    away = slice(ONSET + 4, ONSET + 8)
    satellites, visible = WORLD.satellites.copy(), WORLD.visible.copy()
    satellites[away, 7, 6:], visible[away, 7] = 0.0, False
    world = replace(default_world(), satellites=satellites, visible=visible)
    attack = Offsets(basis=basis, **FREE)
    actions = np.zeros((12, SIZE[basis]))
    actions[:, 0], actions[:, -1] = 0.5, 0.7
    ranges, rates = played(attack, actions, world)
    assert not ranges[3:7, 7].any()
    assert not rates[3:7, 7].any()
    alone = actions.copy()
    alone[3:7, -1] = 0.0  # what is commanded of a satellite out of view is not looked at
    if basis == "satellites":
        np.testing.assert_array_equal(played(attack, alone, world)[0], ranges)
    if basis == "position+clock":
        np.testing.assert_array_equal(ranges[:3], played(attack, actions)[0][:3])
        np.testing.assert_array_equal(ranges[7:], played(attack, actions)[0][7:])
    assert np.abs(rates).max() < 5.0  # no jump of a range is a rate
    begin(attack, world)
    masks = [attack.report(np.array([ONSET + k]))["action_mask"][0].sum() for k in (2, 3, 7)]
    lost = 0 if basis == "position+clock" else 1
    assert masks == [SIZE[basis], SIZE[basis] - lost, SIZE[basis]]


@pytest.mark.parametrize("basis", SIZE)
@pytest.mark.parametrize("channels", ["5 of 8", ("S05", "S30", "S11"), "6 highest", "4 drawn"])
def test_only_captured_channels_take_offsets(basis, channels):
    attack = Offsets(basis=basis, channels=channels, **FREE)
    size, count = len(attack.action_names(WORLD)), attack.count_slots(WORLD)
    assert size == (4 if basis == "position+clock" else count if count > 4 else max(size, count))
    ranges, _ = played(attack, [np.full(size, 0.5)] * 6)
    moved = ranges.any(axis=0)
    taken = attack.memory["taken"][0]
    assert taken.sum() == count
    np.testing.assert_array_equal(moved, taken)
    if channels == "5 of 8":
        np.testing.assert_array_equal(np.flatnonzero(taken), range(5))
    if channels == "6 highest":
        elevation = WORLD.look(np.array([ONSET]))[0][0]
        assert elevation[taken].min() > elevation[~taken & WORLD.visible[ONSET]].max()
    if basis == "position+clock":  # the common offset of the captured ones is an axis
        ranges, rates = played(attack, [[0.0, 0.0, 0.0, 1.0]] * 6)
        np.testing.assert_allclose(
            ranges[:, taken], 0.125 * np.arange(1, 7)[:, None] @ [[1] * count]
        )
        np.testing.assert_allclose(rates[:, taken], 0.25)


def test_drawn_channels_differ_between_episodes_and_come_again():
    attack = Offsets(channels="5 drawn")
    begin(attack, WORLD, 40)
    taken = attack.memory["taken"].copy()
    assert (taken.sum(axis=1) == 5).all()
    assert len(np.unique(taken, axis=0)) > 20
    assert taken[:, WORLD.visible[ONSET]].any(axis=0).all()
    begin(attack, WORLD, 40)
    np.testing.assert_array_equal(attack.memory["taken"], taken)


def test_slots_by_elevation_have_the_highest_first():
    attack = Offsets(slot_order="elevation")
    begin(attack, WORLD)
    elevation = WORLD.look(np.array([ONSET]))[0][0][attack.memory["orders"][0]]
    assert (np.diff(elevation) < 0.0).all()
    ranges, _ = played(attack, [np.eye(8)[0]] * 3)
    assert ranges.any(axis=0).argmax() == attack.memory["orders"][0, 0]


def test_equipment_is_that_of_the_captured_channels():
    own = {"spoofer_clock": {"offset_m": 7.0}, "errors": "replaced", "channels": "5 drawn"}
    attack = Offsets(basis="position+clock", **own)
    ranges, _ = played(attack, [np.zeros(4)] * 3, receivers=4)
    np.testing.assert_allclose(ranges[-1, attack.memory["taken"][0]], 7.0, atol=1e-12)
    authentic = attack.memory["authentic"].reshape(4, 2, -1)
    assert (authentic[:, 0] == np.where(attack.memory["taken"], 0.0, 1.0)).all()


def test_another_attack_is_commanded_by_offsets():
    made = as_offsets(make_attack("tracking-1m"), basis="rotated", channels="5 of 8")
    assert (made.tracking, made.control, made.channels) == (
        make_attack("tracking-1m").tracking,
        "rate",
        "5 of 8",
    )
    assert made.label == "offsets-partial-tracking"
    with pytest.raises(ValueError, match="got 'meaconer'"):
        as_offsets(make_attack("meaconer"), control="rate")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"channels": "1 of 8"}, "must capture at least 2 satellites, got '1 of 8'"),
        ({"channels": ["S05"]}, "must capture at least 2 satellites"),
        ({"channels": "some"}, "'all', 'K of N', 'K highest', .* or a pattern .* got 'some'"),
        ({"channels": "5 of 9"}, "'5 of 9' does not fit .*, which has 8 .* '5 of 8', '5 highest'"),
        ({"channels": "9 drawn"}, "'9 drawn' does not fit .* has 8 satellites"),
        ({"channels": ["S05", "S31"]}, "'S31' is not in view .*: S05, S06"),
        ({"basis": "rotatde"}, "`basis` must be 'satellites', .* did you mean 'rotated'"),
        ({"control": "acceleration"}, "`control` must be 'rate' or 'offset', got 'acceleration'"),
        ({"scales_mps": (1.0, 0.25)}, "must be three numbers: position, clock, residual"),
        ({"scales_mps": (1.0, 0.0, 0.1)}, "numbers above 0"),
    ],
)
def test_what_is_no_attack_by_offsets_is_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        Offsets(**settings).bind(AttackContext(1, WORLD))
