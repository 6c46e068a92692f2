"""The optimized open-loop attack: the best found against a detector, by CMA-ES over curves.

Candidates (`hansen2006`) are played on response replay, which adds an attack to recorded clean runs
and calls the detector itself; on the engine where a detector de-weights, so that replay does not
hold.  A rate at the start of a long window displaces much more than one at its end, and is seen as
much sooner: so a search does not step in rates, but in parts of the rate at which each knot alone
raises an alarm in half of the runs.  Every generation is played on another part of the runs, so
that the mean of the search does not learn the noise of a few of them by heart.  Every candidate is
scored at the amplitude that its share of alarms allows.  For each run the amplitude at which its
largest ratio of statistic to threshold comes to 1 is interpolated between two that are judged; the
score is the displacement at the quantile of these, by a line through the smaller ones against
normal scores, which a single run moves less than the quantile itself.

Another aim is P(HMI): every candidate is scored at the amplitude that takes it over the alert limit
by the share of the runs in which it raises no alarm.

In a campaign passive detectors share one response replay.  A curve found by replay is played on the
engine, too, and where its displacement is another one there, the search is done again on the
engine.  A few alarms decide on an amplitude: so the plain curves and the campaign's own profiles
are fitted like the one that was found, and the best one is played: on training runs by the rule
`upper-limit`; by `exact` on the scored ones, where the curve is chosen on one half of the runs and
scored on the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from ...core.declared import setting, settings_record
from ...limits.linear import get_rate_limits
from ...limits.response import NotReplayable, Replay, check_replayable
from ...simulation.domain import draw
from ...simulation.setup import Setup, seed_sequences
from ...simulation.simulator import weighs
from ...simulation.tight import TightlyCoupledSetup
from ...spoofers.profile import MOST_KNOTS, sample_curve
from ..runs.panel import Panel, play_searches
from ..runs.play import FloatArray, Runs, WarmStart, induced_error, play
from ..runs.players import PlayerSpec
from ..runs.record import MEASURES
from ..scores.at_budget import score_best
from ..scores.statistics import aim
from .alarm_amplitude import tune_at_budget
from .amplitude import EXACT, Tuning, TuningResult, search_work, tune_amplitude, with_rates
from .backends import Backend, EngineBackend, ReplayBackend, Rows
from .bounds import DisplacementBounds

WorkCallback = Callable[[float], None]
LADDER = np.geomspace(1e-3, 1.0, 13)
"""Parts of the largest rate at which the first curves are tried."""
PAIR = (0.93, 1.075)  # amplitudes at which a candidate is judged, around that of the best so far
STEEPEST, FLATTEST = 4.0, 0.1
"""Largest and smallest power of the amplitude by which a largest ratio is taken to grow."""
FEWEST = 2  # runs that a search takes
AT_ONCE = 24  # attacks that are judged together
SPREAD = 0.15
"""Standard deviation of the first candidates, as a part of the root mean square of the start."""
LOWER_PART = 0.3  # part of the runs above the share; their amplitudes decide on the quantile, too
SATURATION = 0.95
"""Part of the farthest reach of the attack from which on a search is over before it begins."""
BEYOND = 1.03  # mean displacement over the alert limit, so that nearly all runs get beyond it
NEVER_SEEN = 5.0  # margin, in standard deviations, from which on there is nothing to gain
WIDEST, SLOWEST_GROWTH = 4.0, 0.25
"""Factor that a candidate may need to get to the alert limit, and the smallest power of the
amplitude by which it is taken to get farther."""
SHAPES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "ramp": lambda t: np.ones_like(t),
    "smooth entry": lambda t: np.where(t < 0.5, t * t * (12.0 - 16.0 * t), 1.0),
    "accelerating ramp": lambda t: t,
    "ramp that levels off": lambda t: np.sin(0.5 * np.pi * t) ** 1.3,
    "cubic ramp": lambda t: t * t,
    "ramp of the fifth degree": lambda t: t**4,
    "ramp that accelerates": lambda t: 0.3 + 0.7 * t,
    "late accelerating ramp": lambda t: np.clip(2.0 * t - 1.0, 0.0, None),
}
"""Rates over the attack window of the curves that a search starts from."""


@settings_record(frozen=True, kw_only=True)
class OpenLoopSearch:
    """How an optimized open-loop attack is looked for."""

    runs: int = setting(
        default=512, least=8, help="Clean runs of the search, of a split of their own."
    )
    batch: int = setting(default=256, least=4, help="Runs that a generation is played on.")
    knots: int = setting(default=12, least=2, most=MOST_KNOTS, help="Knots of the curve.")
    population: int = setting(default=12, least=4, help="Size of a generation of CMA-ES.")
    generations: int = setting(
        default=60, least=0, help="Generations of CMA-ES; 0 for the best of the first curves."
    )
    seed: int = setting(default=0, least=0, help="Seed of the search.")


class OpenLoopAttack(NamedTuple):
    """A curve that a search has found: (knots,) rates at the amplitude that the share of alarms
    allows, what it gets there by the score of the search, the shape that it began at and what that
    gets, and whether it gets as far as any attack, so that nothing was left to search for."""

    rates_mps: FloatArray
    displacement_m: float
    start: str
    start_m: float
    saturated: bool = False


class OpenLoopOptimizer:
    """Search for the curve that gets farthest while some share of the runs may alarm."""

    def __init__(self, backend: Backend, share: float, settings: OpenLoopSearch) -> None:
        self.backend, self.share, self.settings = backend, share, settings
        self.all_runs = np.arange(backend.runs)

    def search(
        self, others: Mapping[str, FloatArray] | None = None, tick: WorkCallback | None = None
    ) -> OpenLoopAttack:
        """Search, from the best of some shapes, with `others` (n,) among them, by their names. With
        fewer than two runs no share of them can be estimated: the result is the slowest of the
        first curves. The rates are within the attack's limit, as they were judged."""
        advance = tick or (lambda part: None)
        found, (limit, _) = self._search(others or {}, advance), self.backend.limits
        return found._replace(rates_mps=np.clip(found.rates_mps, -limit, limit))

    def _search(self, others: Mapping[str, FloatArray], advance: WorkCallback) -> OpenLoopAttack:
        t = np.linspace(0.0, 1.0, self.settings.knots)
        if self.backend.runs < FEWEST:
            slowest = np.full(len(t), LADDER[0] * self.backend.limits[0])
            return OpenLoopAttack(slowest, 0.0, "ramp", 0.0)
        if (fastest := self._try_fastest(len(t))) is not None:
            return fastest
        found, free = self._ladder(self._shapes(t, others))
        advance(0.2)
        if free:
            return found._replace(saturated=True)
        means = [found.rates_mps, *self._generations(found.rates_mps, advance)]
        third = np.array(means[-max(len(means) // 3, 1) :])
        last = np.array([means[0], *third, third.mean(axis=0)])
        scores, rates = self._pairs(last, self._size(means[0]), self.all_runs)
        best = int(np.argmax(scores))
        return found._replace(rates_mps=rates[best], displacement_m=float(scores[best]))

    def _shapes(self, t: FloatArray, others: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Curves (knots,) that a search may start from, the largest value 1."""
        shapes = {name: shape(t) for name, shape in SHAPES.items()}
        for name, other in others.items():
            at_knots = np.interp(t, np.linspace(0.0, 1.0, len(other)), other)
            shapes[name] = at_knots / np.abs(at_knots).max()
        return shapes

    def _size(self, rates: FloatArray) -> Any:
        """(...) size of rates (..., knots), by which they are compared at one amplitude."""
        return rates.mean(axis=-1)

    def _try_fastest(self, knots: int) -> OpenLoopAttack | None:
        """The fastest curve of all, where no run alarms at it: nothing gets farther."""
        fastest = np.full(knots, self.backend.limits[0])
        peak, reach = self._judge(fastest[None], self._batch(0))
        if (peak > 1.0).any():
            return None
        return OpenLoopAttack(fastest, float(reach[0]), "ramp", float(reach[0]), True)

    def _ladder(self, shapes: dict[str, FloatArray]) -> tuple[OpenLoopAttack, bool]:
        limit, _ = self.backend.limits
        scales, found = LADDER * limit, OpenLoopAttack(np.zeros(0), -1.0, "", -1.0)
        edges, reach = self._climb(np.array(list(shapes.values())), scales)
        for (name, shape), of_runs, farthest in zip(shapes.items(), edges, reach, strict=True):
            scale, score = self._score_shape(of_runs, scales, farthest)
            if not found.start or score > found.displacement_m:
                found = OpenLoopAttack(scale * shape, score, name, score)
        return found, self._is_free(found.displacement_m, float(reach.max()))

    def _score_shape(
        self, edges: FloatArray, scales: FloatArray, reach: FloatArray
    ) -> tuple[float, float]:
        """Amplitude of a shape, and its score there; (N,) `edges` of single runs, `reach` (L,)."""
        scale = self._fit_amplitude(edges)
        return scale, float(np.interp(math.log(scale), np.log(scales), reach))

    def _score_pairs(
        self, edges: FloatArray, middle: float, reach: FloatArray, growth: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(P,) amplitudes of curves, and their scores there; (P, N) `edges` of single runs, (P,)
        `reach` at an amplitude `middle`, and the power `growth` of it by which it grows."""
        scale = np.array([self._fit_amplitude(each) for each in edges])
        return scale, reach * (scale / middle) ** growth

    def _is_free(self, score: float, farthest: float) -> bool:
        """Whether nothing is left to search for."""
        return score >= SATURATION * farthest

    def _climb(self, shapes: FloatArray, scales: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(P, N) amplitudes at which single runs alarm, and (P, L) how far shapes (P, knots) get at
        each of L `scales`."""
        tried = (shapes[:, None] * scales[:, None]).reshape(-1, shapes.shape[1])
        peak, reach = self._judge(tried, self._batch(0))
        by_shape = peak.reshape(len(shapes), len(scales), -1)
        edges = [[crossing(scales, column) for column in own.T] for own in by_shape]
        return np.array(edges), reach.reshape(len(shapes), -1)

    def _fit_amplitude(self, edges: FloatArray) -> float:
        """Amplitude that a share of alarms allows, by (N,) those at which single runs alarm."""
        slope, level = fit_log_normal(edges, self.share + LOWER_PART)
        return float(np.exp(level + slope * special.ndtri(self.share)))

    def _batch(self, turn: int) -> Rows:
        """Runs of a turn; all have theirs before any comes again."""
        size = min(self.settings.batch, len(self.all_runs))
        again, part = divmod(turn, max(len(self.all_runs) // size, 1))
        order = np.random.default_rng([self.settings.seed, again]).permutation(self.all_runs)
        return np.asarray(np.sort(order[part * size : (part + 1) * size]))

    def _judge(self, rates: FloatArray, rows: Rows) -> tuple[FloatArray, FloatArray]:
        """Play (P, knots) rates, as the attack's limits let them be followed."""
        curves = self.curves(rates)
        starts = range(0, len(rates), AT_ONCE)
        parts = [self.backend.play(curves[k : k + AT_ONCE], rows) for k in starts]
        peak, reach = (np.concatenate(each) for each in zip(*parts, strict=True))
        return peak, reach

    def curves(self, rates: FloatArray) -> FloatArray:
        """Sampled curves (P, steps) of rates at knots (P, knots), within the attack's limits."""
        steps, (limit, most) = self.backend.steps, self.backend.limits
        wanted = np.array([sample_curve(tuple(rate.tolist()), steps) for rate in rates])
        wanted = np.clip(wanted, -limit, limit)
        if math.isinf(most):
            return np.asarray(wanted)
        now: FloatArray = np.zeros(len(wanted))
        out: FloatArray = np.empty(wanted.shape)
        for k in range(steps):
            now = now + np.clip(wanted[:, k] - now, -most, most)
            out[:, k] = now
        return out

    def _generations(self, start: FloatArray, advance: WorkCallback) -> Iterator[FloatArray]:
        """Means of CMA-ES, each at the amplitude of its score."""
        try:
            from cmaes import CMA
        except ImportError as error:
            raise ImportError(
                "the search for an open-loop attack needs cmaes: pip install 'spoofgym[limits]'"
            ) from error
        settings, size, limit = self.settings, self.settings.population, self.backend.limits[0]
        edges, _ = self._climb(np.eye(len(start)), LADDER * limit)
        unit = np.median(edges, axis=1)
        sd = SPREAD * float(np.sqrt(np.mean((start / unit) ** 2)))
        cma = CMA(start / unit, sd, seed=settings.seed, population_size=size)
        moved = float(self._size(start))
        for turn in range(settings.generations):
            # the mean is one of the candidates: it learns the noise of a few runs the least
            points = [cma.mean.copy(), *(cma.ask() for _ in range(size - 1))]
            scores, rates = self._pairs(np.array(points) * unit, moved, self._batch(turn))
            cma.tell([(x, -score) for x, score in zip(points, scores.tolist(), strict=True)])
            moved = float(self._size(rates[0]))
            advance(0.8 / settings.generations)
            yield rates[0]

    def _pairs(self, rates: FloatArray, moved: float, rows: Rows) -> tuple[FloatArray, FloatArray]:
        """Scores of (P, knots) rates, and these at the amplitudes of the scores. All are brought to
        the same mean rate first, so that they are judged near their amplitude."""
        mean = self._size(rates)
        factor = np.where(mean * moved > 0.0, moved / np.where(mean, mean, 1.0), 1.0)
        rates = rates * factor[:, None]
        peak, reach = self._judge(np.concatenate([part * rates for part in PAIR]), rows)
        low, high = np.log(np.maximum(peak, 1e-300)).reshape(2, len(rates), -1)
        width, middle = math.log(PAIR[1] / PAIR[0]), math.sqrt(PAIR[0] * PAIR[1])
        power = np.clip((high - low) / width, FLATTEST, STEEPEST)
        edges = middle * np.exp(np.clip(-0.5 * (low + high) / power, -1.5, 1.5))
        near, far = reach.reshape(2, -1)
        growth = np.clip(np.log(far / near) / width, 0.0, 1.5)
        scale, score = self._score_pairs(edges, middle, np.sqrt(near * far), growth)
        return score, rates * scale[:, None]


class HazardOptimizer(OpenLoopOptimizer):
    """Search for the curve that most often gets to an alert limit without an alarm. The score, in
    the place of the displacement, is the quantile of P(HMI), `special.ndtr` of which it is."""

    def __init__(self, backend: Backend, limit_m: float, settings: OpenLoopSearch) -> None:
        super().__init__(backend, 0.5, settings)
        self.limit_m = BEYOND * limit_m

    def _try_fastest(self, knots: int) -> OpenLoopAttack | None:
        found = super()._try_fastest(knots)
        if found is None:
            return None
        score = NEVER_SEEN if found.displacement_m > self.limit_m else -NEVER_SEEN
        return found._replace(displacement_m=score, start_m=score)

    def _score_shape(
        self, edges: FloatArray, scales: FloatArray, reach: FloatArray
    ) -> tuple[float, float]:
        if reach[-1] < self.limit_m:
            return float(scales[-1]), -NEVER_SEEN
        scale = math.exp(np.interp(self.limit_m, reach, np.log(scales)))
        return scale, self._margin(edges, scale)

    def _score_pairs(
        self, edges: FloatArray, middle: float, reach: FloatArray, growth: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        power = 1.0 / np.maximum(growth, SLOWEST_GROWTH)
        wanted = middle * (self.limit_m / np.maximum(reach, 1e-9)) ** power
        scale = np.clip(wanted, 1.0 / WIDEST, WIDEST)
        pairs = zip(edges, scale.tolist(), strict=True)
        margin = np.array([self._margin(*each) for each in pairs])
        return scale, np.where(wanted > WIDEST, -NEVER_SEEN, margin)

    def _margin(self, edges: FloatArray, scale: float) -> float:
        """Standard deviations of the runs' logarithmic amplitudes between an amplitude and them."""
        slope, level = fit_log_normal(edges, 1.0)
        margin = (level - math.log(scale)) / max(slope, 1e-3)
        return float(np.clip(margin, -NEVER_SEEN, NEVER_SEEN))

    def _is_free(self, score: float, farthest: float) -> bool:
        return abs(score) >= NEVER_SEEN


def fit_log_normal(amplitudes: FloatArray, part: float) -> tuple[float, float]:
    """Slope and level of a line through logarithmic amplitudes against normal scores, the smallest
    `part` of them."""
    count = len(amplitudes)
    lowest = min(max(4, math.ceil(part * count)), count)
    normal = special.ndtri((np.arange(lowest) + 0.5) / count)
    slope, level = np.polyfit(normal, np.log(np.sort(amplitudes)[:lowest]), 1)
    return float(slope), float(level)


def crossing(amplitudes: FloatArray, peak: FloatArray) -> float:
    """Amplitude at which a largest ratio comes to 1, between those that were judged."""
    above = np.flatnonzero(peak > 1.0)
    if not len(above):
        return float(amplitudes[-1])
    k = int(above[0])
    if k == 0:
        return float(amplitudes[0])
    low, high = (math.log(max(float(peak[j]), 1e-12)) for j in (k - 1, k))
    ratio = float(amplitudes[k] / amplitudes[k - 1])
    return float(amplitudes[k - 1] * ratio ** min(max(-low / max(high - low, 1e-12), 0.0), 1.0))


AIMS = ("budget", "half", "hmi")
"""What a curve is for: the alarm budget of a stealthy attack, as far as an amplitude that is fitted
keeps it; half of the runs alarming, by which the protection is given; most runs that come beyond
the alert limit without an alarm, where there is one."""
LINEAR_ERROR = 0.02
"""How far the displacement on the engine may be from that of the replay, as a part of it."""
RUNS_EACH = 4  # runs that are searched on at most for each that amplitudes are fitted on
SHARED_STREAM = 0x5C  # of the seed of a search, for the circumstances that its runs share
SPLIT = "search"
"""Runs that are searched on: an amplitude that is fitted on the same ones would be too large."""
QUICK = OpenLoopSearch(runs=96, batch=24, generations=4)
"""Of a quick budget, for the first aim alone; its curve is the only one that is fitted."""
LONG = OpenLoopSearch(batch=512, generations=200)
"""Of other campaigns. With 60 generations of 256 runs the curve against solution separation on the
victim's filter got 3 and 6 % less in S1, on other runs."""
JUDGED = {"batch": 48, "generations": 24}
"""Most of a search where candidates are judged, and no sums, which cost a hundredth of that."""
NOTHING_BETTER = 1.01
"""Displacement, by that of the start, up to which a search has found nothing better."""
IDLE = 1e-9  # part of its rates at which an attack is commanded nothing
REPLAY, ENGINE, STORED = "response replay", "engine", "the task's stored search"
BEST_CURVE, PLAIN = "found", ("ramp", "accelerating ramp")
"""Curves whose amplitude is fitted: the one that was found, and shapes of the rate."""
ZERO_ALARM, BEFORE = "zero-alarm shape", "found before"
"""A shape that is fitted, too, and one that a search starts from where another has found it."""


def name_unbeaten_start(found: Mapping[str, Any]) -> str | None:
    """Shape that a search started from, where it has found nothing better."""
    played, search = found["played"]["curve"], found["aims"][AIMS[0]]
    if played != BEST_CURVE:
        return str(played)
    if "start" not in search:  # it was made before, and the task's page says it
        return None
    improved = search["displacement_m"] > NOTHING_BETTER * search["start_m"]
    return None if improved else str(search["start"])


def share_skies(setup: Setup, entropy: int, runs: int) -> dict[str, Any]:
    """World, start and age of runs: one start and one age for every sky, so that its runs share
    their response, which is computed 32 times for 32 skies, and not for each of 512 runs."""
    rng, bounds = np.random.default_rng([entropy, SHARED_STREAM]), setup.bounds
    choice = draw(bounds, rng.integers(0, 2**63, (bounds.worlds, 2), dtype=np.uint64))
    world = np.arange(runs) % bounds.worlds
    times = {"start_s": choice.start, "age_s": choice.age}
    return {"world": world, **{name: of[world] * setup.interval_s for name, of in times.items()}}


def search_aims(
    backend: Backend,
    tuning: Tuning,
    settings: OpenLoopSearch,
    alert_limit_m: float | None,
    tick: WorkCallback = lambda part: None,
) -> dict[str, Any]:
    """Curves that get farthest, by `AIMS`; the first one alone where the search is quick."""
    found: dict[str, Any] = {}
    best: OpenLoopAttack | None = None
    least = 1.0
    for name, most in {} if backend.sums else JUDGED.items():
        settings = replace(settings, **{name: min(getattr(settings, name), most)})
    budget = aim(tuning.runs, tuning.budget)
    for name, share in zip(AIMS, (budget,) if tuning.quick else (budget, 0.5), strict=False):
        # what gets as far as any attack at few alarms does so at more of them
        if best is None or not best.saturated or share < least:
            others = {} if best is None else {BEFORE: best.rates_mps}
            best = OpenLoopOptimizer(backend, share, settings).search(others, tick)
            least = share
        found[name] = {
            "share": share,
            "rates_mps": [float(f"{rate:.6g}") for rate in best.rates_mps],
            "displacement_m": best.displacement_m,
            "start": best.start,
            "start_m": best.start_m,
        }
    if alert_limit_m is not None and best is not None and not tuning.quick:
        best = HazardOptimizer(backend, alert_limit_m, settings).search({BEFORE: best.rates_mps})
        found[AIMS[2]] = {
            "limit_m": alert_limit_m,
            "rates_mps": [float(f"{rate:.6g}") for rate in best.rates_mps],
            "p_hmi": float(special.ndtr(best.displacement_m)),
            "start": best.start,
            "start_p_hmi": float(special.ndtr(best.start_m)),
        }
    return found


class Optima:
    """Searches for open-loop attacks against the detectors of `brackets`, in its world. `spoofers`
    also play there; the profiles among them are candidates of a search. `alert_limit_m`: that of
    the aim ``hmi``, which is left out without one. `stored`: rates at the knots of curves that were
    found before, by the labels of detectors; these are not searched again. `device`: where the
    engine plays candidates."""

    def __init__(
        self,
        brackets: DisplacementBounds,
        tuning: Tuning,
        spoofers: Sequence[PlayerSpec] = (),
        threads: int | None = None,
        alert_limit_m: float | None = None,
        settings: OpenLoopSearch | None = None,
        stored: Mapping[str, Sequence[float]] | None = None,
        device: str = "cpu",
    ) -> None:
        self.device = device
        self.bounds, self.tuning, self.spoofers = brackets, tuning, spoofers
        self.stored = stored or {}
        self.alert_limit_m = alert_limit_m
        self.world, self.threads = brackets.world, threads
        own = settings or (QUICK if tuning.quick else LONG)
        self.settings = replace(own, runs=min(own.runs, max(RUNS_EACH * tuning.runs, 8)))
        self._replay: Replay | None = None
        self._numbers: dict[str, int] | None = None
        self._unwatched: tuple[WarmStart, Runs] | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """Largest rate and its largest change, as the attack and the world's actions have them."""
        largest, most = get_rate_limits(self.world.setup)
        return min(largest, self.world.context.largest_rate[1]), most

    def _start(
        self, setup: Setup, shared: bool = False, device: str = "cpu"
    ) -> tuple[WarmStart, Runs]:
        """Runs that are searched on, at the onset, and what they do without attack; `shared`: with
        the circumstances of those of the replay."""
        entropy, runs = self.bounds.entropy, self.settings.runs
        rngs = self.world.generators(entropy, SPLIT, runs)
        given = share_skies(setup, entropy, runs) if shared else None
        start = WarmStart(setup, rngs, threads=self.threads, device=device, given=given)
        return start, play(start, "none")

    def find(self, detector: PlayerSpec, spoofer: PlayerSpec, tick: WorkCallback) -> dict[str, Any]:
        """Curves by `AIMS`, ``aims``, with their ``rates_mps``; ``by``, what played the candidates.
        `spoofer`: an optimized open-loop attack without rates, for its heading."""
        if detector.label in self.stored:
            rates = [*self.stored[detector.label]]
            return {"by": STORED, "aims": {AIMS[0]: {"rates_mps": rates}}, "shapes": {}}
        heading_deg = spoofer.spec["heading_deg"]
        shape = self._zero_alarm(detector)
        replayed, why = self._replay_backend(detector, heading_deg)
        error, sizes = None, (self.tuning, self.settings, self.alert_limit_m)
        if replayed is not None:
            replayed.limits = self.limits
            found = search_aims(replayed, *sizes, tick)
            spec = {**spoofer.fixed_spec, "rates_mps": found[AIMS[0]]["rates_mps"]}
            # a passive detector changes no displacement
            self._unwatched = self._unwatched or self._start(self.world.setup, shared=True)
            error = linear_error(replayed, spec, *self._unwatched)
            if error <= LINEAR_ERROR:
                return {"by": REPLAY, "linear_error": error, "aims": found, "shapes": shape}
            why = f"the displacement by replay is off by {100.0 * error:.1f} %"
        setup = self.world.build_setup(detector, self.spoofers)
        start = self._start(setup, device=self.device)
        engine = EngineBackend(*start, heading_deg)
        engine.limits = self.limits
        found = search_aims(engine, *sizes, tick)
        how = {"by": ENGINE, "why": why, "linear_error": error}
        return {**how, "aims": found, "shapes": shape}

    def _zero_alarm(self, detector: PlayerSpec) -> dict[str, list[float]]:
        """Shape of the attack that gets farthest without an alarm, if known: fitted, and no start
        of the search, which got less far from there (49 m, not 54, against `cusum` of range
        rates)."""
        rates = self.bounds.zero_alarm(detector).rates_mps
        shape = np.mean(rates, axis=0) if rates else np.zeros(1)
        return {ZERO_ALARM: shape.tolist()} if np.any(shape > 0.0) else {}

    def _replay_backend(
        self, detector: PlayerSpec, heading_deg: float | str
    ) -> tuple[ReplayBackend | None, str]:
        """The detector on the shared replay; None, and why, where it has none."""
        setup = self.world.setup
        if not isinstance(setup, TightlyCoupledSetup):
            return None, f"{setup.whose} has no linear response here"
        try:
            judge = self.world.judge(detector)
            check_replayable(judge)
            if weighs(setup, judge):
                return None, "the detector takes weight off measurements"
            replay, numbers = self._record_replay(setup)
        except NotReplayable as error:
            return None, str(error)
        return ReplayBackend(replay, numbers[detector.label], heading_deg), ""

    def _record_replay(self, setup: TightlyCoupledSetup) -> tuple[Replay, dict[str, int]]:
        if self._replay is None or self._numbers is None:
            judges = {}
            for entry in self.bounds.detectors:
                judge = self.world.judge(entry)
                try:
                    check_replayable(judge)
                except NotReplayable:
                    continue
                if not weighs(setup, judge):
                    judges[entry.label] = judge
            entropy, runs = self.bounds.entropy, self.settings.runs
            seeds = seed_sequences(entropy, SPLIT, setup.name, runs)
            everyone = list(judges.values())
            given = share_skies(setup, entropy, runs)
            self._replay = Replay(setup, everyone, seeds, threads=self.threads, given=given)
            self._numbers = {label: k for k, label in enumerate(judges)}
        return self._replay, self._numbers

    def curves_to_fit(self, found: dict[str, Any]) -> dict[str, list[float]]:
        """The curve for the budget, and others that get as far, by their names. Nothing gets
        farther than the largest rate: where that was found, it is the only one."""
        rates = np.array(found["aims"][AIMS[0]]["rates_mps"])
        limit, _ = self.limits
        curves = {BEST_CURVE: rates}
        if rates.min() < limit and not self.tuning.quick:
            t = np.linspace(0.0, 1.0, len(rates))
            plain = {name: SHAPES[name](t) for name in PLAIN}
            plain |= {
                entry.label: np.array(entry.spec["rates_mps"])
                for entry in self.spoofers
                if entry.spec["name"] == "profile" and not entry.spec["cross_rates_mps"]
            }
            plain |= {name: np.array(each) for name, each in found["shapes"].items()}
            for name, shape in plain.items():
                # its amplitude may exceed 1, and the attack's limit holds after that
                shape = np.interp(t, np.linspace(0.0, 1.0, len(shape)), shape)
                curves[name] = min(rates.mean() / shape.mean(), limit / np.abs(shape).max()) * shape
        return {name: [float(f"{rate:.6g}") for rate in each] for name, each in curves.items()}


def linear_error(
    backend: ReplayBackend, spec: dict[str, Any], start: WarmStart, clean: Runs
) -> float:
    """How far the engine displaces from what the replay says, as a part of it, in the mean."""
    attacked, still = play(start, spec), clean
    if not start.setup.attack.idle_is_clean:  # what is commanded displaces, not the own errors
        still = play(start, {**spec, "rates_mps": [IDLE * rate for rate in spec["rates_mps"]]})
    engine = induced_error(start.setup, attacked, still)[: start.setup.steps]
    optimizer = OpenLoopOptimizer(backend, 0.5, OpenLoopSearch())
    everyone = np.arange(min(backend.replay.runs, engine.shape[1]))
    curves = optimizer.curves(np.array([spec["rates_mps"]]))
    linear = backend.replay.errors(curves, everyone)[: start.setup.steps, 0]
    size = float(linear.max(axis=0).mean())
    return float(np.abs(engine[:, everyone] - linear).max(axis=0).mean() / max(size, 1e-9))


def fit(
    panel: Panel,
    detectors: Mapping[int, PlayerSpec],
    entry: PlayerSpec,
    settings: Tuning,
    optima: Callable[[], Optima],
    tick: Callable[[float], None] = lambda _: None,
) -> Iterator[TuningResult]:
    """Search for a spoofer's setting against detectors of a panel, in their order; of an open-loop
    attack for its curve first, the best of several being scored on runs that it was not chosen
    on."""
    if not entry.needs_search:
        yield from _tune(panel, [(k, d, entry) for k, d in detectors.items()], settings, tick)
        return
    share = 0.25 * search_work(settings, panel.runs)
    for number, detector in detectors.items():
        found = optima().find(detector, entry, lambda part: tick(share * part))
        curves = optima().curves_to_fit(found)
        own = [(number, detector, with_rates(entry, rates)) for rates in curves.values()]
        fits = dict(zip(curves, _tune(panel, own, settings, tick), strict=True))
        best = _choose_curve(found, curves, fits)
        if settings.rule == EXACT:
            traces = [each.trace for each in fits.values() if each.trace is not None]
            score = score_best(traces, settings.budget)
            best = replace(best, at_budget={**(best.at_budget or {}), MEASURES[0]: score.as_json()})
        yield best


def _tune(
    panel: Panel,
    pairs: Sequence[tuple[int, PlayerSpec, PlayerSpec]],
    settings: Tuning,
    tick: Callable[[float], None],
) -> Iterator[TuningResult]:
    """Fit spoofers to the budget, by the rule; `pairs`: number of a detector, and both players."""
    if settings.rule == EXACT:
        for k, detector, entry in pairs:
            yield tune_at_budget(panel, k, entry, detector.label, settings, tick)
        return
    searches = [
        (k, tune_amplitude(panel, k, entry, detector.label, settings))
        for k, detector, entry in pairs
    ]
    yield from play_searches(panel, searches, tick)


def _choose_curve(
    found: dict[str, Any], curves: Mapping[str, Any], fits: Mapping[str, TuningResult]
) -> TuningResult:
    """The fit that gets farthest, with how its curve was found."""
    best = max(fits, key=lambda name: fits[name].score)
    found["fitted_m"] = {name: fit.score for name, fit in fits.items()}
    found["played"] = {"curve": best, "rates_mps": curves[best]}
    found["unbeaten_start"] = name_unbeaten_start(found)
    return replace(fits[best], found=found)
