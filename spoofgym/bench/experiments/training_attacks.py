"""Attacks that a detector learns from: families, and what is drawn of each for every episode.

They are drawn so that some are hard to see: where an attack would get to by the end of its window
is log-uniform, from an eighth of the alert limit to five times that.  The families that the tasks
for detectors hold out (`HELD_OUT`) are not among them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...attacks import Meaconer
from ...attacks.equipment import QUIET, CounterfeitErrors
from ...core.registry import Spec
from ...envs.context import spoofer_context
from ...envs.spoofer_binding import bound_spoofer, monitors_for
from ...simulation.engine import Engine
from ...simulation.setup import Setup
from ...spoofers import make_spoofer
from ...spoofers.base import has_heading
from ...spoofers.scaled import AMPLITUDE
from ..runs.play import FloatArray, SpooferController, get_traits
from ..search.attack_suite import KNOTS, SHAPES

FAMILIES = {
    "ramp": "ramps",
    "accelerating-ramp": "ramps that accelerate",
    "profile": "the attack suite's profiles, and powers of the time",
    "dash": "dashes",
    "open-loop": "curves that a search has found against the detectors of this world",
    "feedback": "feedback from the statistic of the detector in the loop",
}
"""Families by name."""
HELD_OUT = (
    "quiet",
    "inherited, in the world of T5",
    "subset of channels",
    "meaconer",
    "onset in a turn",
    "onset at a satellite switch",
    "onset after a chance alarm",
)
"""Families of the tasks for detectors, which no training data have; onsets in a data set are drawn
as the world draws them."""
QUIET_TASKS = ("T5",)
"""Tasks whose own counterfeit is quieter than nature; there the plain one is held out."""
REACH = (0.125, 5.0)
"""Range of the displacement at the end of a window, in alert limits; log-uniform."""
AMPLITUDES = (0.25, 2.0)
"""Range of the factor on spoofers that are given, or were found by a search; log-uniform."""
POWERS = (0.3, 4.0)  # range of the power of time in a profile that is not one of the attack suite's
LAST_PARTS = (0.1, 0.6)  # range of the part of the window in which a dash takes place


class TrainingAttacks:
    """Families of attacks, some of `FAMILIES`, in one world with the detector in the loop; `REACH`
    is in parts of `reach_m`; `optima`: rates of open-loop attacks at their knots [m/s]; `spoofers`:
    further ones, each a family of its own."""

    def __init__(
        self,
        setup: Setup,
        reach_m: float,
        families: Sequence[str],
        optima: Sequence[Sequence[float]] = (),
        spoofers: Sequence[Spec] = (),
    ) -> None:
        labels = []
        for spec in spoofers:
            made = make_spoofer(spec)
            labels.append(str(made.label or spec["name"]))
            if not made.transmits:
                raise ValueError(f"the spoofer {spec['name']!r} transmits nothing: it is no attack")
            watched = setup.copy_with(monitors=monitors_for([made], setup))
            made.bind(bound_spoofer(made, watched, 1)[0])  # or what does not fit
        self._context = spoofer_context(setup)
        self._reach_m, self._optima, self._spoofers = reach_m, list(optima), list(spoofers)
        self._makers: dict[str, Callable[[np.random.Generator, float], Spec]] = {
            name: getattr(self, f"_{name.replace('-', '_')}") for name in families
        }
        self.families = (*families, *labels)

    def draw(self, rng: np.random.Generator) -> tuple[int, Spec]:
        """Family, by its number, and settings of one attack; all families are as likely."""
        family = int(rng.integers(len(self.families)))
        own = family - len(self._makers)
        if own >= 0:
            return family, {
                **self._spoofers[own],
                AMPLITUDE: round_setting(log_uniform(rng, AMPLITUDES)),
            }
        spec = self._makers[self.families[family]](rng, self._reach_m * log_uniform(rng, REACH))
        if has_heading(self._context.action_names):
            spec["heading_deg"] = round_setting(rng.uniform(0.0, 360.0))
        return family, spec

    @property
    def _window_s(self) -> float:
        return self._context.steps * self._context.interval_s

    def _rate(self, rate: float) -> float:
        return round_setting(min(rate, self._context.largest_rate[1]))

    def _ramp(self, rng: np.random.Generator, goal_m: float) -> Spec:
        return {"name": "ramp", "rate_mps": self._rate(goal_m / self._window_s)}

    def _accelerating_ramp(self, rng: np.random.Generator, goal_m: float) -> Spec:
        wanted = 2.0 * goal_m / self._window_s**2
        if self._context.control != "rate":
            wanted = min(wanted, self._context.acceleration_limit_mps2)
        return {"name": "accelerating-ramp", "acceleration_mps2": round_setting(wanted)}

    def _profile(self, rng: np.random.Generator, goal_m: float) -> Spec:
        """A shape of the attack suite, or a power of the time."""
        time, shapes = np.linspace(0.0, 1.0, KNOTS), list(SHAPES.values())
        which, power = int(rng.integers(2 * len(shapes))), rng.uniform(*POWERS)
        shape = shapes[which](time) if which < len(shapes) else time**power
        return self._curve("profile", shape, goal_m)

    def _open_loop(self, rng: np.random.Generator, goal_m: float) -> Spec:
        rates = self._optima[int(rng.integers(len(self._optima)))]
        return self._curve("open-loop", np.asarray(rates, dtype=np.float64), goal_m)

    def _curve(self, name: str, shape: FloatArray, goal_m: float) -> Spec:
        length = float(np.trapezoid(shape, dx=1.0 / (len(shape) - 1))) * self._window_s
        rates = shape * goal_m / length
        return {"name": name, "rates_mps": [self._rate(float(rate)) for rate in rates]}

    def _dash(self, rng: np.random.Generator, goal_m: float) -> Spec:
        last_s = self._window_s * rng.uniform(*LAST_PARTS)
        return {
            "name": "dash",
            "rate_mps": self._rate(goal_m / last_s),
            "last_s": round_setting(last_s),
        }

    def _feedback(self, rng: np.random.Generator, goal_m: float) -> Spec:
        """By the detector in the loop; how carefully is drawn, too."""
        growth, full = rng.uniform(0.0, 6.0), rng.uniform(0.2, 0.7)
        return {
            "name": "feedback",
            "rate_mps": self._rate(2.0 * goal_m / (self._window_s * (1.0 + growth))),
            "growth": round_setting(growth),
            "full_ratio": round_setting(full),
            "zero_ratio": round_setting(full + rng.uniform(0.2, 0.6)),
            "back": round_setting(rng.uniform(-1.0, 0.0)),
        }


def check_not_held_out(attack: Any, task: str | None) -> None:
    """Raise where all that an attack does belongs to a family that is held out."""
    errors = getattr(attack, "errors", "inherited")
    # however they are blended in, errors of the counterfeits' own may be smaller than real ones
    quiet = isinstance(errors, CounterfeitErrors)
    found = {
        "quiet": quiet and not (task in QUIET_TASKS and errors == QUIET),
        "inherited": not quiet and task in QUIET_TASKS,
        "subset of channels": getattr(attack, "channels", "all") != "all",
        "meaconer": isinstance(attack, Meaconer),
    }
    if named := [name for name, held in found.items() if held]:
        raise ValueError(
            f"the attack belongs to what the tasks for detectors have held out ({named[0]}): a "
            "detector that has learned from it could not be compared there"
        )


def log_uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    return math.exp(rng.uniform(math.log(bounds[0]), math.log(bounds[1])))


def round_setting(value: float) -> float:
    """Six digits, so that a setting can be read."""
    return float(f"{value:.6g}")


class Attackers:
    """Spoofers each of which commands one receiver of an engine, which are at their onset; those
    that can command parts of one batch decide together. `specs`: one a receiver."""

    def __init__(self, specs: Sequence[Spec], engine: Engine) -> None:
        self._shape = engine.receivers, len(engine.setup.action_names)
        traits = [get_traits(make_spoofer(spec)) for spec in specs]
        self._controllers: list[tuple[list[int], SpooferController]] = []
        for each in dict.fromkeys(traits):
            rows = [row for row, own in enumerate(traits) if own == each]
            which = np.full(len(specs), -1)
            which[rows] = np.arange(len(rows))
            alike = SpooferController([specs[row] for row in rows], engine, which)
            self._controllers.append((rows, alike))

    def command(self, epoch: int) -> FloatArray | None:
        """Command (B, a) of an epoch, counted from the onset on; None after the last one."""
        out = np.zeros(self._shape)
        for rows, controller in self._controllers:
            if (command := controller.command(epoch)) is None:
                return None
            out[rows] = command[rows]
        return out
