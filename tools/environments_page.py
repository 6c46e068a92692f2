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
from spoofgym.core.files import write_file
from spoofgym.duel_v0 import DetectorView
from spoofgym.envs import SpoofEnv
from spoofgym.envs.core import ALARM_PRICE
from spoofgym.envs.rendering import save_animation
from tools.pages import DOCS, render_page

FOLDER = DOCS / "environments"
IDS = {
    "TightlyCoupled": "an aircraft's tightly coupled GNSS/INS filter, in the world of task S1",
    "Zhong2025": "the same filter in the papers' fixed world, which is fast",
    "LooselyCoupled": "an airliner's loosely coupled GNSS/INS filter, of `shadmehri2025`",
    "Snapshot": "a receiver without a filter, of `wu2024`",
    "WheeledRobot": "a robot with odometry, of `song2021`",
    "Offsets": "the world of task S1, with an action for each satellite",
}
"""In the order of their tables in the docstring of `SpoofEnv`; the last has none."""
HEAD = ("index", "element", "unit", "scale")


def read_table(kind: type[Any], number: int = 0) -> list[list[str]]:
    """Rows of a table of observations in a docstring, which a test holds against the terms."""
    parts = re.split(r"^ *=====  =+ .*$", kind.__doc__ or "", flags=re.MULTILINE)
    return [re.split(r" {2,}", row.strip()) for row in parts[3 * number + 2].strip().splitlines()]


def build_spoofer_page(name: str) -> str:
    env: Any = gym.make(f"spoofgym/{name}-v0", detector="never").unwrapped
    number = [*IDS].index(name) if name != "Offsets" else 0
    found = groupby(read_table(SpoofEnv, number), key=lambda row: row[-1])
    tables = {key: Table.of_texts(*HEAD).markdown(row[:-1] for row in rows) for key, rows in found}
    if name == "Offsets":  # whose own commands are others
        del tables["blind"]
    values = {"key": name, "env": env, "setup": env.core.setup, "tables": tables}
    values |= {"price": ALARM_PRICE, "settings": gym.spec(f"spoofgym/{name}-v0").kwargs}
    return render_page("environment.md.j2", **values, summary=IDS[name])


def build_detector_page() -> str:
    rows = read_table(DetectorView)
    tables = [Table.of_texts(*HEAD).markdown(each) for each in (rows[:6], rows[6:])]
    return render_page("detector_view.md.j2", tables=tables)


def draw_episode(name: str) -> Iterator[Any]:
    """Frames of an episode, at most 40, half as large."""
    env: Any = gym.make(f"spoofgym/{name}-v0", detector="never", render_mode="rgb_array")
    env.reset(seed=2)
    action = env.action_space.sample() * 0.0
    action[: None if name == "Offsets" else 1] = {"Offsets": 0.05, "Zhong2025": 0.4}.get(name, 0.1)
    over, step, every = False, 0, -(-env.unwrapped.core.episode_steps // 40)
    while not over:
        *_, over, _, _ = env.step(action)
        step += 1
        if over or not step % every:
            yield env.render()[::2, ::2]


if __name__ == "__main__":
    for each in IDS:
        if "--pictures" in sys.argv:
            save_animation(draw_episode(each), FOLDER / f"{each}.webp", 8.0)
        write_file(FOLDER / f"{each}.md", build_spoofer_page(each).encode())
    write_file(FOLDER / "DetectorView.md", build_detector_page().encode())
