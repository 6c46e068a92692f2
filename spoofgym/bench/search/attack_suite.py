"""The attack suite: a fixed, versioned list of attacks that every detector is scored against.

What no member of it achieves, another attack may.  Every member has one setting that is searched
for, the same as in a campaign.  With them play the blind optima (letter c) that a campaign has
found against the detector, where that is among its spoofers.  A member whose spoofer is not
registered is left out, which changes the digest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.registry import Spec, whole_number
from ...core.settings import digest_of
from ...simulation.setup import Setup
from ...spoofers import SPOOFERS, SpooferContext, make_spoofer
from ...spoofers.scaled import AMPLITUDE
from ..runs.play import make_bound_spoofer
from ..runs.players import TUNED, PlayerSpec, specify_spoofer
from ..scores.statistics import log_spaced

FloatArray = NDArray[np.float64]
NAME, VERSION = "spoofgym-scripted", 2
"""Of the suite; another list of members, or another grid, is another version."""
FAMILIES = {
    "a": "ramps and accelerating ramps",
    "b": "profiles",
    "c": "blind optima, found against each detector",
    "e": "feedback (oracle)",
    "h": "dashes",
}
"""What the letters of the members mean."""
ORACLES = "e"
"""Letters of those that see the detector's statistics, as nobody can in practice."""
KNOTS = 13
SHAPES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "smooth-entry": lambda t: np.where(t < 0.5, t * t * (12.0 - 16.0 * t), 1.0),
    "quadratic": lambda t: t * t,
    "late": lambda t: t**4,
}
"""Rates of the profiles over the attack window, both in parts of the largest."""
STEEPEST = 0.25
"""Largest rate of a profile with amplitude 1, of what the acceleration allows in a whole window."""
AROUND_FOUND = (0.5, 2.0)
"""Amplitudes of a blind optimum that are tried first, in parts of that at which it was found."""
LAST_PARTS = (0.15, 0.4)
"""Parts of the attack window in which a dash takes place."""


@dataclass(frozen=True, kw_only=True)
class Selection:
    """How the worst attack of the suite is looked for. `runs`: runs of the split `selection`;
    `sift_runs`: how many of them play the whole suite; `values`: log-spaced values of every
    member's setting."""

    runs: int = 192
    sift_runs: int = 48
    values: int = 10

    def __post_init__(self) -> None:
        for name, least in (("runs", 1), ("sift_runs", 1), ("values", 2)):
            count = whole_number(f"`selection.{name}`", getattr(self, name), least)
            object.__setattr__(self, name, count)


@dataclass(frozen=True)
class SuiteAttack:
    """One attack of the suite; `budgeted` where a campaign plays it under the alarm budget, too."""

    letter: str
    player: PlayerSpec
    budgeted: bool


def members_of(context: SpooferContext) -> tuple[SuiteAttack, ...]:
    """All attacks, by an attack's limits and the length of its window."""
    found = [
        ("a", {"name": "ramp", "rate_mps": TUNED}),
        ("a", {"name": "accelerating-ramp", "acceleration_mps2": TUNED}),
        *(("b", _profile(name, context)) for name in SHAPES),
        ("e", {"name": "feedback", AMPLITUDE: TUNED}),
        *(("h", _dash(part, context)) for part in LAST_PARTS),
    ]
    return tuple(
        SuiteAttack(letter, specify_spoofer(spec), letter != "h")
        for letter, spec in found
        if spec["name"] in SPOOFERS
    )


def fitting_members(setup: Setup, context: SpooferContext) -> tuple[SuiteAttack, ...]:
    """Those that this attack can be commanded by: feedback needs its victim's statistics."""
    found = []
    for member in members_of(context):
        try:
            make_bound_spoofer(member.player.with_value(1e-3), setup, 1)
        except ValueError:
            if member.letter not in ORACLES:  # of the others each must fit
                raise
            continue
        found.append(member)
    return tuple(found)


def suite_digest(members: Sequence[SuiteAttack]) -> str:
    specs = [[member.letter, member.player.spec] for member in members]
    return digest_of({"name": NAME, "version": VERSION, "members": specs})


def grid_of(member: SuiteAttack, context: SpooferContext, values: int) -> list[float]:
    """Log-spaced values of a member's setting over its whole range. Of a blind optimum around the
    amplitude that it was found at."""
    if member.letter == "c":
        return log_spaced(*AROUND_FOUND, values)
    kind = type(make_spoofer(member.player.with_value(1.0)))
    return log_spaced(*kind.tuning_range(context), values)


def _profile(name: str, context: SpooferContext) -> Spec:
    """A curve of the rate by its shape."""
    most = context.rate_limit_mps
    if context.control == "acceleration":
        window_s = context.steps * context.interval_s
        most = min(most, STEEPEST * context.acceleration_limit_mps2 * window_s)
    rates = most * SHAPES[name](np.linspace(0.0, 1.0, KNOTS))
    return {
        "name": "profile",
        "rates_mps": [float(f"{rate:.6g}") for rate in rates],
        "label": f"profile-{name}",
        AMPLITUDE: TUNED,
    }


def _dash(part: float, context: SpooferContext) -> dict[str, Any]:
    last_s = part * context.steps * context.interval_s
    return {"name": "dash", "rate_mps": TUNED, "last_s": float(f"{last_s:.4g}")}
