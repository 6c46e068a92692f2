"""What the tasks for detectors are, and how far stated attacks come in them: kept as they are.

python -m tests.golden.detector_tasks     # writes tests/golden/detector_tasks.json
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from spoofgym import tasks as detector_tasks
from spoofgym.attacks import ATTACKS, make_attack
from spoofgym.bench.experiments.audit import Auditor
from spoofgym.bench.runs.panel import Panel, PanelAttack, generators, select_runs
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.search.attack_suite import IDLE
from spoofgym.core.files import write_file
from spoofgym.core.registry import build_spec
from spoofgym.core.settings import compute_digest, describe
from spoofgym.detectors import make_detector
from spoofgym.tasks import DETECTOR_TASKS, AttackFamily, DetectorTask
from tests.bench.detector_support import displace

KEPT = Path(__file__).with_name("detector_tasks.json")
RUNS = 2
RAMP = {"name": "ramp", "rate_mps": 0.3}
WHOM = {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"}
NOBODY = specify_detector("never")  # for whom no spoofer was made
NEWER = ("domain", None)
"""A setting of families, not of the first ones."""
CONSTANTS = (
    "TURNING_DEGPS",
    "SWITCH_WITHIN_S",
    "NEAR_ALARM_S",
    "CANDIDATES",
    "ANTENNA_PARTS",
    "EVENTS",
)


def resolved(task: DetectorTask) -> dict[str, Any]:
    """All settings of a task with their defaults, of every family, and of the learners' pool."""
    evaluator = Auditor(task.key, entropy=0)
    families = {}
    for family in task.families:
        setup = evaluator.worlds.setup(**task.get_overrides(family))
        families[family.key] = {
            **{k: x for k, x in dataclasses.asdict(family).items() if (k, x) != NEWER},
            "attack": build_spec("attack", ATTACKS, setup.attack),
            "timeline": describe(setup.timeline),
            "members": [
                [each.letter, each.player.spec]
                for each in evaluator.worlds.list_attacks(family, NOBODY)
            ],
        }
    found = {
        "world": evaluator.worlds.world.setup.conditions.settings,
        "alert_limit_m": task.alert_limit_m,
        "families": families,
        "constants": {name: getattr(detector_tasks, name) for name in CONSTANTS},
        "spec": task.env_kwargs,
    }
    kept: dict[str, Any] = json.loads(json.dumps(describe(found)))
    return kept


def reached(task: DetectorTask, family: AttackFamily) -> dict[str, Any]:
    """Runs of a family that are drawn by its onset, and how far one stated attack comes in them."""
    setup = Auditor(task.key, entropy=0).worlds.setup(**task.get_overrides(family))
    onset = None if family.onset == "chance-alarm" else family.onset
    numbers = select_runs(setup, 0, "evaluation", RUNS, onset)
    judges = [make_detector("never"), make_detector(WHOM)]
    panel = Panel(setup, judges, lambda: generators(setup, 0, "evaluation", numbers), 1)
    attack = None
    if family.letters == "m":
        attack = make_attack({**(family.attack or {}), "antenna_m": [0.0, task.alert_limit_m, 0.0]})
    moved = displace(panel, PanelAttack(RAMP if attack is None else IDLE, RUNS, attack))
    return {"numbers": numbers.tolist(), "displacement_m": moved.tolist()}


def main() -> None:
    """Write what is kept."""
    found = {}
    for key, task in DETECTOR_TASKS.items():
        settings = resolved(task)
        figures = {each.key: reached(task, each) for each in task.held_out}
        found[key] = {"sha256": compute_digest(settings), "settings": settings, "reached": figures}
        print(key, found[key]["sha256"], figures, flush=True)
    write_file(KEPT, (json.dumps(found, indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
