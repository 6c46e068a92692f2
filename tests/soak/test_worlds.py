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
SIZES = st.sampled_from([1e-3, 1.0, 1e3, 3e5, 1e9, -1e9])
COUNTS = st.integers(1, 12)
SEEDS = st.integers(0, 2**31)


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
    @rule(count=COUNTS, channels=st.sets(st.integers(0, 11), min_size=1))
    def satellites_set(self, count, channels):
        hide_satellites(self.core.setup.world, self.epoch, count, sorted(channels))

    @precondition(lambda self: self.tight)
    @rule(count=COUNTS)
    def a_gap(self, count):
        hide_satellites(self.core.setup.world, self.epoch, count, slice(None))

    @precondition(lambda self: self.tight)
    @rule(count=COUNTS, level=st.sampled_from([0.0, 160.0, -160.0]))
    def sensors_saturate(self, count, level):
        saturate_sensors(self.core.setup.world, self.epoch, count, level)

    @precondition(lambda self: self.tight)
    @rule(size=SIZES)
    def the_clock_jumps(self, size):
        shift_field(self.simulator, "clock", np.array([size, 0.0]))

    @precondition(lambda self: self.tight)
    @rule(size=SIZES, channel=st.integers(0, 11))
    def a_range_is_off(self, size, channel):
        shift_field(self.simulator, "satellite_bias", size * (np.arange(12) == channel))

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


@pytest.mark.parametrize("machine", [Attacked, Played])
def test_a_few_faults(machine):
    run_slice(machine, examples=6, steps=12)


@pytest.mark.nightly
@pytest.mark.parametrize("machine", [Attacked, Played])
def test_faults_for_some_minutes(machine):
    run_soak(machine)
