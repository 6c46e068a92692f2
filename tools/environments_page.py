"""The pages of `docs/environments/`, one for each kind of environment, from what is registered.

python -m tools.environments_page             # writes the pages
python -m tools.environments_page --pictures  # draws an episode of each, too: minutes
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from itertools import groupby
from typing import Any

import gymnasium as gym

from spoofgym.bench.report.table import Table
from spoofgym.core.declared import list_declarations
from spoofgym.core.files import write_file
from spoofgym.duel_v0 import DetectorView
from spoofgym.envs.core import ALARM_PRICE
from spoofgym.envs.rendering import save_animation
from spoofgym.envs.terms.action import CommandMap, default_action
from spoofgym.envs.terms.observation import OwnOffsets, default_terms
from tools.pages import DOCS, render_page

FOLDER = DOCS / "environments"
IDS = {
    "TightlyCoupled": "an aircraft's tightly coupled GNSS/INS filter, in the world of task S1",
    "Zhong2025": "the same filter in the papers' fixed world, which is fast",
    "Offsets": "the world of task S1, with an action for each satellite",
    "LooselyCoupled": "an airliner's loosely coupled GNSS/INS filter, of `shadmehri2025`",
    "Snapshot": "a receiver without a filter, of `wu2024`",
    "WheeledRobot": "a robot with odometry, of `song2021`",
}
MOST = "oracle+reported"
PUSH = {"TightlyCoupled": 0.1, "Offsets": 0.05, "Zhong2025": 0.4}
"""What the spoofer of a picture commands, 0.2 elsewhere; its first element alone."""
SCALES = {
    "own_displacement": "scale_m",
    "own_rate": "rate_scale_mps",
    "target_position": "position_scale_m",
    "target_velocity": "velocity_scale_mps",
    "error": "scale_m",
    "reported": "scale_m",
}
"""Setting that is observed as 1, by the first words of an element's name."""
HEAD = ("index", "element", "unit", "scale")


def unit_of(name: str, term: Any, setup: Any) -> tuple[str, float]:
    """Unit of an element, and what is observed as 1."""
    if isinstance(term, OwnOffsets) and name.startswith("own"):
        return "that of the action", 1.0
    times = {"time": setup.steps * setup.interval_s, "report_age": 1.0}
    for word, scale in times.items():
        if name.startswith(word):
            return "s", scale
    found = [scale for word, scale in SCALES.items() if name.startswith(word)]
    if not found:
        return "1", 1.0
    unit = list_declarations(type(term))[found[0]][0].unit
    return unit or "1", getattr(term, found[0])


def observed(terms: Any, setup: Any) -> Iterator[tuple[str, str, str, str, str]]:
    """Index, name, unit, scale and knowledge; what slots have alike in one row."""
    start = 0
    for term in terms:
        for key, names in groupby(term.names(setup), key=lambda n: n.split("_")[0] * ("slot" in n)):
            listed = list(names)
            for part in [listed] if key else [[name] for name in listed]:
                words = ", ".join(dict.fromkeys(re.sub(r"slot\d+", "slotJJ", x) for x in part))
                unit, scale = unit_of(part[0], term, setup)
                last = start + len(part) - 1
                index = str(start) if start == last else f"{start}-{last}"
                yield index, words, unit, f"{float(f'{scale:.4g}'):g}", term.knowledge
                start += len(part)


def list_observed(setup: Any) -> list[tuple[str, ...]]:
    """What an environment of the most knowledge observes."""
    along = CommandMap(default_action(setup), setup).along_target
    return [*observed(default_terms(setup, MOST, along_target=along), setup)]


def build_spoofer_page(name: str) -> str:
    env = gym.make(f"spoofgym/{name}-v0", knowledge=MOST).unwrapped
    spec = gym.spec(f"spoofgym/{name}-v0")
    core: Any = env.core  # type: ignore[attr-defined]
    found = groupby(list_observed(core.setup), key=lambda row: row[-1])
    tables = {key: Table.of_texts(*HEAD).markdown(row[:-1] for row in rows) for key, rows in found}
    values = {"key": name, "env": env, "setup": core.setup, "tables": tables, "price": ALARM_PRICE}
    return render_page("environment.md.j2", **values, settings=spec.kwargs, summary=IDS[name])


def build_detector_page() -> str:
    part = re.split(r"^ *=====  =+ .*$", DetectorView.__doc__ or "", flags=re.MULTILINE)[2]
    rows = [re.split(r" {2,}", row.strip()) for row in part.strip().splitlines()]
    tables = [Table.of_texts(*HEAD).markdown(each) for each in (rows[:6], rows[6:])]
    return render_page("detector_view.md.j2", tables=tables)


def draw_episode(name: str) -> Iterator[Any]:
    """Frames of an episode, at most 40, a third as large."""
    env = gym.make(f"spoofgym/{name}-v0", detector="never", render_mode="rgb_array")
    env.reset(seed=2)
    action = env.action_space.sample() * 0.0
    action[: 1 if name != "Offsets" else None] = PUSH.get(name, 0.2)
    over, step, every = False, 0, -(-env.unwrapped.core.episode_steps // 40)  # type: ignore
    while not over:
        *_, over, truncated, _ = env.step(action)
        step, over = step + 1, over or truncated
        if over or not step % every:
            yield env.render()[::2, ::2]  # type: ignore[call-overload]


if __name__ == "__main__":
    for each in IDS:
        if "--pictures" in sys.argv:
            save_animation(draw_episode(each), FOLDER / f"{each}.webp", 8.0)
        write_file(FOLDER / f"{each}.md", build_spoofer_page(each).encode())
    write_file(FOLDER / "DetectorView.md", build_detector_page().encode())
