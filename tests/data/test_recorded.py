"""Satellites of navigation files over a whole flight."""

import numpy as np
import pytest

from spoofgym.data.ephemerides import BroadcastConstellation, join_ephemerides
from spoofgym.data.recorded import describe_satellites
from spoofgym.truth.manoeuvres import Straight, fly

from ..truth.records import later, one_record

TOE = 345_600.0 + 1590 * 604_800.0
VALID_S = 7200.0


def fill_sky(time_of_ephemeris):
    """24 satellites in six planes, all of one time."""
    return join_ephemerides(
        [
            one_record(
                f"G{k + 1:02d}",
                time_of_ephemeris,
                node=np.radians(60.0 * (k % 6)),
                mean_anomaly=np.radians(90.0 * (k // 6) + 40.0 * (k % 6)),
            )
            for k in range(24)
        ]
    )


def continue_sky(sky):
    """The same orbits by records of two hours later."""
    return join_ephemerides([later(sky.take([k]), VALID_S) for k in range(len(sky))])


@pytest.fixture(scope="module")
def flight():
    return fly(
        [Straight(600.0)],
        latitude_deg=46.0,
        longitude_deg=8.0,
        height_m=2000.0,
        speed_mps=100.0,
        heading_deg=10.0,
        rate_hz=10.0,
    )


def test_a_flight_past_the_last_record_is_refused_and_a_second_file_mends_it(flight):
    first, start = fill_sky(TOE), TOE + VALID_S - 280.0
    with pytest.raises(
        ValueError, match=r"0 satellites are in view 300 s into the flight.*add the"
    ):
        describe_satellites(flight, BroadcastConstellation(first, start), 10.0)
    both = join_ephemerides([first, continue_sky(first)])
    (line,) = describe_satellites(flight, BroadcastConstellation(both, start), 10.0)
    assert line.startswith("satellites above 10 deg: ")


def test_records_of_a_few_satellites_that_end_are_named(flight):
    sky, start = fill_sky(TOE), TOE + VALID_S - 280.0
    constellation = BroadcastConstellation(sky, TOE)
    seen = constellation.states([0.0]).position_e[0]
    nearest = np.argsort(-seen @ flight.position_e[0])[:6]
    rest = np.setdiff1d(np.arange(24), nearest[:1])
    both = join_ephemerides([sky, continue_sky(sky).take(rest)])
    lines = describe_satellites(flight, BroadcastConstellation(both, start), 10.0)
    name = sky.satellite_ids[nearest[0]]
    assert f"the records of 1 satellites end in flight, after {name} 300 s" in lines[1]
