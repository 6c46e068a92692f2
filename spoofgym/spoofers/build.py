"""Spoofers from specs, files and objects, and back; their cards."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..core.reading import name_file, read_json
from ..core.registry import Spec, build_spec, make
from ..policies.card import SPOOFER, SpooferCard
from ..policies.onnx_file import SUFFIX
from ..policies.zoo import list_shipped, load_card
from .base import Spoofer
from .feedback import Feedback, FeedbackProfile, ThresholdRider
from .learned import OnnxPolicy
from .profile import ActionCurves, OpenLoop, Profile
from .ramps import AcceleratingRamp, Dash, Intermittent, NoSpoofer, Ramp, Step
from .scaled import AMPLITUDE, Scaled, split_amplitude

SPOOFERS: dict[str, type[Spoofer]] = {
    "accelerating-ramp": AcceleratingRamp,
    "action-curves": ActionCurves,
    "open-loop": OpenLoop,
    "feedback": Feedback,
    "feedback-profile": FeedbackProfile,
    "dash": Dash,
    "intermittent": Intermittent,
    "none": NoSpoofer,
    "onnx-policy": OnnxPolicy,
    "profile": Profile,
    "ramp": Ramp,
    "step": Step,
    "threshold-rider": ThresholdRider,
}
"""Spoofers by name."""


CARD = "card"
"""In settings that a card was read for: the card."""
SpooferSpec = str | Mapping[str, Any] | Spoofer
"""What `make_spoofer` takes."""


def resolve_spec(spec: Any) -> Any:
    """Registered name and settings behind the name of a shipped spoofer or of an ONNX file; any
    other spec as it is."""
    settings = dict(spec) if isinstance(spec, Mapping) else {"name": spec}
    name = settings.pop("name", None)
    if not isinstance(name, str):
        return spec
    if name.endswith(SUFFIX):
        return {"name": "onnx-policy", "file": name, **settings}
    if name not in list_shipped(SPOOFER):
        return spec
    if settings:
        raise ValueError(
            f"the settings of the shipped spoofer {name!r} are fixed, got "
            f"{', '.join(map(repr, settings))}"
        )
    return spec_of_card(load_card(name, SpooferCard), name)


def spec_of_card(card: SpooferCard, file: str) -> Spec:
    """Registered name and settings behind a card; `file` is the policy, where it has one."""
    if card.file is None:
        return {"name": card.kind, **card.settings, "label": card.name}
    return {"name": card.kind, "file": file, "sha256": card.file.sha256}


def read_settings(spec: Any) -> Any:
    """Name and settings in a ``.json`` file, such as an audit writes, or behind the card that it
    is; any other spec as it is."""
    given = dict(spec) if isinstance(spec, Mapping) else {"name": spec}
    file = given.pop("name", None)
    if not isinstance(file, str) or not file.endswith(".json"):
        return spec
    found = read_json(file)
    if "side" in found:
        policy, card = f"{file.removesuffix('.json')}{SUFFIX}", SpooferCard.load(file)
        return {**spec_of_card(card, policy), CARD: card, **given}
    if "name" not in found:
        raise ValueError(f"{file} has no name and settings of a spoofer")
    return {**found, **given}


def make_spoofer(spec: SpooferSpec) -> Spoofer:
    """Spoofer by name, by name and settings, by file, or a copy of an object.

    Parameters
    ----------
    spec : str, mapping or Spoofer
        A name in `SPOOFERS`, of a shipped spoofer, or the path of an ``.onnx`` file with its card
        in the same folder, or of a ``.json`` file, a card or a name and settings;
        ``{"name": ..., "setting": value, ...}``; or a spoofer, which is copied.
        With a name, ``"amplitude"`` is a factor on all that it commands (`Scaled`).

    Returns
    -------
    Spoofer
        Not bound yet.

    Raises
    ------
    ValueError
        When the name or a setting is unknown, with the valid ones; or a file does not fit its card.
    TypeError
        When `spec` is something else.

    Examples
    --------
    >>> from spoofgym.spoofers import make_spoofer
    >>> make_spoofer({"name": "ramp", "rate_mps": 0.2})
    Ramp(heading_deg=90.0, rate_mps=0.2)
    """
    given, file = read_settings(spec), spec.get("name") if isinstance(spec, Mapping) else spec
    with name_file(None if given is spec else str(file)):
        plain, amplitude = split_amplitude(given)
        plain = resolve_spec(plain)
        card = plain.pop(CARD, None) if isinstance(plain, dict) else None
        made: Spoofer = make("spoofer", SPOOFERS, Spoofer, plain, list_shipped(SPOOFER))
    if card is not None:
        setattr(made, CARD, card)
    return made if amplitude is None else Scaled(made, amplitude)


def spec_of_spoofer(spoofer: Spoofer) -> Spec:
    """Name and all settings; a TypeError where it does not keep them under their names."""
    if isinstance(spoofer, Scaled):
        return {**spec_of_spoofer(spoofer.spoofer), AMPLITUDE: spoofer.amplitude}
    return build_spec("spoofer", SPOOFERS, spoofer)


def card_behind(spoofer: Spoofer) -> SpooferCard | None:
    """Card of a policy, or of the shipped profile that this is; None of any other spoofer."""
    card, name = getattr(spoofer, "card", None), spoofer.label
    if isinstance(card, SpooferCard):
        return card
    inner = spoofer.spoofer if isinstance(spoofer, Scaled) else spoofer
    if name not in list_shipped(SPOOFER):
        return None
    if spec_of_spoofer(inner) != spec_of_spoofer(make_spoofer(name)):
        return None
    return load_card(name, SpooferCard)
