"""What a detector says is checked in every simulation, and an epoch leads to no filter's memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym import duel_v0
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.episode import play_episode
from spoofgym.bench.runs.play import WarmStart, play
from spoofgym.bench.runs.world import PLAIN_ID
from spoofgym.detectors import Detector, Verdict
from spoofgym.simulation import Engine, Timeline

B = 3
INTERVALS = {
    "spoofgym/LooselyCoupled-v0": 0.1,
    "spoofgym/Snapshot-v0": 1.0,
    "spoofgym/WheeledRobot-v0": 1.0,
}
"""Of the epochs of ids [s]."""
EPOCHS = {"warmup_s": 4, "live_s": 4, "attack_s": 6, "time_to_alert_s": 2}
QUIET = 6
"""Verdicts before the first wrong one, which comes at the second step."""


def timeline(interval_s):
    return {name: count * interval_s for name, count in EPOCHS.items()}


def part(name, change):
    return lambda verdict: verdict._replace(**{name: change(getattr(verdict, name))})


def last(value):
    """The last receiver's last column is another value."""

    def change(array):
        array[-1, -1] = value
        return array

    return change


def more_rows(verdict):
    return Verdict(*(np.vstack([array, array]) for array in verdict))


FAULTS = {
    "narrow weights": (part("weights", lambda w: w[:, :1].copy()), ValueError, "`weights` must ha"),
    "flat weights": (part("weights", np.ravel), ValueError, "`weights` must have shape"),
    "weights above 1": (part("weights", last(2.0)), ValueError, "lie within 0 and 1, got 2.0 for"),
    "weights below 0": (part("weights", last(-0.1)), ValueError, "lie within 0 and 1, got -0.1"),
    "NaN weights": (part("weights", last(np.nan)), ValueError, "lie within 0 and 1, got nan for"),
    "single weights": (part("weights", np.float32), TypeError, "`weights` must be of type float64"),
    "listed weights": (part("weights", np.ndarray.tolist), TypeError, "must be an array, got list"),
    "weights by columns": (
        part("weights", lambda w: np.ascontiguousarray(np.hstack([w, w]))[:, ::2]),
        ValueError,
        "`weights` must be a C-contiguous array",
    ),
    "NaN statistic": (part("statistic", last(np.nan)), ValueError, "be finite, got nan for"),
    "infinite threshold": (
        part("threshold", last(np.inf)),
        ValueError,
        "be finite and above 0, got inf for",
    ),
    "float alarm": (part("alarm", np.float64), TypeError, "`alarm` must be of type bool, got flo"),
    "wide alarm": (part("alarm", lambda a: np.hstack([a, a])), ValueError, "`alarm` must have sh"),
    "other receivers": (more_rows, ValueError, "`statistic` must have shape"),
    "tuple": (tuple, TypeError, "must return a `Verdict`, got tuple"),
}


@dataclass
class Wrong(Detector):
    """Right verdicts, then wrong ones."""

    fault: str = ""
    quiet: int = QUIET

    paper: ClassVar[str] = "barshalom2001"
    measures: ClassVar[str] = "any"

    def bind(self, context):
        super().bind(context)
        self.memory.declare("judged", np.zeros(context.receivers))

    def judge(self, epoch):
        self.memory["judged"] = self.memory["judged"] + 1.0
        one = np.ones((len(epoch.time), 1))
        verdict = Verdict(0.0 * one, one, one < 0.0, np.ones_like(epoch.innovation))
        wrong = self.fault and self.memory["judged"].min() > self.quiet
        return FAULTS[self.fault][0](verdict) if wrong else verdict


def single(name="spoofgym/Zhong2025-v0", **given):
    return gym.make(name, timeline=timeline(INTERVALS.get(name, 0.5)), **given)


def several(name="spoofgym/Zhong2025-v0", **given):
    mode = {"vectorization_mode": "vector_entry_point"}
    return gym.make_vec(name, B, timeline=timeline(INTERVALS.get(name, 0.5)), **mode, **given)


def pool_of(detector):
    return {"name": "pool", "members": [detector, Wrong()], "weights": [1.0, 0.0]}


def stepped(env):
    env.reset(seed=1)
    yield
    for _ in range(EPOCHS["attack_s"] - 1):
        env.step(np.zeros(env.action_space.shape))


def small_suite(detector):
    own = {"env": PLAIN_ID, "timeline": Timeline(**timeline(0.5)), "runs": B}
    return Suite(detectors=(detector,), spoofers=("step",), **own)


def bench(detector):
    suite = small_suite(detector)
    setup = suite.setup(suite.detector_players[0])
    start = WarmStart(setup, suite.generators("evaluation", B), threads=1)
    yield
    play(start, "step")


def episode(detector):
    suite = small_suite(detector)
    yield
    play_episode(suite.world, suite.detector_players[0], suite.spoofer_players[0])


ROBOT = "spoofgym/WheeledRobot-v0"
SIMULATIONS = {
    "single": (1, lambda judge: stepped(single(detector=judge))),
    "watching": (1, lambda judge: stepped(single(watch=[judge]))),
    "several": (B, lambda judge: stepped(several(detector=judge))),
    "pool": (B, lambda judge: stepped(several(detector=pool_of(judge)))),
    "twin": (B, lambda judge: stepped(several(detector=judge, twin=True))),
    "view": (
        1,
        lambda j: stepped(
            duel_v0.SpooferView(scenario="zhong2025", pool=[j], timeline=timeline(0.5))
        ),
    ),
    **{
        name: (B, lambda judge, name=name: stepped(several(name, detector=judge)))
        for name in INTERVALS
    },
    "plant watching": (1, lambda judge: stepped(single(ROBOT, watch=[judge]))),
    "bench": (B, bench),
    "episode": (2, episode),  # it plays two alike
}
"""Receivers of each, and a run that stops once at the onset."""


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        *(("several", fault) for fault in FAULTS),
        *(
            (name, fault)
            for name in SIMULATIONS
            for fault in ("NaN weights", "wide alarm")
            if name != "several"
        ),
    ],
)
def test_a_wrong_verdict_is_refused(name, fault):
    receivers, simulate = SIMULATIONS[name]
    _, error, words = FAULTS[fault]
    run = simulate(Wrong(fault))
    next(run)
    with pytest.raises(error, match=rf"^Wrong, epoch at [\d.]+ s: .*{words}") as refused:
        list(run)
    if " for" in words:
        assert f"for receiver {receivers - 1} of {receivers}, column" in str(refused.value)


def test_a_wrong_verdict_of_the_warm_up_is_refused():
    with pytest.raises(ValueError, match=r"^Wrong, epoch at .* got 2\.0 for receiver 2 of 3"):
        next(SIMULATIONS["several"][1](Wrong("weights above 1", quiet=1)))


def test_a_duel_takes_no_decision_that_is_no_number():
    view = duel_v0.DetectorView(pool=["none"], timeline=timeline(0.5), threshold=0.5)
    view.reset(seed=1)
    action = np.full((1, *view.action_space.shape), np.nan)
    # past the environment, which refuses such an action by itself
    with pytest.raises(ValueError, match=r"^DetectorAgent, epoch at .* `statistic` .* got nan for"):
        view.core.duel.decide(action)


def test_the_weights_of_an_update_are_checked_whoever_gives_them():
    setup = small_suite(Wrong()).setup(small_suite(Wrong()).detector_players[0])
    engine = Engine(B, setup, threads=1)
    engine.reset([np.random.default_rng(row) for row in range(B)])
    engine.predict(None)
    verdict = engine.judge()
    for fault in ("narrow weights", "NaN weights", "weights by columns"):
        change, error, words = FAULTS[fault]
        with pytest.raises(error, match=f"^an update, epoch at .*{words}"):
            engine.update(change(verdict._replace(weights=verdict.weights.copy())))
    engine.update(verdict)


WAYS = (
    lambda owner: owner,
    lambda owner: owner.view(),
    lambda owner: owner.reshape(-1),
    np.asarray,
    lambda owner: np.ndarray(1, np.uint8, owner),
    lambda owner: np.frombuffer(owner, np.uint8),
    lambda owner: np.asarray(memoryview(owner)),
    lambda owner: np.lib.stride_tricks.as_strided(owner, writeable=True),
)


def ways_in(array):
    """Writable arrays over the memory of an array, as attributes and views lead there."""
    owner = array
    while owner is not None:
        for attempt in WAYS:
            try:
                reached = attempt(owner)
                reached.flags.writeable = True
            except (TypeError, ValueError, AttributeError):
                continue
            if np.may_share_memory(reached, array):
                yield reached
        owner = getattr(owner, "base", getattr(owner, "obj", None))


@dataclass
class Burglar(Wrong):
    """Writes wherever an epoch lets it."""

    found: ClassVar[list[str]] = []
    looked: ClassVar[int] = 0

    def judge(self, epoch):
        for name, array in epoch._asdict().items():
            if array is not None and array.size:
                type(self).looked += 1
                self.found.extend(name for _ in ways_in(array))
        return super().judge(epoch)


@pytest.mark.parametrize("name", SIMULATIONS)
def test_no_epoch_leads_to_memory_that_may_be_written(name):
    # ctypes, forged addresses, `gc` and imports of this package's private names are not looked at
    Burglar.found.clear()
    before = Burglar.looked
    assert len(list(SIMULATIONS[name][1](Burglar()))) == 1  # and so a right detector runs
    assert Burglar.looked > before
    assert not Burglar.found
