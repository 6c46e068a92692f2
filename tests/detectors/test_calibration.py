"""Order statistics of clean runs, the file that keeps them, and what they refuse to say."""

import json
import math
import os
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.detectors.calibration_file import (
    SHIPPED_FOLDER,
    STANDARD_RATES,
    Calibration,
    Conditions,
    compute_min_runs,
    compute_rank,
    file_name,
    hourly_rate,
    list_stored_ranks,
    load_stored,
    round_digits_up,
    run_probability,
)

WINDOW_S = 160.0


def calibration(maxima, *, before=0.0, bisected=False):
    runs = len(maxima)
    ranks = list_stored_ranks(runs, WINDOW_S)
    order = np.sort(maxima)[::-1]
    return Calibration(
        world={"kind": "none"},
        detector={"name": "toy"},
        window_s=WINDOW_S,
        runs=runs,
        entropy=0,
        seed_name="none",
        ranks=tuple(ranks),
        largest=tuple(round_digits_up(order[np.array(ranks) - 1]).tolist()),
        before=((1, before), (runs, before)),
        witnesses=((0, 0.0, float(maxima[0])),),
        bisected=bisected,
    )


def test_a_rate_is_by_the_hour_or_a_probability_by_the_run():
    assert run_probability(0.2, WINDOW_S) == pytest.approx(1.0 - math.exp(-0.2 * 160 / 3600))
    assert hourly_rate(run_probability(0.002, 77.0), 77.0) == pytest.approx(0.002)
    assert hourly_rate(1.0, 77.0) == math.inf
    with pytest.raises(ValueError, match=r"hour=0\.2 and per_run=0\.05"):
        calibration(RUNS_499).point(0.2, per_run=0.05)
    for per_run in (0.0, 1.0):
        with pytest.raises(ValueError, match="`per_run` must be a number above 0 and below 1"):
            calibration(RUNS_499).interval(per_run)


@pytest.mark.parametrize("p", [0.001, 0.00885, 0.05, 0.3])
def test_the_rank_is_the_lowest_that_keeps_the_probability(p):
    least = compute_min_runs(p)
    for n in (least, least + 1, 2000, 54_321):
        rank = compute_rank(p, n)
        # a new run among n that are like it exceeds the order statistic of this rank so often
        assert rank / (n + 1) <= p + 1e-9 < (rank + 1) / (n + 1)
    assert compute_rank(p, least - 1) < 1 <= compute_rank(p, least)


def test_neither_a_thinned_file_nor_written_scales_exceed_a_rate():
    maxima = np.random.default_rng(4).permutation(50_000) + 1.0
    found = calibration(maxima)
    assert len(found.ranks) < 1000
    for rate in [*np.geomspace(0.001, 100.0, 50).tolist(), *STANDARD_RATES]:
        point = found.point(rate)
        exact = compute_rank(point.per_run, found.runs)
        assert exact / 1.011 - 1 <= point.rank <= exact
        assert point.rank == exact or rate not in STANDARD_RATES
        assert (maxima > point.scale).sum() <= exact - 1
        assert not point.extrapolated
    values = np.random.default_rng(5).lognormal(size=5000) * 10.0 ** np.arange(-5, 5).repeat(500)
    up = round_digits_up(values)
    assert (up >= values).all()
    np.testing.assert_allclose(up, values, rtol=1.1e-11)
    assert round_digits_up(np.zeros(3)).tolist() == [0.0, 0.0, 0.0]
    assert json.loads(json.dumps(up.tolist())) == up.tolist()


def test_what_runs_can_just_say_and_a_tail_is_fitted_beyond_the_largest_alone_and_marked():
    found = calibration(np.random.default_rng(6).exponential(size=4000) + 2.0)
    inside, beyond = found.point(0.01), found.point(0.001)
    assert (inside.extrapolated, inside.rank) == (False, 1)
    assert (beyond.extrapolated, beyond.rank) == (True, 0)
    assert "fitted tail" in str(beyond)
    # an exponential tail: its quantile is known
    assert beyond.scale == pytest.approx(2.0 - math.log(beyond.per_run), rel=0.25)
    assert beyond.scale >= found.largest[0]
    # and not past a tenth of a run
    least = hourly_rate(1.0 / 40_000, WINDOW_S)
    assert found.point(least * 1.001).extrapolated
    with pytest.raises(ValueError, match=r"for which 4000 clean runs are too few: it takes at lea"):
        found.point(least * 0.999)
    assert 1.0 <= calibration(RUNS_499).point(0.999999 * MOST_499).scale < 7.0  # ranks are thinned
    assert calibration(np.r_[np.zeros(1990), np.arange(1.0, 11.0)]).point(0.05).scale > 0.0
    state = calibration(np.arange(1.0, 2001.0), bisected=True)  # which has no tail
    with pytest.raises(ValueError, match=r"too few: it takes at least 11250$"):
        state.point(0.002)
    found = calibration(np.linspace(1.0, 2.0, 500), before=1.5)
    assert [found.point(rate).warmup_alarms for rate in (2.0, 100.0)] == [0.0, 1.0]


RUNS_499 = np.arange(1.0, 500.0)
MOST_499 = hourly_rate(499.0 / 500.0, WINDOW_S)


@pytest.mark.parametrize(
    ("maxima", "rate", "said"),
    [
        (np.arange(1.0, 100.0), 0.2, r"99 clean runs are too few: .* at least 113, or 500 for"),
        (RUNS_499, 0.0, "`false_alarms_per_hour` must be a number above 0, got 0"),
        (RUNS_499, 1.01 * MOST_499, r"must be at most 139\.\d* for 499 runs of 160 s: a run h"),
        (np.r_[np.zeros(1990), np.arange(1.0, 11.0)], 0.2, r"toy is degenerate: .* 0 in 99\.5 % o"),
    ],
)
def test_what_runs_cannot_say_is_refused(maxima, rate, said):
    with pytest.raises(ValueError, match=said):
        calibration(maxima).point(rate)


def test_files(tmp_path):
    made = calibration(np.arange(1.0, 3000.0))
    saved = made.save(tmp_path / "folder" / "toy.json")
    assert Calibration.load(saved.path) == made
    assert [path.name for path in saved.path.parent.iterdir()] == ["toy.json"]
    text = saved.path.read_text()
    whole = json.loads(text)
    old = {key: value for key, value in whole.items() if key != "checksum"}
    write = lambda **changes: json.dumps(old | changes)  # noqa: E731
    plain = tmp_path / "plain.json"
    plain.write_text(write())
    assert Calibration.load(plain) == made
    ranks, largest = old["ranks"], old["largest"]
    faults = [
        ("{}", "is no calibration: it has no 'format'"),
        ("[" * 100_000, "is no calibration"),
        (text[:-20], "is no calibration"),
        (text.replace('"window_s":160.0', '"window_s":161.0'), "its checksum is not that of its"),
        (write(format=2), "its format is 2, this version reads 1"),
        (write(runs=29), "are not in order"),
        (write(runs=2_999_000), "must reach from rank 1 to that of all runs"),
        (write(runs=True), "`runs` must be"),
        (write(window_s=0.0), "`window_s` must be"),
        (write(window_s=math.inf), "is no calibration"),
        (write(entropy=-1), "`entropy` must be"),
        (write(world=[]), "`world` must be settings"),
        (write(detector={}), "`detector.name` must be a text"),
        (write(seed_name=None), "`seed_name` must be a text"),
        (write(bisected=1), "`bisected` must be a bool"),
        (write(rescale=[1.0, 1.0, 0.0, 1.0]), "`rescale` must be"),
        (write(largest=[-1.0, *largest[1:]]), "are not in order"),
        (write(largest=largest[:-1]), "is no calibration"),
        (write(largest=[0.01 * x for x in largest], witnesses=[[0, 0.0, 40.0]]), "do not fit"),
        (write(largest=[100.0 * x for x in largest]), "do not fit its order statistics"),
        (write(ranks=[1.5, *ranks[1:]]), r"at whole ranks, got 2999\..* at 1\.5"),
        (write(ranks=[ranks[1], ranks[0], *ranks[2:]]), "are not in order"),
        (write(largest=["2999", *largest[1:]]), "got '2999' at 1"),
        (write(before=[[1, 0.0], [1, 0.0]]), "are not in order"),
        (write(witnesses=[[0, 1.0, 1.0]]), "do not fit its order statistics"),
        (write(witnesses=[[5, 0.0, 1.0]]), "`witnesses` must be runs, got 5"),
        (write(witnesses=[]), "`witnesses` must be runs, got none"),
    ]
    path = tmp_path / "bad.json"
    for k, (bad, message) in enumerate(faults):
        path.write_text(bad)
        os.utime(path, (k, k))
        with pytest.raises(ValueError, match=message):
            Calibration.load(path)


def test_a_stored_calibration_is_taken_for_its_content(tmp_path):
    made = calibration(np.arange(1.0, 3000.0))
    here = Conditions(dict(made.world), WINDOW_S, "here", "")

    def stored(conditions, *, detector=made.detector, rescaled=False, content=made):
        content.save(tmp_path / file_name(conditions.digest, detector, rescaled))
        return next(load_stored(conditions, detector, rescaled, tmp_path))

    assert stored(here) == made
    elsewhere = replace(here, settings={"kind": "else"}, label="there")
    with pytest.raises(ValueError, match="else than toy in there: world kind: 'none' there, 'els"):
        stored(elsewhere)
    with pytest.raises(ValueError, match="detector gain: None there, 2 here"):
        stored(here, detector={"name": "toy", "gain": 2})
    with pytest.raises(ValueError, match="rescaled: False there, True here"):
        stored(here, rescaled=True)
    longer = replace(made, window_s=2.0 * WINDOW_S)
    with pytest.raises(ValueError, match=r"must have a window of 160.0 s, got 320\.0"):
        stored(here, content=longer)


def test_shipped_files_have_a_checksum():
    for path in sorted(SHIPPED_FOLDER.rglob("*.json")):
        end = path.read_text()[-40:]
        assert '"checksum":' in end, f"{path}: `Calibration.load(path).save(path)` adds it"


@pytest.mark.usefixtures("default_rate")
def test_a_test_with_a_drift_term_that_hardly_alarms_is_marked():
    with pytest.warns(UserWarning, match="cusum hardly ever alarms at an attack here: at 0.2 fal"):
        gym.make("spoofgym/Zhong2025-v0", detector="cusum").close()
