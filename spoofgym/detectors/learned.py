"""The detector agent of the duel, which decides by actions; a policy or a file as a detector.

An action has one element for the statistic (or one for every slot), and one for the weight of every
satellite, all in [-1, 1]; both are mapped to [0, 1] by :math:`(a + 1) / 2`.  An alarm is raised
where the statistic exceeds the threshold.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..core.declared import check_number, setting, settings_record
from ..core.memory import Memory
from ..policies.card import DetectorCard, Space, State
from ..policies.contract import DetectorPolicy, PolicyContext
from ..policies.load import OnnxDetector, card_path
from ..policies.onnx_file import SUFFIX, check_signature, describe_file, read_model
from ..receiver.epoch import Epoch
from .base import BoolArray, Detector, DetectorContext, FloatArray, Verdict, compare
from .build import LOADERS, THRESHOLD_KEYS
from .observation import (
    ALL_TERMS,
    DetectorObserver,
    DetectorTerm,
    ExclusionLeft,
    make_detector_terms,
    slots,
    written_terms,
)
from .pool import JointMemory

EXCLUSION_S = 30.0
"""Allowance of exclusion; without one the best answer to any attack is not to look at GNSS."""


def action_names(statistic: str, weighs: bool, channels: int) -> tuple[str, ...]:
    """(a,) names of the elements of a detector agent's action."""
    first = ("statistic",) if statistic == "receiver" else slots("statistic", channels)
    return first + (slots("weight", channels) if weighs else ())


def check_delay(decision_delay: int) -> None:
    check_number("decision_delay", decision_delay, least=0, most=1, whole=True)


@settings_record
class DetectorAgent(Detector):
    """Observes every epoch; its decisions are actions; without them: no alarm, weights 1."""

    statistic: str = setting(
        default="receiver",
        one_of=("receiver", "channel"),
        help="One statistic, or one for every slot.",
    )
    weighs: bool = setting(default=True, help="Whether the agent gives satellites weights, too.")
    exclusion_s: float | None = setting(
        default=EXCLUSION_S,
        least=0.0,
        unit="s",
        help="Allowance of exclusion in an episode, None for no limit: an epoch costs its "
        "interval times what the weights of the visible satellites lack, on average, of 1. An "
        "epoch that would exceed it is used with all weights 1.",
    )
    terms: Sequence[Any] | None = setting(
        default=None,
        omitted=True,
        kw_only=True,
        help="What it observes, as `make_detector_terms` takes it; None for `ALL_TERMS`, and "
        "what is left of the allowance.",
    )

    paper: ClassVar[str] = "groves2013"

    def __post_init__(self) -> None:
        if self.terms is not None:
            self.terms = make_detector_terms(self.terms)
        # these are the object's choice, not the class's
        self.scope = self.statistic  # type: ignore[misc]
        self.needs = frozenset().union(*(term.needs for term in self.observed_terms))  # type: ignore[misc]
        self.from_start = any(term.from_start for term in self.observed_terms)
        self.needs_model = any(term.needs_model for term in self.observed_terms)
        for term in self.observed_terms:
            if isinstance(term, ExclusionLeft) and term.exclusion_s != self.exclusion_s:
                raise ValueError(
                    f"`exclusion_s` of the term exclusion-left must be that of the detector, "
                    f"{self.exclusion_s}, got {term.exclusion_s}"
                )

    @property
    def observed_terms(self) -> tuple[DetectorTerm, ...]:
        if self.terms is not None:
            return tuple(self.terms)
        return (*ALL_TERMS, ExclusionLeft(self.exclusion_s))

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        n = context.channels
        self.observer = DetectorObserver(self.observed_terms, n)
        self.action_names = action_names(self.statistic, self.weighs, n)
        self._columns = n if self.statistic == "channel" else 1
        self.memory = JointMemory(context.receivers, self._bound_parts(context))
        self.memory.declare("excluded_s", np.zeros(context.receivers))
        self.observer.declare(self.memory)

    def _bound_parts(self, context: DetectorContext) -> list[Memory]:
        return self.observer.bind(context)

    def look(self, epoch: Epoch) -> None:
        self.observer.look(epoch, self.memory)

    def watch(self, epoch: Epoch) -> None:
        self.observer.watch(epoch)

    def judge(self, epoch: Epoch) -> Verdict:
        """Observe an epoch of the warm-up, without a decision: no alarm, no weights."""
        self.look(epoch)
        return compare(np.zeros((len(epoch.time), self._columns)), 1.0)

    def verdict(
        self, action: FloatArray, threshold: FloatArray, visible: BoolArray, interval: FloatArray
    ) -> Verdict:
        """Verdict of an action (B, a) in [-1, 1]; what it excludes is taken off the allowance.
        `threshold` (B,); `interval` (B,) since the last epoch [s]. The statistic of an invisible
        slot is 0, its weight 1; weights are the same for pseudorange and range rate."""
        share = np.clip(0.5 * (action + 1.0), 0.0, 1.0)
        statistic = np.ascontiguousarray(share[:, : self._columns])
        if self.statistic == "channel":
            statistic = np.where(visible, statistic, 0.0)
        limit = np.ascontiguousarray(np.broadcast_to(threshold[:, None], statistic.shape))
        weights = None
        if self.weighs:
            weight = np.where(visible, share[:, self._columns :], 1.0)
            lacking = (1.0 - weight).sum(axis=1) / np.maximum(visible.sum(axis=1), 1)
            excluded_s = self.memory["excluded_s"]
            used = excluded_s + interval * lacking
            within = used <= (np.inf if self.exclusion_s is None else self.exclusion_s)
            self.memory["excluded_s"] = np.where(within, used, excluded_s)
            weight = np.where(within[:, None], weight, 1.0)
            weights = np.concatenate([weight, weight], axis=1)
        return Verdict(statistic, limit, statistic > limit, weights)


@settings_record
class PolicyDetector(DetectorAgent):
    """A trained policy that learns no more, as a detector with a threshold."""

    policy: DetectorPolicy = setting(default=None, help="What decides; copied.")
    threshold: float = setting(
        default=1.0,
        above=0.0,
        most=1.0,
        help="What the statistic is compared with; of a calibration of this policy.",
    )
    decision_delay: int = setting(
        default=0,
        least=0,
        most=1,
        help="Which decision judges an epoch: 0, the one on this epoch; 1, that on the one before.",
    )
    quiet_epochs: int | None = setting(
        default=None,
        least=0,
        help="Epochs after it is switched on in which it does not decide: statistic 0 and all "
        "weights 1, as an agent of the duel in the monitored warm-up.  By default it decides at "
        "once; only a pool of the duel then takes its own warm-up.",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.policy, DetectorPolicy):
            raise TypeError(f"`policy` must be a DetectorPolicy, got {self.policy!r}")

    def identity(self) -> dict[str, Any]:
        """Settings to which its calibration belongs: all but the threshold."""
        digest = self.policy.digest()
        if digest is None:
            raise ValueError(
                f"{self.policy!r} has no digest to look its calibration up by: give a "
                "FunctionPolicy a `name`, or override `digest`"
            )
        own = ("statistic", "weighs", "exclusion_s", "decision_delay")
        settings = {name: getattr(self, name) for name in own}
        if self.terms is not None:
            settings["terms"] = written_terms(self.terms)
        return {"name": "policy", "policy": digest, "quiet_epochs": self.quiet, **settings}

    @property
    def quiet(self) -> int:
        return self.quiet_epochs or 0

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self.silent_epochs = self.quiet
        self.memory.declare("judged", np.zeros(context.receivers, dtype=np.int64))

    def _bound_parts(self, context: DetectorContext) -> list[Memory]:
        parts, observer = super()._bound_parts(context), self.observer
        low, high = (tuple(side.tolist()) for side in (observer.low, observer.high))
        sizes = context.receivers, context.epoch_interval_s
        self.policy.bind(PolicyContext(*sizes, observer.names, low, high, self.action_names))
        return [*parts, self.policy.memory]

    def judge(self, epoch: Epoch) -> Verdict:
        if self.decision_delay:
            action = self.policy.decide(self.memory["observation"])
        self.look(epoch)
        if not self.decision_delay:
            action = self.policy.decide(self.memory["observation"])
        quiet = self.memory["judged"] < self.quiet
        self.memory["judged"] = self.memory["judged"] + 1
        if quiet.any():
            self.policy.reset(quiet)
            action = np.array(action)
            action[quiet, : self._columns], action[quiet, self._columns :] = -1.0, 1.0
        threshold = np.full(len(quiet), float(self.threshold))
        return self.verdict(action, threshold, epoch.visible, epoch.interval)


FILE_SETTINGS = ("quiet_epochs", "sha256")


@settings_record
class LearnedDetector(Detector):
    """Judges as the network in an ONNX file does: an alarm where its statistic exceeds a threshold.

    The statistic is within 0 and 1; the class has threshold 1, so that it never alarms.
    `make_detector` takes the threshold of the card, of a calibration, or ``"threshold"``.

    Attributes
    ----------
    card : DetectorCard
        What it observes and decides, its state and the threshold that it was given.
    label : str
        Name on the card.
    """

    file: str = setting(
        help="Path of the ONNX file, whose card has the same name and lies in the same folder; "
        "or the name of a shipped detector."
    )
    sha256: str | None = setting(
        default=None, help="Digest that the file must have; by default the card's."
    )
    quiet_epochs: int | None = setting(
        default=None,
        least=0,
        help="Epochs after it is switched on in which it does not decide; by default those of "
        "the card.  They are its `silent_epochs`.",
    )

    paper: ClassVar[str] = PolicyDetector.paper

    def __post_init__(self) -> None:
        self.file = os.fspath(self.file)
        policy = OnnxDetector(self.file, self.sha256)
        self.card: DetectorCard = policy.card  # type: ignore[misc]
        self.sha256 = self.card.file.sha256
        if self.quiet_epochs is None:
            self.quiet_epochs = self.card.quiet_epochs
        self.judge_by = PolicyDetector(
            statistic=self.card.statistic,
            weighs=self.card.weighs,
            exclusion_s=self.card.exclusion_s,
            terms=self.card.terms,
            policy=policy,
            decision_delay=self.card.decision_delay,
            quiet_epochs=self.quiet_epochs,
        )
        # these differ from file to file, so that they are the object's, not the class's
        self.label = self.card.name  # type: ignore[misc]
        self.scope, self.needs = self.judge_by.scope, self.judge_by.needs  # type: ignore[misc]
        self.from_start, self.needs_model = self.judge_by.from_start, self.judge_by.needs_model
        self.has_nominal = self.card.threshold is not None

    def identity(self) -> dict[str, Any]:
        return self.judge_by.identity()

    @property
    def spec(self) -> dict[str, Any]:
        quiet = self.judge_by.quiet_epochs
        further = {} if quiet == self.card.quiet_epochs else {"quiet_epochs": quiet}
        return {"name": self.file, **further}

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        if self.card.channels not in (None, context.channels):
            raise ValueError(
                f"the detector {self.label!r} ({self.file}) was made for {self.card.channels} "
                f"slots of satellites, and the receiver has {context.channels}"
            )
        self.judge_by.bind(context)
        self.memory = self.judge_by.memory
        self.silent_epochs = self.judge_by.silent_epochs

    def watch(self, epoch: Epoch) -> None:
        self.judge_by.watch(epoch)

    def judge(self, epoch: Epoch) -> Verdict:
        return self.judge_by.judge(epoch)


def load_detector(spec: Mapping[str, Any]) -> LearnedDetector:
    """Detector of an ONNX file; a request for thresholds is ignored."""
    settings = dict(spec)
    name = settings.pop("name")
    valid = ("threshold", *FILE_SETTINGS, *THRESHOLD_KEYS)
    unknown = [key for key in settings if key not in valid]
    if unknown:
        raise ValueError(
            f"the learned detector {name} has no setting {', '.join(map(repr, unknown))}; valid: "
            f"{', '.join(valid)}"
        )
    return LearnedDetector(name, **{key: settings[key] for key in FILE_SETTINGS if key in settings})


LOADERS[SUFFIX] = load_detector


def detector_card(
    agent: DetectorAgent,
    channels: int,
    file: str | os.PathLike[str],
    *,
    decision_delay: int = 0,
    state: Mapping[str, int] | None = None,
    training: Mapping[str, Any] | None = None,
    **fields: Any,
) -> DetectorCard:
    """Card of an ONNX file for what an agent observes and decides, not written yet. `state`: sizes
    by name; `fields`: others of the card."""
    content, where = Path(file).read_bytes(), os.fspath(file)
    card_path(file)
    observer = DetectorObserver(agent.observed_terms, channels)
    names = action_names(agent.statistic, agent.weighs, channels)
    states = tuple(State(name=key, size=size) for key, size in (state or {}).items())
    check_signature(read_model(content, where), len(observer.names), len(names), where, states)
    low, high = (tuple(side.tolist()) for side in (observer.low, observer.high))
    fields |= {"statistic": agent.statistic, "decision_delay": decision_delay}
    return DetectorCard(
        observation=Space(names=observer.names, low=low, high=high),
        action=Space(names=names, low=(-1.0,) * len(names), high=(1.0,) * len(names)),
        weighs=agent.weighs,
        exclusion_s=agent.exclusion_s,
        terms=written_terms(agent.observed_terms),
        state=states,
        channels=channels,
        training=dict(training or {}),
        file=describe_file(Path(file).name, content),
        **fields,
    )
