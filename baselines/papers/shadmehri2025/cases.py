"""Cases of the reproduction, and what a second program of the same equations found in them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from .runs import MARKOV, SMALL_WHITE, WHITE, make_self_tuning, scale_noise


class LatencyResult(NamedTuple):
    """What the second program found at one ramp.

    - `detected`: share of the runs;
    - `mean`, `sd`: of the latency [s], where anything was detected;
    - `spread_recorded`, `share_recorded`: whether `sd` and `detected` are its own; if not, `sd` is
      a width of ours, and the share is not held against anything.
    """

    detected: float
    mean: float | None = None
    sd: float | None = None
    spread_recorded: bool = True
    share_recorded: bool = True


class Case(NamedTuple):
    """One receiver under one kind of errors.

    - `results`: figures of the second program by ramp; where there are none, there is no band;
    - `tests`: more tests of the same runs than the paper's, as `runs.judge_statistic` takes them.
    """

    title: str
    errors: dict[str, float]
    receiver: dict[str, Any]
    results: dict[str, LatencyResult]
    tests: Mapping[str, dict[str, Any]] = MappingProxyType({})


PAPER = {
    "conventional": {"2": None, "3": 3.41, "5": 1.91},
    "tuned": {"2": 0.35, "3": 0.22, "5": 0.11},
}
"""Table 1, latency [s]; None where the paper detects nothing."""


def around(detected: float, mean: float, width: float) -> LatencyResult:
    """A mean latency whose spread is not recorded, with a width of ours [s]."""
    return LatencyResult(detected, mean, width, spread_recorded=False)


def _by_ramp(*found: tuple[float, ...]) -> dict[str, LatencyResult]:
    """What was found at ramps of 2, 3 and 5 m/s: share detected, then mean and spread [s]."""
    return {ramp: LatencyResult(*each) for ramp, each in zip("235", found, strict=True)}


def _estimate_covariance(window: int) -> dict[str, Any]:
    return {"rule": "estimated", "covariance_window": window}


MEANS = {f"mean of {n}": {"rule": "mean", "window": n} for n in (5, 10)}
"""The paper's mean over N epochs against 25.9."""

CONVENTIONAL = {
    "conventional, white": Case(
        "white 3.7/6 m, as the stated R",
        WHITE,
        {},
        _by_ramp((0.05, 3.7, 1.1), (0.52, 3.9, 0.75), (1.0, 2.5, 0.58)),
        {"window of 10": {"window": 10}},
    ),
    "conventional, correlated": Case(
        "correlated, stated R", MARKOV, {}, _by_ramp((0.0,), (0.0,), (1.0, 4.14, 0.13))
    ),
    **{
        f"conventional, R x {factor}": Case(
            f"correlated, R x {factor} (fitted)", MARKOV, scale_noise(factor), results
        )
        for factor, results in {
            0.24: _by_ramp((0.0,), (1.0, 3.48, 0.21), (1.0, 1.66, 0.07)),
            0.26: _by_ramp((0.0,), (1.0, 3.69, 0.23), (1.0, 1.74, 0.08)),
            0.28: _by_ramp((0.0,), (1.0, 3.94, 0.27), (1.0, 1.82, 0.07)),
        }.items()
    },
    "conventional, white 1.6 m": Case(
        "white 1.6/3 m, R x 0.4 (fitted)",
        SMALL_WHITE,
        scale_noise(0.4),
        _by_ramp((0.05,), (1.0, 3.46, 0.51), (1.0, 1.83, 0.22)),
    ),
}
TUNED = {
    "tuned, w = 20": Case(
        "correlated, w = 20",
        MARKOV,
        make_self_tuning(20),
        _by_ramp((0.73, 0.24, 0.1), (0.95, 0.17, 0.07), (1.0, 0.11, 0.04)),
        {"with itself": {"masked": True}},
    ),
    "tuned, w = 30": Case(
        "correlated, w = 30",
        MARKOV,
        make_self_tuning(30),
        _by_ramp((0.74, 0.3, 0.28), (0.94, 0.2, 0.08), (0.99, 0.13, 0.05)),
        {"estimated": _estimate_covariance(30)},
    ),
    "tuned, w = 50": Case(
        "correlated, w = 50",
        MARKOV,
        make_self_tuning(50),
        _by_ramp((0.85, 0.37, 0.19), (0.97, 0.24, 0.11), (1.0, 0.15, 0.07)),
        {"with itself": {"masked": True}, **MEANS},
    ),
    "tuned, w = 100": Case(
        "correlated, w = 100",
        MARKOV,
        make_self_tuning(100),
        _by_ramp((0.98, 0.38, 0.17), (1.0, 0.24, 0.09), (1.0, 0.15, 0.06)),
        {"estimated": _estimate_covariance(100), **MEANS},
    ),
    "tuned, white": Case(
        "white 3.7/6 m, w = 100", WHITE, make_self_tuning(100), _by_ramp((0.02,), (0.02,), (0.06,))
    ),
    "tuned, white 1.6 m": Case(
        "white 1.6/3 m, w = 100", SMALL_WHITE, make_self_tuning(100), {"5": LatencyResult(0.37)}
    ),
    "tuned, w = 50, Q too": Case(
        "correlated, w = 50, Q adapts too (clamped)",
        MARKOV,
        make_self_tuning(50, "clamped"),
        {
            ramp: each._replace(spread_recorded=False, share_recorded=False)
            for ramp, each in _by_ramp(
                (0.85, 0.36, 0.19), (0.97, 0.26, 0.11), (1.0, 0.16, 0.07)
            ).items()
        },
    ),
    "tuned, floor": Case(
        "correlated, w = 50, R no smaller than 0.83 m",
        MARKOV,
        make_self_tuning(50, floor_m=0.83),
        _by_ramp((0.0,), (0.0,), (0.0,)),
    ),
}
SMALL_R_FACTOR = 0.0021
SMALL_R = {
    f"R of {sd} m": Case(
        f"R of {sd} m, fixed",
        MARKOV,
        scale_noise(factor),
        {ramp: around(1.0, *each) for ramp, each in zip("235", found, strict=True)},
    )
    for sd, factor, found in (
        (0.17, SMALL_R_FACTOR, ((0.36, 0.1), (0.25, 0.1), (0.17, 0.1))),
        (0.37, 0.01, ((0.87, 0.1), (0.56, 0.1), (0.34, 0.1))),
        (0.83, 0.05, ((2.27, 0.25), (1.3, 0.12), (0.73, 0.1))),
    )
}
CASES = CONVENTIONAL | TUNED | SMALL_R

DECAYS = {0.9999: 1.0, 0.999: 0.98, 0.995: 0.43, 0.99: 0.13, 0.97: 0.07, 0.9: 0.02}
"""Share of ramps of 2 m/s that w = 100 detects, by the decay of the errors."""

FALSE_ALARMS = {5: 5.9e-2, 10: 1.3e-2, 20: 4.8e-3, 30: 2.1e-3, 50: 6.7e-4, 100: 1.7e-4, 150: 2e-4}
"""Share of clean epochs with an alarm at 25.9, by w."""

WHITE_WINDOWS = (30, 100)
"""Windows w whose alarms are counted under white errors, too."""

SMALL_R_SD_M = tuple(scale_noise(SMALL_R_FACTOR).values())
"""Standard deviations that the smallest R assumes, horizontal and vertical [m]."""

SMALL_R_ALARMS = {"R of 0.17 m": 5e-3, "R of 0.37 m": 0.0, "R of 0.83 m": 0.0}
"""The same of fixed small R, in the first 15 s after the lead-in."""

SPREADS = (
    ("raw", 100, "correlated"),
    ("skip", 100, "correlated"),
    ("clamped", 100, "correlated"),
    ("clamped", 100, "white"),
    ("clamped", 30, "white"),
    ("clamped", 10, "white"),
)
"""Rule of Q, w and errors whose scale of Q is followed."""

SINCE_START = {
    "clean since the start, correlated": MARKOV,
    "clean since the start, white": {
        "horizontal_sd_m": SMALL_R_SD_M[0],
        "vertical_sd_m": SMALL_R_SD_M[1],
        "decay": 0.0,
    },
}
"""Errors under which the common filter with R of 0.17 m is watched from its start on."""
