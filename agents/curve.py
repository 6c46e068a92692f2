"""Picture of training records: ``python -m agents.curve RECORD... --out learning_curve.png``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .record import Point, read_record

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
"""Okabe and Ito's, which colour-blind people tell apart."""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


def draw_curves(records: dict[str, list[Point]], path: Path) -> None:
    """Draw what training reached over time, one column for each record.

    Parameters
    ----------
    records : dict
        Points of every record by its name, as `read_record` returns them.
    path : Path
        The picture, replaced.
    """
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
    part = path.with_name(path.name + ".part")
    canvas.print_figure(part, dpi=110, format="png")
    part.replace(path)


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
    read = {path.stem if path.stem != "record" else path.parent.name: path for path in records}
    try:
        draw_curves({name: read_record(path) for name, path in read.items()}, out)
    except (OSError, ValueError) as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(2) from error
    typer.echo(f"written: {out}")


if __name__ == "__main__":
    app()
