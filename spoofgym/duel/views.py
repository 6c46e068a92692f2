"""One side of the duel for Gymnasium, against a pool of frozen opponents of the other side."""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from ..core.registry import check_keywords
from ..core.settings import compute_digest
from ..detectors import Detector
from ..detectors.calibration_file import Calibration
from ..detectors.learned import detector_card
from ..envs.core import SingleStep, SpoofCore
from ..envs.env import C, CoreEnv, CoreVectorEnv
from ..envs.factory import CORE, make_setup
from ..envs.options import Array, InfoSpec, check_vector_settings, read_mask
from ..envs.scoring import Info, PlainResult
from ..policies.card import DetectorCard
from ..policies.load import card_path
from ..simulation.monitors import FloatArray, PastPositions
from ..simulation.tight import TightlyCoupledSetup
from ..spoofers.build import SpooferSpec
from .duel import SETTINGS, default_opponent, make_duel, refuse_to_draw, with_world
from .opponents import DetectorSpec, SpooferPool, label_opponent, list_opponents, pooled_detector

DetectorPool = Sequence[DetectorSpec] | DetectorSpec
SpooferPoolSpec = Sequence[SpooferSpec] | SpooferSpec
Weights = Sequence[float] | None
WORLD = tuple(n for n in inspect.signature(TightlyCoupledSetup).parameters if n != "detector")
RULES = (*CORE, "prefetch")  # settings of the core beside those of its world
OF_DETECTOR = tuple(name for name in SETTINGS if name not in ("knowledge", "action"))
"""Settings of a view of the detector's side: each spoofer has knowledge and actions of its own."""
POOL_CHANGED = "the pool has changed"


def check_view_settings(kind: type, settings: Mapping[str, Any], pool: DetectorPool) -> None:
    if settings.get("detector") is not None:
        labels = ", ".join(label_opponent(spec) for spec in list_opponents(pool, Detector))
        raise ValueError(
            f"two detectors are set at once: `pool` = {labels} and `detector` = "
            f"{settings['detector']!r}; {kind.__name__} takes its detectors by `pool` alone"
        )
    check_keywords(kind, settings, (*WORLD, *RULES))


class SpooferSide:
    """Cores of the spoofer's side against a pool that can be changed; `core`: the present one."""

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
        setup = self._setup.copy_with(
            detector=pooled_detector(pool, weights, self._setup.least_live)
        )
        core = SpoofCore(self._receivers, setup, **self._rules)
        self.labels = tuple(label_opponent(spec) for spec in list_opponents(pool, Detector))
        return core

    def change(self, pool: DetectorPool, weights: Weights) -> SpoofCore:
        before, labels = self.core, self.labels
        core = self._against(pool, weights)
        if core.observation_names != before.observation_names:
            now, self.labels = self.labels, labels
            raise ValueError(
                f"the spoofer has {len(core.observation_names)} observations against the pool "
                f"{', '.join(now)}, but {len(before.observation_names)} against {', '.join(labels)}"
            )
        before.close()
        self.core = core
        return core

    def opponents(self) -> list[str]:
        return [self.labels[k] for k in self.core.engine.simulator.detector.memory["opponent"]]


class DetectorCore:
    """Episodes of B receivers, in which the learner is the detector; a step is an epoch. With
    ``decision_delay=0`` an observation is of the epoch that the next action judges; with 1 of the
    one before. Nothing that the learner is shown before the end depends on when the attack begins,
    but for the measurements and the payoff. `settings` are those of `make_duel`."""

    reset_names: tuple[str, ...] = ("time_s", "decision_delay")
    info_names: tuple[str, ...] = (
        "time_s",
        "alarm",
        "statistic",
        "threshold",
        "decision_delay",
        "attacked",
        "undetected_displacement_m",
    )

    def __init__(
        self,
        receivers: int,
        pool: Sequence[SpooferSpec] | SpooferSpec,
        weights: Sequence[float] | None = None,
        *,
        threads: int | None = None,
        **settings: Any,
    ) -> None:
        given = {"action": "full-command", **with_world(settings, paced=False)}
        # for spoofers of the pool that know what the victim reports
        duel = make_duel(receivers, threads=threads, monitors=[PastPositions()], **given)
        self.duel = duel
        self.change(pool, weights)
        observer, self.action_names = duel.agent.observer, duel.agent.action_names
        self.observation_names, self.bounds = observer.names, (observer.low, observer.high)
        self.receivers, self.episode_steps = duel.receivers, duel.episode_steps
        self._all_rows = np.arange(duel.receivers)

    def change(
        self, pool: Sequence[SpooferSpec] | SpooferSpec, weights: Sequence[float] | None = None
    ) -> Self:
        self.pool = SpooferPool(pool, weights, self.duel.setup, self.duel.receivers)
        return self

    def opponents(self) -> list[str]:
        return [self.pool.labels[k] for k in self.pool.opponent]

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        rows: NDArray[np.intp] | None = None,
        given: Mapping[str, Any] | None = None,
    ) -> None:
        where = self._all_rows if rows is None else rows
        self.duel.reset(rngs, rows, given)
        self.pool.start_episodes(where, self.duel.core.engine.simulator.memory["key"][where])
        if self.duel.decision_delay == 0:
            self._arrive(where)

    def _arrive(self, rows: NDArray[np.intp]) -> None:
        due = rows[self.duel.deciding[rows]]
        action = self.pool.act(self.duel.snapshot(), due) if len(due) else None
        self.duel.arrive(action, rows)

    def step(self, action: FloatArray) -> tuple[PlainResult, NDArray[np.float32]]:
        if self.duel.decision_delay == 0:
            # the world may end one epoch after an episode
            playing = np.flatnonzero(~self.duel.over)
            done = self.duel.decide(action)
            if len(playing):
                self._arrive(playing)
        else:
            self._arrive(self._all_rows)
            done = self.duel.decide(action)
        over, all_ = done.terminated, done.info
        info: Info = {
            **{name: all_[name] for name in ("time_s", "alarm", "statistic", "threshold")},
            "decision_delay": np.full(self.receivers, self.duel.decision_delay),
            "attacked": all_["attacked"] & over,
            "undetected_displacement_m": np.where(over, all_["undetected_displacement_m"], 0.0),
        }
        return PlainResult(done.detector_reward, over, np.zeros_like(over), info), self.observe()

    def single(self, action: FloatArray) -> SingleStep:
        result, observation = self.step(action)
        return observation[0], *result.single()

    def observe(self) -> NDArray[np.float32]:
        return self.duel.observe_detector()

    def reset_info(self) -> Info:
        delay = np.full(self.receivers, self.duel.decision_delay)
        return {"time_s": self.duel.time_s(), "decision_delay": delay}

    def close(self) -> None:
        self.duel.close()


class PooledView(CoreEnv[C]):
    """Environment of one side of the duel, of one receiver."""

    _side: Any

    @property
    def opponent(self) -> str:
        """Label of the opponent of the running episode, in a clean one too."""
        return str(self._side.opponents()[0])

    def set_pool(self, pool: Any, weights: Weights = None) -> None:
        """Take other opponents; the running episode is over, and `reset` has to follow."""
        self.core = self._side.change(pool, weights)
        if self._screen is not None:
            self._screen.close()
            self._prepare_screen()
        self._stopped = POOL_CHANGED


class PooledVectorView(CoreVectorEnv[C]):
    """Vector environment of one side of the duel."""

    _side: Any
    _pool_changed = False

    @property
    def opponents(self) -> list[str]:
        """Label of the opponent of every receiver, in clean episodes too."""
        return list(self._side.opponents())

    def set_pool(self, pool: Any, weights: Weights = None) -> None:
        """Take other opponents; the running episodes are over, and `reset` has to follow."""
        self.core = self._side.change(pool, weights)
        self._pool_changed = True

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        if self._pool_changed and not read_mask(options, self.num_envs).all():
            raise ValueError(f"{POOL_CHANGED}: the next reset must reset all receivers")
        begun = super().reset(seed=seed, options=options)
        self._pool_changed = False
        return begun

    def step(self, actions: Any) -> Any:
        if self._pool_changed:
            raise RuntimeError(f"{POOL_CHANGED}: call reset() before step()")
        return super().step(actions)


class SpooferView(PooledView[SpoofCore]):
    """The spoofer's side: the learner attacks, one detector of the pool defends for an episode.

    Actions, and observations with their scales, are those of `SpoofEnv`.  Every episode is
    attacked, since a clean one pays nothing and teaches nothing.  The undiscounted return is the
    undetected displacement [m], minus `alarm_price` times `length_m` at an alarm.

    Parameters
    ----------
    pool : list, optional
        Detectors by name, by name and settings, as objects (`PolicyDetector` for a policy with its
        threshold), or paths of ``.onnx`` files with a card; a single one may stand for itself.  By
        default that of ``spoofgym/TightlyCoupled-v0``, and with a `scenario` of your own `ewma`.
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
        check_view_settings(SpooferView, settings, pool)
        self._side = SpooferSide(1, pool, weights, {**settings, "threads": 1})
        super().__init__(self._side.core, render_mode)


class SpooferVectorView(PooledVectorView[SpoofCore]):
    """Vector environment of `SpooferView`; receiver i is the single one seeded with ``seed + i``.

    Each receiver has an opponent of its own.  Arguments are as in `SpooferView`, all others
    as in `SpoofVectorEnv`.
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
        check_vector_settings(num_envs, render_mode)
        pool = default_opponent(settings) if pool is None else pool
        check_view_settings(SpooferVectorView, settings, pool)
        self._side = SpooferSide(num_envs, pool, weights, {**settings, "threads": threads})
        super().__init__(self._side.core, autoreset_mode, infos, max_episode_steps)


class DetectorView(PooledView[DetectorCore]):
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
        parallel one.  With ``onset="within"`` an episode begins where detectors go live, and the
        attack at the age that the domain's ``age_s`` draws; `attacked` in the last information says
        whether it had begun.

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
        check_keywords(DetectorView, settings, OF_DETECTOR)
        self._side = DetectorCore(1, pool, weights, threads=1, **settings)
        super().__init__(self._side)


class DetectorVectorView(PooledVectorView[DetectorCore]):
    """Vector environment of `DetectorView`; receiver i is the single one seeded with ``seed + i``.

    Each receiver has an opponent of its own.  Arguments are as in `DetectorView`, all others
    as in `SpoofVectorEnv`.
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
        check_vector_settings(num_envs, render_mode)
        check_keywords(DetectorVectorView, settings, OF_DETECTOR)
        self._side = DetectorCore(num_envs, pool, weights, threads=threads, **settings)
        super().__init__(self._side, autoreset_mode, infos, max_episode_steps)


def _summarize(calibration: Calibration, false_alarm: float) -> dict[str, Any]:
    """What the card of a policy says of its threshold."""
    low, high = calibration.interval(false_alarm)
    return {
        "false_alarm": false_alarm,
        "runs": calibration.runs,
        "threshold_low": low,
        "threshold_high": min(high, 1.0),
        "detector": calibration.detector["policy"],
        "world": compute_digest(calibration.world),
    }


def write_card(
    file: str | os.PathLike[str],
    view: Any,
    *,
    name: str,
    calibration: Calibration | None = None,
    false_alarm: float = 0.05,
    training: dict[str, Any] | None = None,
) -> DetectorCard:
    """Write the card of a detector policy that was made in a view.

    Parameters
    ----------
    file : path-like
        The ONNX file, of one float32 input (batch, o) and one float32 output (batch, a).
    view : DetectorView or DetectorVectorView
        Where it was made; knows names, bounds and delay.
    name : str
        Of the detector.
    calibration : Calibration, optional
        Of this policy, which gives the threshold.
    false_alarm : float
        Probability of an alarm in a clean run that the threshold is for.
    training : dict, optional
        How it was made, JSON-able.

    Returns
    -------
    DetectorCard
        As it was written.
    """
    duel = view.unwrapped.core.duel
    setup = duel.setup
    card = detector_card(
        duel.agent,
        setup.world.channels,
        file,
        name=name,
        interval_s=setup.interval_s,
        quiet_epochs=duel.quiet_epochs,
        decision_delay=duel.decision_delay,
        threshold=None if calibration is None else calibration.point(per_run=false_alarm).scale,
        calibration={} if calibration is None else _summarize(calibration, false_alarm),
        training=training,
    )
    card.save(card_path(file))
    return card
