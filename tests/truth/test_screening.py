"""Screening of broadcast records: which are copies, and which their neighbours contradict."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from spoofgym.data.ephemerides import screen

from .records import HOUR, SATURDAY_22, chain, joined, later, one_record

PROPERTY = settings(deadline=None, max_examples=50)


def rejected_records(ephemerides):
    _, report = screen(ephemerides)
    toe = ephemerides.time_of_ephemeris.tolist()
    return [toe.index(rejection.time_of_ephemeris) for rejection in report.rejections]


@PROPERTY
@given(count=st.integers(3, 9), data=st.data(), error=st.floats(110.0, 2e7) | st.floats(-2e7, -110))
def test_a_single_bad_record_is_found_wherever_it_stands(count, data, error):
    bad = data.draw(st.integers(0, count - 1))
    errors = [0.0] * count
    errors[bad] = error
    records = chain(*errors)
    assert rejected_records(records) == [bad]
    kept, report = screen(records)
    assert (report.records, report.rejected, report.unresolved) == (count, 1, 0)
    assert len(kept) == count - 1


@PROPERTY
@given(errors=st.lists(st.floats(-45.0, 45.0), min_size=1, max_size=9))
def test_broadcast_errors_are_no_contradiction(errors):
    kept, report = screen(chain(*errors))
    assert (len(kept), report.rejected, report.unresolved) == (len(errors), 0, 0)


@pytest.mark.parametrize(
    ("errors", "bad"),
    [
        ((0, 0, 5000, -9000, 0, 0), [2, 3]),
        ((0, 5000, -9000, 0), [1, 2]),
        ((5000, -9000, 0, 0), [0, 1]),
        ((0, 500, 0, 2e6, 0), [1, 3]),
        ((5000, 0, 0, -9000), [0, 3]),
    ],
)
def test_two_bad_records_are_found(errors, bad):
    # half an hour apart, so that records beyond the bad ones are near enough to compare
    assert rejected_records(chain(*errors, interval=0.5 * HOUR)) == bad


@pytest.mark.parametrize(
    ("records", "counts"),
    [
        (chain(0, 0, 5000, -9000, 0, 0), (2, 0, 0)),  # in a row, two hours apart
        (chain(0, 0, 5000, 5000, 0, 0), (0, 2, 0)),  # wrong alike: they confirm each other
        (chain(0, 5000), (0, 1, 0)),  # of which either may be wrong
        (one_record(), (0, 0, 1)),
        (chain(0, 5000, 0, interval=4.1 * HOUR), (0, 0, 3)),  # too far apart to be compared
        (chain(0, 5000, 0, interval=4.0 * HOUR), (1, 0, 2)),
    ],
)
def test_what_neighbours_cannot_tell_is_kept_and_counted(records, counts):
    kept, report = screen(records)
    assert (report.rejected, report.unresolved, report.unchecked) == counts
    assert len(kept) == len(records) - report.rejected


def test_unhealthy_neighbours_bear_witness_and_copies_and_other_satellites_none():
    # G01 in brdc1820.10n: the only record marked healthy is the wrong one
    records = chain(0, 0, 2e7, 0)
    records = replace(records, health=np.array([63.0, 63.0, 0.0, 63.0]))
    kept, report = screen(records)
    assert (rejected_records(records), report.unhealthy) == ([2], 3)
    assert not kept.healthy.any()
    records = chain(0, 5000, 0)
    rounded = replace(records, node=records.node * (1.0 + 1e-13))
    kept, report = screen(joined(records, rounded, records))
    assert (report.records, report.duplicates, report.rejected) == (9, 6, 1)
    assert_array_equal(kept.time_of_ephemeris, SATURDAY_22 + np.array([0.0, 4.0]) * HOUR)
    kept, report = screen(joined(one_record(), one_record(health=63.0), one_record()))
    assert (report.duplicates, report.unhealthy) == (2, 1)
    assert_array_equal(kept.health, [63.0])  # the unhealthy one stays
    other = one_record("G06", mean_anomaly=2.0)
    records = joined(chain(0, 0, 5000, 0), other, later(other, 2 * HOUR), later(other, 4 * HOUR))
    assert rejected_records(records) == [2]
    assert screen(records)[0].satellite_id.tolist() == ["G05"] * 3 + ["G06"] * 3


@PROPERTY
@given(order=st.permutations(range(7)))
def test_the_order_of_the_records_does_not_matter(order):
    records = chain(0, 0, 5000, 0, 0, -9000, 0)
    kept, report = screen(records)
    shuffled, same_report = screen(records.take(order))
    assert same_report == report
    assert_array_equal(shuffled.time_of_ephemeris, kept.time_of_ephemeris)
