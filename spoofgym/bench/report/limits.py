"""Limits as tables and figure.

Limits of a world and of its detectors: one record, and the tables that are made of it.

The record is JSON-able, and all that is printed or drawn comes from it.  It holds the floors of a
perfect detector, the zero-alarm bounds of given ones, whether the bound by divergence holds for a
spoofer, and the assumptions of each.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...core.plots import BLUE, ORANGE, figure_class, save_figure, style
from ...core.registry import check_choice
from ...detectors.calibration_file import hourly_rate, run_probability
from ...envs.observer import Observer
from ...envs.terms.observation import default_terms
from ...limits import Frontier, deflection_for
from ...limits.bounds import ASSUMPTIONS, ZeroAlarm, heading_of
from ...limits.floor import QUANTILES
from ...limits.power import check_no_latent, kl_of
from ...simulation.setup import Setup
from ...simulation.tight import TightlyCoupledSetup
from ..runs.players import PlayerSpec
from ..search.bounds import floors_m, purposes
from .table import number

Record = dict[str, Any]
SENSORS = {"unknown": False, "known": True}
"""Whether the constants of the inertial sensors are known, by the word for it."""
HEADINGS = ("known", "unknown")
TIMES = 12
"""Times of the command phase at which a picture has the floor."""
DRAWN = ("half", "certain")
"""Purposes whose floors are drawn over time."""
UNBOUNDED = "unbounded"
COMMANDS_NO_POSITION = "the restricted attack is a false position, which this one does not command"
ZERO_ALARM_HEAD = (
    "detector",
    "free attack [m]",
    "restricted attack [m]",
    "kind",
    "why there is none, or an upper one; what holds instead",
)


def sensors_known(word: str) -> bool:
    """Whether the constants of the inertial sensors are known; an error for another word."""
    check_choice("knowledge of the inertial sensors' constants", word, SENSORS)
    return SENSORS[word]


def per_run(false_alarms_per_hour: float, setup: TightlyCoupledSetup) -> float:
    """Probability of a false alarm in a run, which has to leave room for a detection."""
    found = run_probability(false_alarms_per_hour, setup.window_s)
    if found >= 0.5:
        raise ValueError(
            f"{false_alarms_per_hour:g} false alarms an hour are {100 * found:.3g} % of runs of "
            f"{setup.window_s:g} s, so that no floor is left for a detection of 50 %; valid: below "
            f"{hourly_rate(0.5, setup.window_s):.4g} an hour"
        )
    return found


def floor_record(
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
            "heading_deg": math.degrees(heading_of(setup)),
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
                for purpose, cell in floors_m(frontier, p_fa, budget, heading).items()
            }
            for heading in HEADINGS
        },
        "per_deflection_m": _spread(frontier.sizes()),
        "every_channel_free_m": _spread(frontier.sizes(free=True)),
        "below_every_channel_free": _below(frontier),
        "assumptions": {"floor": list(frontier.assumptions)},
    }
    if len(frontier.times_s):
        record["course"] = _course(frontier, p_fa, budget)
    return record


def zero_alarm_record(
    found: Mapping[str, ZeroAlarm], points: Mapping[str, Sequence[Any]]
) -> Record:
    """Zero-alarm bounds by detector, and where these work, to be added to a record."""
    rows = [
        {
            "detector": label,
            "points": [point._asdict() for point in points[label]],
            **bound.as_json(),
            **({"why": COMMANDS_NO_POSITION} if _only_free(bound) else {}),
        }
        for label, bound in found.items()
    ]
    return {"zero_alarm": rows, "assumptions": {"zero_alarm": list(ASSUMPTIONS)}}


def _only_free(bound: ZeroAlarm) -> bool:
    return bound.restricted_m is None and not bound.why


def divergence_record(
    setup: Setup, frontier: Frontier, player: PlayerSpec, p_fa: float, budget: float
) -> Record:
    """What no test exceeds against a spoofer, by divergence; or why there is no such bound. For
    each probability of detection: the divergence D below which no test reaches it, and the mean
    displacement that D allows."""
    spoofer = player.build()
    names = Observer(default_terms(setup, spoofer.knowledge), setup).names
    found: Record = {"spoofer": player.label, "knowledge": spoofer.knowledge}
    try:
        check_no_latent(spoofer.knowledge, names)
    except ValueError as error:
        return {**found, "holds": False, "why": str(error), "bounds": {}}
    sizes = _spread(frontier.sizes())
    bounds = {}
    for purpose, p_d in purposes(p_fa, budget).items():
        divergence = kl_of(p_d, p_fa)
        d = math.sqrt(2.0 * divergence)
        metres = {name: x if isinstance(x, str) else d * x for name, x in sizes.items()}
        bounds[purpose] = {"p_d": p_d, "divergence": divergence, **metres}
    return {**found, "holds": True, "why": "", "bounds": bounds}


def _json(value: float | None) -> float | str:
    return UNBOUNDED if value is None or math.isinf(value) else float(value)


def _spread(sizes: np.ndarray[Any, np.dtype[np.float64]]) -> Record:
    """Median over worlds and headings, 10th and 90th percentile."""
    low, middle, high = (float(np.quantile(sizes, q, method="nearest")) for q in QUANTILES)
    return {"value": _json(middle), "low": _json(low), "high": _json(high)}


def _below(frontier: Frontier) -> bool:
    """Whether the frontier stays below that of an attack on every channel, as it has to."""
    free = frontier.sizes(free=True)
    return bool((frontier.sizes() <= free * (1.0 + 1e-6)).all())


def _course(frontier: Frontier, p_fa: float, budget: float) -> Record:
    """Floors of attacks that aim at some times, heading unknown."""
    asked, found = purposes(p_fa, budget), {}
    for purpose in DRAWN:
        p_d = asked[purpose]
        low, middle, high = (
            [_json(x) for x in frontier.course_m(p_fa, p_d, quantile=q).tolist()] for q in QUANTILES
        )
        d = deflection_for(p_fa, p_d, heading="unknown")
        found[purpose] = {"p_d": p_d, "deflection": d, "value": middle, "low": low, "high": high}
    return {"times_s": frontier.times_s.tolist(), "heading": "unknown", "floors_m": found}


def percent(part: float) -> str:
    """Probability in per cent, with digits enough to differ from 0 and 1."""
    return f"{100 * part:.3g} %"


def metres(cell: Mapping[str, Any]) -> str:
    """Median with its range, where there is one."""
    low, middle, high = (_metres(cell[name]) for name in ("low", "value", "high"))
    return middle if low == high else f"{middle} ({low} to {high})"


def _metres(value: float | str | None) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else number(value)


def worlds_text(record: Record) -> str:
    """Over how many worlds, and what is in brackets."""
    if record["worlds"] == 1:
        return "one world"
    return f"median over {record['worlds']} drawn worlds (10 to 90 %)"


def rate_text(record: Record) -> str:
    """Rate of false alarms of the perfect detector."""
    return (
        f"P_FA {percent(record['p_fa'])} of runs of {record['window_s']:g} s, "
        f"{record['false_alarms_per_hour']:g} false alarms an hour"
    )


def floor_title(record: Record) -> str:
    return (
        f"{record['scenario']}, {record['attack']['name']}: floor, displacement that even a "
        f"perfect detector allows [m]; {worlds_text(record)}; {rate_text(record)}"
    )


def floor_head(record: Record) -> tuple[str, ...]:
    return ("heading of the attack", *_heads(record, record["floors_m"][HEADINGS[0]]))


def _heads(record: Record, cells: Mapping[str, Any]) -> list[str]:
    """What is asked of a perfect detector, by column."""
    said = {"stealthy": f" (budget {percent(record['budget'])})", "certain": " (P_MD 1e-3)"}
    return [f"P_D {percent(cell['p_d'])}{said.get(name, '')}" for name, cell in cells.items()]


def floor_rows(record: Record) -> list[tuple[str, ...]]:
    return [
        (
            f"{heading} to the detector",
            *(f"{metres(cell)}; d = {cell['deflection']:.2f}" for cell in cells.values()),
        )
        for heading, cells in record["floors_m"].items()
    ]


def check_line(record: Record) -> str:
    """What the frontier is per unit of d, and its check by the closed form."""
    own, free = record["per_deflection_m"]["value"], record["every_channel_free_m"]["value"]
    if isinstance(own, str) or isinstance(free, str):
        return (
            f"per unit of the deflection d: {_metres(own)}; with every channel free {_metres(free)}"
        )
    verdict = "below it in every world" if record["below_every_channel_free"] else "ABOVE IT"
    return (
        f"per unit of the deflection d: {own:.3g} m; check: with every channel free, in closed "
        f"form by solution separation, {free:.3g} m; the floor has to be below it, and is {verdict}"
    )


def zero_alarm_title(record: Record) -> str:
    attack, count = record["attack"], record["worlds"]
    limits = f"{attack['rate_limit_mps']:g} m/s"
    if attack["control"] != "rate":
        limits += f" and {attack['acceleration_limit_mps2']:g} m/s^2"
    return (
        f"{record['scenario']}: zero-alarm bound, mean displacement that no attack exceeds without "
        f"an alarm of its own doing, {'one world' if count == 1 else f'mean over {count} worlds'}; "
        f"restricted: {attack['name']} towards {attack['heading_deg']:g} deg, at most {limits}"
    )


def zero_alarm_rows(record: Record) -> list[tuple[str, ...]]:
    return [
        (
            row["detector"],
            _metres(row["free_m"]),
            _metres(row["restricted_m"]),
            row["kind"] or "none",
            row["why"] or "-",
        )
        for row in record["zero_alarm"]
    ]


def divergence_title(record: Record) -> str:
    found = record["divergence"]
    return (
        f"{found['spoofer']} ({found['knowledge']}): with a divergence D no test finds it more "
        f"often than P_D, and its mean displacement is at most [m]; {worlds_text(record)}"
    )


def divergence_head(record: Record) -> tuple[str, ...]:
    return ("", *_heads(record, record["divergence"]["bounds"]))


def divergence_rows(record: Record) -> list[tuple[str, ...]]:
    cells = record["divergence"]["bounds"].values()
    return [
        ("divergence [nats]", *(f"{cell['divergence']:.3g}" for cell in cells)),
        ("displacement [m]", *(metres(cell) for cell in cells)),
    ]


def assumption_lines(record: Record) -> list[str]:
    titles = {"floor": "Assumptions of a floor:", "zero_alarm": "Of a zero-alarm bound:"}
    return [
        line
        for kind, lines in record["assumptions"].items()
        for line in (titles[kind], *(f"- {text}" for text in lines))
    ]


if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"half": BLUE, "certain": ORANGE}
LABELS = {
    "half": "found in half of the runs",
    "certain": "missed in one of a thousand",
}
WIDTH = 140
"""Characters of a line of the caption."""


def draw_floors(record: Record, path: Path) -> Path:
    lines = _caption(record)
    figure = figure_class()(figsize=(8.0, 4.8 + 0.16 * len(lines)), layout="constrained")
    ax = figure.subplots()
    style(ax)
    course = record["course"]
    time = np.array(course["times_s"])
    ends = [_draw_floor(ax, time, purpose, cells) for purpose, cells in course["floors_m"].items()]
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


def _draw_floor(ax: Axes, time: NDArray[np.float64], purpose: str, cells: dict[str, Any]) -> bool:
    """Median, from 0 at the onset, and its range; whether there is any that is finite."""
    low, middle, high = (_finite(cells[name]) for name in ("low", "value", "high"))
    since, colour = np.append(0.0, time), COLOURS[purpose]
    label = f"P_D {percent(cells['p_d'])}: {LABELS[purpose]} (d = {cells['deflection']:.2f})"
    ax.plot(since, np.append(0.0, middle), "o-", color=colour, ms=4, label=label)
    if not np.array_equal(low, high, equal_nan=True):
        bounds = np.append(0.0, low), np.append(0.0, high)
        ax.fill_between(since, *bounds, color=colour, alpha=0.15, lw=0)
    return bool(np.isfinite(middle).any())


def _finite(values: list[float | str]) -> NDArray[np.float64]:
    """Values, NaN where there is no bound."""
    return np.array([np.nan if isinstance(x, str) else x for x in values])


def _caption(record: Record) -> list[str]:
    text = (
        f"{worlds_text(record).capitalize()}. {rate_text(record)}. The detector does not know "
        "the heading of the attack. "
        f"Assumptions: {'; '.join(record['assumptions']['floor'])}."
    )
    return textwrap.wrap(text, WIDTH)
