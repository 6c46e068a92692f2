"""Monte Carlo runs of shadmehri2025: statistics of every epoch, and what is told of them.

A passive detector does not act on the run, so that one run serves every threshold and
every length of the window: the normalized innovation squared of each epoch is kept, and judged
afterwards.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from spoofgym.detectors.chi_square import estimated_covariance_thresholds
from spoofgym.simulation import Engine, LooselyCoupledSetup
from spoofgym.simulation.loose import INTERVAL_S

FloatArray = NDArray[np.float64]

FALSE_ALARM = 1e-5
RAMPS = (2.0, 3.0, 5.0)
LEAD_IN_S, ATTACK_S, AFTER_S = 20.0, 5.0, 5.0
EARLY = 150
"""Epochs of the first 15 s after the lead-in."""
STRETCHES_S = (5.0, 20.0, 35.0, 55.0)
"""Edges of the stretches of a clean run in which alarms are counted, after its start."""
STATED_SD = (3.7, 6.0)
THRESHOLD = float(stats.chi2.isf(FALSE_ALARM, 3))
WATCHER = {"name": "windowed-chi2", "window": 1, "thresholds": "nominal"}

MARKOV = {"horizontal_sd_m": 1.6, "vertical_sd_m": 3.0, "decay": 0.999}
WHITE = {"horizontal_sd_m": 3.7, "vertical_sd_m": 6.0, "decay": 0.0}
SMALL_WHITE = {"horizontal_sd_m": 1.6, "vertical_sd_m": 3.0, "decay": 0.0}


def scale_noise(factor: float) -> dict[str, Any]:
    """Conventional receiver whose R is the paper's times a factor."""
    root = factor**0.5
    return {"horizontal_sd_m": STATED_SD[0] * root, "vertical_sd_m": STATED_SD[1] * root}


def make_self_tuning(window: int, process: str = "fixed", floor_m: float = 0.0) -> dict[str, Any]:
    """Self-tuning receiver. `floor_m`: least standard deviation of a coordinate [m]."""
    return {"self_tuning": {"window": window, "process": process, "floor_m": floor_m}}


class Play(NamedTuple):
    """What a batch of runs showed from the onset on.

    - `statistic`: (K, B) normalized innovation squared;
    - `masked`: (K, B) the same with the covariance that the present residual has already entered;
    - `before`: (B,) bool, whether the statistic was above 25.9 before the onset;
    - `error`: (K, B, 2) error of the solution north and east [m];
    - `scale`: (K, B) of Q;
    - `noise_sd`: (K, B) root of R's first element [m].
    """

    statistic: FloatArray
    masked: FloatArray
    before: NDArray[np.bool_]
    error: FloatArray
    scale: FloatArray
    noise_sd: FloatArray


def play(
    errors: dict[str, float],
    receiver: dict[str, Any],
    ramp_mps: float,
    runs: int,
    seed: int,
    attack_s: float = ATTACK_S,
    after_s: float = AFTER_S,
    lead_in_s: float = LEAD_IN_S,
) -> Play:
    """Play runs with a ramp to the north and to the east. `errors`, `receiver`: settings of
    `PositionErrors` and `LooselyCoupled`; `ramp_mps`: rate along each of the two axes [m/s];
    `runs`, `seed`: run i is seeded by the pair (seed, i), whatever the attack and the receiver;
    `attack_s`, `after_s`: how long the ramp grows, and how long it then stays at its last offset
    [s]; `lead_in_s`: clean run before the onset [s]."""
    setup = LooselyCoupledSetup(
        detector=WATCHER,
        errors=errors,
        receiver=receiver,
        timeline={
            "warmup_s": lead_in_s,
            "live_s": lead_in_s,
            "attack_s": attack_s,
            "time_to_alert_s": after_s,
        },
        rate_limit_mps=max(ramp_mps, 1.0),
    )
    rngs = [np.random.default_rng([seed, i]) for i in range(runs)]
    engine = Engine(runs, setup)
    engine.reset(rngs)
    before, simulator = engine.warmup_alarm, engine.simulator
    action = np.full((runs, 2), ramp_mps / setup.attack.rate_limit_mps)
    seen: dict[str, list[FloatArray]] = {name: [] for name in Play._fields if name != "before"}
    memory = simulator.memory
    for k in range(setup.steps + setup.hold):
        R = memory["measurement_cov"].copy()
        verdict = engine.step(action if k < setup.steps else np.zeros_like(action))
        now, z = memory["measurement_cov"], memory["innovation"]
        S = memory["innovation_cov"] - R + now
        seen["masked"].append(np.einsum("bi,bi->b", z, np.linalg.solve(S, z[:, :, None])[:, :, 0]))
        seen["statistic"].append(verdict.statistic.max(axis=1))
        seen["error"].append(simulator.error_n())
        seen["scale"].append(memory["process_scale"].copy())
        seen["noise_sd"].append(np.sqrt(now[:, 0, 0]))
    return Play(before=before, **{name: np.array(values) for name, values in seen.items()})


def judge_statistic(statistic: FloatArray, test: dict[str, Any]) -> NDArray[np.bool_]:
    """Alarms of one test.  `statistic`: (K, B) of single epochs; `test`: ``window`` N (1);
    ``rule``: ``"sum"`` against chi- square of 3 N (the default), ``"mean"`` against the paper's
    25.9, or ``"estimated"`` with ``covariance_window`` w.  Returns (K, B) bool; windows reach back
    to the onset at most."""
    n = int(test.get("window", 1))
    total = np.cumsum(statistic, axis=0)
    total[n:] -= total[:-n].copy()
    rule = test.get("rule", "sum")
    if rule == "mean":
        return total > n * THRESHOLD
    if rule == "sum":
        return total > stats.chi2.isf(FALSE_ALARM, 3 * n)
    rows, w = np.array([3.0 * n]), int(test["covariance_window"])
    return total > estimated_covariance_thresholds(FALSE_ALARM, n, w, rows)[0]


def latency(alarm: NDArray[np.bool_]) -> FloatArray:
    """Time from the onset to the first alarm during the attack.  `alarm`: (K, B) bool, the first
    epoch being the first with an offset.  Returns (B,) [s]; NaN where there is none."""
    during = alarm[: round(ATTACK_S / INTERVAL_S)]
    first = np.round((during.argmax(axis=0) + 1) * INTERVAL_S, 6)
    return np.where(during.any(axis=0), first, np.nan)


def summarize_delays(delay: FloatArray) -> dict[str, float | None]:
    """Fraction detected, and median, mean and spread of the delays.  `delay`: (B,) [s], NaN where
    missed.  Returns ``detected``, ``runs``, ``median``, ``mean``, ``sd``; the last three None where
    nothing was detected."""
    found = delay[np.isfinite(delay)]
    share, runs = found.size / delay.size, float(delay.size)
    out: dict[str, float | None] = {"detected": share, "runs": runs}
    for name, of in (("median", np.median), ("mean", np.mean), ("sd", np.std)):
        out[name] = float(of(found)) if found.size else None
    return out


def latencies(
    errors: dict[str, float],
    receiver: dict[str, Any],
    tests: dict[str, dict[str, Any]],
    runs: int,
    seed: int,
    ramps: tuple[float, ...] = RAMPS,
) -> dict[str, Any]:
    """Part of the reproduction: latencies of one receiver under all ramps, by several tests.
    `tests`: as `judged` takes them, by name; with ``"masked": True`` on the covariance that the
    present residual has already entered; `ramps`: rates [m/s].  Returns by test and ramp what
    `told` gives; by ramp the share of epochs with an alarm at 25.9 during the attack and after it,
    and the mean horizontal error when the attack ends."""
    out: dict[str, Any] = {name: {} for name in tests}
    out |= {"duty": {}, "afterwards": {}, "error_m": {}}
    steps = round(ATTACK_S / INTERVAL_S)
    for ramp in ramps:
        run = play(errors, receiver, ramp, runs, seed)
        key = f"{ramp:g}"
        for name, test in tests.items():
            statistic = run.masked if test.get("masked") else run.statistic
            out[name][key] = summarize_delays(latency(judge_statistic(statistic, test)))
        alarm = run.statistic > THRESHOLD
        out["duty"][key] = float(alarm[:steps].mean())
        out["afterwards"][key] = float(alarm[steps:].mean())
        out["error_m"][key] = float(np.hypot(*run.error[steps - 1].T).mean())
    return out


def false_alarms(
    errors: dict[str, float], receiver: dict[str, Any], window: int, runs: int, seed: int
) -> dict[str, Any]:
    """Part of the reproduction: alarms of clean runs of 35 s, after the lead-in of 20 s.  `window`:
    w, for the threshold of an estimated covariance; 0 where it is known.  Returns shares of epochs
    with an alarm: ``rate`` at 25.9, ``early`` in the first 15 s alone, ``fitting`` at the threshold
    for an estimated covariance; number of ``epochs``; ``any``, share of runs with an alarm within
    15 s; mean ``nis``."""
    run = play(errors, receiver, 0.0, runs, seed, attack_s=35.0, after_s=0.0)
    alarm = run.statistic > THRESHOLD
    fitting = alarm
    if window:
        fitting = judge_statistic(run.statistic, {"rule": "estimated", "covariance_window": window})
    return {
        "epochs": int(alarm.size),
        "rate": float(alarm.mean()),
        "early": float(alarm[:EARLY].mean()),
        "fitting": float(fitting.mean()),
        "any": float(alarm[:EARLY].any(axis=0).mean()),
        "nis": float(run.statistic.mean()),
    }


def alarms_since_start(
    errors: dict[str, float], receiver: dict[str, Any], runs: int, seed: int
) -> dict[str, Any]:
    """Part of the reproduction: alarms of clean runs of 55 s by the time since the filter's start.
    Returns ``begin_s`` and ``end_s`` of every stretch, its share of epochs with an alarm at 25.9,
    ``rate``, and its mean statistic, ``nis``."""
    statistic = play(errors, receiver, 0.0, runs, seed, 55.0, 0.0, lead_in_s=0.0).statistic
    alarm = statistic > THRESHOLD
    edges = [round(second / INTERVAL_S) for second in STRETCHES_S]
    stretches = [slice(*pair) for pair in pairwise(edges)]
    return {
        "begin_s": list(STRETCHES_S[:-1]),
        "end_s": list(STRETCHES_S[1:]),
        "rate": [float(alarm[stretch].mean()) for stretch in stretches],
        "nis": [float(statistic[stretch].mean()) for stretch in stretches],
    }


def stability(
    errors: dict[str, float], window: int, process: str, runs: int, seed: int
) -> dict[str, Any]:
    """Part of the reproduction: where the scale of Q goes in clean runs of 30 s. Returns ``low``,
    ``median``, ``high``: quantiles 5, 50 and 95 % of the last scale; ``zero``: share of runs that
    end with Q = 0; ``negative``: mean number of epochs in which a full window left the scale alone,
    which with ``"skip"`` are those of a negative ratio; mean horizontal ``error_m`` at the end."""
    run = play(errors, make_self_tuning(window, process), 0.0, runs, seed, 30.0, 0.0, lead_in_s=0.0)
    low, median, high = np.quantile(run.scale[-1], [0.05, 0.5, 0.95])
    same = np.diff(run.scale[window - 1 :], axis=0) == 0.0
    return {
        "low": float(low),
        "median": float(median),
        "high": float(high),
        "zero": float((run.scale[-1] == 0.0).mean()),
        "negative": float(same.sum(axis=0).mean()),
        "error_m": float(np.hypot(*run.error[-1].T).mean()),
    }


def sample(seed: int) -> dict[str, Any]:
    """Part of the reproduction: one run of each filter, for the figures. Returns ``time`` [s], the
    ``offset`` of the spoofer [m], ``track`` east, north, up of the flight [m], and for
    ``conventional`` and ``tuned`` the errors of the solution north and east [m], of the GNSS
    position, and the statistic by ramp."""
    out: dict[str, Any] = {}
    for name, receiver in (("conventional", scale_noise(0.26)), ("tuned", make_self_tuning(100))):
        out[name] = {"statistic": {}}
        for ramp in RAMPS:
            setup = LooselyCoupledSetup(
                detector=WATCHER,
                errors=MARKOV,
                receiver=receiver,
                timeline={"warmup_s": 0.0, "live_s": 0.0, "attack_s": 25.0},
            )
            engine = Engine(1, setup)
            engine.reset([np.random.default_rng([seed, 0])])
            memory, log = engine.simulator.memory, []
            for k in range(300):
                rate = ramp / setup.attack.rate_limit_mps if 200 <= k < 250 else 0.0
                statistic = engine.step(np.full((1, 2), rate)).statistic.max()
                gnss_ne = memory["position_error"][0, [1, 0]] + memory["displacement"][0]
                log.append([statistic, *engine.simulator.error_n()[0], *gnss_ne])
            columns = np.array(log).T
            out[name]["statistic"][f"{ramp:g}"] = columns[0].tolist()
            if ramp == RAMPS[0]:
                out[name]["solution"] = columns[1:3].tolist()
                out[name]["gnss"] = columns[3:5].tolist()
    world = setup.world
    moved = (world.position_e[:301] - world.position_e[0]) @ world.C_el[0]
    out["track"] = moved.T.tolist()
    out["time"] = (np.arange(1, 301) * INTERVAL_S).tolist()
    return out
