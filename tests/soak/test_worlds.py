"""Faults in any order wear no environment down: it recovers, or it refuses in a sentence."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from spoofgym.detectors import DETECTORS
from spoofgym.simulation import tight
from spoofgym.simulation.simulator import FilterDiverged

from ..duel.support import PAPERS, parallel
from ..duel.support import SHORT as DUEL_SHORT
from ..envs.support import SMALL, single, victim
from .support import (
    hide_satellites,
    loosen_world,
    run_slice,
    run_soak,
    saturate_sensors,
    shift_field,
)

DETECTOR_NAMES = sorted(
    name
    for name, kind in DETECTORS.items()
    if kind.measures in ("satellites", "any") and name != "pool"
)
SIZES = st.sampled_from([0.0, 1.0, 160.0, -160.0, 3e5, 1e9, -1e9])
COUNTS = st.integers(1, 12)
SEEDS = st.integers(0, 2**31)
KINDS = st.sampled_from(["set", "gap", "saturated", "clock", "ranges"])
CHANNELS = st.sets(st.integers(0, 11), min_size=1)
FAULTS = st.tuples(KINDS, SIZES, COUNTS, CHANNELS)
"""What happens, its size [m] or [m/s^2], for how many epochs, and to which satellites."""


class Faults(RuleBasedStateMachine):
    """What happens to a tightly coupled receiver, beside what its players do."""

    def __init__(self):
        super().__init__()
        self.core, self.seen, self.tight = None, [], True
        self.patch = pytest.MonkeyPatch()
        build = tight.build_worlds

        def build_own(*given):
            world, worlds = build(*given)
            return loosen_world(world), worlds

        self.patch.setattr(tight, "build_worlds", build_own)

    @property
    def simulator(self):
        return self.core.engine.simulator

    @property
    def epoch(self):
        return int(self.simulator.epochs[0])

    @precondition(lambda self: self.tight)
    @rule(fault=FAULTS)
    def happen(self, fault):
        kind, size, count, channels = fault
        world, channels = self.core.setup.world, sorted(channels)
        if kind == "set":
            hide_satellites(world, self.epoch, count, channels)
        elif kind == "gap":
            hide_satellites(world, self.epoch, count, slice(None))
        elif kind == "saturated":
            saturate_sensors(world, self.epoch, count, size)
        elif kind == "clock":
            shift_field(self.simulator, "clock", np.array([size, 0.0]))
        else:
            shift_field(self.simulator, "satellite_bias", size * np.isin(np.arange(12), channels))

    def refuse(self, refused):
        self.seen = []
        assert "has diverged at" in str(refused)

    @invariant()
    def nothing_that_is_seen_is_not_finite(self):
        for each in self.seen:
            assert np.isfinite(each).all()

    def teardown(self):
        self.patch.undo()
        if self.core is not None:
            self.core.close()


class Attacked(Faults):
    @initialize(
        kind=st.sampled_from(["Zhong2025"] * 4 + [*SMALL]),
        detector=st.sampled_from(DETECTOR_NAMES),
        receiver=st.sampled_from(["paper", "matched", "augmented"]),
        seed=SEEDS,
    )
    def begin(self, kind, detector, receiver, seed):
        self.tight = kind == "Zhong2025"
        self.env = single(detector=detector, receiver=receiver) if self.tight else victim(kind)
        self.core = self.env.unwrapped.core
        self.reset(seed)

    @rule(seed=SEEDS)
    def reset(self, seed):
        self.seen, self.over = [self.env.reset(seed=seed)[0]], False

    @precondition(lambda self: not self.over)
    @rule(level=st.floats(-1.0, 1.0), count=COUNTS)
    def attack(self, level, count):
        for _ in range(count):
            if self.over:
                return
            try:
                observation, reward, *over, _ = self.env.step(
                    np.full(self.env.action_space.shape, level, dtype=np.float32)
                )
            except FilterDiverged as refused:
                self.refuse(refused)
                self.over = True
                return
            self.seen, self.over = [observation, reward], any(over)
            assert self.env.observation_space.contains(observation)

    @precondition(lambda self: not self.over)
    @rule(value=st.sampled_from([np.nan, np.inf, -np.inf, 1e9]))
    def send_nonsense(self, value):
        with pytest.raises(ValueError, match="an action must be finite and in"):
            self.env.step(np.full(self.env.action_space.shape, value))


class Played(Faults):
    @initialize(weighs=st.booleans(), seed=SEEDS)
    def begin(self, weighs, seed):
        self.env = parallel(**PAPERS, weighs=weighs, timeline=DUEL_SHORT)
        self.reset(seed)
        self.core = self.env.unwrapped.duel.core

    @rule(seed=SEEDS)
    def reset(self, seed):
        self.seen = [*self.env.reset(seed=seed)[0].values()]

    def actions(self, **levels):
        return {
            f"{side}_0": np.full(self.env.action_space(f"{side}_0").shape, level, dtype=np.float32)
            for side, level in levels.items()
        }

    @precondition(lambda self: self.env.agents)
    @rule(spoofer=st.floats(-1.0, 1.0), detector=st.floats(-1.0, 1.0), count=COUNTS)
    def play(self, spoofer, detector, count):
        for _ in range(count):
            if not self.env.agents:
                return
            try:
                observations, rewards, *_ = self.env.step(
                    self.actions(spoofer=spoofer, detector=detector)
                )
            except FilterDiverged as refused:
                self.refuse(refused)
                self.reset(1)
                return
            self.seen = [*observations.values(), *rewards.values()]

    @precondition(lambda self: self.env.agents)
    @rule(whose=st.sampled_from(["spoofer", "detector"]))
    def send_nonsense(self, whose):
        levels = {"spoofer": 0.0, "detector": -1.0, whose: np.nan}
        with pytest.raises(ValueError, match="an action must be finite and in"):
            self.env.step(self.actions(**levels))


def test_a_receiver_that_runs_away_is_refused_before_the_detector_of_a_duel_sees_it():
    env = parallel(**PAPERS, weighs=False, timeline=DUEL_SHORT)
    env.reset(seed=1)
    duel = env.unwrapped.duel
    duel.decide(np.full((1, 1), -1.0))
    duel.core.engine.simulator.buffers.fields.put("velocity_e", [0], [[1e11, 0.0, 0.0]])
    with pytest.raises(FilterDiverged, match="has diverged at"):
        duel.arrive(np.zeros((1, 2)))
    env.close()


@pytest.mark.parametrize("machine", [Attacked, Played])
def test_a_few_faults(machine):
    run_slice(machine, examples=6, steps=12)


@pytest.mark.nightly
@pytest.mark.parametrize("machine", [Attacked, Played])
def test_faults_for_some_minutes(machine):
    run_soak(machine)
