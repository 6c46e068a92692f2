"""Blind optima of a campaign: the curves that are found against each detector.

Passive detectors share one response replay of runs that play nothing else.  A detector that
de-weights, or a victim or an attack that has no replay, is searched against on the engine, and the
result says so.  A curve found by replay is played on the engine, too, and where its displacement is
another one there, the search is done again on the engine.

The amplitude is fitted on training runs, where a few alarms decide.  So the plain curves and the
campaign's own profiles are fitted like the one that was found, and the best of them is played.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..detectors import Detector
from ..detectors.calibrated import resolve
from ..limits.response import NotReplayable, Replay, check_replayable
from ..simulators.clean_runs import weighs
from ..simulators.splits import seed_sequences
from ..simulators.tightly_coupled import TightlyCoupledSetup
from .blind_optimum import SHAPES, BlindOptimizer, BlindOptimum, BlindSearch
from .bracket import Brackets
from .budget import aim
from .entries import Entry
from .players import EnginePlayer, ReplayPlayer, limits_of
from .run import Runs, WarmStart, induced_error, play
from .specs import make_judge
from .suite import Suite

Tick = Callable[[float], None]
AIMS = ("budget", "half")
"""What a curve is for: the alarm budget of a stealthy attack, as far as an amplitude that is fitted
keeps it, or half of the runs alarming, by which the protection is given."""
LINEAR_ERROR = 0.02
"""How far the displacement on the engine may be from that of the replay, as a part of it."""
SPLIT = "search"
"""Runs that are searched on: an amplitude that is fitted on the same ones would be too large."""
IDLE = 1e-9
"""Part of its rates at which an attack is commanded nothing."""
REPLAY, ENGINE = "response replay", "engine"
FOUND, PLAIN = "found", ("constant", "linear")
"""Curves whose amplitude is fitted: the one that was found, and shapes of the rate."""
ZERO_ALARM, BEFORE = "zero-alarm shape", "found before"
"""A shape that is fitted, too, and one that a search starts from where another has found it."""


class Optima:
    """Searches of one campaign."""

    def __init__(
        self, suite: Suite, threads: int | None = None, brackets: Brackets | None = None
    ) -> None:
        self.suite, self.threads, self.settings = suite, threads, BlindSearch()
        self.brackets = brackets or Brackets(suite)
        self._replay: Replay | None = None
        self._numbers: dict[str, int] | None = None

    def find(self, detector: Entry, spoofer: Entry, tick: Tick) -> dict[str, Any]:
        """Curves by `AIMS`, ``aims``, with their ``rates_mps``; ``by``, what played the candidates.
        `spoofer`: a blind optimum without rates, for its heading."""
        generators = self.suite.generators(SPLIT, self.settings.runs)
        start = WarmStart(self.suite.setup(detector), generators, threads=self.threads)
        clean = play(start, "none")
        heading_deg = spoofer.spec["heading_deg"]
        shape = self._zero_alarm(detector)
        replayed, why = self._player(detector, heading_deg)
        error = None
        if replayed is not None:
            found = self._search(replayed, tick)
            spec = {**spoofer.untuned, "rates_mps": found[AIMS[0]]["rates_mps"]}
            error = linear_error(replayed, spec, start, clean)
            if error <= LINEAR_ERROR:
                return {"by": REPLAY, "linear_error": error, "aims": found, "shapes": shape}
            why = f"the displacement by replay is off by {100.0 * error:.1f} %"
        found = self._search(EnginePlayer(start, clean, heading_deg), tick)
        return {
            "by": ENGINE,
            "why": why,
            "linear_error": error,
            "aims": found,
            "shapes": shape,
        }

    def _search(self, player: ReplayPlayer | EnginePlayer, tick: Tick) -> dict[str, Any]:
        found: dict[str, Any] = {}
        best: BlindOptimum | None = None
        least = 1.0
        tuning = self.suite.tuning
        for name, share in zip(AIMS, (aim(tuning.runs, tuning.budget), 0.5), strict=True):
            # what gets as far as any attack at few alarms does so at more of them
            if best is None or not best.free or share < least:
                others = {} if best is None else {BEFORE: best.rates_mps}
                best = BlindOptimizer(player, share, self.settings).search(others, tick)
                least = share
            found[name] = {
                "share": share,
                "rates_mps": [float(f"{rate:.6g}") for rate in best.rates_mps],
                "displacement_m": best.displacement_m,
                "start": best.start,
                "start_m": best.start_m,
            }
        return found

    def _zero_alarm(self, detector: Entry) -> dict[str, list[float]]:
        """Shape of the attack that gets farthest without an alarm of its own doing, if known. It is
        fitted, and no start of the search, which got less far from there in its few generations: 49
        m against `cusum` of range rates, and 54 m from plain shapes."""
        rates = self.brackets.zero_alarm(detector).rates_mps
        shape = np.mean(rates, axis=0) if rates else np.zeros(1)
        return {ZERO_ALARM: shape.tolist()} if np.any(shape > 0.0) else {}

    def _player(self, detector: Entry, heading_deg: float | str) -> tuple[ReplayPlayer | None, str]:
        """The detector on the shared replay; None, and why, where it has none."""
        setup = self.suite.world
        if not isinstance(setup, TightlyCoupledSetup):
            return None, f"{setup.whose} has no linear response here"
        try:
            judge = self._judge(detector)
            check_replayable(judge)
            if weighs(setup, judge):
                return None, "the detector takes weight off measurements"
            replay, numbers = self._recorded(setup)
        except NotReplayable as error:
            return None, str(error)
        return ReplayPlayer(replay, numbers[detector.label], heading_deg), ""

    def _judge(self, detector: Entry) -> Detector:
        judge = make_judge(detector.spec)
        resolve(judge, self.suite.world)
        return judge

    def _recorded(self, setup: TightlyCoupledSetup) -> tuple[Replay, dict[str, int]]:
        """The replay of all passive detectors, and their numbers."""
        if self._replay is None or self._numbers is None:
            judges = {}
            for entry in self.suite.detector_entries:
                judge = self._judge(entry)
                try:
                    check_replayable(judge)
                except NotReplayable:
                    continue
                if not weighs(setup, judge):
                    judges[entry.label] = judge
            seeds = seed_sequences(self.suite.entropy, SPLIT, setup.name, self.settings.runs)
            everyone = list(judges.values())
            self._replay = Replay(setup, everyone, seeds, threads=self.threads)
            self._numbers = {label: k for k, label in enumerate(judges)}
        return self._replay, self._numbers


def curves_to_fit(suite: Suite, found: dict[str, Any]) -> dict[str, list[float]]:
    """The curve for the budget, and others that get as far, by their names. Nothing gets farther
    than the largest rate: where that was found, it is the only one."""
    rates = np.array(found["aims"][AIMS[0]]["rates_mps"])
    limit, _ = limits_of(suite.world)
    curves = {FOUND: rates}
    if rates.min() < limit:
        t = np.linspace(0.0, 1.0, len(rates))
        plain = {name: SHAPES[name](t) for name in PLAIN}
        plain |= {
            entry.label: np.array(entry.spec["rates_mps"])
            for entry in suite.spoofer_entries
            if entry.spec["name"] == "profile" and not entry.spec["cross_rates_mps"]
        }
        plain |= {name: np.array(each) for name, each in found["shapes"].items()}
        for name, shape in plain.items():
            # its amplitude may exceed 1, and the attack's limit holds after that
            shape = np.interp(t, np.linspace(0.0, 1.0, len(shape)), shape)
            size = min(rates.mean() / shape.mean(), limit / np.abs(shape).max())
            curves[name] = size * shape
    return {name: [float(f"{rate:.6g}") for rate in each] for name, each in curves.items()}


def linear_error(
    player: ReplayPlayer, spec: dict[str, Any], start: WarmStart, clean: Runs
) -> float:
    """How far the engine displaces from what the replay says, as a part of it, in the mean."""
    attacked, still = play(start, spec), clean
    if not start.setup.attack.idle_is_clean:  # what is commanded displaces, not the own errors
        still = play(start, {**spec, "rates_mps": [IDLE * rate for rate in spec["rates_mps"]]})
    engine = induced_error(start.setup, attacked, still)[: start.setup.steps]
    optimizer = BlindOptimizer(player, 0.5, BlindSearch())
    everyone = np.arange(min(player.replay.runs, engine.shape[1]))
    curves = optimizer.curves(np.array([spec["rates_mps"]]))
    linear = player.replay.errors(curves, everyone)[: start.setup.steps, 0]
    size = float(linear.max(axis=0).mean())
    return float(np.abs(engine[:, everyone] - linear).max(axis=0).mean() / max(size, 1e-9))
