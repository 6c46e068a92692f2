"""Make the calibrations that are shipped, in spoofgym/calibrations.

    python -m tools.calibrations                   # what is missing, in all worlds
    python -m tools.calibrations headline-zhong2025 --runs 200000 --overwrite

The worlds are the three of the headlines, those of the environments' default settings, those of the
papers' ids, and those of the tasks.  Detectors that de-weight have a fifth of the runs, at least
2000, unless ``--weighing-runs`` says how many.  Killed, it goes on where it was.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

from spoofgym.bench.experiments.calibration import calibrate
from spoofgym.bench.experiments.suite import list_task_detectors
from spoofgym.bench.runs.world import DEFAULTS, PLAIN_ID
from spoofgym.calibration.thresholds import WEIGHING_RUNS, inner_detectors, suitable_detectors
from spoofgym.core.progress import show_progress
from spoofgym.core.registry import check_choice
from spoofgym.detectors import Detector
from spoofgym.detectors.calibration_file import SHIPPED_FOLDER
from spoofgym.envs.factory import make_setup
from spoofgym.envs.spoofer_binding import SETUPS
from spoofgym.simulation.setup import Setup
from spoofgym.simulation.simulator import weighs
from spoofgym.tasks import DETECTOR_TASKS, PAPERS, RANGE_RATE_TESTS, TASKS
from spoofgym.tasks.v1 import DRAWN

RANDOM_START = {"domain": {"start_s": [0.0, None]}, "target_heading_deg": "random"}
HEADLINES: dict[str, dict[str, Any]] = {
    "headline-zhong2025": {"domain": DRAWN},
    "headline-trolley": {"scenario": "trolley", "receiver": "matched", "domain": DRAWN},
    "headline-aviation-actual": {
        "scenario": "aviation-actual",
        "receiver": "matched",
        "domain": DRAWN,
    },
}
"""Worlds of the table of all detectors, drawn for every run."""
OWN_WORLDS = ("S1", "S2", "S3", "T3", "T4")
"""Tasks whose own detectors, tests of range rates and classics of the tasks for detectors are
calibrated, and no others; the world of T3, which T5 and T6 have, too, is the headline `trolley`."""
WORLDS = {
    **{name: (PLAIN_ID, settings) for name, settings in HEADLINES.items()},
    **PAPERS,
    "random-start": (PLAIN_ID, RANDOM_START),
    **{key: (PLAIN_ID, TASKS[key].world_kwargs) for key in OWN_WORLDS},
}
"""Environments and their settings, by the names of the worlds."""


def build_setup(name: str) -> Setup:
    env_id, settings = WORLDS[name]
    return make_setup(SETUPS[env_id], {**settings, "detector": "never"})


def list_detectors(name: str, setup: Setup) -> list[Detector]:
    """All detectors that suit a world, and those that its environment and benchmark name."""
    env_id, settings = WORLDS[name]
    if name in OWN_WORLDS:
        judged = (each for each in DETECTOR_TASKS.values() if each.task.key == name)
        classics = [each for task in judged for each in list_task_detectors(task.task)]
        return inner_detectors([*TASKS[name].detectors, *RANGE_RATE_TESTS, *classics])
    own = [settings["detector"]] if "detector" in settings else []
    return inner_detectors([*suitable_detectors(setup), *DEFAULTS[SETUPS[env_id]], *own])


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("worlds", nargs="*", help=f"of {', '.join(WORLDS)}; by default all")
    parser.add_argument("--runs", type=int, default=20_000, help="of passive detectors")
    parser.add_argument("--weighing-runs", type=int, help="of those that de-weight")
    parser.add_argument("--threads", type=int, default=None)
    parser.add_argument("--overwrite", action="store_true")
    given = parser.parse_args(arguments)
    for name in given.worlds:
        check_choice("world", name, WORLDS)
    for name in given.worlds or WORLDS:
        setup = build_setup(name)
        everyone = list_detectors(name, setup)
        light = [each for each in everyone if not weighs(setup, each)]
        heavy = [each for each in everyone if weighs(setup, each)]
        fewer = given.weighing_runs or max(WEIGHING_RUNS, given.runs // 5)
        drifting = [each for each in light if each.drifts]
        groups = (light, given.runs, False), (drifting, given.runs, True), (heavy, fewer, False)
        for group, runs, rescaled in groups:
            found = calibrate(
                setup,
                group,
                runs=runs,
                rescaled=rescaled,
                threads=given.threads,
                progress=show_progress,
                folder=SHIPPED_FOLDER,
                overwrite=given.overwrite,
                strict=False,
            )
            for made in found:
                print(name, made.detector["name"], made.runs, made.path, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
