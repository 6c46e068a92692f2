"""Draw `house.svg`, the packages of spoofgym by layers, from the layers in pyproject.toml.

    python docs/house.py

tests/docs/test_architecture.py fails where the picture is not what this draws.
"""

from __future__ import annotations

import tomllib
from html import escape
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOMS = {
    "cli": "the command line, one file per command",
    "sb3": "stable-baselines3",
    "export": "torch to ONNX",
    "testing": "checks of your own parts",
    "wrappers": "detectors as wrappers",
    "duel_v0": "the duel, for PettingZoo",
    "bench": "detectors x spoofers x paired seeds: runs, scores, searches, experiments, reports",
    "duel": "spoofer against detector, views of one side",
    "tasks": "S1 to S3, D1 to D3 and the first suite, frozen settings",
    "cuda": "the vector environment on a GPU, a thread per receiver",
    "envs": "what Gymnasium sees: one step path, terms, score, wrappers, pictures",
    "spoofers": "who decides what the attack does",
    "limits": "what no detector and no spoofer can beat",
    "calibration": "thresholds from clean runs, for a rate of false alarms",
    "simulation": "B receivers in step: predict, judge, update; warm-up, twins, threads",
    "detectors": "one algorithm or family per file: an Epoch in, a Verdict out",
    "policies": "a learned policy: contract, ONNX model, card",
    "attacks": "what a spoofer can do to measurements",
    "receiver": "the victim's filters and fixes",
    "data": "recorded flights and navigation files",
    "truth": "the authentic world: flights, sensors, clocks, satellites, noise",
    "earth": "ellipsoid, gravity, frames, ranges",
    "core": "no physics: names, settings, files, memory, threads, compiled code",
}
"""Every room, and what it is for in a few words."""
WIDTH, LEFT, FLOOR, GAP, ROOF = 860, 40, 34, 4, 74


def floors() -> list[list[str]]:
    """Packages from the top layer to the lowest."""
    with (DOCS.parent / "pyproject.toml").open("rb") as file:
        contracts = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    layers = next(each["layers"] for each in contracts if each.get("containers") == ["spoofgym"])
    rows = [[name.strip(" ()") for name in layer.split("|")] for layer in layers]
    return [row for row in rows if row != ["__main__"]]


def text(x: float, y: float, words: str, style: str) -> str:
    """One line, centred."""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="middle" class="{style}">{escape(words)}</text>'


def draw() -> str:
    """The picture as SVG."""
    rows = floors()
    height, middle = ROOF + len(rows) * (FLOOR + GAP) + 10, LEFT + (WIDTH - LEFT - 10) / 2
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        'font-family="sans-serif">',
        "<style>.name{font-weight:bold;font-size:14px}.what{font-size:12.5px}"
        "text{fill:#1b2733}</style>",
        f'<rect width="{WIDTH}" height="{height}" rx="6" fill="#ffffff"/>',
        f'<path d="M{LEFT} {ROOF - GAP} L{middle:g} 6 L{WIDTH - 10} {ROOF - GAP} Z" '
        'fill="#f3ddc4" stroke="#8a6a45"/>',
        text(middle, 42, "agents  baselines  train", "name"),
        text(middle, 60, "the laboratory, run from a checkout", "what"),
        f'<path d="M18 {ROOF + 4} V{height - 14} m-6 -10 l6 10 l6 -10" '
        'fill="none" stroke="#8a6a45" stroke-width="2"/>',
        f'<text transform="translate(34 {(ROOF + height) / 2:g}) rotate(-90)" '
        'text-anchor="middle" class="what">imports from below only</text>',
    ]
    for level, row in enumerate(rows):
        y = ROOF + level * (FLOOR + GAP)
        width = (WIDTH - LEFT - 10 - GAP * (len(row) - 1)) / len(row)
        for place, name in enumerate(row):
            x = LEFT + place * (width + GAP)
            parts.append(
                f'<rect x="{x:g}" y="{y}" width="{width:g}" height="{FLOOR}" rx="3" '
                'fill="#dcebf5" stroke="#5d7f99"/>'
            )
            if name not in ROOMS:
                raise SystemExit(f"{name} has no entry in ROOMS of {Path(__file__).name}: add one")
            line = f'<tspan class="name">{name}</tspan>&#160;&#160;{escape(ROOMS[name])}'
            parts.append(
                f'<text x="{x + width / 2:g}" y="{y + 22}" text-anchor="middle" '
                f'class="what">{line}</text>'
            )
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    (DOCS / "house.svg").write_text(draw())
