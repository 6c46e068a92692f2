"""Learned detectors, from a torch module to a file with its card."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .._files import write_file
from ..detectors.learned.agent import DetectorAgent, action_names
from ..detectors.learned.card import DetectorCard, OnnxDetector, card_path
from ..detectors.learned.detector import detector_card
from ..detectors.learned.observer import DetectorObserver
from ..policies.onnx_file import checked_path
from .asked import check_training, checked_states, one_line, trial_of
from .tracing import TOLERANCE, TRIED, evaluating, library_versions, traced

EPOCHS = 4
"""Epochs in a row on which a recurrent one is compared."""
CHANNELS = 12
"""Slots of a receiver by default."""


def detector(
    module: Any,
    path: str | Path,
    *,
    name: str | None = None,
    terms: Any = None,
    state: Mapping[str, int] | None = None,
    statistic: str = "receiver",
    weighs: bool = False,
    exclusion_s: float | None = None,
    quiet_epochs: int = 0,
    channels: int = CHANNELS,
    interval_s: float = 0.5,
    threshold: float | None = None,
    training: Mapping[str, Any] | None = None,
) -> DetectorCard:
    """Write a learned detector and its card, from a torch module with or without a state.

    Parameters
    ----------
    module : torch.nn.Module
        Of (B, o) observations, and (B, s) of each state in its order.  It returns (B, a) actions,
        which are cut to [-1, 1], and with states a tuple of actions and the next states.  The
        statistic is (a + 1) / 2, of the receiver or of every slot; with `weighs` the weights of the
        slots follow.
    path : str or Path
        ``.../NAME.onnx``; the card becomes ``.../NAME.json``.
    name : str, optional
        Of the detector; by default that of the file.
    terms : sequence, optional
        What it observes, in this order, as `make_detector_terms` takes it; by default what an agent
        of the duel does.
    state : mapping, optional
        Size of each state by name, such as ``{"hidden": 32}``; 0 at the start of an episode.
    statistic : {"receiver", "channel"}
        One statistic, or one for every slot.
    weighs : bool
        Whether it weighs satellites in the filter; by default it is passive.
    exclusion_s : float, optional
        Allowance of exclusion in an episode [s]; none by default.
    quiet_epochs : int
        Epochs after it is switched on in which it is not asked.
    channels : int
        Slots of the receiver.
    interval_s : float
        Time between epochs that it was trained on [s].
    threshold : float, optional
        Of the statistic, in (0, 1]; by default none, and worlds look theirs up by a rate of false
        alarms, which ``spoofgym calibrate --detector NAME.onnx`` finds.
    training : mapping, optional
        How it was made, JSON-able; ``"decided_on"`` as in `onnx`.

    Returns
    -------
    DetectorCard
        As it was written.

    Raises
    ------
    TypeError
        When `module` is no torch module.
    ValueError
        When it does not take or return what it should, or the file does not act as the module
        does; nothing is written then.
    """
    path = checked_path(path)
    if not isinstance(module, torch.nn.Module):
        raise TypeError(f"`module` must be a torch module, got {type(module).__name__}")
    states = checked_states(state)
    check_training(training, path.stem)
    agent = DetectorAgent(statistic, weighs, exclusion_s, terms=terms)
    observer = DetectorObserver(agent.observed, channels)
    size = len(observer.names)
    judge = _Judge(module)
    with evaluating(judge):
        _check_states(judge, size, len(action_names(statistic, weighs, channels)), states)
        content = traced(judge, size, states)
        with trial_of(path) as trial:
            trial.write_bytes(content)
            with one_line(f"card of {path}"):
                card = detector_card(
                    agent,
                    channels,
                    trial,
                    name=path.stem if name is None else name,
                    interval_s=interval_s,
                    quiet_epochs=quiet_epochs,
                    state=states,
                    threshold=threshold,
                    training={"versions": library_versions(), **(training or {})},
                )
            card.save(card_path(trial))
            _compare_sequences(judge, OnnxDetector(trial), observer)
    write_file(path, content)
    card.save(card_path(path))
    return card


class _Judge(torch.nn.Module):
    """A module whose actions are cut, with its states side by side."""

    def __init__(self, module: torch.nn.Module) -> None:
        super().__init__()
        self.module = module

    def forward(self, observation: torch.Tensor, *states: torch.Tensor) -> Any:
        if not states:
            return torch.clamp(self.module(observation), -1.0, 1.0)
        action, *after = self.module(observation, *states)
        return (torch.clamp(action, -1.0, 1.0), *after)


def _check_states(judge: _Judge, observed: int, decided: int, states: Mapping[str, int]) -> None:
    """Raise unless a module takes observations and states, and returns actions and states."""
    given = [torch.zeros(2, size) for size in (observed, *states.values())]
    form = ", ".join(f"(B, {size})" for size in (observed, *states.values()))
    wanted = ", ".join(f"(B, {size})" for size in (decided, *states.values()))
    try:
        with torch.no_grad():
            found = judge(*given)
    except (RuntimeError, TypeError, ValueError) as error:
        first = str(error).strip().partition("\n")[0]
        raise ValueError(
            f"the module can't be run with {form}, to return {wanted}: {first}"
        ) from error
    parts = list(found) if states else [found]
    shapes = [tuple(getattr(part, "shape", ())) for part in parts]
    if shapes != [(2, size) for size in (decided, *states.values())]:
        raise ValueError(
            f"the module must return {wanted}, of action and states, got "
            f"{', '.join(map(str, shapes))} for a batch of 2"
        )


def _compare_sequences(judge: _Judge, policy: OnnxDetector, observer: DetectorObserver) -> None:
    """Raise unless a file acts as its module over some epochs in a row."""
    rng = np.random.default_rng(0)
    states = [np.zeros((TRIED, each.size), np.float32) for each in policy.card.state]
    for k in range(EPOCHS):
        drawn = rng.uniform(observer.low, observer.high, (TRIED, len(observer.low)))
        seen = ((0.1 if k % 2 else 1.0) * drawn).astype(np.float32)
        with torch.no_grad():
            found = judge(*(torch.from_numpy(array) for array in (seen, *states)))
        wanted = [part.numpy() for part in (found if states else (found,))]
        action, states = policy.model.step(seen, states)
        for what, mine, theirs in zip(
            ("action", *(each.name for each in policy.card.state)),
            (action, *states),
            wanted,
            strict=True,
        ):
            apart = float((np.abs(mine - theirs) / np.maximum(np.abs(theirs), 1.0)).max())
            if not apart <= TOLERANCE:
                raise ValueError(
                    f"the exported file differs from the module by {apart:.2g} in {what}, more "
                    f"than {TOLERANCE:g}; does it draw random numbers, depend on the batch, or let "
                    "rounding grow, as weights of too large a learning rate do?"
                )
