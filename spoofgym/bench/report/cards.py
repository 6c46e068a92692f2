"""Cards of spoofers and of learned detectors, to be read by people."""

from __future__ import annotations

import json
from operator import attrgetter
from pathlib import Path
from typing import Any

from ...policies import Card, DetectorCard, SpooferCard, load_card
from ...policies.load import load_policy
from ...policies.onnx_file import SUFFIX
from .table import Table, share, yes_no

SCORES = Table(
    ("detector", attrgetter("detector")),
    ("runs, counted", lambda x: str(x.runs) if x.counted is None else f"{x.runs}, {x.counted}"),
    ("split, entropy", lambda x: f"{x.split}, {x.entropy}"),
    (
        "undetected displacement [m]",
        lambda x: f"{x.undetected_displacement_m:.1f} ({x.low:.1f} to {x.high:.1f})",
    ),
    ("alarm rate [%]", attrgetter("alarm_rate"), share(1)),
    ("without attack [%]", attrgetter("clean_alarm_rate"), share(1)),
    ("budget [%]", lambda x: f"{100 * x.budget:g}"),
)
SHOWN = 60  # letters of a long list or text that are shown


def find_card(name: str) -> Card:
    """Card by the name of a shipped spoofer or detector, or by a file, which has to fit it."""
    path = Path(name)
    if path.suffix == SUFFIX:  # which has to fit its card
        return load_policy(name, Card)[0]
    return Card.load(path) if path.suffix == ".json" else load_card(name)


def score_text(score: dict[str, Any]) -> str:
    mean, low, high = (score[key] for key in ("undetected_displacement_m", "low", "high"))
    rate, clean = 100.0 * score["alarm_rate"], 100.0 * score["clean_alarm_rate"]
    return (
        f"{score['detector']}: {mean:.1f} m ({low:.1f} to {high:.1f}), alarms {rate:.1f} % "
        f"(clean {clean:.1f} %)"
    )


def card_rows(card: Card) -> list[tuple[str, str]]:
    """What is on a card but its scores, field by field."""
    if isinstance(card, SpooferCard):
        rows = _spoofer_rows(card)
    else:
        assert isinstance(card, DetectorCard)
        rows = _detector_rows(card)
    if card.file is None:
        return rows
    file = card.file
    about = f"{file.name}, {file.bytes} bytes, opset {file.opset}"
    return [*rows, ("file", about), ("sha256", file.sha256)]


def _detector_rows(card: DetectorCard) -> list[tuple[str, str]]:
    each = {"receiver": "one for the receiver", "channel": "one for every slot"}
    terms = "those of the duel"
    if card.terms is not None:
        terms = _cut(", ".join(str(term["name"]) for term in card.terms))
    memory = ", ".join(f"{state.name} ({state.size})" for state in card.state)
    interval = "any length" if card.interval_s is None else f"{card.interval_s:g} s"
    threshold = "none on the card: `spoofgym calibrate` finds one in a world"
    return [
        ("kind", card.kind),
        ("observes", _names(card.observation.names)),
        ("terms", terms),
        ("statistic", each[card.statistic]),
        ("weighs satellites", yes_no(card.weighs)),
        ("remembers", memory or "nothing"),
        ("made for", f"{card.channels or 'any number of'} slots, epochs of {interval}"),
        ("threshold", threshold if card.threshold is None else f"{card.threshold:g}"),
        *_settings("calibration", card.calibration),
        *_settings("training", card.training),
    ]


def _spoofer_rows(card: SpooferCard) -> list[tuple[str, str]]:
    conditions = card.conditions
    limits = f"{conditions.rate_limit_mps:g} m/s"
    if conditions.control != "rate":
        limits = f"{conditions.acceleration_limit_mps2:g} m/s^2 and {limits}"
    return [
        ("kind", card.kind),
        ("knows at run time", card.knowledge.run_time),
        ("was designed on", card.knowledge.design_time),
        ("environment", card.env_id),
        *_settings("with", card.env_kwargs),
        ("observes", "nothing" if card.observation is None else _names(card.observation.names)),
        ("commands", _names(card.action.names)),
        (
            "attack",
            f"{conditions.steps} commands, one every {conditions.interval_s:g} s, by "
            f"{conditions.control}; limits {limits}",
        ),
        *_settings("setting", card.settings),
        *_settings("training", card.training),
        *_settings("version", card.versions),
        ("compared with", f"{len(card.rivals)} rivals, whose tuning `--json` shows"),
    ]


def _names(names: tuple[str, ...]) -> str:
    """How many, and the first ones."""
    return f"{len(names)}: {_cut(', '.join(names))}"


def _settings(word: str, settings: dict[str, Any]) -> list[tuple[str, str]]:
    rows = []
    for key, value in settings.items():
        text = value if isinstance(value, str) else json.dumps(value)
        rows.append((f"{word} {key}", text if key == "command" else _cut(text)))
    return rows


def _cut(text: str) -> str:
    return text if len(text) <= SHOWN else f"{text[:SHOWN].rstrip(', ')} ..."
