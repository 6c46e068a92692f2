"""Limits as tables and figure.

Limits of a world and of its detectors: one record, and the tables that are made of it.

The record is JSON-able, and all that is printed or drawn comes from it.  It holds the floors of a
perfect detector, the zero-alarm bounds of given ones, whether the bound by divergence holds for a
spoofer, and the assumptions of each.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...core.plots import BLUE, ORANGE, figure_class, save_figure, style
from ...core.progress import ProgressBar
from ...detectors.calibration_file import hourly_rate, run_probability
from ...envs.observer import Observer
from ...envs.terms.observation import default_terms
from ...limits import Frontier, deflection_for
from ...limits.bounds import ASSUMPTIONS, get_heading
from ...limits.floor import QUANTILES
from ...limits.power import check_no_latent, compute_kl_divergence
from ...simulation.setup import Setup
from ...simulation.tight import TightlyCoupledSetup
from ..experiments.suite import Suite
from ..runs.players import PlayerSpec
from ..search.bounds import compute_lower_limits, expect_onset, purposes
from .table import Table, metres, texts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Record = dict[str, Any]
SENSORS = {"unknown": False, "known": True}
"""Whether the constants of the inertial sensors are known, by the word for it."""
HEADINGS = ("known", "unknown")
TIMES = 12  # times of the command phase at which a picture has the floor
DRAWN = {
    "half": (BLUE, "found in half of the runs"),
    "certain": (ORANGE, "missed in one of a thousand"),
}
"""Purposes with floors that are drawn over time, their colours and labels."""
EPOCH_S = 0.001  # of a processor, of the floor of one world, for an epoch before the attack
UNBOUNDED = "unbounded"
NO_POSITION = "the restricted attack is a false position, which this one does not command"


def per_run(false_alarms_per_hour: float, setup: TightlyCoupledSetup) -> float:
    """Probability of a false alarm in a run, which has to leave room for a detection."""
    found = run_probability(false_alarms_per_hour, setup.window_s)
    if found >= 0.5:
        raise ValueError(
            f"{false_alarms_per_hour:g} false alarms an hour are {100 * found:.3g} % of runs of "
            f"{setup.window_s:g} s, so there is no floor for finding 50 % of the attacks; valid: "
            f"below {hourly_rate(0.5, setup.window_s):.4g} an hour"
        )
    return found


def build_limit_record(
    setup: TightlyCoupledSetup,
    frontier: Frontier,
    *,
    false_alarms_per_hour: float,
    budget: float,
    seed: int,
) -> Record:
    p_fa = per_run(false_alarms_per_hour, setup)
    record = {
        "scenario": setup.name,
        "world": setup.conditions.settings,
        "attack": {
            "name": setup.attack.label,
            "control": setup.attack.control,
            "rate_limit_mps": setup.attack.rate_limit_mps,
            "acceleration_limit_mps2": setup.attack.acceleration_limit_mps2,
            "heading_deg": math.degrees(get_heading(setup)),
        },
        "worlds": len(frontier.per_deflection),
        "seed": seed,
        "sensors_known": frontier.sensors_known,
        "window_s": setup.window_s,
        "false_alarms_per_hour": false_alarms_per_hour,
        "p_fa": p_fa,
        "budget": budget,
        "floors_m": {
            heading: {
                purpose: {name: _json(value) for name, value in cell.items()}
                for purpose, cell in compute_lower_limits(frontier, p_fa, budget, heading).items()
            }
            for heading in HEADINGS
        },
        "per_deflection_m": _spread(frontier.sizes()),
        "every_channel_free_m": _spread(frontier.sizes(free=True)),
        # whether it stays below that of an attack on every channel, as it has to
        "below_every_channel_free": bool(
            (frontier.sizes() <= frontier.sizes(free=True) * (1.0 + 1e-6)).all()
        ),
        "assumptions": {"floor": list(frontier.assumptions)},
    }
    if len(frontier.times_s):
        record["course"] = _course(frontier, p_fa, budget)
    return record


def expect_floor(setup: TightlyCoupledSetup, worlds: int) -> float:
    """Time that the floor of some drawn worlds takes [s of a processor]; ages are log-uniform."""
    return EPOCH_S * worlds * expect_onset(setup)


def add_bounds(record: Record, suite: Suite, show: ProgressBar, worlds: int) -> None:
    """Add the zero-alarm bounds of all detectors of a suite, and where these work."""
    brackets, entries = suite.build_bounds(worlds=worlds), suite.detector_players
    with show(1.0 + len(entries)) as bar:
        record["bound_worlds"] = len(brackets.cases(partial(bar.advance, now="worlds")))
        bounds = [brackets.zero_alarm(x, partial(bar.advance, now=x.label)) for x in entries]
    record["zero_alarm"] = [
        {
            "detector": each.label,
            "points": [point._asdict() for point in suite.world.points(each)],
            **bound.as_json(),
            **({} if bound.why or bound.restricted_m is not None else {"why": NO_POSITION}),
        }
        for each, bound in zip(entries, bounds, strict=True)
    ]
    record["assumptions"]["zero_alarm"] = list(ASSUMPTIONS)


def divergence_record(
    setup: Setup, frontier: Frontier, player: PlayerSpec, p_fa: float, budget: float
) -> Record:
    """What no test exceeds against a spoofer, by divergence; or why there is no such bound. For
    each probability of detection: the divergence D below which no test reaches it, and the mean
    displacement that D allows."""
    spoofer = player.build()
    latent = Observer(default_terms(setup, spoofer.knowledge), setup).latent_names
    found: Record = {"spoofer": player.label, "knowledge": spoofer.knowledge}
    bounds: Record = {}
    try:
        check_no_latent(spoofer.knowledge, latent)
    except ValueError as error:
        return {**found, "holds": False, "why": str(error), "bounds": bounds}
    sizes = _spread(frontier.sizes())
    for purpose, p_d in purposes(p_fa, budget).items():
        divergence = compute_kl_divergence(p_d, p_fa)
        d = math.sqrt(2.0 * divergence)
        metres = {name: x if isinstance(x, str) else d * x for name, x in sizes.items()}
        bounds[purpose] = {"p_d": p_d, "divergence": divergence, **metres}
    return {**found, "holds": True, "why": "", "bounds": bounds}


def _json(value: Any) -> Any:
    """Number, or numbers of a list, with a word where there is no end."""
    if isinstance(value, list):
        return [_json(each) for each in value]
    return UNBOUNDED if value is None or math.isinf(value) else float(value)


def _spread(sizes: np.ndarray[Any, np.dtype[np.float64]]) -> Record:
    """Median over worlds and headings, 10th and 90th percentile."""
    low, middle, high = (float(np.quantile(sizes, q, method="nearest")) for q in QUANTILES)
    return {"value": _json(middle), "low": _json(low), "high": _json(high)}


def _course(frontier: Frontier, p_fa: float, budget: float) -> Record:
    """Floors of attacks that aim at some times, heading unknown."""
    powers, found = purposes(p_fa, budget), {}
    for purpose in DRAWN:
        p_d = powers[purpose]
        low, middle, high = (
            [_json(x) for x in frontier.course_m(p_fa, p_d, quantile=q).tolist()] for q in QUANTILES
        )
        d = deflection_for(p_fa, p_d, heading="unknown")
        found[purpose] = {"p_d": p_d, "deflection": d, "value": middle, "low": low, "high": high}
    return {"times_s": frontier.times_s.tolist(), "heading": "unknown", "floors_m": found}


def spread_text(cell: Mapping[str, Any]) -> str:
    """Median with its range, where there is one."""
    low, middle, high = (metres(cell[name]) for name in ("low", "value", "high"))
    return middle if low == high else f"{middle} ({low} to {high})"


def _heads(record: Record, cells: Mapping[str, Any]) -> dict[str, str]:
    """What a perfect detector has to achieve, by purpose."""
    said = {"stealthy": f" (budget {100 * record['budget']:.3g} %)", "certain": " (P_MD 1e-3)"}
    return {
        name: f"P_D {100 * cell['p_d']:.3g} %{said.get(name, '')}" for name, cell in cells.items()
    }


def _format_lower_limit(cell: Record) -> str:
    value = metres(cell["value"])
    if cell["low"] != cell["high"]:  # of several worlds
        low, high = map(metres, cell["interval"])
        value += f" [{low}, {high}] ({metres(cell['low'])} to {metres(cell['high'])})"
    return f"{value}; d = {cell['deflection']:.2f}"


ZERO_ALARM = Table(
    ("detector", "detector"),
    ("free attack [m]", "free_m", metres),
    ("restricted attack [m]", "restricted_m", metres),
    ("kind", lambda row: row["kind"] or "none"),
    ("why it is missing, or an upper one; what holds instead", lambda row: row["why"] or "-"),
)
DIVERGENCE: dict[str, Callable[[Record], str]] = {
    "divergence [nats]": lambda cell: f"{cell['divergence']:.3g}",
    "displacement [m]": spread_text,
}
"""What is shown of each bound."""


def print_limits(record: Record) -> None:
    """Print all that a record has, but its notes."""
    say, heads = texts("limits.txt.j2"), _heads(record, record["floors_m"][HEADINGS[0]])
    Table(
        ("heading of the attack", lambda row: f"{row[0]} to the detector"),
        *(
            (head, lambda row, name=name: row[1][name], _format_lower_limit)
            for name, head in heads.items()
        ),
    ).print(say.floor_title(record), record["floors_m"].items())
    print(say.check(record))
    if "zero_alarm" in record:
        ZERO_ALARM.print(say.zero_alarm_title(record), record["zero_alarm"])
    found = record.get("divergence")
    if found is not None and found["holds"]:
        cells = found["bounds"]
        Table(
            ("", itemgetter(0)),
            *(
                (head, lambda row, cell=cells[name]: row[1](cell))
                for name, head in _heads(record, cells).items()
            ),
        ).print(say.divergence_title(record), DIVERGENCE.items())
    elif found is not None:
        print(f"{found['spoofer']}: {found['why']}")
    print(say.assumptions(record).rstrip())


WIDTH = 140  # characters of a line of the caption


def draw_lower_limits(record: Record, path: Path) -> Path:
    lines = textwrap.wrap(texts("limits.txt.j2").caption(record), WIDTH)
    figure = figure_class()(figsize=(8.0, 4.8 + 0.16 * len(lines)), layout="constrained")
    ax = figure.subplots()
    style(ax)
    course = record["course"]
    time = np.array(course["times_s"])
    ends = [
        _draw_lower_limit(ax, time, purpose, cells) for purpose, cells in course["floors_m"].items()
    ]
    if not any(ends):
        ax.text(0.5, 0.5, f"the floor is {UNBOUNDED}", transform=ax.transAxes, ha="center")
    ax.set_xlim(0.0, time[-1])
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("time since the onset that the attack aims at [s]")
    ax.set_ylabel("displacement [m]")
    ax.set_title(f"{record['scenario']}, {record['attack']['name']}: floor of a perfect detector")
    if any(ends):
        ax.legend(frameon=False, loc="upper left")
    figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=7.5)
    return save_figure(figure, path, dpi=150)


def _draw_lower_limit(
    ax: Axes, time: NDArray[np.float64], purpose: str, cells: dict[str, Any]
) -> bool:
    """Median, from 0 at the onset, and its range; whether there is any that is finite."""
    low, middle, high = (_finite(cells[name]) for name in ("low", "value", "high"))
    since, (colour, name) = np.append(0.0, time), DRAWN[purpose]
    label = f"P_D {100 * cells['p_d']:.3g} %: {name} (d = {cells['deflection']:.2f})"
    ax.plot(since, np.append(0.0, middle), "o-", color=colour, ms=4, label=label)
    if not np.array_equal(low, high, equal_nan=True):
        bounds = np.append(0.0, low), np.append(0.0, high)
        ax.fill_between(since, *bounds, color=colour, alpha=0.15, lw=0)
    return bool(np.isfinite(middle).any())


def _finite(values: list[float | str]) -> NDArray[np.float64]:
    """Values, NaN where there is no bound."""
    return np.array([np.nan if isinstance(x, str) else x for x in values])
