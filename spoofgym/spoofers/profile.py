r"""Curves drawn before the attack, of the rate or of an action: what a blind spoofer plans at best.

The rates at the knots are joined by a shape-preserving cubic (`fritsch1980`), which never leaves
the range of two neighbouring knots and has no overshoot.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.registry import require
from .base import FloatArray, HeadingCommand, ScriptedSpoofer, Spoofer, SpooferContext, has_heading

FEWEST_KNOTS, MOST_KNOTS = 2, 64


@settings_record(kw_only=True)
class Profile(ScriptedSpoofer):
    r"""Follows a smooth curve of the rate over the attack window, whatever happens.

    With n rates at knots :math:`t_i = i T / (n - 1)` over a window of length T, the rate that is
    wanted at the time t after the onset is, with :math:`s = (t - t_i) / h` and
    :math:`h = T / (n - 1)`,

    .. math:: v(t) = v_i (1 + 2 s)(1 - s)^2 + v_{i+1} s^2 (3 - 2 s)
        + h \left( m_i s (1 - s)^2 - m_{i+1} s^2 (1 - s) \right)

    where the slopes m are the weighted harmonic means of `fritsch1980`, zero where the rates turn.
    The attack's limits hold as for every spoofer: what is wanted faster comes later.
    """

    rates_mps: tuple[float, ...] = setting(
        default=(0.0, 0.2),
        unit="m/s",
        help="Rate (n,) of the false position along the heading at equally spaced knots, from the "
        "onset to the end of the attack window; 2 to 64 of them.",
    )
    cross_rates_mps: tuple[float, ...] = setting(
        default=(),
        empty=True,
        unit="m/s",
        help="The same (l,) for the rate to the right of the heading; none for a straight line.  "
        "With them, the attack's limits apply to the size of both together.",
    )
    label: str | None = setting(default="profile", help="Short name in results.")
    designed_on: str = setting(
        default="nothing", help="What the curve was optimised on; or nothing."
    )

    def __post_init__(self) -> None:
        check_knots("rates_mps", self.rates_mps)
        check_knots("cross_rates_mps", self.cross_rates_mps)

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        self._along = sample_curve(self.rates_mps, context.steps)
        self._across = sample_curve(self.cross_rates_mps or (0.0, 0.0), context.steps)
        fastest = {
            "`rates_mps`": np.abs(self.rates_mps).max(),
            "`cross_rates_mps`": np.abs((*self.cross_rates_mps, 0.0)).max(),
            "`rates_mps` and `cross_rates_mps` together": np.hypot(self._along, self._across).max(),
        }
        for name, rate in fastest.items():
            check_fastest(name, rate, *context.largest_rate)
        if self.cross_rates_mps:
            self._right = _to_the_right(context, self.heading_deg)
            for name in ("cross_rate", "cross_displacement"):
                self.memory.declare(name, np.zeros(context.receivers))

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        return self._along[self._row(step)]

    def _row(self, step: FloatArray) -> NDArray[np.int64]:
        return np.minimum(step.astype(np.int64), len(self._along) - 1)

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        if not self.cross_rates_mps:
            return super().act(observation)
        memory, tau, row = self.memory, self.context.interval_s, self._row(self.memory["step"])
        rates = np.stack([memory["rate"], memory["cross_rate"]])
        wanted = np.stack([self._along[row], self._across[row]])
        size, after, mean = self._follow(rates, wanted, limit_length)
        memory["rate"], memory["cross_rate"] = after[0].copy(), after[1].copy()
        memory["displacement"] = memory["displacement"] + mean[0] * tau
        memory["cross_displacement"] = memory["cross_displacement"] + mean[1] * tau
        memory["step"] = memory["step"] + 1.0
        along, right = self._aim(observation), self._right(observation)
        action = size[0][:, None] * along + size[1][:, None] * right
        return np.ascontiguousarray(np.clip(action, -1.0, 1.0))


@settings_record(kw_only=True)
class OpenLoop(Profile):
    """The best open-loop curve of the rate that a search finds against one detector.

    Without rates it is what the benchmark looks for, against each of its detectors, by
    `spoofgym.bench.search.open_loop`; with rates it plays them.
    """

    rates_mps: tuple[float, ...] = setting(
        default=(),
        empty=True,
        unit="m/s",
        help="Rates (n,) at equally spaced knots, as in `Profile`; none where they are still to be "
        "found.",
    )
    label: str | None = setting(default="open-loop", help="Short name in results.")
    designed_on: str = setting(
        default="detector, receiver and scenario, by a search",
        help="What the curve was optimised on.",
    )

    def bind(self, context: SpooferContext) -> None:
        if not self.rates_mps:
            raise ValueError(
                "the rates of an open-loop attack are not known before it has been looked for: "
                "`spoofgym bench --spoofer open-loop` does so against each detector"
            )
        super().bind(context)


def check_fastest(name: str, rate: float, limit_name: str, limit: float) -> None:
    if rate > limit * (1.0 + 1e-12):
        raise ValueError(
            f"{name} = {rate:g} is more than the attack allows: `{limit_name}` = {limit:g}"
        )


def sample_curve(rates_mps: tuple[float, ...], steps: int) -> FloatArray:
    """Curve (steps,) [m/s] through equally spaced knots (n,), from the onset to the end of the
    window, at the ends of the epochs."""
    from scipy.interpolate import PchipInterpolator  # half of the start of an environment

    knots = np.linspace(0.0, 1.0, len(rates_mps))
    ends = np.arange(1, steps + 1) / steps
    return np.asarray(PchipInterpolator(knots, rates_mps)(ends))


def limit_length(vector: FloatArray, limit: float) -> FloatArray:
    """Vectors, those that are too long shortened to the limit.  `vector` (2, B); returns (2, B)."""
    length = np.hypot(vector[0], vector[1])
    return np.asarray(vector * (limit / np.maximum(length, limit)))


def _to_the_right(context: SpooferContext, heading_deg: float | str) -> HeadingCommand:
    commands = ", ".join(context.action_names)
    if not has_heading(context.action_names):
        raise ValueError(
            "`cross_rates_mps` needs an attack that moves a false position, but this one commands "
            f"{commands}"
        )
    try:
        return HeadingCommand(context, heading_deg, 90.0)
    except ValueError as error:
        said = heading_deg if isinstance(heading_deg, str) else f"{heading_deg:g}"
        raise ValueError(
            f"`cross_rates_mps` needs a command to the right of `heading_deg` = {said}, "
            f"but the attack commands {commands} only"
        ) from error


def check_knots(name: str, rates_mps: tuple[float, ...]) -> None:
    """Raise unless a curve has as many rates as it can; none at all, where that is valid."""
    if rates_mps and not FEWEST_KNOTS <= len(rates_mps) <= MOST_KNOTS:
        valid = f"{FEWEST_KNOTS} to {MOST_KNOTS} rates"
        raise ValueError(f"`{name}` must have {valid}, got {len(rates_mps)}")


@settings_record(kw_only=True)
class ActionCurves(Spoofer):
    r"""Plays a curve of every element of the action over the attack window, whatever happens.

    With values :math:`x_i` at n equally spaced knots, :math:`t_0 = 0` at the onset and
    :math:`t_{n-1} = T` at the end of the window, an element at the time t is on the straight line
    between two of them.  An action of 1 requests what the environment says it does, so that the
    curves belong to its `control`, `basis` and scales.
    """

    knowledge = "blind"
    curves: tuple[tuple[float, ...], ...] = setting(
        default=((0.0, 0.1),),
        help="Values (a, n) at the knots, in units of the action, by its elements in their order; "
        "elements after the last one stay 0.",
    )
    label: str | None = setting(default="action-curves", help="Short name in results.")
    designed_on: str = setting(
        default="nothing", help="What the curves were optimised on; or nothing."
    )

    def __post_init__(self) -> None:
        self.curves = tuple(tuple(float(x) for x in each) for each in self.curves)
        sizes = {len(each) for each in self.curves}
        require(
            len(sizes) == 1 and min(sizes) >= FEWEST_KNOTS and bool(np.isfinite(self.curves).all()),
            f"`curves` must be rows of the same number of finite values, {FEWEST_KNOTS} or more, "
            f"got {self.curves!r}",
        )

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        elements = len(context.action_names)
        require(
            len(self.curves) <= elements,
            f"`curves` has {len(self.curves)} rows, and an action of this environment {elements} "
            f"elements: {', '.join(context.action_names)}",
        )
        knots = np.linspace(0.0, 1.0, len(self.curves[0]))
        ends = np.arange(1, context.steps + 1) / context.steps
        self._actions = np.zeros((context.steps, elements))
        for k, curve in enumerate(self.curves):
            self._actions[:, k] = np.interp(ends, knots, curve)
        self.memory.declare("step", np.zeros(context.receivers, dtype=np.int64))

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command the coming interval: (B, a) in [-1, 1]."""
        step = self.memory["step"]
        action = self._actions[np.minimum(step, len(self._actions) - 1)]
        step += 1
        return np.asarray(np.clip(action, -1.0, 1.0))
