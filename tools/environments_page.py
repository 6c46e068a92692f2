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

from spoofgym.attacks.offsets import BASES
from spoofgym.bench.report.table import Table
from spoofgym.bench.runs.players import specify_detector
from spoofgym.core.declared import list_declarations
from spoofgym.core.files import write_file
from spoofgym.duel_v0 import DetectorView
from spoofgym.envs.core import ALARM_PRICE
from spoofgym.envs.rendering import save_animation
from spoofgym.envs.terms.action import CommandMap, default_action
from spoofgym.envs.terms.observation import default_terms
from tools.pages import DOCS, render_page

FOLDER = DOCS / "environments"
IDS = {
    "TightlyCoupled": "an aircraft's tightly coupled GNSS/INS filter, in the world of task S1",
    "Zhong2025": "the filter of `TightlyCoupled-v0` in the papers' fixed world, which is fast",
    "LooselyCoupled": "an airliner's loosely coupled GNSS/INS filter, of `shadmehri2025`",
    "Snapshot": "a receiver without a filter, of `wu2024`",
    "WheeledRobot": "a robot with odometry, of `song2021`",
    "Offsets": "the world of task S1, with an action for each satellite",
}
HEAD = ("index", "element", "unit", "scale", "clipped to")


SCALES = {
    "own_displacement": "scale_m",
    "own_rate": "rate_scale_mps",
    "target_position": "position_scale_m",
    "target_velocity": "velocity_scale_mps",
    "error": "scale_m",
    "reported": "scale_m",
}
"""Setting that is observed as 1, by the first words of an element's name."""


def read_table(kind: type[Any]) -> list[list[str]]:
    """Rows of the table of observations in a docstring, which a test holds against the terms."""
    parts = re.split(r"^ *=====  =+ .*$", kind.__doc__ or "", flags=re.MULTILINE)
    return [re.split(r" {2,}", row.strip()) for row in parts[2].strip().splitlines()]


def find_unit(name: str, term: Any, setup: Any) -> tuple[str, float]:
    """Unit of an element, and what is observed as 1."""
    if re.match(r"own_(offset|rate)_slot", name):
        rate_mps = setup.attack.unit_rates(setup.world)[0]
        return ("m/s", rate_mps) if "rate" in name else ("m", rate_mps * setup.attack.span_s)
    for word, scale in {"time": setup.steps * setup.interval_s, "report_age": 1.0}.items():
        if name.startswith(word):
            return "s", scale
    found = [scale for word, scale in SCALES.items() if name.startswith(word)]
    if not found:
        return "1", 1.0
    return list_declarations(type(term))[found[0]][0].unit, getattr(term, found[0])


def format_bounds(low: float, high: float) -> str:
    """Least and largest value that is observed, after scaling."""
    return f"±{high:g}" if low == -high else f"{low:g} to {high:g}"


def name_group(name: str) -> str:
    """What elements that slots have alike share; nothing of those without a slot."""
    if "slot" not in name:
        return ""
    return name.partition("_slot")[0] if name.startswith("own") else name.partition("_")[0]


def list_elements(name: str) -> list[list[str]]:
    """Index, name, unit, scale, bounds and knowledge of what an environment observes by default;
    elements that slots have alike share a row."""
    env: Any = gym.make(f"spoofgym/{name}-v0").unwrapped
    setup = env.core.setup
    along = CommandMap(default_action(setup), setup).along_target
    rows, first = [], 0
    for term in default_terms(setup, "oracle+reported", along_target=along):
        for key, group in groupby(term.names(setup), name_group):
            names = list(group)
            for part in [names] if key else [[each] for each in names]:
                words = dict.fromkeys(re.sub(r"slot\d+", "slotJJ", each) for each in part)
                unit, scale = find_unit(part[0], term, setup)
                index = f"{first}-{first + len(part) - 1}" if len(part) > 1 else str(first)
                shown = f"{float(f'{scale:.4g}'):g}"
                bounds = format_bounds(*term.bounds(setup))
                rows.append([index, ", ".join(words), unit, shown, bounds, term.knowledge])
                first += len(part)
    return rows


def count_reported(name: str) -> dict[str, int]:
    """Elements of the observation at the levels with reports that no table has."""
    found = {}
    for knowledge in ("blind+reported", "tracking+reported"):
        env: Any = gym.make(f"spoofgym/{name}-v0", knowledge=knowledge, detector="never")
        found[knowledge] = len(env.unwrapped.observation_names)
    return found


def name_detector(name: str) -> str:
    """Default detector of an id, with its settings but for the rate of false alarms."""
    env: Any = gym.make(f"spoofgym/{name}-v0").unwrapped
    label = specify_detector(env.core.setup.detector).label
    return re.sub(r"\(false_alarms_per_hour=0\.2\)|,? ?false_alarms_per_hour=0\.2", "", label)


def list_bases() -> dict[str, tuple[int, int]]:
    """Elements of action and blind observation in the papers' world, by the basis of offsets."""
    world: dict[str, Any] = {
        "scenario": "zhong2025",
        "receiver": None,
        "timeline": None,
        "domain": None,
    }
    found = {}
    for basis in BASES:
        same: dict[str, Any] = {"basis": basis, "knowledge": "blind", "detector": "never"}
        env: Any = gym.make("spoofgym/Offsets-v0", **world, **same)
        found[basis] = env.action_space.shape[0], env.observation_space.shape[0]
    return found


def build_spoofer_page(name: str) -> str:
    env: Any = gym.make(f"spoofgym/{name}-v0", detector="never").unwrapped
    tables: dict[str, str] = {}
    sizes: dict[str, int] = {}
    for key, group in groupby(list_elements(name), key=lambda row: row[-1]):
        rows = [row[:-1] for row in group]
        tables[key] = Table.of_texts(*HEAD).markdown(rows)
        sizes[key] = int(rows[-1][0].rpartition("-")[2]) + 1
    values: dict[str, Any] = {
        "key": name,
        "env": env,
        "setup": env.core.setup,
        "tables": tables,
        "sizes": sizes,
        "reported": count_reported(name),
        "detector": name_detector(name),
    }
    values["bases"] = list_bases() if name == "Offsets" else {}
    values |= {"price": ALARM_PRICE, "settings": gym.spec(f"spoofgym/{name}-v0").kwargs}
    return render_page("environment.md.j2", **values, summary=IDS[name])


def build_detector_page() -> str:
    env: Any = gym.make("spoofgym/DetectorView-v0").unwrapped
    space, rows = env.observation_space, read_table(DetectorView)
    for row in rows:
        first = int(row[0].partition("-")[0])
        row.append(format_bounds(space.low[first], space.high[first]))
    tables = [Table.of_texts(*HEAD).markdown(each) for each in (rows[:6], rows[6:])]
    return render_page("detector_view.md.j2", tables=tables, env=env)


def draw_episode(name: str) -> Iterator[Any]:
    """Frames of an episode, at most 40."""
    env: Any = gym.make(f"spoofgym/{name}-v0", detector="never", render_mode="rgb_array")
    env.reset(seed=2)
    env.action_space.seed(2)
    action = env.action_space.sample() * -0.1  # one for each satellite; a common one moves nothing
    if name != "Offsets":
        action[:] = 0.0
        action[0] = 0.4 if name == "Zhong2025" else 0.1
    over, step, every = False, 0, -(-env.unwrapped.core.episode_steps // 40)
    while not over:
        *_, over, _, _ = env.step(action)
        step += 1
        if over or not step % every:
            yield env.render()


if __name__ == "__main__":
    for each in IDS:
        if "--pictures" in sys.argv:
            save_animation(draw_episode(each), FOLDER / f"{each}.webp", 8.0)
        write_file(FOLDER / f"{each}.md", build_spoofer_page(each).encode())
    write_file(FOLDER / "DetectorView.md", build_detector_page().encode())
