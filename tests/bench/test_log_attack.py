"""Attacks on a log: as on the engine, as on the log's own filter, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

import spoofgym
from spoofgym import InnovationLog
from spoofgym.bench.experiments.log_audit import LogAuditor
from spoofgym.bench.report.audit import format_screen
from spoofgym.bench.runs.play import WarmStart, play
from spoofgym.bench.runs.record import MEASURES, measure_displacement, undetected_displacement
from spoofgym.bench.search.log_attack import MOVED, UNITS, attack_log
from spoofgym.bench.search.open_loop import OpenLoopSearch
from spoofgym.calibration.log import judge_log
from spoofgym.limits.log_replay import LogReplay
from spoofgym.receiver import replay
from spoofgym.receiver.log_noise import fit_noise_factors
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.recording import record_run

from ..command_line import call, refused

TESTED = {"name": "snapshot-chi2", "signals": "both", "thresholds": "nominal"}
SHORT = {"attack_s": 40.0, "time_to_alert_s": 10.0}
pytest.importorskip("cmaes")


def write_filter(path, seconds=1600, false=None, believed=1.0, seed=0):
    """A loosely coupled filter of 15 states, of NumPy alone; `false` (K, 6) added to what it
    measures, `believed` factor on the standard deviations of its noise. Its positions (K, 3)."""
    rng, F, H = np.random.default_rng(seed), np.zeros((15, 15)), np.zeros((6, 15))
    F[0:3, 12:15], F[3:6, 9:12], F[6:9, 3:6] = np.eye(3), np.eye(3), np.eye(3)
    F[3:6, 0:3] = [[0.0, 9.8, 0.0], [-9.8, 0.0, 0.0], [0.0, 0.0, 0.0]]
    F[9:, 9:] = -np.eye(6) / 300.0
    Phi = np.eye(15) + F + 0.5 * F @ F
    H[:3, 6:9] = H[3:, 3:6] = np.eye(3)
    q, r = (np.repeat(sd, 3) for sd in ([3e-5, 3e-2, 1e-3, 3e-4, 3e-7], [2.0, 0.1]))
    P, R = np.diag(np.repeat([1e-4, 1.0, 9.0, 1e-4, 1e-9], 3)), np.diag((believed * r) ** 2)
    truth, x = np.sqrt(np.diag(P)) * rng.standard_normal(15), np.zeros(15)
    rows = []
    for k in range(seconds):
        truth = Phi @ truth + q * rng.standard_normal(15)
        x, P = Phi @ x, Phi @ P @ Phi.T + np.diag(q**2)
        z = H @ (truth - x) + r * rng.standard_normal(6) + (0.0 if false is None else false[k])
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        x = x + K @ z
        rows.append((z, S, P, x[6:9]))
        P = P - K @ H @ P
    z, S, P, position = map(np.array, zip(*rows, strict=True))
    known = {"design": H, "transition": Phi}
    np.savez(
        path,
        time=np.arange(1.0, seconds + 1.0),
        innovation=z,
        innovation_cov=S,
        predicted_cov=P,
        **{name: np.tile(each, (seconds, 1, 1)) for name, each in known.items()},
        channels=["north", "east", "down"],
        signals=["position", "velocity"],
        position=[6, 7, 8],
        velocity=[3, 4, 5],
    )
    return position


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "own.npz"
    return path, write_filter(path)


def test_a_log_of_the_engine_gives_its_displacements_and_alarms():
    times = {"warmup_s": 30.0, "live_s": 30.0, "attack_s": 20.0, "time_to_alert_s": 10.0}
    attack = {"name": "false-position", "control": "rate"}
    setup = TightlyCoupledSetup(
        scenario="zhong2025", detector=TESTED, attack=attack, timeline=times
    )
    start = WarmStart(setup, [np.random.default_rng([4, k]) for k in range(8)], threads=1)
    clean, parts = play(start, "none"), []
    for k in range(8):
        count, rng = setup.onset + setup.steps + setup.hold, np.random.default_rng([4, k])
        initial, recording, _ = record_run(setup, rng, epochs=count)
        fields = "predicted_cov", "design", "transition"
        solution = replay(recording, setup.receiver, initial=initial, fields=fields)
        parts.append(InnovationLog.from_replay(solution))
    names = "time", "innovation", "innovation_cov"
    log = InnovationLog(
        **{name: np.concatenate([getattr(each, name) for each in parts]) for name in names},
        more={x: np.concatenate([each.more[x] for each in parts]) for x in parts[0].more},
        **{name: getattr(parts[0], name) for name in ("channels", "about", "position", "velocity")},
        segment=np.repeat(np.arange(8), count),
    )
    linear = LogReplay(log, TESTED, attack_s=20.0)
    for rate in (0.2, 0.35, 1.0):
        attacked = play(start, {"name": "ramp", "rate_mps": rate})
        (moved,) = measure_displacement(setup, attacked, clean, MEASURES[:1]).values()
        found = linear.play(0, np.full((1, linear.steps), rate))
        np.testing.assert_array_equal(found.first_alarm[0], attacked.first_alarm)
        np.testing.assert_allclose(found.peak[0], attacked.peak, rtol=2e-3)
        error = found.error[: setup.steps, 0]
        mine = undetected_displacement(error, found.first_alarm[0], setup.hold)
        np.testing.assert_allclose(mine, moved, rtol=2e-3)


def test_the_response_of_ones_own_filter_is_that_of_an_attacked_replay(own, tmp_path):
    path, clean = own
    log, window = InnovationLog.load(path), 3
    linear = LogReplay(log, TESTED, **SHORT, heading_deg=270.0)  # its H is that of measurements
    at, false = int(linear.starts[window]), np.zeros((1600, 6))
    moved = np.clip(np.arange(1600) - at + 1.0, 0.0, None)
    false[:, 1], false[:, 4] = 0.5 * moved, 0.5 * (moved > 0.0)
    attacked = write_filter(tmp_path / "attacked.npz", false=false)
    found = linear.play(0, np.full((1, linear.steps), 0.5))
    rows = slice(at, at + linear.epochs)
    error = np.hypot(*(attacked - clean)[rows, :2].T)
    np.testing.assert_allclose(found.error[:, 0, window], error, rtol=2e-3)
    (judged,) = judge_log(InnovationLog.load(tmp_path / "attacked.npz"), [TESTED])
    assert found.peak[0, window] == pytest.approx(judged.ratio[rows].max(), rel=2e-3)


def test_every_family_is_scored_at_the_budget_and_within_the_bound(own):
    log, search = InnovationLog.load(own[0]), OpenLoopSearch(generations=2)
    (found,) = attack_log(log, ["snapshot-chi2"], 20.0, **SHORT, search=search)
    rows = json.loads(json.dumps(found.as_json(), allow_nan=False))["families"]
    assert {row["family"] for row in rows} == set(UNITS)
    half = {row["family"]: row for row in rows if row["budget"] == 0.5}
    assert found.windows == 31
    counted = found.windows - found.clean_alarms
    for row in rows:
        assert row["counted"] == counted
        assert row["at_limit"] or abs(row["alarm_rate"] - row["budget"]) < 2.0 / counted
        assert row[MOVED]["low"] <= row[MOVED]["value"] <= row[MOVED]["high"]
    assert half["open-loop"][MOVED]["value"] > half["ramp"][MOVED]["value"]
    assert half["step"][MOVED]["value"] < half["ramp"][MOVED]["value"]
    assert max(row[MOVED]["value"] for row in rows) < found.zero_alarm.restricted_m


def test_windows_are_cut_where_epochs_jitter_but_none_is_missing(own):
    log, rng = InnovationLog.load(own[0]), np.random.default_rng(0)
    starts = LogReplay(log, TESTED, **SHORT).starts
    jitter = replace(log, time=log.time + rng.uniform(-0.3, 0.3, len(log.time)))
    assert LogReplay(jitter, TESTED, **SHORT).starts.tolist() == starts.tolist()
    late = replace(log, time=log.time + (np.arange(len(log.time)) >= 800))
    assert len(LogReplay(late, TESTED, **SHORT).starts) == len(starts) - 1
    with pytest.raises(ValueError, match="`heading_deg` must be"):
        LogReplay(log, TESTED, heading_deg=np.nan)


def test_the_noise_that_would_mend_a_log_does(tmp_path):
    write_filter(tmp_path / "timid.npz", believed=3.0)
    found = fit_noise_factors(InnovationLog.load(tmp_path / "timid.npz"))
    for signal in ("position", "velocity"):
        assert found[signal].factor == pytest.approx(1.0 / 3.0, rel=0.05)
        assert found[signal].nis < 0.3
        assert found[signal].mended == pytest.approx(1.0, abs=0.01)
    shown = call("log", "check", str(tmp_path / "timid.npz"), "--json").output
    noise = json.loads(shown)["signals"][0]["noise"]
    assert noise["factor"] == pytest.approx(found["position"].factor)


def test_an_audit_of_a_log_has_screen_and_report_of_the_others(own, tmp_path):
    auditor = LogAuditor(
        own[0], "quick", families=["ramps", "dashes"], folder=tmp_path, alert_limit_m=5.0, **SHORT
    )
    detector = {"name": "snapshot-chi2", "false_alarms_per_hour": 20.0}
    cells = auditor.prepare(detector)
    store = spoofgym.bench.experiments.MemoryStore()
    found = cells.conclude(spoofgym.bench.experiments.run_experiment(cells, store))
    screen = "\n".join(format_screen(found))
    assert "31 windows of 50 s of a log, alert limit 5 m" in screen
    assert "15 runs of each of 2 families, chosen on 16" in screen
    record = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    rate = record["false_alarms_per_hour"]
    assert rate["low"] < 20.0 < rate["high"]
    assert record["requested_per_hour"] == 20.0
    assert record["ages"]["age_s"] == [30.0, 180.0, 600.0]
    ramps = next(x for x in record["families"] if x["family"] == "ramps")
    assert ramps["exceeded_m"]["0.5"]["value"] > 0.0
    with pytest.raises(ValueError, match=r"need 360 windows .* it supports"):
        auditor.prepare({**detector, "false_alarms_per_hour": 0.2})


def test_an_audit_takes_its_options_and_writes_attacks_that_play_again(own, tmp_path):
    rate, length = ["--false-alarms-per-hour", "20"], ["--attack-s", "40"]
    options = [*rate, *length, "--alert-limit-m", "5", "--family", "ramps", "--budget", "quick"]
    both = "audit", "snapshot-chi2", "ewma", "--log", str(own[0]), *options
    text = call(*both, "--out", str(tmp_path), "--json").output
    found = json.loads(text[text.index("[\n") :] if not text.startswith("[") else text)
    assert [each["detector"] for each in found] == ["snapshot-chi2", "ewma"]
    assert {(each["alert_limit_m"], each["requested_per_hour"]) for each in found} == {(5.0, 20.0)}
    files = sorted((tmp_path / "own" / "attacks").glob("*-worst.json"))
    assert [path.name for path in files] == ["ewma-worst.json", "snapshot-chi2-worst.json"]
    again = [*rate, *length, "--spoofer", str(files[1]), "--spoofer", "ramp:rate_mps=0.01"]
    shown = call("log", "attack", str(own[0]), "--detector", "snapshot-chi2", *again, "--json")
    worst, slow = json.loads(shown.output)[0]["played"]
    assert worst["spoofer"] == "snapshot-chi2-worst"
    assert worst[MOVED]["value"] > 5.0
    assert slow["alarm_rate"]["value"] == 0.0
    assert slow[MOVED]["value"] < 1.0
    one = "log", "attack", str(own[0]), "--detector", "cusum", *length, "--spoofer"
    assert "observes its victim" in refused(*one, "feedback")
    assert "goes with --log" in refused("audit", "ewma", *rate)


def test_what_is_no_log_to_attack_is_refused_with_what_is_missing(own, tmp_path):
    log = InnovationLog.load(own[0])
    table = InnovationLog.load(log.save(tmp_path / "own.csv"))
    text = refused("log", "attack", str(tmp_path / "own.csv"), "--detector", "snapshot-chi2")
    assert (
        "need design, transition, position, velocity, gain or predicted_cov, which it does" in text
    )
    assert fit_noise_factors(table) == {}
    write_filter(tmp_path / "short.npz", 1300)
    short = InnovationLog.load(tmp_path / "short.npz")
    with pytest.raises(ValueError, match=r"need 8 windows of 160 s after .* the log has 7:"):
        attack_log(short, ["snapshot-chi2"])
    with np.load(own[0]) as found:
        arrays = dict(found)
    for name, value, message in (
        (
            "transition",
            arrays["transition"][:, :, :9],
            r"`transition` must have shape \(1600, 15, 15\)",
        ),
        ("design", arrays["design"][:, :, :9], "must have shape"),
        ("position", np.array([6, 7, 77]), "three different states"),
        ("predicted_cov", np.nan * arrays["predicted_cov"], "`predicted_cov` must be finite"),
    ):
        np.savez(tmp_path / "wrong.npz", **{**arrays, name: value})
        with pytest.raises(ValueError, match=message):
            InnovationLog.load(tmp_path / "wrong.npz")
    with pytest.raises(
        ValueError, match=r"alarms in .* windows without an attack: take thresholds"
    ):
        attack_log(log, [{**TESTED, "false_alarm": 0.2}], **SHORT)


def test_the_command_attacks_and_draws(own, tmp_path):
    options = ["--detector", "cusum", "--false-alarms-per-hour", "20", "--attack-s", "20"]
    picture = tmp_path / "unseen.png"
    shown = call("log", "attack", str(own[0]), *options, "--out", str(picture)).output
    assert "open-loop" in shown
    assert "no attack without an alarm exceeds" in " ".join(shown.split())
    assert picture.stat().st_size > 5000
    text = refused("audit", "cusum", "--log", str(own[0]), "--task", "D1")
    assert "--task does not go with --log" in text
