"""Displacement against alarms: one spoofer for each price of an alarm, and the curve of them all.

    python -m train.frontier --detector ewma --penalties 0.3 1 3 10 --out runs/frontier

A single number under a budget hides what an attack costs in alarms.  Here PPO learns once for each
price, which stays as it is; what is kept is what gets farthest less that price for every alarm, as
it was learned.  All of them then play runs that decided nothing.  The ramps of the same tuning, at
all of their values, are the curve beside it.

All settings of `train.ppo_spoofer` hold here as well.  The folder holds a run for each price,
`frontier.json` and `frontier.png`.  After a kill the same command goes on: prices that are finished
are kept, the one that was interrupted is resumed.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from spoofgym._files import write_file
from spoofgym._pictures import BLUE, ORANGE, figure_class, save_figure, style
from spoofgym.bench.metrics import wilson
from spoofgym.spoofers.card import Card

from .ppo_spoofer import CONFIG, Arguments, finish, open_folder, train

RESULT, PICTURE = "frontier.json", "frontier.png"
DECIDED = ("penalty", "penalty_gain", "choose", "resume")
"""Settings of a run that the frontier decides."""


@dataclass(frozen=True)
class FrontierArguments(Arguments):
    """Settings of a frontier: those of its runs, and the prices."""

    penalties: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0)
    """Prices of an alarm, in displacements of the best ramp."""

    def __post_init__(self) -> None:
        """Check the prices, and what they decide."""
        super().__post_init__()
        if not self.penalties or not all(math.isfinite(p) and p >= 0.0 for p in self.penalties):
            raise ValueError(f"`penalties` must be finite and >= 0, got {self.penalties}")
        if len(set(self.penalties)) < len(self.penalties):
            raise ValueError(f"`penalties` must differ from each other, got {self.penalties}")
        for item in fields(Arguments):
            if item.name in DECIDED and getattr(self, item.name) != item.default:
                raise ValueError(f"`{item.name}` can't be given here: `penalties` decide it")

    def run(self, price: float) -> Arguments:
        """Settings of the run of a price."""
        shared = {item.name: getattr(self, item.name) for item in fields(Arguments)}
        return replace(
            Arguments(**shared),
            out=self.out / f"price-{price:g}",
            penalty=price,
            penalty_gain=0.0,
            choose="price",
            resume=True,
        )


def play(args: FrontierArguments, console: Console) -> dict[str, Any]:
    """Train what is missing; the frontier, JSON-able."""
    points: list[dict[str, Any]] = []
    rivals: list[dict[str, Any]] | None = None
    for price in sorted(args.penalties):
        run = args.run(price)
        console.print(f"price {price:g}")
        card = finished(run, console)
        if card is None:
            best, spent_s = train(run, console, rivals)
            finish(run, best, spent_s, console)
            card = Card.load(best.with_suffix(".json"))
        rivals = json.loads((run.out / CONFIG).read_text(encoding="utf-8"))["rivals"]
        score = card.scores[1]
        counted = score.counted or score.runs
        alarms = wilson(round(score.alarm_rate * counted), counted)
        points.append(
            {
                "penalty": price,
                "policy": f"{run.out.name}/{card.name}.onnx",
                "runs": score.runs,
                "undetected_displacement_m": {
                    "value": score.undetected_displacement_m,
                    "low": score.low,
                    "high": score.high,
                },
                "alarm_rate": alarms.as_json(),
                "clean_alarm_rate": score.clean_alarm_rate,
            }
        )
    return {"detector": card.scores[1].detector, "points": points, "ramps": ramps_of(rivals or [])}


def finished(run: Arguments, console: Console) -> Card | None:
    """Card of a run of these settings that has played the runs that decided nothing."""
    path = run.out / f"{run.out.name}.json"
    if not path.is_file():
        return None
    open_folder(run, console)  # or a message that tells what differs
    card = Card.load(path)
    return card if len(card.scores) == 2 else None


def ramps_of(rivals: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """What every ramp that was tried on all tuning runs did."""
    return [
        {
            "spoofer": table["spoofer"],
            table["setting"]: trial["value"],
            "runs": trial["runs"],
            "undetected_displacement_m": trial["stealthy_displacement_m"],
            "alarm_rate": trial["alarm_rate"],
        }
        for table in rivals
        for trial in table["trials"]
    ]


def draw(result: dict[str, Any], path: Path) -> None:
    """Draw the learned points with their intervals over the curves of the ramps."""
    figure = figure_class()(figsize=(7.5, 5.0), layout="constrained")
    ax = figure.subplots()
    style(ax)
    names = sorted({ramp["spoofer"] for ramp in result["ramps"]})
    for name, marker in zip(names, "s^", strict=False):
        mine = [ramp for ramp in result["ramps"] if ramp["spoofer"] == name]
        rates = [100.0 * ramp["alarm_rate"] for ramp in mine]
        far = [ramp["undetected_displacement_m"] for ramp in mine]
        ax.plot(rates, far, marker, color=BLUE, alpha=0.5, mec="white", ms=7, label=name)
    rate = [point["alarm_rate"] for point in result["points"]]
    moved = [point["undetected_displacement_m"] for point in result["points"]]
    ax.errorbar(
        [100.0 * one["value"] for one in rate],
        [one["value"] for one in moved],
        xerr=_arms(rate, 100.0),
        yerr=_arms(moved, 1.0),
        fmt="o-",
        color=ORANGE,
        lw=1.5,
        capsize=2,
        label="PPO, one for each price of an alarm",
    )
    for point, x, y in zip(result["points"], rate, moved, strict=True):
        ax.annotate(
            f"{point['penalty']:g}",
            (100.0 * x["value"], y["value"]),
            xytext=(5, 6),
            textcoords="offset points",
            fontsize=9,
        )
    ax.set(
        title=f"displacement against alarms, {result['detector']}",
        xlabel="runs with an alarm [%]",
        ylabel="undetected displacement [m], mean",
    )
    ax.set_ylim(bottom=0.0)
    ax.legend(fontsize=9, framealpha=0.9)
    save_figure(figure, path, dpi=130)


def _arms(estimates: list[dict[str, float]], unit: float) -> list[list[float]]:
    """Distances of both ends of intervals from their values."""
    return [
        [unit * max(one["value"] - one["low"], 0.0) for one in estimates],
        [unit * max(one["high"] - one["value"], 0.0) for one in estimates],
    ]


def tell(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    table = Table(title=f"frontier against {result['detector']}")
    for head in ("price", "runs", "undetected displacement [m]", "alarms [%]", "without attack"):
        table.add_column(head, justify="right")
    for point in result["points"]:
        moved, rate = point["undetected_displacement_m"], point["alarm_rate"]
        table.add_row(
            f"{point['penalty']:g}",
            str(point["runs"]),
            f"{moved['value']:.2f} ({moved['low']:.2f} to {moved['high']:.2f})",
            f"{100 * rate['value']:.1f} ({100 * rate['low']:.1f} to {100 * rate['high']:.1f})",
            f"{100 * point['clean_alarm_rate']:.1f}",
        )
    console.print(table)


def main() -> None:
    """Command line."""
    console = Console()
    try:
        args = tyro.cli(FrontierArguments, description=__doc__)
        result = play(args, console)
    except ValueError as error:
        raise SystemExit(f"error: {error}") from error
    except KeyboardInterrupt:
        console.print("interrupted; the same command goes on")
        raise SystemExit(130) from None
    write_file(args.out / RESULT, (json.dumps(result, indent=1, allow_nan=False) + "\n").encode())
    draw(result, args.out / PICTURE)
    tell(result, console)
    console.print(f"written: {args.out / RESULT} and {PICTURE} beside it")


if __name__ == "__main__":
    main()
