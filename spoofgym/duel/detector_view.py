"""The detector's side of the duel for Gymnasium, against a pool of frozen spoofers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gymnasium.vector import AutoresetMode

from ..core.registry import check_keywords
from ..envs.env import CoreEnv
from ..envs.options import InfoSpec, autoreset_mode_of, check_vector_settings
from .detector_core import DetectorCore
from .opponents import SpooferSpec
from .rules import SETTINGS, refuse_to_draw
from .spoofer_view import Weights
from .vector_view import POOL_CHANGED, PooledVectorView

SpooferPoolSpec = Sequence[SpooferSpec] | SpooferSpec
VALID = tuple(name for name in SETTINGS if name not in ("knowledge", "action"))
"""Settings of a view of the detector's side: each spoofer has knowledge and actions of its own."""


class DetectorView(CoreEnv[DetectorCore]):
    """The detector's side: the learner defends, one spoofer of the pool attacks for an episode.

    Half of the episodes are clean, which is not observed.  The payoff, the threshold and
    `decision_delay` are those of the duel.

    Parameters
    ----------
    pool : list
        Spoofers by name, by name and settings, as objects, or paths of ``.onnx`` files with a card;
        a single one may stand for itself.
    weights : sequence of float, optional
        Probability of each; all alike by default.
    render_mode : None
        Only the spoofer's side draws its episode.
    **settings
        As in `spoofgym.duel_v0.env`, but for ``knowledge`` and ``action``, which each spoofer has
        of its own, and ``decision_delay``: 0 by default, as in the AEC form, or 1, as in the
        parallel one.

    Attributes
    ----------
    observation_names, action_names : tuple of str
        Name of every element.

    Notes
    -----
    What is observed, over its scale; 12 slots JJ, XXX for three axes,

    =====  ========================  =====  =====
    index  name                      unit   scale
    =====  ========================  =====  =====
    0-11   range_innovation_slotJJ   sd     1
    12-23  rate_innovation_slotJJ    sd     1
    24-35  range_average_slotJJ      sd     1
    36-47  rate_average_slotJJ       sd     1
    48-59  range_sd_slotJJ           m      10
    60-71  rate_sd_slotJJ            m/s    1
    72     chi_square_ratio          1      1
    73-84  visible_slotJJ            1      1
    85-87  predicted_velocity_XXX    m/s    100
    88-90  specific_force_XXX        m/s^2  10
    91-93  angular_rate_XXX          rad/s  0.1
    94     elapsed                   s      600
    95     exclusion_left            1      1
    =====  ========================  =====  =====

    where sd is the standard deviation that the filter believes in.
    """

    def __init__(
        self,
        pool: SpooferPoolSpec = "ramp",
        weights: Weights = None,
        *,
        render_mode: None = None,
        **settings: Any,
    ) -> None:
        refuse_to_draw("DetectorView", render_mode)
        check_keywords(DetectorView, settings, VALID)
        super().__init__(DetectorCore(1, pool, weights, threads=1, **settings))

    @property
    def opponent(self) -> str:
        return self.core.opponents()[0]

    def set_pool(self, pool: SpooferPoolSpec, weights: Weights = None) -> None:
        """Take other opponents; the running episode is over, and `reset` has to follow."""
        self.core.set_pool(pool, weights)
        self._stopped = POOL_CHANGED


class DetectorVectorView(PooledVectorView[DetectorCore]):
    """Vector environment of `DetectorView`; receiver i is the single one seeded with ``seed + i``.

    Parameters
    ----------
    num_envs : int
        Receivers, each with an opponent of its own.
    pool, weights : list
        As in `DetectorView`.
    autoreset_mode : {"next_step", "same_step", "disabled"} or AutoresetMode
        When a finished receiver starts its next episode; with ``disabled``, when ``reset`` is
        called with ``options={"reset_mask": ...}``.
    threads : int, optional
        Threads of the engine.
    infos : {"all", "none"} or sequence of str
        Which information is handed out, by its keys; ``final_obs`` and ``final_info`` always are.
    max_episode_steps : int, optional
        Of `gymnasium.make_vec`, from a spec: more than an episode has, and without effect.
    render_mode : None
        There is nothing to render.
    **settings
        As in `DetectorView`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        pool: SpooferPoolSpec = "ramp",
        weights: Weights = None,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        infos: InfoSpec = "all",
        max_episode_steps: int | None = None,
        render_mode: None = None,
        **settings: Any,
    ) -> None:
        mode = autoreset_mode_of(autoreset_mode)
        check_vector_settings(num_envs, render_mode)
        check_keywords(DetectorVectorView, settings, VALID)
        core = DetectorCore(num_envs, pool, weights, threads=threads, **settings)
        super().__init__(core, mode, infos, max_episode_steps)

    @property
    def opponents(self) -> list[str]:
        return self.core.opponents()

    def set_pool(self, pool: SpooferPoolSpec, weights: Weights = None) -> None:
        """Take other opponents; the running episodes are over, and `reset` has to follow."""
        self.core.set_pool(pool, weights)
        self.pool_changed = True
