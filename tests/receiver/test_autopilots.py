"""Logs of autopilots: what is read, what is left out and why, and what is refused."""

import sys
from importlib.util import find_spec

import numpy as np
import pytest

from spoofgym import InnovationLog
from spoofgym.calibration.log import judge_log
from spoofgym.core.reading import FileError
from spoofgym.receiver.autopilots import read_dataflash, read_ulog
from tools.autopilot_logs import (
    FUSED_S,
    SD,
    fly,
    fly_ardupilot,
    message,
    write_dataflash,
    write_ulog,
)

from ..command_line import call, refused

TESTS = ("snapshot-chi2", "ewma", "cusum", "aime", "glr-step")
needs_pyulog = pytest.mark.skipif(find_spec("pyulog") is None, reason="needs pyulog")


@needs_pyulog
@pytest.mark.parametrize("old", [False, True], ids=["estimator_innovations", "ekf2_innovations"])
def test_innovations_of_px4_come_back_with_the_sign_of_an_epoch(old, tmp_path):
    topics, z = fly(old=old)
    log = read_ulog(write_ulog(tmp_path / "flight.ulg", topics))
    rows = np.round((log.time - 1.0) / 0.1).astype(int)
    np.testing.assert_allclose(log.innovation, z[rows], rtol=1e-6)
    np.testing.assert_allclose(log.variance, np.tile(SD**2, (len(rows), 1)), rtol=1e-6)
    assert log.time[0] >= FUSED_S
    assert np.diff(log.innovation, axis=0).all()  # every fix is published twice
    assert abs(log.about["left_out"]["repeated"] - len(rows)) < 3
    # A gap, and a reset where it is counted; attitude may be reset as it likes.
    starts = log.time[1:][np.diff(log.segment) > 0]
    np.testing.assert_allclose(starts, [45.2] if old else [30.6, 45.2], atol=0.11)
    assert ("not logged" in log.about["trusted"]) == old


@needs_pyulog
def test_heights_that_are_not_of_gnss_are_left_out(tmp_path):
    log = read_ulog(write_ulog(tmp_path / "flight.ulg", fly(height=False)[0]))
    assert np.isnan(log.innovation[:, 2]).all()
    assert np.isfinite(np.delete(log.innovation, 2, axis=1)).all()
    assert log.about["left_out"]["positions down, whose height is not of GNSS"] == len(log.time)


@needs_pyulog
def test_the_estimator_that_flew_is_taken(tmp_path):
    (topics, _), (other, z), stamp = fly(), fly(seed=1), "uint64_t timestamp"
    topics |= {(name, 2): columns for (name, _), columns in other.items()}
    topics["estimator_selector_status", 0] = {
        stamp: np.array([5, 6, 7]) * 10**6,
        "uint8_t primary_instance": np.array([2, 2, 0]),
    }
    log = read_ulog(write_ulog(tmp_path / "flight.ulg", topics))
    assert "estimator 2 of 2" in log.about["found"]
    np.testing.assert_allclose(log.innovation[5], z[round(10 * (log.time[5] - 1.0))], rtol=1e-6)


@needs_pyulog
def test_an_autopilot_that_believes_in_noise_gets_no_alarm_of_any_test(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write_ulog(tmp_path / "flight.ulg", fly(believed=8.0)[0])
    shown = call("log", "import", path, "-o", "flight.npz")
    assert shown.exit_code == 0, shown.output
    for part in (
        "found: 549 epochs of estimator_innovations, estimator 0",
        "trusted: bits 2 (GNSS) and 11 (GNSS height) of control_mode_flags; counters of resets",
        "left out: 55 not of GNSS, as flags say, 246 repeated",
        "in 3 segments",
        "median NIS 0.012 (position), 0.012 (velocity)",
        "written: flight.npz",
    ):
        assert part in " ".join(shown.output.split()), shown.output
    log = InnovationLog.load("flight.npz")
    assert any("assumes 7.9" in line for line in log.list_remarks())
    for found in judge_log(log, list(TESTS)):
        assert found.ratio.max() < 0.1, found.detector
    steady = read_ulog(write_ulog(tmp_path / "steady.ulg", fly()[0]))
    assert min(each.nis for each in steady.check_signals()) > 0.9
    assert max(found.ratio.max() for found in judge_log(steady, list(TESTS))) > 0.4


@needs_pyulog
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop(("estimator_innovations", 0)), "holds no innovations of EKF2: log the"),
        (lambda t: t.pop(("estimator_innovation_variances", 0)), "needs the topic estimator_inno"),
        (lambda t: t.pop(("estimator_status", 0)), "needs the topic estimator_status, which was"),
        (
            lambda t: t["estimator_status", 0].update({"uint32_t control_mode_flags": [19] * 62}),
            "0 innovations of GNSS are left of 549 epochs .*; left out: 549 not of GNSS",
        ),
        (
            lambda t: t["estimator_innovations", 0].pop("float gps_vvel"),
            "a topic lacks the field 'gps_vvel'",
        ),
    ],
)
def test_a_log_without_innovations_of_gnss_says_what_to_log(change, message, tmp_path):
    topics, _ = fly()
    change(topics)
    path = write_ulog(tmp_path / "flight.ulg", topics)
    with pytest.raises(FileError, match=message) as caught:
        read_ulog(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value).splitlines()) == 1


def check_cut(path, read, sizes):
    """A log that is cut is read as far as it goes, or refused with its name."""
    whole, outcomes = path.read_bytes(), set()
    for size in sizes:
        path.write_bytes(whole[:size])
        try:
            outcomes.add(len(read(path).time) > 1)
        except FileError as error:
            outcomes.add(str(error).split(":")[0])
    assert outcomes == {True, str(path)}


@needs_pyulog
def test_damaged_logs_are_read_or_refused_with_their_name(tmp_path):
    path = write_ulog(tmp_path / "flight.ulg", fly(seconds=30.0)[0])
    whole = path.read_bytes()
    sizes = [*range(0, 700, 23), *np.linspace(700, len(whole), 20).astype(int)]
    check_cut(path, read_ulog, sizes)
    for kinds in (["a:a x;"], ["a:b[9999] x;", "b:uint8_t[9999] x;"]):
        nested = b"".join(message("F", kind.encode()) for kind in kinds)
        path.write_bytes(whole[:16] + nested + whole[16:])
        with pytest.raises(FileError, match=r"holds itself|more than 4096 fields"):
            read_ulog(path)
    path.write_bytes(b"not a log")
    assert f"{path}: pyulog can't read it" in refused("log", "import", path, "-o", "x.npz")


def test_without_its_package_a_log_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyulog", None)
    path = write_ulog(tmp_path / "flight.ulg", fly(seconds=10.0)[0])
    assert "pip install 'spoofgym[logs]'" in refused("log", "import", path, "-o", "x.npz")


SHARED = {
    "sample.ulg": "3271 epochs of ekf2_innovations, .* left out: 3271 without a time",
    "sample_appended_multiple.ulg": "184 epochs of ekf2_innovations, .*: 184 not of GNSS",
    "sample_log_small.ulg": "33 epochs of estimator_innovations, .*: 33 not of GNSS",
    "sample_logging_tagged_and_default_params.ulg": "estimator 0 of 3; .* 1279 not of GNSS",
}


@needs_pyulog
@pytest.mark.parametrize("name", SHARED)
def test_logs_of_four_versions_hold_no_innovations_of_gnss(name, data_folder):
    """The fields of GNSS hold innovations of an assumed position in all of them, or nothing."""
    path = data_folder / "ulog" / name
    if not path.is_file():
        pytest.skip(f"no {path}")
    with pytest.raises(FileError, match=SHARED[name]):
        read_ulog(path)


@needs_pyulog
def test_a_simulated_flight_of_px4_starts_with_its_first_fix(data_folder):
    path = data_folder / "ulog" / "sample_px4_events.ulg"
    if not path.is_file():
        pytest.skip(f"no {path}")
    log = read_ulog(path)
    assert len(log.time) == 43
    assert np.abs(log.innovation).max() < 1.0  # -1,006,600 m before
    assert [round(each.nis, 3) for each in log.check_signals()] == [0.015, 0.057]
    assert max(found.ratio.max() for found in judge_log(log, list(TESTS))) < 0.3


def test_variances_of_ardupilot_follow_from_its_test_ratios(tmp_path):
    rows, z = fly_ardupilot()
    path = write_dataflash(tmp_path / "flight.BIN", rows)
    log = read_dataflash(path)
    at = np.round((log.time - 1.0) / 0.2).astype(int)
    np.testing.assert_allclose(log.innovation, z[at], atol=1e-9)  # of the core that flew
    assert len(at) == 275  # of 300, from the first fix on
    # Of a test all axes have the same variance, that of 10 s; ratios are cut off to hundredths.
    for part in (slice(0, 2), slice(2, 3), slice(3, 6)):
        found = log.variance[:, part].sum(axis=1) / (SD[part] ** 2).sum()
        np.testing.assert_allclose(found, 1.0, atol=0.02)
    assert log.time[1:][np.diff(log.segment) > 0].tolist() == pytest.approx([30.2])
    assert (
        "EK3_POS_I_GATE 500, EK3_HGT_I_GATE 500, EK3_VEL_I_GATE 300" in log.about["reconstructed"]
    )
    low = read_dataflash(write_dataflash(path, fly_ardupilot(height=1)[0]))
    assert np.isnan(low.innovation[:, 2]).all()


@pytest.mark.skipif(find_spec("pymavlink") is None, reason="needs pymavlink, as a referee")
def test_messages_of_ardupilot_are_those_that_pymavlink_reads(tmp_path):
    from pymavlink.DFReader import DFReader_binary

    rows, z = fly_ardupilot()
    path = write_dataflash(tmp_path / "flight.BIN", rows)
    with DFReader_binary(str(path)) as theirs:
        messages = iter(lambda: theirs.recv_match(type=["XKF3"]), None)
        found = [(each.IPN, each.IVD) for each in messages if each.C == 1]
    assert len(found) == len(z)
    log = read_dataflash(path)
    np.testing.assert_allclose(np.array(found)[25:], -log.innovation[:, [0, 5]], atol=1e-9)


def test_an_ardupilot_that_believes_in_noise_is_imported_and_judged(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write_dataflash(tmp_path / "flight.BIN", fly_ardupilot(believed=8.0)[0])
    shown = " ".join(call("log", "import", path, "-o", "flight.npz").output.split())
    assert "found: 300 epochs of XKF3, core 1" in shown
    assert "reconstructed: variances" in shown
    log = InnovationLog.load("flight.npz")
    assert all(each.nis < 0.05 for each in log.check_signals())
    assert max(found.ratio.max() for found in judge_log(log, list(TESTS))) < 0.2


def test_damaged_logs_of_ardupilot_are_read_or_refused_with_their_name(tmp_path):
    rows, _ = fly_ardupilot(seconds=12.0)
    path = write_dataflash(tmp_path / "flight.BIN", rows)
    check_cut(path, read_dataflash, np.linspace(0, path.stat().st_size, 40).astype(int))
    write_dataflash(path, [row for row in rows if row[0] != "XKF4"])
    assert "holds no XKF3 and XKF4: fly with EKF3" in refused("log", "import", path, "-o", "x.npz")
