"""What PPO learns with: the action, the price of an alarm, and an end where it diverges."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from typing import Any

import numpy as np
import torch
import tyro
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from agents.folder import write_json
from spoofgym.core.progress import show_progress
from spoofgym.envs.core import SpoofCore
from spoofgym.envs.terms.reward import default_rewards
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.simulation.setup import Setup
from spoofgym.spoofers.learned import finite

ABOUT_S = 10.0
"""Time between decisions, as far as the attack holds a whole number of them."""
LENGTHS = 4.0
"""How far an action of 1 all through an attack goes, in lengths, by default."""
LEAST, MOST = 1.0, 8.0
"""In lengths.  With less a policy that has found nothing learns that alarms are for nothing; with
more a few alarms drown what else there is to learn."""


def for_learning(
    settings: Mapping[str, Any],
    full_scale_mps: float | None = None,
    decision_interval_s: float | None = None,
) -> dict[str, Any]:
    """Settings of a `SpoofVecEnv` with the action that is learned, as the two below have it."""
    with closing(SpoofVecEnv(1, **settings)) as probe:
        return {
            **settings,
            **setpoint_action(probe.core, full_scale_mps),
            **seldom(probe.core.setup, decision_interval_s),
        }


def seldom(setup: Setup, decision_interval_s: float | None) -> dict[str, Any]:
    """Settings in which decisions are seldom, and linear between: after some ten seconds where no
    interval [s] is given, at every epoch where it is 0, or as the world has them."""
    if decision_interval_s == 0.0 or setup.decision_interval_s is not None:
        return {}
    if decision_interval_s is None:
        fitting = [n for n in range(1, setup.steps + 1) if setup.steps % n == 0]
        nearest = min(fitting, key=lambda n: abs(n * setup.interval_s - ABOUT_S))
        decision_interval_s = round(nearest * setup.interval_s, 9)
    return {"decision_interval_s": decision_interval_s, "between": "linear"}


def setpoint_action(core: SpoofCore, full_scale_mps: float | None) -> dict[str, Any]:
    """Setting `action`; {} where no rate is commanded.  By default the full scale is that of
    `LENGTHS`, or the attack's limit where that is less."""
    commands, setup = core.commands, core.setup
    if commands.setpoint_mps is None:
        if full_scale_mps is not None:
            raise ValueError(
                "`full_scale_mps` is that of a wanted rate, and the attack of these settings is "
                f"commanded otherwise ({', '.join(core.action_names)}); got {full_scale_mps}"
            )
        return {}
    if full_scale_mps is None:
        window_s = setup.steps * setup.interval_s
        most = float(np.min(setup.attack.rate_limit_mps))
        full_scale_mps = min(LENGTHS * core.length_m / window_s, most)
    dimensions = {} if commands.along_target else {"dimensions": 2}
    return {"action": {"name": "rate-setpoint", "full_scale_mps": full_scale_mps, **dimensions}}


def next_price(price: float, amplitude: float, gain: float) -> float:
    """Price in lengths after a fit of the amplitude: divided by it to the power of `gain`, within a
    factor of two and from `LEAST` to `MOST`."""
    if gain == 0.0:
        return price
    factor = min(max(max(amplitude, 1e-3) ** -gain, 0.5), 2.0)
    return min(max(price * factor, LEAST), MOST)


def set_price(envs: SpoofVecEnv, price: float) -> None:
    """Let an alarm cost `price` lengths from now on, unless the reward is one's own."""
    core = envs.core
    if core.settings["reward"] is None:
        envs.set_rewards(default_rewards(price * core.length_m))


def run_training(
    kind: type,
    text: str | None,
    play: Callable[..., Any],
    build_table: Callable[[Any], str],
    list_plan: Callable[[Any], Iterable[str]] = lambda _: (),
) -> None:
    """The command of a training with `kind` of settings: its plan, where this is all that is asked,
    or its results, to a file and as a table."""
    settings = tyro.cli(kind, description=text)
    if getattr(settings, "list", False):
        print(*list_plan(settings), sep="\n")
        return
    torch.set_num_threads(1)
    results = play(settings, show_progress)
    write_json(settings.out / "results.json", results)
    print(build_table(results))


def learn(model: BaseAlgorithm, steps: int, **how: Any) -> str | None:
    """Let a model learn; what torch says where a distribution has no number for its mean.  Weights
    may be not finite without that, too, after the last minibatch."""
    try:
        model.learn(steps, **how)
    except ValueError as error:
        if finite(model.policy):
            raise
        return str(error).partition("\n")[0]
    return None


class Steps(BaseCallback):
    """Tells how many steps of a training have been taken."""

    def __init__(self, tick: Callable[[float], None]) -> None:
        super().__init__()
        self.tick, self.reported = tick, 0

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self.tick(self.num_timesteps - self.reported)
        self.reported = self.num_timesteps
