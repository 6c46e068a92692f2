"""A detector by file: the policy in an ONNX file, with what its card declares."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from ..._registry import is_number
from ...policies.card import Space, State
from ...policies.onnx_file import check_signature, file_of, read_model
from ...receiver.epoch import Epoch
from ..asked import ASKED, Asked, with_thresholds
from ..base import Detector, DetectorContext, Verdict
from ..calibrated import Calibrated
from .agent import DetectorAgent, PolicyDetector, action_names
from .card import DetectorCard, OnnxDetector, card_path
from .observer import DetectorObserver, written_terms

OWN = ("quiet_epochs", "sha256")
"""Settings of a detector in a file besides its name and thresholds."""


@dataclass
class LearnedDetector(Detector):
    """Judges as the network in an ONNX file does; its statistic is within 0 and 1, its threshold 1.

    Parameters
    ----------
    file : str or path-like
        Path of the ONNX file, whose card has the same name and lies in the same folder; or the name
        of a shipped detector.
    sha256 : str, optional
        Digest that the file must have; by default the card's.
    quiet_epochs : int, optional
        Epochs after it is switched on in which it is not asked; by default those of the card.

    Attributes
    ----------
    card : DetectorCard
        What it observes and decides, its state and the threshold that it was given.
    label : str
        Name on the card.

    Raises
    ------
    ValueError
        When file or card are missing, damaged, or don't fit each other.
    """

    described_as = "LearnedDetector"
    file: str
    sha256: str | None = None
    quiet_epochs: int | None = None

    paper: ClassVar[str] = PolicyDetector.paper

    def __post_init__(self) -> None:
        self.file = os.fspath(self.file)
        policy = OnnxDetector(self.file, self.sha256)
        self.card, self.sha256 = policy.card, policy.card.file.sha256
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
        self.has_nominal = self.card.threshold is not None

    def identity(self) -> dict[str, Any]:
        """What its calibration belongs to: the content of the file, and settings, not its path."""
        return self.judge_by.identity()

    @property
    def spec(self) -> dict[str, Any]:
        """Name and settings, from which `make_detector` makes an equal one."""
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

    def judge(self, epoch: Epoch) -> Verdict:
        return self.judge_by.judge(epoch)


def unscaled(spec: Any) -> LearnedDetector:
    """Detector of an ONNX file, by its name or a dict, without what is asked of its thresholds."""
    settings: dict[str, Any] = dict(spec) if isinstance(spec, Mapping) else {"name": spec}
    name = settings.pop("name")
    valid = ("threshold", *OWN, *ASKED)
    unknown = [key for key in settings if key not in valid]
    if unknown:
        raise ValueError(
            f"the learned detector {name} has no setting {', '.join(map(repr, unknown))}; valid: "
            f"{', '.join(valid)}"
        )
    return LearnedDetector(name, **{key: settings[key] for key in OWN if key in settings})


def of_file(plain: Mapping[str, Any], asked: Asked) -> Detector:
    """Detector of an ONNX file with the thresholds that are asked for. `plain`: its name and
    settings. Its own threshold is 1, so that a factor on it is a threshold; the nominal one is that
    of the card."""
    made, name, own = unscaled(plain), plain["name"], plain.get("threshold")
    nominal = asked in (Asked(), Asked(thresholds="nominal"))
    if own is not None:
        if not (is_number(own) and 0.0 < own <= 1.0):
            raise ValueError(f"`threshold` must be a number in (0, 1], got {own!r}")
        if not nominal:
            raise ValueError(
                f"detector {name!r} is given a `threshold` of its own, and asked for another one: "
                "leave out one"
            )
        return Calibrated(made, scale=float(own))
    if not nominal:
        return with_thresholds(made, asked)
    if made.card.threshold is not None:
        return Calibrated(made, scale=made.card.threshold)
    raise ValueError(
        f"{name} has no threshold on its card: ask for `false_alarms_per_hour`, which "
        "`spoofgym calibrate` finds a threshold for, or give one as `threshold`"
    )


def detector_card(
    agent: DetectorAgent,
    channels: int,
    file: str | os.PathLike[str],
    *,
    name: str,
    interval_s: float,
    quiet_epochs: int,
    decision_delay: int = 0,
    state: Mapping[str, int] | None = None,
    threshold: float | None = None,
    calibration: Mapping[str, Any] | None = None,
    training: Mapping[str, Any] | None = None,
) -> DetectorCard:
    """Card of an ONNX file for what an agent observes and decides; not written yet. `state`: size
    of each by name."""
    content, where = Path(file).read_bytes(), os.fspath(file)
    card_path(file)
    observer = DetectorObserver(agent.observed, channels)
    names = action_names(agent.statistic, agent.weighs, channels)
    states = tuple(State(name=key, size=size) for key, size in (state or {}).items())
    check_signature(read_model(content, where), len(observer.names), len(names), where, states)
    low, high = (tuple(side.tolist()) for side in (observer.low, observer.high))
    fields: dict[str, Any] = {
        "statistic": agent.statistic,
        "weighs": agent.weighs,
        "exclusion_s": agent.exclusion_s,
        "decision_delay": decision_delay,
    }
    return DetectorCard(
        name=name,
        observation=Space(names=observer.names, low=low, high=high),
        action=Space(names=names, low=(-1.0,) * len(names), high=(1.0,) * len(names)),
        terms=written_terms(agent.observed),
        state=states,
        quiet_epochs=quiet_epochs,
        channels=channels,
        interval_s=interval_s,
        threshold=threshold,
        calibration=dict(calibration or {}),
        training=dict(training or {}),
        file=file_of(Path(file).name, content),
        **fields,
    )
