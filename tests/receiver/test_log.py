"""Logs of innovations: both forms, what is refused, and detectors in front of them."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from spoofgym import InnovationLog
from spoofgym.calibration.log import cut_windows, judge_log
from spoofgym.detectors import make_detector
from spoofgym.receiver import replay
from spoofgym.receiver.epoch import FILTER
from spoofgym.simulation import Engine, TightlyCoupledSetup
from spoofgym.simulation.recording import record_run

from ..command_line import call, refused

pandas = pytest.importorskip("pandas")

NAMES = ("north", "east", "down")
TESTS = ("snapshot-chi2", "cusum", "aime", "ewma", "glr-step", "shewhart")


def write_filter(seconds=4000, interval_s=1.0, ramp_mps=0.0, from_s=np.inf, seed=0):
    """Rows of a filter of its own: position and velocity, driven by white acceleration."""
    rng = np.random.default_rng(seed)
    F, q = np.array([[1.0, interval_s], [0.0, 1.0]]), 0.1
    Q = q * np.array([[interval_s**3 / 3, interval_s**2 / 2], [interval_s**2 / 2, interval_s]])
    R, root, truth = np.diag([4.0, 0.04]), np.linalg.cholesky(Q), np.zeros((2, 3))
    estimate, P, rows = np.zeros((2, 3)), np.diag([4.0, 1.0]), []
    for k in range(1, round(seconds / interval_s) + 1):
        time = k * interval_s
        truth = F @ truth + root @ rng.standard_normal((2, 3))
        pull = max(time - from_s, 0.0) * ramp_mps
        false = np.array([[pull, 0.0, 0.0], [ramp_mps * (pull > 0.0), 0.0, 0.0]])
        measured = truth + false + np.sqrt(np.diag(R))[:, None] * rng.standard_normal((2, 3))
        estimate, P = F @ estimate, F @ P @ F.T + Q
        S, z = P + R, measured - estimate
        for axis, name in enumerate(NAMES):
            for signal, row in (("position", 0), ("velocity", 1)):
                rows.append((time, name, signal, z[row, axis], S[row, row]))
        gain = P @ np.linalg.inv(S)
        estimate, P = estimate + gain @ z, P - gain @ P
    return pandas.DataFrame(rows, columns=["time_s", "channel", "signal", "innovation", "variance"])


@pytest.fixture(scope="module")
def clean():
    return InnovationLog.from_table(write_filter())


@pytest.mark.parametrize("signals", ["pseudorange", "range_rate"])
def test_a_log_of_the_engine_gives_its_statistics_to_the_last_bit(signals, tmp_path):
    detector = {"name": "snapshot-chi2", "signals": signals}
    setup = TightlyCoupledSetup(
        scenario="zhong2025", detector=detector, timeline={"warmup_s": 20.0, "live_s": 10.0}
    )
    initial, recording, _ = record_run(setup, np.random.default_rng(4), epochs=80)
    log = InnovationLog.from_replay(replay(recording, setup.receiver, initial=initial))
    log = InnovationLog.load(log.save(tmp_path / "run.npz"))
    (found,) = judge_log(log, [detector])
    engine = Engine(1, setup, threads=1)
    engine.reset([np.random.default_rng(4)])
    ratio = []
    for _ in range(80 - int(engine.simulator.onset[0])):
        engine.step(np.zeros((1, len(setup.action_names))))
        ratio.append(engine.simulator.ratio()[0])
    assert len(ratio) > 30
    np.testing.assert_array_equal(found.ratio[-len(ratio) :], ratio)
    # a table has no correlations: clock drift is common to all range rates, and hides their errors
    table = InnovationLog.load(log.save(tmp_path / "run.csv"))
    (coarse,) = judge_log(table, [detector])
    left = np.median(coarse.ratio) / np.median(found.ratio)
    assert 0.9 < left < 1.0 if signals == "pseudorange" else left < 0.2
    assert any("correlations" in line for line in table.list_remarks())
    assert not any("correlations" in line for line in log.list_remarks())


def test_tests_of_ranges_and_of_separation_judge_a_log_that_has_what_they_need(tmp_path):
    timeline = {"warmup_s": 10.0, "live_s": 10.0}
    for spec, more in ({"name": "raim", "sigma_m": 2.5}, True), ("solution-separation", False):
        detector = make_detector(spec)
        setup = TightlyCoupledSetup(scenario="zhong2025", detector=detector, timeline=timeline)
        initial, recording, _ = record_run(setup, np.random.default_rng(4), epochs=60)
        solution = replay(recording, setup.receiver, initial=initial, fields=FILTER)
        log = InnovationLog.from_replay(solution, recording if more else None)
        log = InnovationLog.load(log.save(tmp_path / "run.npz"))
        (found,) = judge_log(log, [spec])
        engine = Engine(1, setup, threads=1)
        engine.reset([np.random.default_rng(4)])
        ratio = []
        for _ in range(60 - int(engine.simulator.onset[0])):
            engine.step(np.zeros((1, len(setup.action_names))))
            ratio.append(engine.simulator.ratio()[0])
        # the log has the position after the update
        np.testing.assert_allclose(found.ratio[-len(ratio) :], ratio, rtol=1e-3)
        assert max(ratio) > 0.0
    half = {name: x for name, x in log.more.items() if name != "predicted_position"}
    with pytest.raises(ValueError, match="needs predicted_position of every epoch"):
        judge_log(replace(log, more=half), ["solution-separation"])
    with pytest.raises(ValueError, match="needs the 17 states of a tightly coupled receiver"):
        judge_log(replace(log, velocity=()), ["solution-separation"])
    with pytest.raises(
        ValueError, match=r"ranges need .*, got pseudorange, predicted_position alone"
    ):
        replace(log, more={**log.more, "pseudorange": np.zeros(log.visible.shape)})


def test_a_filter_of_ones_own_is_judged_unchanged_and_its_ramp_found(clean):
    attacked = InnovationLog.from_table(write_filter(ramp_mps=5.0, from_s=3000.0))
    specs = [{"name": name, "signals": "range_rate"} for name in TESTS if name != "ewma"]
    specs.append("ewma")
    onset = clean.time > 3000.0
    for quiet, loud in zip(judge_log(clean, specs, 1.0), judge_log(attacked, specs), strict=True):
        assert (loud.ratio[onset] / quiet.factor).max() > 1.0, loud.detector
        assert (loud.ratio[~onset] / quiet.factor > 1.0).mean() < 0.05, loud.detector
    nis = {each.signal: each for each in clean.check_signals()}
    for each in nis.values():
        assert each.low < 1.0 < each.high
        assert abs(each.lag1) < 0.1
        assert each.innovations == 3 * 4000


def test_thresholds_of_the_log_keep_their_rate_on_another_one():
    rate, window_s, alarms, windows = 20.0, 30.0, 0, 0
    fitted, *others = (InnovationLog.from_table(write_filter(3000, seed=seed)) for seed in range(4))
    (own,) = judge_log(fitted, ["snapshot-chi2"], rate, window_s)
    for log in others:
        (found,) = judge_log(log, ["snapshot-chi2"], None, window_s)
        alarms += int((found.windows > own.factor).sum())
        windows += len(found.windows)
    # 15 % of 300 windows, where the threshold is the 15th of 100: within 4 standard deviations
    p = -np.expm1(-rate * window_s / 3600.0)
    spread = np.sqrt(windows * p * (1 - p) * (1.0 + windows / len(own.windows)))
    assert abs(alarms - p * windows) < 4.0 * spread


def test_a_rate_beyond_the_log_is_refused_with_the_one_that_it_supports(clean):
    message = r"need 113 windows of 160 s \(5.0 h\), .* has 25; it supports (\S+) an hour"
    with pytest.raises(ValueError, match=message) as caught:
        judge_log(clean, ["snapshot-chi2"], 0.2)
    supported = float(re.search(message, str(caught.value))[1])
    assert judge_log(clean, ["snapshot-chi2"], 1.01 * supported)[0].factor > 0.0


def test_segments_begin_anew_and_time_that_runs_back_is_refused():
    table = write_filter(400)
    back = table.assign(time_s=np.where(table.time_s > 200, table.time_s - 150.5, table.time_s))
    with pytest.raises(ValueError, match=r"must rise within a segment.*begin a new segment"):
        InnovationLog.from_table(back)
    log = InnovationLog.from_table(back.assign(segment=(table.time_s > 200).astype(int)))
    assert log.duration_s == pytest.approx(398.0)
    assert (cut_windows(log, 60.0).max() + 1, (cut_windows(log, 60.0) < 0).sum()) == (6, 40)


def test_rows_may_come_channel_by_channel_and_epochs_be_absent_in_some():
    table = write_filter(50)
    part = table[~((table.channel == "down") & (table.time_s == 7.0))]
    ordered, grouped = (
        InnovationLog.from_table(t) for t in (part, part.sort_values("channel", kind="stable"))
    )
    np.testing.assert_array_equal(grouped.innovation, ordered.innovation)
    assert (~grouped.visible).sum() == 1


def test_a_log_that_would_take_the_memory_is_refused(monkeypatch):
    monkeypatch.setattr("spoofgym.receiver.log.MOST_ELEMENTS", 1000)
    with pytest.raises(ValueError, match="got 50 epochs of 3 channels: cut it into parts"):
        InnovationLog.from_table(write_filter(50))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop(columns="variance"), "missing: variance"),
        (lambda t: t.assign(variance=0.0), "variances must be positive, got 0 at 1 s of down"),
        (lambda t: t.assign(variance=np.nan), "variances must be positive, got nan"),
        (lambda t: t.assign(signal="doppler_hz"), "pseudorange and range_rate, .* got doppler_hz"),
        (lambda t: pandas.concat([t, t.iloc[:1]]), "position of north is there twice at 1 s"),
        (lambda t: t.assign(time_s=np.nan), "`time` must be finite"),
        (lambda t: t.assign(innovation=np.inf), "`innovation` must be finite; absent is NaN"),
        (lambda t: t.iloc[:0], "a log needs rows"),
    ],
)
def test_what_is_no_log_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        InnovationLog.from_table(change(write_filter(20)))


def test_tables_of_other_languages_are_read(tmp_path):
    """Blanks after commas, absent numbers as C++ prints them, seconds of a week that begins again,
    epochs that jitter."""
    rng, table = np.random.default_rng(0), write_filter(100)
    rising = 604_750.0 + table.time_s + rng.uniform(-0.2, 0.2, 100).repeat(6)
    rows = [",".join(f" {x}" for x in row) for row in table.itertuples(index=False)]
    rows[7] = " 2.0, north, velocity, -nan(ind), nan"  # rejected by the filter
    stamps = np.mod(rising, 604_800.0)
    lines = [f"{a}{row[row.index(',') :]}" for a, row in zip(stamps, rows, strict=True)]
    head = "time_s , channel, signal, innovation, variance"
    (tmp_path / "log.csv").write_text("\n".join([head, *lines]))
    log = InnovationLog.load(tmp_path / "log.csv")
    np.testing.assert_allclose(log.time, rising[::6])
    assert log.channels == ("down", "east", "north")
    assert (~np.isfinite(log.innovation)).sum() == 1
    slow = replace(log, time=1e3 * log.time)
    assert any("are times in s" in line for line in slow.list_remarks())


@pytest.mark.parametrize("last", [False, True])
def test_matrices_of_matlab_are_read_with_epochs_as_first_or_last_axis(clean, last, tmp_path):
    from scipy.io import savemat

    arrays = {"time": clean.time[:, None], "innovation": clean.innovation}
    cov = clean.innovation_cov
    arrays["innovation_cov"] = np.moveaxis(cov, 0, 2) if last else cov
    arrays["channels"] = np.array(clean.channels, dtype=object)  # cells, or rows of letters
    arrays["signals"] = np.array(clean.signals, dtype=object if last else str)
    savemat(tmp_path / "log.mat", arrays)
    found = InnovationLog.load(tmp_path / "log.mat")
    for name in ("time", "innovation", "innovation_cov", "channels", "signals"):
        np.testing.assert_array_equal(getattr(found, name), getattr(clean, name))
    whole = (tmp_path / "log.mat").read_bytes()
    for damage in (whole[:200], b"MATLAB 7.3 MAT-file" + b" " * 105 + b"\0\2IM" + whole):
        (tmp_path / "log.mat").write_bytes(damage)
        with pytest.raises(
            ValueError, match=r"log.mat: (scipy can't read it|it is of version 7\.3)"
        ):
            InnovationLog.load(tmp_path / "log.mat")


def test_matrices_of_a_wrong_shape_or_with_objects_are_refused(clean, tmp_path):
    path = clean.save(tmp_path / "log.npz")
    with np.load(path) as found:
        arrays = dict(found)
    for name, value, message in (
        ("innovation_cov", arrays["innovation_cov"][:, :5], r"must have shape \(4000, 6, 6\)"),
        ("signals", np.array(["a", "b"]), "pseudorange and range_rate or position and velocity"),
        ("about", np.array({"a": 1}, dtype=object), "an array of object"),
    ):
        np.savez(path, **{**arrays, name: value}, allow_pickle=True)
        with pytest.raises(ValueError, match=message):
            InnovationLog.load(path)
    np.savez(path, time=arrays["time"])
    with pytest.raises(ValueError, match="missing arrays: innovation, innovation_cov"):
        InnovationLog.load(path)


def test_a_detector_says_what_the_log_lacks(clean):
    alone = InnovationLog.from_table(write_filter(400).query("signal == 'position'"))
    with pytest.raises(
        ValueError, match="tests velocity, which the log does not have: give it sig"
    ):
        judge_log(alone, [{"name": "snapshot-chi2"}])
    assert judge_log(alone, [{"name": "snapshot-chi2", "signals": "pseudorange"}])[0].factor == 1.0
    rates = InnovationLog.from_table(write_filter(400).query("signal == 'velocity'"))
    with pytest.raises(ValueError, match=r"ewma has a statistic of 0 .* does not read velocity"):
        judge_log(rates, ["ewma"])
    with pytest.raises(
        ValueError, match=r"raim needs .*pseudorange, .* which the log does not have"
    ):
        judge_log(clean, ["raim"])
    augmented = make_detector({"name": "solution-separation", "filter": "augmented"})
    with pytest.raises(ValueError, match="needs a model of all errors for a filter of its own"):
        judge_log(clean, [augmented])


def test_the_command_checks_judges_and_converts(clean, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_filter(800).to_csv("walk.csv", index=False)
    shown = " ".join(call("log", "check", "walk.csv").output.split())
    assert "800 epochs in 1 segments, 799 s, one every 1 s, of 3 channels" in shown
    wrong = write_filter(200)
    wrong.assign(innovation=57.3 * wrong.innovation).to_csv("wrong.csv", index=False)
    remarks = json.loads(call("log", "check", "wrong.csv", "--json").output)["remarks"]
    assert all("are units, time base and satellite clocks right" in line for line in remarks)
    assert "written: walk.npz" in call("log", "import", "walk.csv", "-o", "walk.npz").output
    found = json.loads(call("log", "import", "walk.csv", "-o", "walk.npz", "--json").output)
    assert (found["epochs"], found["written"]) == (800, "walk.npz")
    options = "--detector", "ewma", "--detector", "snapshot-chi2:signals=pseudorange"
    rows = json.loads(call("log", "judge", "walk.npz", *options, "--json").output)
    assert [row["epochs"] for row in rows] == [800, 800]
    judged = call("log", "judge", "walk.npz", *options, "--false-alarms-per-hour", "10")
    assert judged.exit_code == 0
    assert "it supports" in refused(
        "log", "judge", "walk.npz", *options, "--false-alarms-per-hour", "0.2"
    )
    assert "there is no file" in refused("log", "check", "none.csv")
    assert "valid: .csv, .npz" in refused("log", "import", "walk.csv", "-o", "walk.txt")


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("innovation", lambda x: x + 1j, "must hold numbers on 2 axes, got complex128 on 2"),
        ("time", lambda x: x.astype(str), "must hold numbers on 1 axes, got <U"),
        ("innovation", lambda x: np.where(x == x[5, 1], np.inf, x), "finite numbers, got inf"),
        ("segment", lambda x: np.where(x == x[0], np.nan, 0.0), "finite whole numbers, got nan"),
        ("segment", lambda x: x + 0.5, "must hold finite whole numbers, got 0.5"),
        ("segment", lambda x: x + 1e18, r"must hold finite whole numbers, got 1e\+18"),
        (
            "innovation_cov",
            lambda x: x + np.eye(6)[0],
            "`innovation_cov` must be a covariance, got",
        ),
        (
            "innovation_cov",
            lambda x: x + 9.0 * (1.0 - np.eye(6)),
            "must be a covariance, got 9 and",
        ),
    ],
)
def test_every_array_of_a_file_is_of_its_kind(clean, name, change, said, tmp_path):
    clean.save(path := tmp_path / "log.npz")
    arrays = dict(np.load(path))
    np.savez(path, **{**arrays, name: change(arrays[name].astype(float))})
    with pytest.raises(ValueError, match=rf"log\.npz.*{said}"):
        InnovationLog.load(path)
