"""Picture of training records: ``python -m agents.curve RECORD... --out learning_curve.png``."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import typer

from spoofgym._files import write_file

from .record import Point, read_record

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
"""Okabe and Ito's, which colour-blind people tell apart."""
DRAWN = ("eval_undetected_m", "within_budget")
"""What every point must have, beside its step and time."""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


def draw_curves(records: dict[str, list[Point]], path: Path) -> None:
    """Draw what training reached over time, one column for each record.

    Parameters
    ----------
    records : dict
        Points of every record by its name, as `read_record` returns them.
    path : Path
        The picture, replaced.

    Raises
    ------
    ValueError
        When a record has no points, or one that was not evaluated.
    """
    for name, points in records.items():
        _check(name, points)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.6 * len(records), 5.4), layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(records), sharex="col", squeeze=False)
    for column, (name, points) in enumerate(records.items()):
        upper, lower = axes[:, column]
        _displacement(upper, points, COLOURS[column % len(COLOURS)])
        _alarms(lower, points)
        upper.set_title(name)
        lower.set_xlabel("training [min]")
    axes[0, 0].set_ylabel("undetected displacement [m]\nwithin the alarm budget")
    axes[1, 0].set_ylabel("alarm penalty [m]")
    axes[0, 0].legend(loc="lower right", fontsize="small")
    content = BytesIO()
    canvas.print_figure(content, dpi=110, format="png")
    write_file(path, content.getvalue())


def _check(name: str, points: list[Point]) -> None:
    """Raise where there is nothing to draw."""
    if not points:
        raise ValueError(f"the record of {name} has no points")
    for point in points:
        missing = [key for key in DRAWN if point.get(key) is None]
        if missing:
            raise ValueError(f"step {point['step']} in the record of {name} lacks {missing[0]!r}")


def names_of(paths: list[Path]) -> list[str]:
    """Short name of every record.

    Parameters
    ----------
    paths : list of Path
        Files; those of training runs are called ``record.jsonl``, in a folder with the name.

    Returns
    -------
    list of str
        All different: the whole path where a short name would stand for two.

    Raises
    ------
    ValueError
        When a record is given twice.
    """
    if len(set(paths)) < len(paths):
        twice = next(path for path in paths if paths.count(path) > 1)
        raise ValueError(f"{twice} is given twice")
    short = [path.stem if path.stem != "record" else path.resolve().parent.name for path in paths]
    return [
        name if short.count(name) == 1 else str(path)
        for name, path in zip(short, paths, strict=True)
    ]


def _minutes(points: list[Point]) -> list[float]:
    return [point["wall_s"] / 60.0 for point in points]


def _displacement(axes: Any, points: list[Point], colour: str) -> None:
    within = [point for point in points if point["within_budget"]]
    values = [point["eval_undetected_m"] for point in within]
    best = [max(values[: i + 1]) for i in range(len(values))]
    axes.step(_minutes(within), best, where="post", color=colour, label="best so far")
    axes.plot(_minutes(within), values, "o", color=colour, ms=4, alpha=0.5, label="evaluated")
    axes.margins(y=0.15)
    axes.grid(alpha=0.3)


def _alarms(axes: Any, points: list[Point]) -> None:
    told = [point for point in points if point.get("alarm_penalty_m") is not None]
    axes.plot(_minutes(told), [p["alarm_penalty_m"] for p in told], color="#777777", marker=".")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)


@app.command()
def main(
    records: Annotated[list[Path], typer.Argument(help="Training records, .jsonl files.")],
    out: Annotated[Path, typer.Option(help="The picture, a .png file.")],
) -> None:
    """Draw what training reached over time."""
    try:
        read = zip(names_of(records), records, strict=True)
        draw_curves({name: read_record(path) for name, path in read}, out)
    except (OSError, ValueError) as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(2) from error
    typer.echo(f"written: {out}")


if __name__ == "__main__":
    app()
