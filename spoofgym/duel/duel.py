"""The duel of B receivers: spoofer and detector agent, by the engine's two halves; its world."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number, check_word
from ..core.registry import check_keywords, require
from ..detectors.base import check_verdict
from ..detectors.calibration_file import Calibration
from ..detectors.learned import EXCLUSION_S, DetectorAgent, check_delay
from ..detectors.pool import NATURE, uniforms
from ..envs import _kernels
from ..envs.core import NOTHING_SEEN, SpoofCore
from ..envs.factory import make_setup
from ..envs.scoring import DisplacementScore, FusedStep, StepResult
from ..envs.terms import ActionSpec
from ..envs.terms.action import Decisions
from ..envs.terms.observation import Snapshot
from ..simulation.domain import FloatArray
from ..simulation.monitors import Monitor
from ..simulation.simulator import Simulator
from ..simulation.tight import TightlyCoupledSetup
from ..tasks import DEFAULT_TASK, get_task
from .payoff import RUNNING, DuelOutcome, make_payoff, make_threshold

RESET, WITHIN = "reset", "within"
"""Where an attack begins: at the reset, after the whole warm-up, or at a drawn moment within."""
PACE = ("decision_interval_s", "between")
ELSEWHERE = "ewma"
"""Detector that a spoofer meets by default in a scenario that is given."""


def own_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings without a scenario of None, which is as if it were not there."""
    return {k: x for k, x in settings.items() if k != "scenario" or x is not None}


def default_opponent(settings: Mapping[str, Any]) -> Any:
    """Detector of the default task, or of a scenario that is given, at the default rate."""
    if "scenario" in own_settings(settings):
        return ELSEWHERE
    reference = get_task(DEFAULT_TASK).detector
    return {key: x for key, x in reference.items() if key != "false_alarms_per_hour"}


def with_world(settings: Mapping[str, Any], *, paced: bool = True) -> dict[str, Any]:
    """Settings with the world of the default task below them, unless they have a scenario. `paced`:
    whether a spoofer decides as there; those of a pool have a pace of their own."""
    own = own_settings(settings)
    if "scenario" in own:
        return own
    world = get_task(DEFAULT_TASK).world_kwargs
    return {**{name: x for name, x in world.items() if paced or name not in PACE}, **own}


class DuelStep(NamedTuple):
    """What an epoch returns: rewards (B,); `terminated` (B,), the same for both; information by
    key, which is not for the detector."""

    spoofer_reward: FloatArray
    detector_reward: FloatArray
    terminated: NDArray[np.bool_]
    info: dict[str, NDArray[Any]]


class Duel:
    """Episodes of a spoofer against a detector agent, the detector of `setup`, for B receivers.

    One epoch is `arrive`, then `decide`.  The spoofer decides at the first of every `Setup.repeat`
    epochs, counted from the onset, and is commanded from there as `Setup.command` says; the
    detector decides on every epoch, since its weights gate the filter.

    Nature draws for every episode whether it is attacked; in a clean one the commands are ignored.
    The episode ends at an alarm, or after the time to alert, which follows the last command and in
    which the offsets hold their rate.

    With `onset` ``"within"`` an episode begins where the detectors go live, and the attack at the
    age that the world draws (`Domain.age_s`). In the epochs before it (`before_onset`, (B,) at the
    last that has arrived) the detector decides as in all others, and the spoofer is not called:
    they are epochs of a clean episode, which an alarm ends as a false one.

    `decision_delay`: whether an epoch is judged by a decision on itself, or by one on the epoch
    before; `false_alarm`: rate that a running threshold keeps.
    """

    def __init__(
        self,
        receivers: int,
        setup: TightlyCoupledSetup,
        *,
        knowledge: str = "tracking",
        payoff: str | Mapping[str, Any] = "neyman-pearson",
        threshold: float | str | Calibration = RUNNING,
        false_alarm: float = 0.05,
        decision_delay: int = 0,
        attack_probability: float = 0.5,
        action: ActionSpec | None = None,
        onset: str = RESET,
        threads: int | None = None,
    ) -> None:
        check_delay(decision_delay)
        check_word("onset", onset, (RESET, WITHIN))
        self.within = onset == WITHIN
        require(
            not self.within or setup.youngest < setup.onset,
            "`onset` 'within' needs a drawn onset, or a detector could count the epochs to it: "
            "give the domain an `age_s`, such as {'age_s': (60, 600)}",
        )
        if type(setup.detector) is not DetectorAgent:
            raise TypeError(f"the detector of `setup` must be an agent, got {setup.detector!r}")
        check_number("attack_probability", attack_probability, least=0.0, most=1.0)
        self.setup, self.receivers = setup, receivers
        self.decision_delay, self.attack_probability = decision_delay, attack_probability
        self.payoff = make_payoff(payoff)
        self.threshold = make_threshold(threshold, false_alarm, receivers)
        self.core = SpoofCore(
            receivers, setup, knowledge=knowledge, action=action, reward=(), threads=threads
        )
        self.core.engine.to_onset = not self.within
        self.score = DisplacementScore(receivers, setup.steps, setup.hold)
        self._fused = FusedStep(self.score, setup.epoch_time, at_alarm=True, window=self.epochs)
        self.attacked = np.zeros(receivers, dtype=np.bool_)
        self.over = np.zeros(receivers, dtype=np.bool_)
        self.before_onset = np.zeros(receivers, dtype=np.bool_)
        self._all_rows = np.arange(receivers)
        self._sources: list[np.random.Generator | None] = [None] * receivers
        shape = (receivers, len(self.core.action_names))
        self._decisions = Decisions(setup, *shape)
        self._command = np.zeros((receivers, len(setup.action_names)))

    @property
    def agent(self) -> DetectorAgent:
        return cast("DetectorAgent", self.core.engine.simulator.detector)

    @property
    def epochs(self) -> int:
        """Of an episode from the onset on."""
        return self.setup.steps + self.setup.hold

    @property
    def episode_steps(self) -> int:
        """Epochs of the longest episode."""
        return self.epochs + (self.setup.live if self.within else 0)

    @property
    def quiet_epochs(self) -> int:
        """Epochs after detectors go live in which the agent does not decide."""
        return 0 if self.within else self.setup.least_live

    @property
    def holding(self) -> NDArray[np.bool_]:
        """(B,) bool, whether all commands have been given."""
        return self.score.step_count >= self.setup.steps

    @property
    def deciding(self) -> NDArray[np.bool_]:
        """(B,) bool, whether the spoofer decides before the coming epoch."""
        return np.asarray(self._decisions.due(self.score.step_count) & ~self._awaits_onset())

    def _awaits_onset(self) -> NDArray[np.bool_]:
        """(B,) bool, whether the coming epoch is before the onset."""
        simulator = self.core.engine.simulator
        return simulator.epochs < simulator.onset

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        rows: NDArray[np.intp] | None = None,
        given: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin new episodes by their warm-up, in which the agent is not called; with the onset
        ``"within"`` only the part without detectors. A generator that a row has not had restarts
        its threshold."""
        where = self._all_rows if rows is None else rows
        self.core.reset(rngs, rows, given)
        self.score.reset(where)
        self._decisions.forget(where)
        self._command[where] = 0.0
        self.over[where] = False
        for row, rng in zip(where, rngs, strict=True):
            if self._sources[row] is not rng:
                self._sources[row] = rng
                self.threshold.restart(np.array([row]))
        keys = self.core.engine.simulator.memory["key"][where]
        self.attacked[where] = uniforms(keys, NATURE) < self.attack_probability

    def arrive(self, action: FloatArray | None, rows: NDArray[np.intp] | None = None) -> None:
        """First half of an epoch: the spoofer moves, measurements arrive, the detector looks.
        `action` (B, k) in [-1, 1] counts where a decision is due (see `deciding`); None where none
        is at all."""
        where = self._all_rows if rows is None else rows
        due = where[self.deciding[where]]
        if len(due):
            if action is None:
                raise ValueError("`action` must be given: a decision of the spoofer is due")
            self._decisions.take(action, due)
        self.before_onset[where] = self._awaits_onset()[where]
        self._command[where] = command = self._select_commands()[where]
        self.core.engine.apart(where, lambda part: self._arrive(part, command, where))

    def _select_commands(self) -> FloatArray:
        """Commands as the attack takes them: holding the rate where all have been given."""
        action = self.core.command(self._decisions.action(self.score.step_count))
        by_rate = self.setup.attack.control != "acceleration"
        held = self._command if by_rate else np.zeros_like(self._command)
        command = np.where(self.holding[:, None], held, action)
        return np.where(self._started[:, None], command, 0.0)

    @property
    def _started(self) -> NDArray[np.bool_]:
        """(B,) bool, whether the last epoch that has arrived is attacked."""
        return self.attacked & ~self.before_onset

    def _arrive(self, part: Simulator, command: FloatArray, rows: NDArray[np.intp]) -> None:
        part.clean = ~self._started[rows]
        waiting = np.flatnonzero(self.before_onset[rows])
        idle = {name: array[waiting] for name, array in part.commands.items()}
        epoch = part.predict(np.ascontiguousarray(command))
        for name, array in idle.items():  # the spoofer's equipment starts at the onset
            part.commands[name][waiting] = array
        part.check_converged()  # before anything is seen of it
        cast("DetectorAgent", part.detector).look(epoch)

    def decide(self, action: FloatArray) -> DuelStep:
        """Second half of an epoch: the detector decides, the filter updates, both are paid.
        `action` (B, a) of the detector, in [-1, 1]."""
        engine, simulator, score = self.core.engine, self.core.engine.simulator, self.score
        limit, epoch = self.threshold.values.copy(), simulator.epoch
        verdict = self.agent.verdict(action, limit, epoch.visible, epoch.interval)
        # the threshold is the game's, and infinite where no alarm is wanted
        any_valid = np.ones(verdict.statistic.shape)
        check_verdict(verdict._replace(threshold=any_valid), self.agent, epoch)
        simulator.verdict = verdict
        engine.update(verdict)
        holding, result = self.holding, StepResult(self._fused.layout)
        before, attacked = self.before_onset, self._started
        result.displacement[:] = np.where(before, 0.0, self.core.displacement())
        score.step_count[before] = -1  # so that the first epoch that counts is that of the onset
        self.core.set_origin(np.flatnonzero(before & (simulator.epochs == simulator.onset)))
        warmup_alarm, alarms = engine.warmup_alarm, verdict.alarm
        self._fused(
            simulator, alarms, score.no_rows, warmup_alarm, result, NOTHING_SEEN, engine.hold
        )
        values, first, terminated = result.values, result.marks[_kernels.FIRST], result.terminated
        outcome = DuelOutcome(
            values[_kernels.GAIN],
            values[_kernels.RETRACTION],
            first,
            attacked,
            ~score.detected,
            self.setup.interval_s,
        )
        won, paid = self.payoff(outcome)
        # a receiver whose episode is over may be stepped once more before it is reset
        self.threshold.learn(score.detected, terminated & ~self.attacked & ~self.over)
        self.over |= terminated
        info = {
            "time_s": simulator.time_s(),
            "alarm": alarms.any(axis=1),
            "statistic": verdict.statistic.max(axis=1),
            "threshold": limit,
            "attacked": attacked,
            "holding": holding,
            "displacement_m": result.displacement,
            "undetected_displacement_m": np.where(attacked, score.undetected, 0.0),
        }
        return DuelStep(won, paid, terminated, info)

    def snapshot(self) -> Snapshot:
        return self.core.snapshot()._replace(step=self.score.step_count)

    def observe_detector(self) -> NDArray[np.float32]:
        """What the detector observes of the last epoch that has arrived, (B, o), a new array."""
        return self.agent.memory["observation"].copy()

    def time_s(self) -> FloatArray:
        return self.core.engine.simulator.time_s()

    def close(self) -> None:
        self.core.close()


def duel_setup(
    *,
    statistic: str = "receiver",
    weighs: bool = True,
    exclusion_s: float | None = EXCLUSION_S,
    **settings: Any,
) -> TightlyCoupledSetup:
    """What all receivers of a duel share; `settings` of `TightlyCoupledSetup` and `with_world`."""
    agent = DetectorAgent(statistic, weighs, exclusion_s)
    return make_setup(TightlyCoupledSetup, {**with_world(settings), "detector": agent})


def _parameters(subject: Any, *without: str) -> dict[str, inspect.Parameter]:
    return {k: p for k, p in inspect.signature(subject).parameters.items() if k not in without}


_OF_SETUP = {**_parameters(TightlyCoupledSetup, "detector"), **_parameters(duel_setup, "settings")}
_OF_DUEL = _parameters(Duel, "receivers", "setup", "threads")
SETTINGS = (*_OF_SETUP, *_OF_DUEL)


def duel_signature() -> inspect.Signature:
    """Arguments of a PettingZoo form: all settings, but for the delay that is its own."""
    default = with_world({})
    settings = [
        parameter.replace(default=default.get(name, parameter.default))
        for name, parameter in {**_OF_SETUP, **_OF_DUEL}.items()
        if name != "decision_delay"
    ]
    nothing = inspect.Parameter("render_mode", inspect.Parameter.KEYWORD_ONLY, default=None)
    return inspect.Signature([*settings, nothing])


def refuse_to_draw(whose: str, render_mode: object) -> None:
    if render_mode is not None:
        raise ValueError(
            f"`render_mode` must be None, there is nothing to render in {whose}: of the duel only "
            f"SpooferView draws its episodes; got {render_mode!r}"
        )


def make_duel(
    receivers: int, *, threads: int | None = None, monitors: Sequence[Monitor] = (), **settings: Any
) -> Duel:
    """Duel from settings that fit into JSON; `monitors` look at its epochs besides."""
    check_keywords("the duel", settings, SETTINGS)
    shared = {name: settings.pop(name) for name in _OF_SETUP if name in settings}
    setup: Any = duel_setup(**shared).copy_with(monitors=monitors)
    return Duel(receivers, setup, threads=threads, **settings)
