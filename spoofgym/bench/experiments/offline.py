"""Episodes of spoofers as a data set of Minari, to learn from offline."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from ...core.progress import NullProgress, ProgressCallback
from ...core.registry import Spec, format_label
from ...envs.spoofer_binding import attach
from ..runs.world import World


def collect_episodes(
    name: str,
    world: World,
    detector: Spec | None,
    spoofers: Sequence[Spec],
    *,
    episodes: int,
    seed: int = 0,
    knowledge: str | None = None,
    progress: ProgressCallback | None = None,
) -> dict[str, Any]:
    """Record episodes of each spoofer by Minari's `DataCollector`, and say what was recorded.

    Episode k has the seed ``seed + k`` and the k-th spoofer in turn; its infos have the cost, 1 at
    the alarm, and its actions keep to the space of the environment, also those of a scripted
    spoofer.  The data set keeps id and options of the environment.
    """
    try:
        import minari
        from minari.dataset.minari_dataset import parse_dataset_id
    except ImportError as error:
        raise ImportError(
            f"a data set of Minari needs {error.name}: pip install 'minari[arrow,create]' ({error})"
        ) from error

    class Cost(minari.StepDataCallback):  # type: ignore[misc]  # Minari is no dependency
        """Records the cost; a reset has none, and Minari wants it there, too."""

        def __call__(self, env: Any, obs: Any, info: Any, **rest: Any) -> Any:
            return super().__call__(env, obs, {"cost": info.get("cost", 0.0)}, **rest)

    bar = progress or NullProgress()
    if re.search(r"-v\d+$", name) is None:
        raise ValueError(f"the id of a data set must end in a version, such as {name}-v0")
    parse_dataset_id(name)  # which refuses other characters
    if name in minari.list_local_datasets():
        raise ValueError(f"there is a data set {name} already; choose another name or version")
    own = {"detector": detector, "knowledge": knowledge}
    chosen: dict[str, Any] = {key: value for key, value in own.items() if value is not None}
    env: Any = gym.make(world.env, **world.settings, **chosen)
    collector = minari.DataCollector(env, Cost, record_infos=True, data_format="arrow")
    alarms, space = 0, env.action_space
    for k in range(episodes * len(spoofers)):
        spec = spoofers[k % len(spoofers)]
        observation, _ = collector.reset(seed=seed + k)
        spoofer, over = attach(spec, env), False
        while not over:
            wanted = spoofer.act(observation[None])[0]
            action = np.clip(wanted, space.low, space.high).astype(space.dtype)
            observation, _, terminated, truncated, info = collector.step(action)
            over = terminated or truncated
        alarms += int(info["detected"])
        bar.advance(1.0, format_label(spec, None))
    labels = ", ".join(format_label(spec, None) for spec in spoofers)
    with warnings.catch_warnings():  # of Minari, which wants an author's name
        warnings.filterwarnings("ignore", r"`\w+` is set to None\.", UserWarning)
        data = collector.create_dataset(name, algorithm_name=labels)
    collector.close()
    return {
        "name": name,
        "environment": world.title,
        "spoofers": labels,
        "episodes": int(data.total_episodes),
        "steps": int(data.total_steps),
        "with an alarm": alarms,
    }
