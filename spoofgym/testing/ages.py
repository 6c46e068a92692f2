"""Does a detector judge an old run, and find an attack on it, as it does a young one?"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, ks_2samp

from ..bench.runs.play import Runs, WarmStart, play
from ..bench.runs.world import World
from ..detectors import Detector
from ..detectors.build import bare_detector
from ..detectors.calibrated import unwrap
from ..receiver.epoch import Epoch
from ..simulation.setup import make_generators
from ..simulation.tight import TightlyCoupledSetup
from .contract import require_contract
from .epochs import SteadyEpochs

FloatArray = NDArray[np.float64]
AGES_S = (180.0, 600.0, 1800.0)
"""Times since the detector's reset at which it is looked at [s]."""
WATCHED_S = 60.0
RECEIVERS = 64
RATES_MPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Ramps from which the test attack is chosen [m/s]."""
ATTACKS = ("the position", "every second channel")
FOUND = 0.9  # share of the receivers in which the test attack is found at the first age, at least
LEVEL = 1e-3
"""Probability that a detector which doesn't depend on its age fails, at most."""


class Ages(NamedTuple):
    """What a detector did at each of `AGES_S`.

    Attributes
    ----------
    clean : ndarray
        (ages, receivers) largest ratio of statistic to threshold within a minute.
    rates_mps : tuple of float or None
        Rate of each of `ATTACKS` [m/s]; None where no rate is found at the first age.
    found : ndarray
        (attacks, ages, receivers) bool, in which of them it is found within a minute.
    """

    clean: FloatArray
    rates_mps: tuple[float | None, ...]
    found: NDArray[np.bool_]


def require_alike(ages: Ages, since: str, advice: str) -> Ages:
    """Ages at which a detector does the same; an AssertionError says what changes with the time
    `since` it was reset or switched on. Found is compared receiver by receiver."""
    each = LEVEL / ((1 + len(ATTACKS)) * (len(AGES_S) - 1))
    for k in range(1, len(AGES_S)):
        clean = ages.clean[[0, k]]
        middle, sizes = np.median(clean, axis=1), "{:.3g} and {:.3g}"
        require_contract(
            ks_2samp(*clean).pvalue >= each,
            "without attack the largest ratio of statistic to threshold in a minute changes with "
            f"the time since the {since}: its medians at {_minutes(0)} and {_minutes(k)} are "
            f"{sizes.format(*middle)}; a detector must not count the time, nor go on summing up",
        )
        for attack, rate_mps, found in zip(ATTACKS, ages.rates_mps, ages.found, strict=True):
            young, old = found[0], found[k]
            lost, won = int((young & ~old).sum()), int((old & ~young).sum())
            low, high = paired_interval(lost, won, len(young))
            require_contract(
                lost == 0 or binomtest(lost, lost + won, alternative="greater").pvalue >= each,
                f"a ramp of {rate_mps} m/s of {attack} is found in {young.sum()} of {len(young)} "
                f"receivers when it begins {_minutes(0)} after the {since}, and in {old.sum()} "
                f"when it begins {_minutes(k)} after it, {100.0 * low:.0f} to {100.0 * high:.0f} % "
                f"of them less (95 %); {advice}",
            )
    return ages


def paired_interval(lost: int, won: int, count: int) -> tuple[float, float]:
    """95 % interval of the share that is lost, less that which is won, in `count` pairs."""
    middle = (lost - won) / count
    half = 1.96 * math.sqrt((lost + won) / count - middle**2) / math.sqrt(count)
    return max(middle - half, -1.0), min(middle + half, 1.0)


def check_stationary(detector: Detector | Mapping[str, Any] | str) -> Ages:
    """Check that what a detector finds does not depend on the time since it was switched on.

    A detector that was tuned on attacks of one age can find nothing later.  64 receivers with a
    filter in steady state are judged for half an hour.  At 3, 10 and 30 min after the reset, within
    a minute,

    - the largest ratio of statistic to threshold without attack must have the same distribution;
    - a ramp of the position, and one on every second channel, the slowest of a few that is found in
      90 % of the receivers at 3 min, must be found as often later.  Found is a larger ratio than
      all receivers have at 3 min without attack, and for a detector that is not in a file an
      alarm, too.

    The filter has settled, and no attack moves it.  A learned detector may take its age from a
    filter that settles: `check_ages` flies its victim.

    A detector that does not depend on its age fails with a probability of at most 1 in 1000
    (Kolmogorov-Smirnov test, and sign test of the receivers that find it at one age alone, by
    Bonferroni).  It takes some seconds.

    Parameters
    ----------
    detector : Detector, str or mapping
        What `make_detector` takes; an ``.onnx`` file needs no threshold on its card.  The object
        itself is left as it is.

    Returns
    -------
    Ages
        What was found.  A rate is None where none of the ramps is found at 3 min; then the attack
        says nothing.

    Raises
    ------
    AssertionError
        Says what changes with age.
    ValueError
        Where it needs a model of its victim's errors, which these epochs have not.

    Examples
    --------
    >>> from spoofgym.testing import check_stationary
    >>> check_stationary("snapshot-chi2").rates_mps
    (0.2, 0.1)
    """
    advice = "train and tune with attacks of all ages (`Domain.age_s`)"
    unbound = bare_detector(detector)
    if unbound.needs_model:
        raise ValueError(
            f"{unbound.label or type(unbound).__name__} needs a model of its victim's errors: "
            "`check_ages` flies a victim that has one"
        )
    return require_alike(play_ages(unbound), "reset", advice)


def _minutes(k: int) -> str:
    return f"{AGES_S[k] / 60.0:g} min"


def play_ages(unbound: Detector) -> Ages:
    """Clean statistic, and how often the test attacks are found, at every age."""
    steady = SteadyEpochs.of(unbound, RECEIVERS)
    bound, epochs = copy.deepcopy(unbound), iter(steady)
    bound.bind(steady.context)
    watched = round(WATCHED_S / steady.interval_s)
    clean: list[FloatArray] = []
    found: list[list[NDArray[np.bool_]]] = []
    rates: list[float | None] = []
    for age_s in AGES_S:
        for epoch in epochs:
            bound.judge(epoch)
            if epoch.time[0] >= age_s:
                break
        minute = list(itertools.islice(epochs, watched))
        before = copy.deepcopy(bound)
        clean.append(_largest(bound, minute)[0])
        level = clean[0].max()
        finders = [partial(_find, before, minute, level, attack) for attack in ATTACKS]
        rates = rates or [*map(find_slowest, finders)]
        found.append([find(rate) for find, rate in zip(finders, rates, strict=True)])
    return Ages(np.array(clean), tuple(rates), np.array(found).swapaxes(0, 1))


def find_slowest(find: Callable[[float], NDArray[np.bool_]]) -> float | None:
    """Slowest ramp that is found; `find` says in which receivers that of a rate is."""
    return next((rate for rate in RATES_MPS if find(rate).mean() >= FOUND), None)


def _find(
    bound: Detector, minute: list[Epoch], level: float, attack: str, rate_mps: float | None
) -> NDArray[np.bool_]:
    """(B,) which receivers find it."""
    if rate_mps is None:
        return np.zeros(RECEIVERS, dtype=np.bool_)
    begin = minute[0].time[0] - minute[0].interval[0]
    attacked = [add_ramp(epoch, attack, rate_mps, epoch.time[0] - begin) for epoch in minute]
    largest, alarmed = _largest(copy.deepcopy(bound), attacked)
    found = largest > level
    return found & alarmed if bound.card is None else found


def _largest(bound: Detector, epochs: list[Epoch]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(B,) largest ratio of statistic to threshold, and whether there was an alarm."""
    largest, alarmed = np.zeros(RECEIVERS), np.zeros(RECEIVERS, dtype=np.bool_)
    for epoch in epochs:
        verdict = bound.judge(epoch)
        np.maximum(largest, (verdict.statistic / verdict.threshold).max(axis=1), out=largest)
        alarmed |= verdict.alarm.any(axis=1)
    return largest, alarmed


def add_ramp(epoch: Epoch, attack: str, rate_mps: float, since_s: float) -> Epoch:
    """An epoch with a ramp of one of `ATTACKS`; of a measured position, on its first coordinate."""
    n = epoch.visible.shape[1]
    if n == 0:
        shift = np.zeros_like(epoch.innovation)
        shift[:, 0] = rate_mps * since_s
        fix = np.array(epoch.gnss_position)
        fix[:, 0] += rate_mps * since_s
        return epoch._replace(innovation=epoch.innovation + shift, gnss_position=fix)
    share = np.arange(n) % 2 == 0.0
    if attack == "the position":
        sight = np.array(epoch.satellite_position) - epoch.predicted_position[:, None, :]
        sight /= np.linalg.norm(sight, axis=2, keepdims=True)
        ahead = epoch.predicted_velocity / np.linalg.norm(epoch.predicted_velocity[0])
        share = np.einsum("bnk,bk->bn", sight, ahead)
    moved = epoch.visible * share
    farther, faster = rate_mps * since_s * moved, rate_mps * moved
    return epoch._replace(
        innovation=epoch.innovation + np.hstack([farther, faster]),
        pseudorange=epoch.pseudorange + farther,
        range_rate=epoch.range_rate + faster,
    )


LIVE_AFTER_S = 10.0  # time from switch-on until the detector is live
ENTROPY = 39  # of the seeds
MARGIN = 2.0
"""A filter that has settled follows some attacks less far, so that less of them can be found."""
POSITION = {"name": "false-position", "control": "rate", "rate_limit_mps": MARGIN * RATES_MPS[-1]}
SUBSET = slice(0, 12, 2)
"""Channels of the attack on a part of them."""


def check_ages(
    detector: Detector | Mapping[str, Any] | str, task: str | None = None, **world: Any
) -> Ages:
    """Check that a detector finds an attack whatever the time since its victim was switched on.

    What `check_stationary` requires is required in flight.  64 tightly coupled receivers are
    switched on, their filters settle, and they are attacked 3, 10 and 30 min later, by ramps twice
    as fast as those that are just found at 3 min.  So it also finds a detector that reads its age
    from the filter, as one that was trained on attacks of one age may do.  The runs of the three
    ages have the same seeds, skies and headings.

    By default the world has white errors, which the filter models, and an epoch a second; that
    takes some 10 s.  In a world with other errors statistics may change while a filter settles, and
    it is for you to judge what is reported.

    Parameters
    ----------
    detector : Detector, str or mapping
        What `make_detector` takes, with satellites to measure; its thresholds are the nominal ones,
        and an ``.onnx`` file needs none.  The object itself is left as it is.
    task : str, optional
        Whose world it is flown in.
    **world
        Or settings as `World.of` takes them, but for attack, timeline and ages.

    Returns
    -------
    Ages
        What was found.

    Raises
    ------
    AssertionError
        Says what changes with age.
    ValueError
        Where the detector does not fit the world, or measures positions.

    Examples
    --------
    >>> from spoofgym.testing import check_ages
    >>> check_ages("snapshot-chi2").rates_mps
    (0.2, 0.4)
    """
    unbound = unwrap(bare_detector(detector))
    if not can_fly(unbound):
        raise ValueError(
            f"{type(unbound).__name__} judges what a tightly coupled receiver does not have; "
            "`check_stationary` has epochs for it"
        )
    given = World.of(task, **world) if task or world else World.of(**_default_world(unbound))
    advice = (
        "train and tune with attacks of all ages, as with `--set domain='{\"age_s\":[60,3600]}'`"
    )
    return require_alike(fly_ages(unbound, given), "switch-on", advice)


def can_fly(detector: Detector) -> bool:
    """Whether a tightly coupled receiver has what a detector judges."""
    return detector.measures != "position" and detector.needs <= TightlyCoupledSetup.has


def _default_world(detector: Detector) -> dict[str, Any]:
    card = detector.card
    scenario = {
        "name": "zhong2025-white",
        "flight": "airway",
        "imu_rate_hz": 10.0,
        "epoch_interval_s": (card and card.interval_s) or 1.0,
    }
    scenario |= {"channels": card.channels} if card and card.channels else {}
    skies = {"constellation_time_s": [0.0, 86_400.0], "worlds": 4}
    drawn = {"start_s": [0.0, None], "turn_on": "drawn", **skies}
    return {"scenario": scenario, "receiver": "matched", "domain": drawn}


def fly_ages(unbound: Detector, world: World) -> Ages:
    """Clean statistic, and where the test attacks are found, at every age."""
    timeline = {
        "warmup_s": AGES_S[0],
        "live_s": AGES_S[0] - LIVE_AFTER_S,
        "attack_s": WATCHED_S,
        "time_to_alert_s": 0.0,
    }
    domain = {**world.settings.get("domain", {}), "age_s": [AGES_S[0], AGES_S[-1]]}
    world = world.copy_with(domain=domain, timeline=timeline, attack=dict(POSITION))
    names = world.setup.world.satellite_ids
    clean: FloatArray | None = None
    rates, found = [], []
    for channels in ("all", [name for name in names[SUBSET] if name]):
        start = _start(unbound, world, {**POSITION, "channels": channels})
        if clean is None:
            clean = _by_age(play(start, "none").peak)
        level = float(clean[0].max())
        slowest = find_slowest(partial(_find_flown, start.first(RECEIVERS), level))
        rate = None if slowest is None else MARGIN * slowest
        rates.append(rate)
        none = np.zeros(start.receivers, dtype=np.bool_)
        found.append(_by_age(none if rate is None else _find_flown(start, level, rate)))
    assert clean is not None  # there are attacks
    return Ages(clean, tuple(rates), np.array(found))


def _start(unbound: Detector, world: World, attack: Mapping[str, Any]) -> WarmStart:
    """The receivers of all ages at their onset, those of the first age first."""
    setup = world.copy_with(attack=dict(attack)).setup
    setup = setup.copy_with(detector=copy.deepcopy(unbound))
    seeds = [np.random.SeedSequence([ENTROPY, k]) for k in range(RECEIVERS)] * len(AGES_S)
    given = {"age_s": np.repeat(AGES_S, RECEIVERS)}
    return WarmStart(setup, make_generators(seeds), threads=1, given=given)


def _by_age(values: Any) -> Any:
    return values.reshape(len(AGES_S), RECEIVERS)


def _find_flown(start: WarmStart, level: float, rate_mps: float) -> Any:
    """(R,) in which runs a ramp is found."""
    runs: Runs = play(start, {"name": "ramp", "rate_mps": rate_mps})
    found = runs.peak > level
    return found & runs.alarm.any(axis=0) if start.setup.detector.card is None else found
