"""One attack that a detector misses and another one finds, with a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from typer import Option

from . import options as opt
from .app import can_draw, print_json, print_lines
from .suites import calibrate_suite

SCENARIO, RATE_MPS = "zhong2025", 0.4
DETECTORS = ("ewma", "snapshot-chi2")
NEXT = "spoofgym audit ewma --budget quick"


def demo(
    out: Path = Option(Path("demo.png"), help="File of the picture."),
    picture: bool = Option(True, help="Draw the picture."),
    as_json: opt.Json = False,
) -> None:
    """Play one spoofing attack against two detectors, and draw what each of them sees of it."""
    from ..bench.experiments.suite import RATE, Suite
    from ..bench.runs.episode import draw_comparison, play_episode
    from ..envs.factory import choose_env_id

    picture = picture and can_draw(out)
    suite = Suite(
        env=choose_env_id(["scenario"]),
        scenario=SCENARIO,
        detectors=[{"name": name, "false_alarms_per_hour": RATE} for name in DETECTORS],
        spoofers=[{"name": "ramp", "rate_mps": RATE_MPS}],
    )
    suite = calibrate_suite(suite, None, None)
    ramp = suite.spoofer_players[-1]
    episodes = [play_episode(suite.world, each, ramp) for each in suite.detector_players]
    runs = [each.summary() for each in episodes]
    written = str(draw_comparison(episodes, out)) if picture else None
    if as_json:
        print_json({"runs": runs, "picture": written})
        return
    lines = [
        f"In the papers' world, {SCENARIO}, a spoofer pulls an aircraft's position aside by "
        f"{RATE_MPS} m/s; both detectors have {RATE} false alarms an hour.",
        *map(_describe, runs),
        *([f"Picture: {written}"] if written else ()),
        f"Next: {NEXT}",
    ]
    print_lines(lines)


def _describe(run: dict[str, Any]) -> str:
    name = run["detector"]["name"]
    if not run["alarm"]:
        return f"{name} raises no alarm: the position ends {run['final_error_m']:.1f} m off."
    moved = f"{run['undetected_displacement_m']:.1f} m"
    return f"{name} raises an alarm after {run['delay_s']:g} s: {moved} went undetected."
