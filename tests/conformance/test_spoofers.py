"""Every spoofer keeps the contract, and `check_spoofer` catches whoever breaks it."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.paper_attacks import PAPER_ATTACKS
from spoofgym.policies import list_shipped
from spoofgym.spoofers import SPOOFERS, Profile, Spoofer
from spoofgym.testing import check_spoofer

ATTACKS = [
    {"name": "false-position"},
    {"name": "false-position", "control": "rate"},
    {"name": "per-channel"},
    {"name": "per-channel", "control": "rate", "coherent": False},
]


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: "-".join(map(str, attack.values())))
@pytest.mark.parametrize("name", sorted(SPOOFERS.keys() - {"onnx-policy"}))  # which needs a file
def test_every_spoofer_keeps_the_contract(name, attack):
    found = {"rates_mps": (0.0, 0.1, 0.4)} if name == "blind-optimum" else {}
    check_spoofer({"name": name, **found}, attack=attack)


def test_a_blind_optimum_that_has_not_been_looked_for_says_so():
    with pytest.raises(ValueError, match=r"not known before it .* `spoofgym bench --spoofer"):
        check_spoofer("blind-optimum")


@pytest.mark.parametrize("name", list_shipped("spoofer"))
def test_every_shipped_spoofer_keeps_the_contract(name):
    check_spoofer(name)


@pytest.mark.parametrize("name", PAPER_ATTACKS)
def test_every_attack_of_a_paper_keeps_the_contract(name):
    found = PAPER_ATTACKS[name]
    check_spoofer(found.spoofer, attack=found.attack(("S15", "S05", "S11")[: found.satellites]))


@pytest.mark.parametrize("control", ["rate", "acceleration"])
def test_a_profile_across_keeps_the_contract(control):
    profile = Profile(
        rates_mps=(0.1, 0.4, 0.35, 0.9), cross_rates_mps=(0.0, 0.3, -0.3), heading_deg=200.0
    )
    check_spoofer(profile, attack={"name": "false-position", "control": control})


class Follower(Spoofer):
    """A spoofer that does all as it should: a smoothed echo of what it sees."""

    knowledge = "oracle"
    tunable = "gain"

    def __init__(self, gain=0.5):
        self.gain = gain

    def bind(self, context):
        super().bind(context)
        self.memory.declare("mean", np.zeros((context.receivers, len(context.action_names))))

    @classmethod
    def tuning_range(cls, context):
        return 0.1, 1.0

    def act(self, observation):
        a = len(self.context.action_names)
        seen = observation[:, -a:].astype(np.float64)
        self.memory["mean"] = 0.9 * self.memory["mean"] + 0.1 * self.gain * seen
        return np.clip(self.memory["mean"], -1.0, 1.0)


class Tracking(Follower):
    knowledge = "tracking"


class Blind(Follower):
    knowledge = "blind"
    tunable = None


@pytest.mark.parametrize("kind", [Follower, Tracking, Blind])
def test_a_new_spoofer_that_keeps_the_contract_passes(kind):
    spoofer = kind()
    check_spoofer(spoofer)
    assert not hasattr(spoofer, "memory")  # the object itself was left alone


class Planned(Follower):
    """Goes by a plan that has an entry for every decision of its own."""

    knowledge = "blind"
    tunable = None

    def __init__(self, decision_interval_s, between="hold"):
        self.decision_interval_s, self.between = decision_interval_s, between

    def bind(self, context):
        super().bind(context)
        self.memory.declare("decision", np.zeros(context.receivers, dtype=np.int64))
        self.plan = np.linspace(0.0, 1.0, context.steps)

    def act(self, observation):
        now = self.plan[self.memory["decision"]]
        self.memory["decision"] = self.memory["decision"] + 1
        return np.repeat(now[:, None], len(self.context.action_names), axis=1)


@pytest.mark.parametrize("every_s", [0.5, 2.5, 5.0, 10.0])
@pytest.mark.parametrize("between", ["hold", "linear"])
def test_a_spoofer_that_decides_seldom_is_asked_as_often_as_it_decides(every_s, between):
    check_spoofer(Planned(every_s, between))


@pytest.mark.parametrize("every_s", [0.7, 0.0, -1.0, float("nan"), "ten", 1e6])
def test_a_pace_that_makes_no_sense_is_told(every_s):
    with pytest.raises(ValueError, match="decision_interval_s"):
        check_spoofer(Planned(every_s))


class AllKnowing(Follower):
    knowledge = "everything"


class TunesNothing(Follower):
    tunable = "speed"


class NoRange(Follower):
    @classmethod
    def tuning_range(cls, context):
        return 0.0, 0.0


class NoBase(Follower):
    def bind(self, context):
        self.context = context


class Undeclared(Follower):
    def act(self, observation):
        self.memory["seen"] = observation.copy()
        return super().act(observation)


class OneForAll(Follower):
    def act(self, observation):
        return super().act(observation)[0]


class SinglePrecision(Follower):
    def act(self, observation):
        return super().act(observation).astype(np.float32)


class Transposed(Follower):
    def act(self, observation):
        return np.asfortranarray(super().act(observation))


class Listing(Follower):
    def act(self, observation):
        return super().act(observation).tolist()


class Unbounded(Follower):
    def act(self, observation):
        return super().act(observation) + 1.5


class NotANumber(Follower):
    def act(self, observation):
        return super().act(observation) * np.nan


class Writes(Follower):
    def act(self, observation):
        observation[observation > 1.0] = 1.0
        return super().act(observation)


class HandsOutItsMemory(Follower):
    def act(self, observation):
        super().act(observation)
        return self.memory["mean"]


class KeepsTheObservation(Follower):
    def bind(self, context):
        super().bind(context)
        self.last = np.zeros((context.receivers, len(context.observation_names)), dtype=np.float32)

    def act(self, observation):
        later, self.last = self.last, observation
        return np.nan_to_num(super().act(later), nan=0.5)


class AveragesReceivers(Follower):
    def act(self, observation):
        action = super().act(observation)
        return np.clip(0.1 * action + action.mean(axis=0), -1.0, 1.0)


class RollsDice(Follower):
    def act(self, observation):
        return np.random.default_rng().uniform(-1.0, 1.0, super().act(observation).shape)


class RollsGlobalDice(Follower):
    def act(self, observation):
        np.random.random()  # noqa: NPY002 - what nobody may do
        return super().act(observation)


class CountsOutsideTheMemory(Follower):
    def bind(self, context):
        super().bind(context)
        self.count = np.zeros((context.receivers, 1))

    def act(self, observation):
        self.count += 0.01
        return np.clip(super().act(observation) + self.count, -1.0, 1.0)


class ForgetsAll(Follower):
    def reset(self, mask=None):
        super().reset(None)


class HoldsALambda(Follower):
    def bind(self, context):
        super().bind(context)
        self.curve = lambda x: x


BROKEN = {
    AllKnowing: "`AllKnowing.knowledge` must be one of 'blind', 'tracking', 'oracle'",
    TunesNothing: "`TunesNothing.tunable` must name a setting that is a number",
    NoRange: "`tuning_range` must return two numbers, 0 < low < high, got 0.0 and 0.0",
    NoBase: "must have a `memory` made by the base class, got None",
    Undeclared: "keeps 'seen' in its memory without having declared it",
    OneForAll: "array of shape \\(5, 2\\), .* got float64 of shape \\(2,\\)",
    SinglePrecision: "array of shape \\(5, 2\\), .* got float32 of shape \\(5, 2\\)",
    Transposed: "a C-contiguous float64 array",
    Listing: "`act` must return an array, got list",
    Unbounded: "actions must be finite and within \\[-1, 1\\], got 1.5",
    NotANumber: "actions must be finite and within \\[-1, 1\\], got nan",
    Writes: "the spoofer writes into its observation",
    HandsOutItsMemory: "the action is \\(part of\\) `memory\\['mean'\\]`",
    KeepsTheObservation: "valid during `act` only",
    AveragesReceivers: "must be the same, bit for bit, among 1 and among 5 receivers",
    RollsDice: "When all is done again, the spoofer must do the same",
    RollsGlobalDice: "uses the global random numbers",
    CountsOutsideTheMemory: "After a reset the spoofer must be as it was after `bind`",
    ForgetsAll: "A reset of some receivers must leave the others alone",
    HoldsALambda: "cannot be pickled",
}


@pytest.mark.parametrize("kind", BROKEN, ids=lambda kind: kind.__name__)
def test_a_broken_spoofer_is_caught(kind):
    with pytest.raises(AssertionError, match=BROKEN[kind]):
        check_spoofer(kind())
