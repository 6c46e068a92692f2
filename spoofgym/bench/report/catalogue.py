"""What there is to choose from, by kind, and cards of policies, to be read by people."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

from ...attacks import ATTACKS
from ...core.declared import list_declarations
from ...core.registry import inspect_settings
from ...core.settings import describe
from ...detectors import DETECTORS
from ...envs.factory import VICTIMS, list_parameters
from ...policies import Card, DetectorCard, SpooferCard, list_shipped, load_card
from ...policies.card import DETECTOR, SPOOFER
from ...policies.load import load_policy
from ...policies.onnx_file import SUFFIX
from ...simulation.setup import Setup
from ...spoofers import SPOOFERS
from ...tasks import DETECTOR_TASKS, TASKS
from ...truth.scenario import SCENARIOS
from .table import Table, share, yes_no


def get_summary(thing: Any) -> str:
    """First sentence of a docstring."""
    text = inspect.getdoc(thing) or ""
    paragraph = " ".join(text.split("\n\n")[0].split())
    return paragraph.split(". ")[0].rstrip(".") if paragraph else ""


def _classes(kinds: Mapping[str, type[Any]], *more: str) -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "summary": get_summary(kind),
            "settings": _defaults(kind),
            **{key: getattr(kind, key) for key in more},
        }
        for name, kind in sorted(kinds.items())
    ]


def _defaults(kind: Callable[..., Any], setup: type[Setup] | None = None) -> dict[str, Any]:
    """Defaults of a class; `setup`: of an environment with a victim that is not its default one."""
    found = inspect_settings(kind)
    if setup is not None:
        own = {key: each.default for key, each in list_parameters(setup).items()}
        found = {"render_mode": found["render_mode"], **own}
    empty = inspect.Parameter.empty
    return {key: describe(value) for key, value in found.items() if value is not empty}


def _scenarios() -> list[dict[str, Any]]:
    shown = ("flight", "errors", "imu", "epoch_interval_s", "channels", "mask_deg")
    return [
        {
            "name": name,
            "summary": f"flight {made.flight}, errors {made.errors}, {made.imu} inertial sensors",
            "settings": {key: getattr(made, key) for key in shown},
        }
        for name, made in ((name, build()) for name, build in SCENARIOS.items())
    ]


def _envs() -> list[dict[str, Any]]:
    import gymnasium
    from gymnasium.envs.registration import load_env_creator

    rows: list[dict[str, Any]] = []
    titles = {each.env_id: f"task {key}: {each.title}" for key, each in TASKS.items()}
    titles |= {each.env_id: f"task {key}: {each.title}" for key, each in DETECTOR_TASKS.items()}
    for name, spec in sorted(gymnasium.registry.items()):
        if spec.namespace != "spoofgym":
            continue
        entry = spec.entry_point
        creator = load_env_creator(entry) if isinstance(entry, str) else entry
        assert creator is not None  # of ours, each has one
        victim = spec.kwargs.get("victim")
        task = titles.get(spec.id)
        setup = None if victim is None else VICTIMS[victim]
        rows.append(
            {
                "name": name,
                "summary": task or get_summary(setup or creator),
                "settings": {**_defaults(creator, setup), **describe(spec.kwargs)},
            }
        )
    return rows


def _list_shipped() -> list[dict[str, Any]]:
    cards = [load_card(name, SpooferCard) for name in list_shipped(SPOOFER)]
    spoofers = [
        {
            "name": card.name,
            "summary": "learned policy" if card.kind == "onnx-policy" else "optimised profile",
            "kind": card.kind,
            "knowledge": card.knowledge.run_time,
            "designed_on": card.knowledge.design_time,
            "scores": [score.model_dump() for score in card.scores],
        }
        for card in cards
    ]
    detectors = [
        {
            "name": card.name,
            "summary": "learned detector",
            "kind": card.kind,
            "knowledge": ", ".join(str(term["name"]) for term in card.terms or ()),
            "designed_on": f"attacks in {card.training['task']}",
            "scores": [],
        }
        for card in (load_card(name, DetectorCard) for name in list_shipped(DETECTOR))
    ]
    return [*spoofers, *detectors]


KINDS: dict[str, Callable[[], list[dict[str, Any]]]] = {
    "envs": _envs,
    "scenarios": _scenarios,
    "attacks": lambda: _classes(ATTACKS),
    "detectors": lambda: _classes(DETECTORS, "paper", "scope", "measures", "oracle"),
    "spoofers": lambda: _classes(SPOOFERS, "knowledge", "tunable"),
    "shipped": _list_shipped,
}
"""Lists by kind; each row has a name, a summary, and settings with their defaults or what its
card says."""


def _mark_summary(row: Mapping[str, Any]) -> str:
    """Summary, with a mark where a detector knows the truth or judges no satellites."""
    marks = []
    if row.get("oracle"):
        marks.append("oracle, knows what no receiver does")
    if row.get("measures", "satellites") != "satellites":
        marks.append("for positions" if row["measures"] == "position" else "for any measurement")
    return f"{row['summary']} [{'; '.join(marks)}]" if marks else str(row["summary"])


NOTES = {
    "scenarios": "The detector of spoofgym/Zhong2025-v0, ewma, has shipped thresholds in zhong2025 "
    "alone. In another scenario give --detector never or --nominal, or run `spoofgym calibrate "
    "--scenario NAME --detector ewma` first."
}
"""What is said below a table."""
LONGEST = 14
"""Characters of a default that a table of names shows; `spoofgym list NAME` has all."""


def _shorten_settings(row: Mapping[str, Any]) -> str:
    pairs = ((key, f"{key}={value}", str(value)) for key, value in row["settings"].items())
    return ", ".join(pair if len(value) <= LONGEST else key for key, pair, value in pairs)


NAMED = Table(("name", "name"), ("what it is", _mark_summary), ("settings", _shorten_settings))
ENVS = Table(("name", "name"), ("what it is (settings: spoofgym list NAME)", "summary"))
SHIPPED = Table(
    ("name", "name"),
    ("what it is", "summary"),
    ("knows at run time", "knowledge"),
    ("was designed on", "designed_on"),
    ("reached", lambda row: "; ".join(map(score_text, row["scores"])) or "-"),
)


CLASSES: dict[str, Mapping[str, type[Any]]] = {
    "attacks": ATTACKS,
    "detectors": DETECTORS,
    "spoofers": SPOOFERS,
}
"""Kinds whose settings are declared by classes."""
SETTINGS = Table(
    ("setting", "name"),
    ("default", lambda row: "needed" if row["needed"] else str(row["default"])),
    ("unit", "unit"),
    ("valid", "valid"),
    ("what it means", "help"),
)


def list_settings(kind: str, name: str) -> list[dict[str, Any]]:
    """Rows of `SETTINGS`, as the class of a registered name declares them."""
    record = CLASSES[kind][name]
    defaults, empty = inspect_settings(record), inspect.Parameter.empty
    return [
        {
            "name": key,
            "needed": defaults[key] is empty,
            "default": None if defaults[key] is empty else describe(defaults[key]),
            "unit": declared.unit,
            "valid": declared.valid(annotation),
            "help": declared.help,
        }
        for key, (declared, annotation) in list_declarations(record).items()
        if key in defaults
    ]


def select_table(kind: str) -> Table:
    return {"shipped": SHIPPED, "envs": ENVS}.get(kind, NAMED)


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
