"""The duel of a spoofer and a detector, as PettingZoo environments and as views of one side.

Agents are ``spoofer_0`` and ``detector_0``.  `env` is the AEC form, whose detector decides on the
epoch that has just arrived (``decision_delay`` 0); in `parallel_env` its decision is applied one
epoch late (``decision_delay`` 1): two different games.  The page docs/duel.md says which agent
observes what, and when.

A population of both sides is a matrix game, `Game`, with equilibria, best responses and their
exploitability: docs/game.md.

PettingZoo is imported when `env` or `parallel_env` is called; the views and `calibrate_policy` do
without.
"""

from __future__ import annotations

from typing import Any

from .bench.experiments.best_response import (
    AttackBudget,
    best_detector,
    best_spoofer,
    exploitability,
)
from .bench.experiments.game import Game
from .bench.runs.players import make_player, mixture
from .bench.scores.matrix_game import solve
from .detectors.calibration_file import Calibration
from .detectors.learned import PolicyDetector
from .duel.calibrate import calibrate_policy
from .duel.duel import duel_signature
from .duel.payoff import NeymanPearson, Weighted
from .duel.views import DetectorVectorView, DetectorView, SpooferVectorView, SpooferView, write_card
from .policies.card import DetectorCard
from .policies.contract import DetectorPolicy, FunctionPolicy
from .policies.load import OnnxDetector

__all__ = [
    "AttackBudget",
    "Calibration",
    "DetectorCard",
    "DetectorPolicy",
    "DetectorVectorView",
    "DetectorView",
    "FunctionPolicy",
    "Game",
    "NeymanPearson",
    "OnnxDetector",
    "PolicyDetector",
    "SpooferVectorView",
    "SpooferView",
    "Weighted",
    "best_detector",
    "best_spoofer",
    "calibrate_policy",
    "env",
    "exploitability",
    "make_player",
    "mixture",
    "parallel_env",
    "raw_env",
    "solve",
    "write_card",
]


def env(*, render_mode: None = None, **settings: Any) -> Any:
    """Make the AEC form: the spoofer moves, measurements arrive, the detector decides on them.

    Parameters
    ----------
    render_mode : None
        There is nothing to render.
    **settings
        The world of `spoofgym.envs.SpoofEnv`: scenario, receiver, attack, timeline, domain,
        target_heading_deg, decision_interval_s, between, on top of those of
        ``spoofgym/TightlyCoupled-v0``, or of the class where a scenario is given; ``knowledge`` of
        the spoofer; and

        - ``statistic``, "receiver" or "channel": whether the detector has one statistic, or one for
          every slot; ``weighs``: whether it weighs satellites in the filter;
        - ``exclusion_s``: allowance of exclusion in an episode.  An epoch costs its interval times
          what the weights of the visible satellites lack, on average, of 1; beyond it all weights
          are 1.  None for no limit: then the best answer to any attack is to ignore GNSS;
        - ``payoff``, "neyman-pearson" or "weighted": undetected displacement at a fixed false-alarm
          rate, or a weighted sum of false alarms, delay and error, ``{"name": "weighted",
          "false_alarm": ..., "delay_per_s": ..., "error_per_m": ...}``;
        - ``threshold``, "running", a float in (0, 1] or a `Calibration`: what the statistic is
          compared with.  It follows the clean episodes of this environment, or is that of
          `calibrate_policy` for one frozen detector;
        - ``false_alarm``: probability of an alarm in a clean episode that the threshold is for, in
          (0, 1);
        - ``attack_probability``: that nature draws an attack, in [0, 1];
        - ``onset``, "reset" or "within": whether the detector's episode begins at the onset, or
          when detectors go live, with the attack at the age that ``domain`` draws by ``age_s``.

        The decisions are the spoofer's; the detector decides on every epoch, since its weights gate
        the filter: here it has the turns in between, too; in `parallel_env` the spoofer's actions
        in between are ignored.

    Returns
    -------
    AECEnv
        With PettingZoo's check of the order of calls.

    Examples
    --------
    >>> from spoofgym import duel_v0
    >>> duel = duel_v0.env(scenario="zhong2025", timeline={"attack_s": 20.0})
    >>> duel.reset(seed=1)
    >>> duel.agent_selection, duel.metadata["decision_delay"]
    ('spoofer_0', 0)
    >>> duel.close()
    """
    from pettingzoo.utils.wrappers import OrderEnforcingWrapper

    return OrderEnforcingWrapper(raw_env(render_mode=render_mode, **settings))


env.__signature__ = duel_signature()  # type: ignore[attr-defined]


def raw_env(**settings: Any) -> Any:
    """Make the AEC form without PettingZoo's check of the order of calls.

    Parameters
    ----------
    **settings
        As in `env`.

    Returns
    -------
    AECEnv
        Of its own class.
    """
    from .duel.pettingzoo import DuelAEC

    return DuelAEC(**settings)


def parallel_env(**settings: Any) -> Any:
    """Make the parallel form: the detector's decision is applied one epoch late.

    Parameters
    ----------
    **settings
        As in `env`.

    Returns
    -------
    ParallelEnv
        Fresh dicts at every step, and equal end flags for both agents.

    Examples
    --------
    >>> from spoofgym import duel_v0
    >>> duel = duel_v0.parallel_env(scenario="zhong2025", timeline={"attack_s": 20.0})
    >>> observations, infos = duel.reset(seed=1)
    >>> infos["detector_0"]["decision_delay"], "attacked" in infos["detector_0"]
    (1, False)
    >>> duel.close()
    """
    from .duel.pettingzoo import DuelParallel

    return DuelParallel(**settings)
