"""The spoofer's side of the duel for Gymnasium, against a pool of frozen detectors."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

from gymnasium.vector import AutoresetMode

from ..core.registry import check_keywords
from ..detectors import Detector
from ..envs.core import SpoofCore
from ..envs.env import CoreEnv
from ..envs.factory import CORE, make_setup
from ..envs.options import InfoSpec, autoreset_mode_of, check_vector_settings
from ..envs.rendering import CoreRecorder
from ..simulation.tight import TightlyCoupledSetup
from .opponents import DetectorSpec, label_of, members_of, pooled_detector
from .vector_view import POOL_CHANGED, PooledVectorView
from .world import default_opponent, with_world

DetectorPool = Sequence[DetectorSpec] | DetectorSpec
Weights = Sequence[float] | None
WORLD = tuple(n for n in inspect.signature(TightlyCoupledSetup).parameters if n != "detector")
RULES = (*CORE, "prefetch")
"""Settings of the core beside those of its world."""


def check_settings(kind: type, settings: Mapping[str, Any], pool: DetectorPool) -> None:
    """Raise unless all settings of a view of the spoofer's side are known."""
    if settings.get("detector") is not None:
        labels = ", ".join(label_of(spec) for spec in members_of(pool, Detector))
        raise ValueError(
            f"two detectors are set at once: `pool` = {labels} and `detector` = "
            f"{settings['detector']!r}; {kind.__name__} takes its detectors by `pool` alone"
        )
    check_keywords(kind, settings, (*WORLD, *RULES))


class SpooferSide:
    """What the single and the vector view of the spoofer share."""

    def __init__(
        self, receivers: int, pool: DetectorPool, weights: Weights, settings: dict[str, Any]
    ) -> None:
        rules = dict(settings)
        world = {name: rules.pop(name) for name in WORLD if name in rules}
        self._receivers = receivers
        # with a reward of one's own there is no default one to be without a price
        free = {} if rules.get("reward") is not None else {"alarm_price": 0.0}
        self._rules = {**free, **rules}
        self._setup = make_setup(TightlyCoupledSetup, {**with_world(world), "detector": "never"})
        self.labels: tuple[str, ...] = ()
        self.core = self._against(pool, weights)

    def _against(self, pool: DetectorPool, weights: Weights) -> SpoofCore:
        setup = self._setup.altered(detector=pooled_detector(pool, weights, self._setup.live))
        core = SpoofCore(self._receivers, setup, **self._rules)
        self.labels = tuple(label_of(spec) for spec in members_of(pool, Detector))
        return core

    def change(self, pool: DetectorPool, weights: Weights) -> SpoofCore:
        before, labels = self.core, self.labels
        core = self._against(pool, weights)
        if core.observation_names != before.observation_names:
            now, self.labels = self.labels, labels
            raise ValueError(
                f"the pool {', '.join(now)} gives the spoofer {len(core.observation_names)} "
                f"observations, but {', '.join(labels)} gave {len(before.observation_names)}"
            )
        before.close()
        self.core = core
        return core

    def opponents(self) -> list[str]:
        drawn = self.core.engine.simulator.detector.memory["opponent"]
        return [self.labels[k] for k in drawn]


class SpooferView(CoreEnv[SpoofCore]):
    """The spoofer's side: the learner attacks, one detector of the pool defends for an episode.

    Actions, and observations with their scales, are those of `SpoofEnv`.  Every episode is
    attacked, since a clean one pays nothing and teaches nothing.  The undiscounted return is the
    undetected displacement [m], minus `alarm_price` times `length_m` at an alarm.

    Parameters
    ----------
    pool : list, optional
        Detectors by name, by name and settings, as objects (`PolicyDetector` for a policy with its
        threshold), or paths of ``.onnx`` files with a card; a single one may stand for itself.  By
        default solution separation, the best detector of the default world, and with a `scenario`
        of your own `ewma`.
    weights : sequence of float, optional
        Probability of each; all alike by default.
    render_mode : {"human", "rgb_array"}, optional
        As in `SpoofEnv`.
    **settings
        As in `SpoofEnv`, but for the detector; ``alarm_price`` is 0 by default, and the world is
        that of `spoofgym.duel_v0.env`.

    Attributes
    ----------
    observation_names, action_names : tuple of str
        Name of every element.
    """

    def __init__(
        self,
        pool: DetectorPool | None = None,
        weights: Weights = None,
        *,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        pool = default_opponent(settings) if pool is None else pool
        check_settings(SpooferView, settings, pool)
        self._side = SpooferSide(1, pool, weights, {**settings, "threads": 1})
        super().__init__(self._side.core, render_mode)

    def _recorder(self) -> CoreRecorder | None:
        return CoreRecorder(self.core)

    @property
    def opponent(self) -> str:
        return self._side.opponents()[0]

    def set_pool(self, pool: DetectorPool, weights: Weights = None) -> None:
        """Take other opponents; the running episode is over, and `reset` has to follow."""
        self.core = self._side.change(pool, weights)
        if self._screen is not None:
            self._screen.close()
            self._draw_with(self._recorder())
        self._stopped = POOL_CHANGED


class SpooferVectorView(PooledVectorView[SpoofCore]):
    """Vector environment of `SpooferView`; receiver i is the single one seeded with ``seed + i``.

    Parameters
    ----------
    num_envs : int
        Receivers, each with an opponent of its own.
    pool, weights : list
        As in `SpooferView`.
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
        As in `SpooferView`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        pool: DetectorPool | None = None,
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
        pool = default_opponent(settings) if pool is None else pool
        check_settings(SpooferVectorView, settings, pool)
        self._side = SpooferSide(num_envs, pool, weights, {**settings, "threads": threads})
        super().__init__(self._side.core, mode, infos, max_episode_steps)

    @property
    def opponents(self) -> list[str]:
        return self._side.opponents()

    def set_pool(self, pool: DetectorPool, weights: Weights = None) -> None:
        """Take other opponents; the running episodes are over, and `reset` has to follow."""
        self.core = self._side.change(pool, weights)
        self.pool_changed = True
