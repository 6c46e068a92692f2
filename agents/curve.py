"""Picture of training records: ``python -m agents.curve RECORD... --out learning_curve.png``."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from spoofgym.cli import clear_errors
from spoofgym.core.plots import COLOURS, GREY, figure_class, save_figure, style

from .record import Point, read_record

DRAWN = ("stealthy_m", "within_budget")
"""What every point must have, beside its step."""

NEAR = 0.03
"""Part of the height within which two levels share a text."""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


def draw_curves(
    records: dict[str, list[Point]], path: Path, levels: Mapping[str, float] | None = None
) -> None:
    """Draw what trainings reached over their steps, a line for each, and the median of all.
    `levels`: displacements to compare with, by the names of who reached them [m]."""
    for name, points in records.items():
        _check(name, points)
    figure = figure_class()(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.subplots()
    style(axes)
    reached, most = [], max(point["step"] for points in records.values() for point in points)
    unit, word = (1e6, "million") if most >= 1e6 else (1e3, "thousand")
    for (name, points), colour in zip(records.items(), cycle(COLOURS), strict=False):
        steps = [point["step"] / unit for point in points]
        moved = [point["stealthy_m"] if point["within_budget"] else 0.0 for point in points]
        reached.append((steps, moved))
        axes.plot(steps, moved, ".-", color=colour, lw=1.0, alpha=0.7, label=name)
    if len(reached) > 1 and all(steps == reached[0][0] for steps, _ in reached):
        middle = np.median([moved for _, moved in reached], axis=0)
        axes.plot(reached[0][0], middle, color="black", lw=2.0, label="median")
    for level in (levels or {}).values():
        axes.axhline(level, color=GREY, ls="--", lw=1.0)
    axes.set(xlabel=f"steps [{word}]", ylabel="stealthy displacement on training runs [m]")
    axes.set_ylim(bottom=0.0)
    for names, level in _group_levels(levels or {}, NEAR * axes.get_ylim()[1]):
        axes.annotate(
            names,
            (0.0, level),
            xytext=(3, 3),
            textcoords="offset points",
            fontsize=8,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
        )
    figure.legend(
        fontsize="small",
        ncols=min(len(axes.get_legend_handles_labels()[0]), 6),
        loc="outside lower center",
    )
    save_figure(figure, path, dpi=110)


def _group_levels(levels: Mapping[str, float], near: float) -> list[tuple[str, float]]:
    """Names of levels that lie so near each other that their texts would overlap, as one text."""
    found: list[tuple[str, float]] = []
    for name, level in sorted(levels.items(), key=lambda each: each[1]):
        if found and level - found[-1][1] < near:
            names, _ = found.pop()
            found.append((f"{names}, {name}", level))
        else:
            found.append((name, level))
    return found


def _check(name: str, points: list[Point]) -> None:
    if not points:
        raise ValueError(f"the record of {name} has no points")
    for point in points:
        missing = [key for key in DRAWN if point.get(key) is None]
        if missing:
            raise ValueError(f"step {point['step']} in the record of {name} lacks {missing[0]!r}")


def name_records(paths: list[Path]) -> list[str]:
    """Short name of every record, of the folder where it is called ``record.jsonl``; the whole path
    where that would stand for two."""
    if len(set(paths)) < len(paths):
        twice = next(path for path in paths if paths.count(path) > 1)
        raise ValueError(f"{twice} is given twice")
    short = [path.stem if path.stem != "record" else path.resolve().parent.name for path in paths]
    return [
        name if short.count(name) == 1 else str(path)
        for name, path in zip(short, paths, strict=True)
    ]


@app.command()
@clear_errors
def main(
    records: Annotated[list[Path], typer.Argument(help="Training records, .jsonl files.")],
    out: Annotated[Path, typer.Option(help="The picture, a .png file.")],
) -> None:
    """Draw what training reached over time."""
    read = zip(name_records(records), records, strict=True)
    draw_curves({name: read_record(path) for name, path in read}, out)
    typer.echo(f"written: {out}")


if __name__ == "__main__":
    app()
