"""Change indication: what every detector says of one short attack, as text for a review.

``python -m tests.golden.changes`` plays one receiver of every victim, and writes a file for each
detector that suits it: statistic over threshold, whether it alarms, and the norm of all
innovations, which its weights change.  A change of behaviour is a difference of these files.
"""

from __future__ import annotations

import csv
import io
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from spoofgym.calibration.thresholds import suitable_detectors
from spoofgym.detectors import Detector, Never
from spoofgym.detectors.base import YoungMemoryWarning
from spoofgym.detectors.calibrated import describe_identity
from spoofgym.envs.factory import VICTIMS
from spoofgym.simulation.setup import Setup
from spoofgym.simulation.simulator import run_serially

FOLDER = Path(__file__).with_name("changes")
SEED, DIGITS = 20261127, 6
TIMELINES = {
    "tightly-coupled": {"warmup_s": 20, "live_s": 20, "attack_s": 20, "time_to_alert_s": 5},
    "loosely-coupled": {"warmup_s": 4, "live_s": 3, "attack_s": 3, "time_to_alert_s": 1},
    "snapshot": {"warmup_s": 10, "live_s": 10, "attack_s": 30, "time_to_alert_s": 4},
    "wheeled-robot": {"warmup_s": 20, "live_s": 20, "attack_s": 40, "time_to_alert_s": 5},
}
HEAD = ("epoch", "innovation", "statistic ratio", "alarm")
Row = tuple[int, float, float, int]


def play(setup: Setup, detector: Detector) -> list[Row]:
    """Monitored warm-up and attack of one receiver, whose spoofer commands half of its limits."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", YoungMemoryWarning)  # all are younger than an attack
        simulator = setup.copy_with(detector=detector).simulator(1, run_serially)
    simulator.start_episodes([np.random.default_rng(SEED)])
    simulator.run_filter_only(setup.filter_only)
    command, rows = np.full((1, len(setup.action_names)), 0.5), []
    for k in range(setup.live + setup.steps):
        attacked = k >= setup.live
        verdict = simulator.step(command if attacked else None, attacked=attacked)
        innovation = np.nan_to_num(simulator.epoch.innovation)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.nan_to_num(verdict.statistic / verdict.threshold)
        rows.append(
            (k, float(np.linalg.norm(innovation)), float(ratio.max()), int(verdict.alarm.any()))
        )
    return rows


def cases() -> Iterator[tuple[str, Setup, Detector]]:
    """Name of the file, victim and detector."""
    for victim, kind in VICTIMS.items():
        setup = kind(timeline=TIMELINES[victim], detector=Never())
        for detector in suitable_detectors(setup):
            yield f"{victim}/{describe_identity(detector)['name']}", setup, detector


def write(rows: list[Row]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEAD)
    writer.writerows((k, f"{x:.{DIGITS}g}", f"{y:.{DIGITS}g}", a) for k, x, y, a in rows)
    return out.getvalue()


def read(name: str) -> np.ndarray:
    return np.loadtxt(FOLDER / f"{name}.csv", delimiter=",", skiprows=1)


if __name__ == "__main__":
    for name, setup, detector in cases():
        path = FOLDER / f"{name}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(write(play(setup, detector)))
