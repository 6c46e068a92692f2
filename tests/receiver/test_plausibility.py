"""A replay refuses what no receiver measures, flags what does not fit, and names the mistake."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from spoofgym.earth.wgs84 import EARTH_RATE, SPEED_OF_LIGHT, dcm_e_from_n, ecef_to_geodetic
from spoofgym.earth.wgs84 import range_and_rate as range_and_rate_from
from spoofgym.receiver import ImplausibleWarning, NavState, Recording, TightlyCoupled, replay
from spoofgym.receiver.plausibility import flag_epochs
from spoofgym.truth.flight import inverse_kinematics
from spoofgym.truth.manoeuvres import Straight, Turn, fly
from spoofgym.truth.satellites import CircularConstellation

N, RATE = 9, 50
SATELLITES = CircularConstellation(satellites=30)
RECEIVER = TightlyCoupled(grade="tactical")


@pytest.fixture(scope="module")
def flown():
    """A recording of a turning flight, its initial state, times and chosen satellites."""
    flight = inverse_kinematics(
        fly(
            [Straight(4.0), Turn(80.0, bank_deg=30.0), Straight(30.0)],
            latitude_deg=-35.0,
            longitude_deg=149.0,
            height_m=900.0,
            speed_mps=60.0,
            heading_deg=250.0,
            rate_hz=float(RATE),
        )
    )
    ends = np.arange(RATE, len(flight.time), RATE)
    time, rng = flight.time[ends], np.random.default_rng(8)
    sky = SATELLITES.states(time)
    up = flight.position_e[0] / np.linalg.norm(flight.position_e[0])
    sight = sky.position_e[0] - flight.position_e[0]
    chosen = np.argsort(-(sight @ up) / np.linalg.norm(sight, axis=1))[:N]
    position, velocity = sky.position_e[:, chosen], sky.velocity_e[:, chosen]
    exact = np.empty((len(ends), N, 2))
    for k, j in np.ndindex(len(ends), N):
        own = flight.position_e[ends[k]], flight.velocity_e[ends[k]]
        exact[k, j] = range_and_rate_from(position[k, j], velocity[k, j], *own)[:2]
    clock_m = 800.0 + 20.0 * time[:, None]
    recording = Recording(
        imu_time=flight.time[1:],
        specific_force_b=flight.specific_force_b + rng.normal(0.0, 0.01, (len(flight.time) - 1, 3)),
        angular_rate_b=flight.angular_rate_b + rng.normal(0.0, 1e-4, (len(flight.time) - 1, 3)),
        gnss_time=time,
        pseudorange=exact[..., 0] + clock_m + rng.normal(0.0, 2.0, (len(time), N)),
        range_rate=exact[..., 1] + 20.0 + rng.normal(0.0, 0.08, (len(time), N)),
        satellite_position_e=position,
        satellite_velocity_e=velocity,
    )
    initial = NavState(
        position_e=flight.position_e[0] + 2.0,
        velocity_e=flight.velocity_e[0] + 0.03,
        C_eb=flight.C_eb[0],
        clock_bias_m=803.0,
        clock_drift_mps=20.1,
    )
    return recording, initial, chosen


def put(array, where, value):
    array = np.array(array)
    array[where] = value
    return array


def test_a_sound_recording_is_neither_refused_nor_flagged(flown):
    recording, initial, _ = flown
    solution = replay(recording, RECEIVER, initial=initial)
    assert not solution.flag.any()
    assert solution.remark == ""
    # for a while without satellites, and with one range 60 m too long
    ranges = put(np.array(recording.pseudorange), (slice(10, 14),), np.nan)
    ranges[20, 3] += 60.0
    gap = replay(replace(recording, pseudorange=ranges), RECEIVER, initial=initial)
    assert not gap.flag.any()


def inertial(recording):
    """Satellites in axes that do not turn, and lie along those of the Earth at time zero."""
    angle = EARTH_RATE * np.asarray(recording.gnss_time)[:, None]
    cosine, sine = np.cos(angle), np.sin(angle)
    s, v = recording.satellite_position_e, recording.satellite_velocity_e
    v = v + np.cross([0.0, 0.0, EARTH_RATE], s)

    def turned(x):
        east = sine * x[..., 0] + cosine * x[..., 1]
        return np.stack([cosine * x[..., 0] - sine * x[..., 1], east, x[..., 2]], axis=-1)

    return {PLACE: turned(s), SPEED: turned(v)}


RANGES, RATES, FORCE, TURNS = "pseudorange", "range_rate", "specific_force_b", "angular_rate_b"
PLACE, SPEED, CLOCKS = "satellite_position_e", "satellite_velocity_e", ("imu_time", "gnss_time")
MILLISECOND_M = 1e-3 * SPEED_OF_LIGHT


def scaled(factor, *names):
    return lambda r, *_: {x: getattr(r, x) * factor for x in names}


def shifted(offset, *names):
    """`offset` of a recording."""
    return lambda r, *_: {x: getattr(r, x) + offset(r) for x in names}


def spoiled(name, where, value):
    return lambda r: {name: put(getattr(r, name), where, value)}


REFUSED = {
    "absent as 0": (spoiled(RANGES, (5, 2), 0.0), "must be NaN .*0.0"),
    "absent as -1": (spoiled(RANGES, (5, 2), -1.0), "mark of an abse"),
    "absent rates": (
        spoiled(RATES, (slice(9), 4), 0.0),
        "`range_rate` must be NaN .* got 0.0 in 9 ",
    ),
    "ranges in km": (scaled(1e-3, RANGES), r"\(are they in km\?\)"),
    "ranges in s": (scaled(1.0 / SPEED_OF_LIGHT, RANGES), r"in s\?\)"),
    "other satellites": (lambda r: {PLACE: r.satellite_position_e[:, ::-1]}, "belong together"),
    "below ground": (spoiled(PLACE, (3, 1), [6e6, 0.0, 0.0]), "6e.06 in channel 1 at 4 s"),
    "below the horizon": (spoiled(PLACE, (3, 1), [2e7, 0, 1.7e7]), "the Earth is between them"),
    "satellites in km": (scaled(1e-3, PLACE), "are they in km"),
    "g": (scaled(1.0 / 9.8, FORCE), "is it in g"),
    "gravity": (scaled(-1.0, FORCE), "is its sign that of gravity"),
    "Doppler": (scaled(-1.0, RATES), "is it Doppler's sign"),
    "Hz": (scaled(-1.0 / 0.1903, RATES), "is it a Doppler shift in Hz"),
    "1 ms": (
        shifted(lambda r: MILLISECOND_M * (r.gnss_time > 21)[:, None], RANGES),
        "jump by 2997.* m at 22 s, 1 ms of the receiver's clock",
    ),
    "time base": (
        shifted(lambda r: 10.0, *CLOCKS),
        r"ends at 10.02 s lasts 10.02 s \(is time zero",
    ),
    "1 ms in an outage": (
        lambda r: {
            RANGES: np.where(
                ((r.gnss_time > 20) & (r.gnss_time < 26))[:, None],
                np.nan,
                r.pseudorange - MILLISECOND_M * (r.gnss_time > 22)[:, None],
            )
        },
        "jump by -2997.* m at 26 s, -1 ms of the receiver's clock",
    ),
    "a satellite twice": (
        lambda r: {
            x: put(getattr(r, x), (slice(None), 4), getattr(r, x)[:, 1])
            for x in (RANGES, RATES, PLACE, SPEED)
        },
        r"channels \[1, 4\] have the same pseudorange in 53 epochs, first at 1 s",
    ),
    "held": (
        lambda r: {
            x: put(getattr(r, x), (slice(7, 15), 3), getattr(r, x)[6, 3]) for x in (RANGES, RATES)
        },
        "the same as before in 8 places, first in channel 3 at 8 s",
    ),
    "infinite": (spoiled(RANGES, (5, 2), np.inf), "absent is NaN"),
    "text": (lambda r: {RATES: r.range_rate.astype(str)}, "must be numbers, got <U"),
    "feet": (scaled(1.0 / 0.3048, RANGES), r"are they in feet\?"),
    "ns": (scaled(1e9 / SPEED_OF_LIGHT, RANGES), r"are they in ns\?"),
    "times in min": (scaled(1.0 / 60.0, *CLOCKS), r"is it, or are the times, in another unit\?"),
    "knots": (scaled(3600.0 / 1852.0, RATES), "grow by 0.514 times"),
    "mirrored": (
        scaled([1.0, -1.0, 1.0], PLACE, SPEED),
        r"\(is an axis flipped, or are two swapped\?\)",
    ),
    "inertial": (
        inertial,
        r"do not move there as orbits do, by 0\.\d+ .*\(are they in inertial axes\?\)",
    ),
    "mg": (scaled(102.0, FORCE), "is it in mg"),
    "a mark in the samples": (
        spoiled(FORCE, slice(90, 99), -9999.0),
        r"below 5000 m/s\^2, got 9999 .*the mark of an absent sample\?",
    ),
    "rates in km/s": (scaled(1e-3, RATES), r"is it in km/s\?"),
    "satellites at rest": (
        scaled(0.0, SPEED),
        "moves differently, by .* m/s in the median .do they belong together",
    ),
    "satellite velocities in km/s": (
        scaled(1e-3, SPEED),
        r"moves differently, .* \(is it in km/s\?\)",
    ),
    "inertial velocities": (
        shifted(lambda r: np.cross([0.0, 0.0, EARTH_RATE], r.satellite_position_e), SPEED),
        r"\(is it with respect to inertial axes\?\)",
    ),
    "no rates": (
        scaled(np.nan, RATES),
        "measured where all of its fields are, but `range_rate` is NaN everywhere",
    ),
    "nothing of the satellites": (
        scaled(np.nan, PLACE, RATES),
        "but `range_rate` and `satellite_position_e` is NaN everywhere",
    ),
    "time of week": (shifted(lambda r: 345_600.0, "gnss_time"), r"counted from the start of"),
    "a gap": (
        lambda r: {x: getattr(r, x) + 30.0 * (getattr(r, x) > 10.0) for x in CLOCKS},
        "lasts 30.02 s .*one by one",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_no_receiver_measures_is_refused_with_its_likeliest_cause(flown, name):
    recording, initial, _ = flown
    change, said = REFUSED[name]
    with pytest.raises(ValueError, match=said):
        replay(replace(recording, **change(recording)), RECEIVER, initial=initial)


def test_a_masked_range_is_an_absent_one(flown):
    recording, initial, _ = flown
    mask = np.zeros(recording.pseudorange.shape, dtype=bool)
    mask[9, 4] = True
    masked = np.ma.array(put(recording.pseudorange, (9, 4), -999.0), mask=mask)
    solution = replay(replace(recording, pseudorange=masked), RECEIVER, initial=initial)
    assert not solution.visible[9, 4]
    assert solution.visible.sum() == mask.size - 1


STARTS = {
    "degrees": ({"position_e": [-35.0, 149.0, 900.0]}, "latitude, longitude and height"),
    "km": ({"position_e": lambda x: x / 1e3}, r"\(is it in km\?\)"),
    "speed": ({"velocity_e": lambda x: x * 1e3}, "at most 12000 m/s"),
    "nearly a rotation": ({"C_eb": lambda C: 1.01 * C}, r"must be a rotation .* = 0.0201"),
    "no rotation": ({"C_eb": lambda C: 2.0 * C}, r"must be a rotation .* \|C C' - I\| = 3"),
    "mirrored": ({"C_eb": lambda C: C * [1.0, -1.0, 1.0]}, "determinant -1"),
    "upside down": ({"C_eb": lambda C: C * [1.0, -1.0, -1.0]}, r"sign that of gravity\?"),
}


@pytest.mark.parametrize("name", STARTS)
def test_an_initial_state_that_cannot_be_is_refused(flown, name):
    recording, initial, _ = flown
    changes, said = STARTS[name]
    made = {
        key: value(getattr(initial, key)) if callable(value) else value
        for key, value in changes.items()
    }
    with pytest.raises(ValueError, match=said):
        replay(recording, RECEIVER, initial=replace(initial, **made))


@pytest.mark.parametrize("variance", [1e-300, np.inf])
def test_noise_that_no_receiver_has_is_refused(flown, variance):
    recording, initial, _ = flown
    noise = np.tile(np.repeat([4.0, 0.01], N), (len(recording.gnss_time), 1))
    with pytest.raises(ValueError, match="noise variance must be finite and at least 1e-08, got"):
        replay(recording, RECEIVER, initial=initial, noise_variance=put(noise, (7, 3), variance))


def moved(recording, chosen, shift):
    """Satellites at other times, `shift` a number or (K, n) [s]."""
    times = np.broadcast_to(recording.gnss_time[:, None] + shift, recording.pseudorange.shape)
    columns = [SATELLITES.states(times[:, j]) for j in range(N)]
    pairs = list(zip(columns, chosen, strict=True))
    return {
        "satellite_position_e": np.stack([sky.position_e[:, c] for sky, c in pairs], axis=1),
        "satellite_velocity_e": np.stack([sky.velocity_e[:, c] for sky, c in pairs], axis=1),
    }


def first(recording, chosen):
    return {x: getattr(recording, x)[chosen] for x in ("gnss_time", RANGES, RATES, PLACE, SPEED)}


def test_a_start_is_not_found_far_from_the_earth_s_surface_and_where_nothing_is_felt(flown):
    recording, _, chosen = flown
    for change, said in (
        (moved(recording, chosen, 3600.0), r"belong together\?\)$"),
        (scaled(0.0, FORCE)(recording), "`specific_force_b` is 0"),
    ):
        with pytest.raises(ValueError, match=f"`initial` is not found .* {said}"):
            replay(replace(recording, **change), RECEIVER)


FLAGGED = {
    "deg/s": (scaled(180.0 / np.pi, TURNS), "is in deg/s"),
    "UTC": (lambda r, c: moved(r, c, -18.0), "18 s before: leap seconds, UTC for GPS"),
    "UTC twice": (lambda r, c: moved(r, c, 18.0), "18 s after: leap"),
    "local axes": (lambda r, c: {}, "attitude to local axes"),
    "satellite clocks": (
        shifted(lambda r: np.linspace(-9e4, 2e5, N), RANGES),
        "the satellites' clocks or delays were not taken out",
    ),
    "TAI": (lambda r, c: moved(r, c, -37.0), "were 37 s before"),
    "another day": (lambda r, c: moved(r, c, 236.0), "236 s after: orbits of another day"),
    "increments": (scaled(1.0 / RATE, TURNS), "is of increments, not of rates"),
    "ft/s^2": (scaled(1.0 / 0.3048, FORCE), "is in ft/s"),
    "half rate": (
        lambda r, c: {"imu_time": 0.5 * r.imu_time, **first(r, r.gnss_time < 0.5 * r.imu_time[-1])},
        "inertial samples last twice as long",
    ),
    "clock": (
        shifted(lambda r: 900.0 * (r.gnss_time > 20)[:, None], RANGES),
        "all pseudoranges jump by (899|900|901) m at 21 s",
    ),
    "one satellite": (
        shifted(lambda r: 9e3 * (np.arange(N) == 4), RANGES),
        "something in channel 4 alone",
    ),
    "arrival": (lambda r, c: moved(r, c, r.pseudorange / SPEED_OF_LIGHT), "when a signal arrives"),
    "lone ranges": (
        shifted(
            lambda r: (
                4e3 * np.random.default_rng(0).normal(size=(1, N)) * (r.gnss_time > 26)[:, None]
            ),
            RANGES,
        ),
        "something in the pseudoranges alone",
    ),
}


@pytest.mark.parametrize("name", FLAGGED)
def test_what_does_not_fit_is_flagged_with_its_likeliest_cause(flown, name):
    recording, initial, chosen = flown
    change, said = FLAGGED[name]
    wrong = replace(recording, **change(recording, chosen))
    if name == "local axes":
        C_en = dcm_e_from_n(*ecef_to_geodetic(initial.position_e)[:2])
        initial = replace(initial, C_eb=C_en.T @ initial.C_eb)
    with pytest.warns(ImplausibleWarning, match=said):
        solution = replay(wrong, RECEIVER, initial=initial)
    assert re.search(said, solution.remark)
    assert (solution.flag != "").mean() > 0.2


@pytest.mark.parametrize(
    ("field", "off", "said"),
    [
        ("position_e", [0.0, 3e3, 0.0], "`initial.position_e` is 3e.03 m from that of the first"),
        ("velocity_e", [0.0, 0.0, 40.0], r"`initial.velocity_e` is (39|40)\S* m/s from"),
        ("clock_bias_m", -2e5, "`initial.clock_bias_m` is 2e.05 m from"),
        ("clock_drift_mps", 2e3, "`initial.clock_drift_mps` is 2e.03 m/s from"),
        ("heading", None, "attitude and axes of the inertial sensor differ by 90 deg in heading"),
    ],
)
def test_an_initial_state_that_contradicts_the_first_fix_is_named(flown, field, off, said):
    recording, start, _ = flown
    if field == "heading":
        local = dcm_e_from_n(*ecef_to_geodetic(start.position_e)[:2])
        turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        wrong = replace(start, C_eb=local @ turn @ local.T @ start.C_eb)
    else:
        wrong = replace(start, **{field: np.add(getattr(start, field), off)})
    with pytest.warns(ImplausibleWarning, match=said):
        replay(recording, RECEIVER, initial=wrong)


def test_a_filter_that_is_not_a_number_is_flagged(flown):
    recording, initial, _ = flown
    with pytest.warns(ImplausibleWarning, match="53 of 53 epochs .* first 'not finite' at 1 s"):
        solution = replay(recording, RECEIVER, initial=replace(initial, clock_bias_m=1e300))
    assert (solution.flag == "not finite").all()


def test_flags_are_those_of_their_epochs():
    misfit = np.ones(60)
    misfit[[3, 4]] = 150.0, -1.0  # one outlier, one epoch without a measurement
    assert not flag_epochs(misfit).any()
    misfit = np.ones(60)
    misfit[30:36], misfit[50] = 150.0, np.nan
    flag = flag_epochs(misfit)
    assert (flag[30:36] == "innovations").all()
    assert (flag[36:49] == "sd").all()
    assert flag[56:].tolist() == [""] * 4
    assert flag[50] == "not finite"
    assert not flag[:30].any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert flag_epochs(np.array([np.inf, 2e4])).tolist() == ["not finite", "innovations"]
