"""The card of a detector that has learned in a view of the duel."""

from __future__ import annotations

import os
from typing import Any

from ..detectors.learned import detector_card
from ..detectors.learned_card import DetectorCard, card_path
from .calibration import Calibration


def write_card(
    file: str | os.PathLike[str],
    view: Any,
    *,
    name: str,
    calibration: Calibration | None = None,
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
        Of this policy.
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
        quiet_epochs=setup.live,
        decision_delay=duel.decision_delay,
        threshold=None if calibration is None else calibration.threshold,
        calibration={} if calibration is None else vars(calibration),
        training=training,
    )
    card.save(card_path(file))
    return card
