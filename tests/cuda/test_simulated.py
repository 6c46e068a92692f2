"""A device by numba's simulator: the bits of the processor, errors, and what is not there."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from spoofgym.envs.factory import make_core, select_victim
from spoofgym.tasks import TASKS

pytest.importorskip("torch")
from spoofgym.cuda import supported

ROOT = Path(__file__).resolve().parents[2]
LINE = {"warmup_s": 2.0, "live_s": 2.0, "attack_s": 2.0, "time_to_alert_s": 1.0}
FAST = {"timeline": LINE, "imu_rate_hz": 10}
REPORT = {"name": "reported-position", "interval_s": 1.0, "latency_s": 3.0}
ORACLE = ["own-command", "time", "target-motion", "satellite-geometry", "gain-weight", REPORT]
S1 = TASKS["S1"].env_kwargs
EVENTS = {"clock_step": 0.3, "satellite_loss": 0.3, "front": 0.3, "within_s": 2.0}
SKIES = {**S1["domain"], "age_s": [4.0, 7.0], "worlds": 3, "turns": 2, "events": EVENTS}
AIRBORNE = {"scenario": S1["scenario"], "receiver": "matched", "timeline": LINE, "domain": SKIES}
TACTICAL = {**FAST, "scenario": "zhong2025-tactical", "receiver": "matched"}
WORLDS = {"zhong2025": FAST, "tactical": TACTICAL, "airborne": AIRBORNE}


def detector(name, **settings):
    return {"name": name, "thresholds": "nominal", **settings}


PACE = {"decision_interval_s": 1.0, "between": "linear", "knowledge": "oracle+reported"}
LOUD = {"false_alarm": 0.02}  # so that some episodes end at an alarm
DETECTORS = {
    "never": "never",
    "ewma": detector("ewma", **LOUD),
    "passive ewma": detector("ewma", weight_scale=None),
    "shewhart": detector("shewhart", **LOUD, signals="both"),
    "cusum": {"name": "cusum", "threshold_scale": 0.35},
    "snapshot-chi2": detector("snapshot-chi2", **LOUD),
    "windowed-chi2": detector("windowed-chi2", **LOUD, window=4),
}
ATTACKS = {
    "false position": {"target_heading_deg": "random", "observation": [*ORACLE, "statistic-ratio"]},
    "per channel": {"attack": "per-channel", "target_heading_deg": "random"},
    "offsets": {"control": "rate", "basis": "rotated", "channels": "6 drawn", **PACE},
    "subset": {"channels": "S0*", **PACE, "knowledge": "blind+reported"},
}
CASES = [
    {**world, "detector": each, **attack}
    for world in WORLDS.values()
    for name, each in DETECTORS.items()
    for attack in ATTACKS.values()
    if (name != "never" or "observation" not in attack)
    and (world is not AIRBORNE or attack is not ATTACKS["subset"])  # other satellites in each
]


def run(module, *arguments, simulated):
    env = {**os.environ, "NUMBA_ENABLE_CUDASIM": str(int(simulated))}
    command = [sys.executable, "-W", "ignore", "-m", module, *arguments]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_receivers_have_the_bits_of_the_processor_and_bad_input_is_an_error():
    cases = [
        {**FAST, "detector": DETECTORS["ewma"], **ATTACKS["false position"]},
        {**FAST, "detector": DETECTORS["windowed-chi2"], **ATTACKS["offsets"]},
        {},
    ]
    *played, refused = run("tests.cuda.in_simulator", json.dumps(cases), simulated=True)
    assert all(each["numbers"] > 1000 and each["resets"] > 0 for each in played)
    assert refused == {"refused": 1}


@pytest.mark.nightly
def test_worlds_detectors_and_attacks_have_the_bits_of_the_processor():
    found = run("tests.cuda.in_simulator", json.dumps(CASES), simulated=True)
    assert [each["resets"] > 0 for each in found] == [True] * len(CASES)


@pytest.mark.nightly
def test_kernels_are_compiled_for_three_architectures_without_contraction():
    pytest.importorskip("numba_cuda")
    kernels, wanted = ("pick", "take", "look", "play_step"), ("75", "80", "90")
    found = run("tests.cuda.ptx", *wanted, simulated=False)
    pairs = {("age", "75"), *((x, y) for x in kernels for y in wanted)}
    assert {(x, y) for x, y, *_ in found} == pairs
    assert all(fused == 0 for *_, fused in found)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"detector": detector("joint-chart")}, "detector JointChart"),
        ({"detector": detector("shewhart", weight_scale=0.3)}, "weight_scale"),
        ({"detector": detector("ewma", min_satellites=5)}, "min_satellites"),
        ({"detector": detector("cusum", bias_window_s=0.5)}, "bias_window_s"),
        ({"detector": detector("snapshot-chi2", two_sided=True)}, "two_sided"),
        ({"attack": "meaconer"}, "attack 'meaconer'"),
        ({"attack": "quiet"}, "errors of its own"),
        ({"twin": True, "watch": ["cusum"], "epoch": True}, "`watch`, `epoch`, `twin`"),
        ({"attack": {"name": "offsets", "capture": {}}}, "a capture"),
        ({"observation": ["divergence-spent"]}, "observation term DivergenceSpent"),
        ({"end": ["at-alarm", {"name": "at-steps", "steps": 2}]}, "`end`"),
    ],
)
def test_a_setting_that_is_not_there_is_named(settings, named):
    settings = {**FAST, "detector": "never", **settings}
    core = make_core(select_victim("tightly-coupled"), 1, settings)
    with pytest.raises(ValueError, match="device='cuda' does not have .*" + named):
        supported.check_supported(core)
    with pytest.raises(ValueError, match="only a tightly coupled receiver"):
        supported.check_supported(make_core(select_victim("snapshot"), 1, {}))
