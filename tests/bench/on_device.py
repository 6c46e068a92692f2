"""Clean runs, attacks and searches by numba's simulator of a device, and on the processor.

Run in a process of its own, since numba reads ``NUMBA_ENABLE_CUDASIM`` when it is imported.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

from spoofgym.bench.experiments.evaluate import evaluate
from spoofgym.bench.runs import play
from spoofgym.bench.runs.panel import Panel, PanelAttack
from spoofgym.bench.search.backends import EngineBackend
from spoofgym.detectors import make_detector
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from spoofgym.envs.factory import make_core, select_victim
from spoofgym.simulation.setup import make_generators, seeds_of_runs
from tests.command_line import FIXED, PAPERS, call, read, refused

WHERE = "cpu", "cuda"
RATES = 0.5, 5.0


def count_false_alarms(settings: dict[str, Any], detectors: list[str]) -> int:
    """`spoofgym calibrate` on both: the same screen and files; a rate that so few runs can't count
    is refused before any is played."""
    line = ["calibrate", "--scenario", "zhong2025", "--runs", "2", "--hold-out", "1", "--json"]
    line += [word for name in detectors for word in ("--detector", name)]
    line += [word for x in settings.items() for word in ("--set", f"{x[0]}={json.dumps(x[1])}")]
    found = []
    for device in WHERE:
        with TemporaryDirectory() as folder, patch.dict(os.environ, {FOLDER_VARIABLE: folder}):
            said = read(*line, "--false-alarms-per-hour", "1200", "--device", device)
            few = refused(*line, "--false-alarms-per-hour", "0.002", "--device", device)
            assert "0.002 false alarms an hour are 1.67e-06 a run" in few
            found.append([path.read_text() for path in sorted(Path(folder).rglob("*.json"))])
        for row in said["calibrations"]:
            assert Path(row.pop("file")).name
        found[-1].append(said)
    assert found[0] == found[1]
    return len(said["calibrations"])


def compare_attacks(settings: dict[str, Any], detector: Any) -> int:
    """Attacks side by side, of which runs are left that have alarmed, runs under attacks of their
    own, and candidates of an open-loop attack."""
    play.DROP_EVERY, found = 1, []
    setup = make_core(select_victim("tightly-coupled"), 1, {**settings, "detector": "never"}).setup

    def rngs() -> list[np.random.Generator]:
        return make_generators(seeds_of_runs(0, "training", setup.name, range(3)))

    for device in WHERE:
        panel = Panel(setup, [make_detector(detector)], rngs, 1, device=device)
        ramps = [{"name": "ramp", "rate_mps": rate} for rate in RATES]
        played = panel.play([(PanelAttack(ramp, 3), 0) for ramp in ramps])
        each = panel.play_each(0, ramps, np.array([1, 0]), np.array([2, 0]))
        backend = EngineBackend(panel.start, panel.clean[0])
        curves = np.outer(RATES, np.linspace(0.0, 1.0, backend.steps))
        peak, reach = backend.play(curves, np.arange(min(backend.runs, 2)))
        runs = [*panel.clean, *played, each]
        parts = [array for each in runs for array in each if array is not None]
        found.append([panel.warmup_alarm, panel.counts, peak, reach, *parts])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
    assert any(np.isnan(array).any() for array in found[0])  # some runs have been left
    return sum(array.size for array in found[0])


def compare_scores(settings: dict[str, Any], detector: Any) -> int:
    """Scores of a ramp that is fitted to the alarm budget, by searches on both."""
    sizes = {"runs": 2, "fit_runs": 59, "rule": "exact"}
    named = {"env": PAPERS[1], **{name: settings[name] for name in ("timeline", "attack")}}
    known = {"detector": detector, **named, "settings": {"imu_rate_hz": settings["imu_rate_hz"]}}
    found = [evaluate("ramp", **sizes, **known, device=each).as_dict() for each in WHERE]
    assert found[0] == found[1]
    return len(found[0]["at_budget"])


def compare_campaigns(detectors: list[str]) -> int:
    """`spoofgym bench` on both; what is not there on a device is played on the processor."""
    times = ("warmup", 2), ("live", 2), ("attack", 2), ("time-to-alert", 1)
    line = [*PAPERS, *FIXED, *(word for x, s in times for word in (f"--{x}-s", s))]
    line += ["--set", "imu_rate_hz=10", "--runs", 2, "--spoofer", "ramp:rate_mps=0.4", "--json"]
    line += [word for name in detectors for word in ("--detector", name)]
    found = []
    for device in WHERE:
        with TemporaryDirectory() as folder:
            result = call("bench", *line, "--out", folder, "--device", device)
        assert result.exit_code == 0, result.output
        found.append({**json.loads(result.stdout), "folder": None})
        assert ("not on cuda: innovation-rate" in result.stderr) == (device == "cuda")
    assert found[0] == found[1]
    return len(found[0]["cells"])


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    several = count_false_alarms, compare_attacks, compare_scores, compare_campaigns
    work = {each.__name__: each for each in several}
    for name, *given in json.loads(sys.argv[1]):
        print(json.dumps({name: work[name](*given)}), flush=True)
