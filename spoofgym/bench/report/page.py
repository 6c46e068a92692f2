"""A report as one HTML file that loads nothing.

Verdict in words, drawings, tables, replay of a run, what was run, terms, and all scores as JSON.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.reading import read_json
from ...simulation.simulator import SkyData
from ..experiments.store import REPLAY, REPORT, SUMMARY, Store
from ..runs.episode import ATTACKED, TWIN, Episode
from .figures import CURVES_IN, Draw, render_svg
from .table import TEMPLATES, Table, render_template

MOST_BYTES = 1_900_000
"""Size beyond which the scores are not part of the page."""
INSTANTS = 400
"""Instants of a replay, at most; one in ten of them has its satellites."""


class Picture(NamedTuple):
    """A drawing with what it shows in words."""

    title: str
    caption: str
    draw: Draw
    height_in: float = CURVES_IN


class Sheet(NamedTuple):
    """A table of a page; `folded`: whether it is closed at first."""

    title: str
    table: Table
    rows: Sequence[Any]
    note: str = ""
    folded: bool = False


@dataclass(frozen=True)
class Page:
    """What a report shows, in this order; paragraphs of the verdict may have a head."""

    title: str
    verdict: Sequence[str | tuple[str, ...]]
    missing: Sequence[str] = ()
    pictures: Sequence[Picture] = ()
    sheets: Sequence[Sheet] = ()
    notes: Sequence[str] = ()
    replay: Mapping[str, Any] | None = None
    played: Sequence[tuple[str, Any]] = ()
    scores: Any = None


def render_page(page: Page) -> str:
    """HTML of a page; its bytes depend on the page alone."""
    why, svgs = "", []
    try:
        svgs = [render_svg(each.draw, each.height_in) for each in page.pictures]
    except ImportError as error:
        why = f"No drawings: {error}."
    values = {"page": page, "svgs": svgs, "why": why, "scores": None}
    text = render_template("report.html.j2", {**values, "terms": {}})
    values["terms"] = {
        term: what
        for term, what in load_terms().items()
        if re.search(rf"(?i)\b{re.escape(term)}", text)
    }
    whole = render_template("report.html.j2", {**values, "scores": page.scores})
    if len(whole.encode()) < MOST_BYTES:
        return whole
    return render_template("report.html.j2", values)


def write_page(store: Store, page: Page) -> list[Path]:
    """Write a report, and its scores if any, into an experiment's folder; returns the files."""
    written = []
    if page.scores is not None:
        scores = json.dumps(page.scores, indent=1, allow_nan=False) + "\n"
        written.append(store.write(SUMMARY, scores.encode()))
    return [*written, store.write(REPORT, render_page(page).encode())]


@cache
def load_terms() -> dict[str, str]:
    """What terms of the reports mean."""
    found: dict[str, str] = json.loads((TEMPLATES / "terms.json").read_bytes())
    return found


def list_played_settings(store: Store) -> list[tuple[str, Any]]:
    """What was run: versions and digest of the code, and all settings."""
    config = dict(store.config)
    return [("code", config["code"]), *config["config"].items()]


def load_replay(store: Store) -> dict[str, Any] | None:
    """Run that a folder has to show, if any."""
    return load_output(store, REPLAY)


def load_output(store: Store, name: str = SUMMARY) -> dict[str, Any] | None:
    """What is written beside the cells, by default the scores; None where it is not there."""
    path = store.path / name
    return read_json(path) if path.is_file() else None


def store_replay(store: Store, replay: Mapping[str, Any]) -> None:
    store.write(REPLAY, json.dumps(replay, allow_nan=False).encode())


def record_replay(episode: Episode, limit_m: float) -> dict[str, Any]:
    """What a page shows of a run, by instant from the onset on, JSON-able; `age_s`: how long the
    detector had been on by then."""
    setup, count, first = episode.setup, len(episode.error_n), episode.first_alarm
    rows = sorted({*range(0, count, max(-(-count // INSTANTS), 1)), count - 1, max(first - 1, 0)})
    ratio, frames = episode.ratio[episode.onset :], [episode.frames[k] for k in rows]

    def show(x: NDArray[Any], digits: int = 2) -> list[Any]:
        return [*np.round(np.nan_to_num(x[rows]), digits).tolist()]

    return {
        "title": f"{episode.spoofer.label} against {episode.detector.label}, run {episode.run}",
        "detector": episode.detector.label,
        "age_s": (episode.onset + setup.filter_only) * setup.interval_s,
        "attack_s": setup.steps * setup.interval_s,
        "limit_m": limit_m,
        "alarm_s": first * setup.interval_s if first else None,
        "undetected_m": episode.summary()["undetected_displacement_m"],
        "time": show(episode.time[episode.onset :]),
        "north": [round(float(frame.position_ne[0]), 1) for frame in frames],
        "east": [round(float(frame.position_ne[1]), 1) for frame in frames],
        "off": show(episode.error_n[:, ATTACKED, :2]),
        "error": show(episode.induced_error_m),
        "ratio": show(ratio[:, ATTACKED], 3),
        "twin": show(ratio[:, TWIN], 3),
        "sky": [None if x.sky is None else _record_sky(x.sky) for x in frames[::10]],
    }


def _record_sky(sky: SkyData) -> list[tuple[str, float, float, int]]:
    """Name, azimuth and elevation [deg] of the satellites in view, and 2 for an excluded one, 1 for
    a spoofed one."""
    degrees = (np.degrees(each).round(1).tolist() for each in (sky.azimuth, sky.elevation))
    state = np.where(sky.weight <= 0.0, 2, sky.spoofed.astype(int)).tolist()
    rows = zip(sky.names, *degrees, state, strict=True)
    return [row for row, seen in zip(rows, sky.visible, strict=True) if seen]
