"""The duel of a spoofer and a detector, as PettingZoo environments and as views of one side.

Agents are ``spoofer_0`` and ``detector_0``.  `env` is the AEC form, whose detector decides on the
epoch that has just arrived (``decision_delay`` 0); in `parallel_env` its decision is applied one
epoch late (``decision_delay`` 1): two different games.  The page docs/duel.md lists what each side
observes, and when.

PettingZoo is imported when `env` or `parallel_env` is called; the views and `calibrate` do without.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .attacks import Attack
from .duel.agent import EXCLUSION_S, PolicyDetector
from .duel.calibrate import calibrate
from .duel.calibration import Calibration
from .duel.detector_view import DetectorVectorView, DetectorView
from .duel.onnx_detector import DetectorCard, OnnxDetector, write_card
from .duel.payoff import RUNNING, NeymanPearson, Weighted
from .duel.policy import DetectorPolicy, FunctionPolicy
from .duel.spoofer_view import SpooferVectorView, SpooferView
from .envs.domain import Domain
from .envs.setup import Timeline
from .receiver import TightlyCoupled
from .sim.scenario import Scenario

__all__ = [
    "Calibration",
    "DetectorCard",
    "DetectorPolicy",
    "DetectorVectorView",
    "DetectorView",
    "FunctionPolicy",
    "NeymanPearson",
    "OnnxDetector",
    "PolicyDetector",
    "SpooferVectorView",
    "SpooferView",
    "Weighted",
    "calibrate",
    "env",
    "parallel_env",
    "raw_env",
    "write_card",
]


def env(
    *,
    scenario: str | Mapping[str, Any] | Scenario = "zhong2025",
    receiver: str | Mapping[str, Any] | TightlyCoupled | None = None,
    attack: str | Mapping[str, Any] | Attack = "false-position",
    timeline: Mapping[str, float] | Timeline | None = None,
    knowledge: str = "tracking",
    statistic: str = "receiver",
    weighs: bool = True,
    exclusion_s: float | None = EXCLUSION_S,
    payoff: str | Mapping[str, Any] = "neyman-pearson",
    threshold: float | str | Calibration = RUNNING,
    false_alarm: float = 0.05,
    attack_probability: float = 0.5,
    domain: Mapping[str, Any] | Domain | None = None,
    target_heading_deg: float | str = 90.0,
    decision_interval_s: float | None = None,
    between: str = "hold",
    render_mode: None = None,
) -> Any:
    """Make the AEC form: the spoofer moves, measurements arrive, the detector decides on them.

    Parameters
    ----------
    scenario, receiver, attack, timeline, knowledge : str, mapping or object
        As in `spoofgym.envs.SpoofEnv`.
    statistic : {"receiver", "channel"}
        Whether the detector has one statistic, or one for every slot.
    weighs : bool
        Whether the detector weighs satellites in the filter.
    exclusion_s : float or None
        Allowance of exclusion in an episode: an epoch costs its interval times what the weights of
        the visible satellites lack, on average, of 1; beyond it all weights are 1.  None for no
        limit: then the best answer to any attack is not to look at GNSS.
    payoff : {"neyman-pearson", "weighted"} or mapping
        Undetected displacement at a fixed false-alarm rate, or a weighted sum of false alarms,
        delay and error, ``{"name": "weighted", "false_alarm": ..., "delay_per_s": ...,
        "error_per_m": ...}``.
    threshold : "running", float in (0, 1] or Calibration
        What the statistic is compared with: it follows the clean episodes of this environment, or
        is that of `calibrate` for one frozen detector.
    false_alarm : float
        Rate of clean episodes with an alarm that a running threshold keeps, in (0, 1).
    attack_probability : float
        That nature draws an attack, in [0, 1].
    domain : mapping or Domain, optional
        What differs from episode to episode.
    target_heading_deg : float or {"random", "worst"}
        Direction in which displacement counts, clockwise from north.
    decision_interval_s : float, optional
        Time between the spoofer's decisions, as in `SpoofEnv`; every epoch by default.  The
        detector decides on every epoch, since its weights gate the filter: here it has the turns
        in between, too; in `parallel_env` the spoofer's actions in between are not looked at.
    between : {"hold", "linear"}
        What is commanded between them.
    render_mode : None
        There is nothing to render.

    Returns
    -------
    AECEnv
        With PettingZoo's check of the order of calls.

    Examples
    --------
    >>> from spoofgym import duel_v0
    >>> duel = duel_v0.env(timeline={"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0})
    >>> duel.reset(seed=1)
    >>> duel.agent_selection, duel.metadata["decision_delay"]
    ('spoofer_0', 0)
    >>> duel.close()
    """
    settings = dict(locals())
    from pettingzoo.utils.wrappers import OrderEnforcingWrapper

    return OrderEnforcingWrapper(raw_env(**settings))


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
    from .duel.aec import DuelAEC

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
    >>> duel = duel_v0.parallel_env(timeline={"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0})
    >>> observations, infos = duel.reset(seed=1)
    >>> infos["detector_0"]["decision_delay"], "attacked" in infos["detector_0"]
    (1, False)
    >>> duel.close()
    """
    from .duel.parallel import DuelParallel

    return DuelParallel(**settings)
