"""Every spoofer keeps the contract, and `check_spoofer` catches whoever breaks it."""

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
    found = {"rates_mps": (0.0, 0.1, 0.4)} if name == "open-loop" else {}
    check_spoofer({"name": name, **found}, attack=attack)


def test_an_open_loop_attack_that_has_not_been_looked_for_says_so():
    with pytest.raises(ValueError, match=r"not known before it .* `spoofgym bench --spoofer"):
        check_spoofer("open-loop")


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


def odd(**changes):
    """A follower that says something else of itself."""
    return type("Odd", (Follower,), changes)()


class Blind(Follower):
    knowledge = "blind"
    tunable = None


@pytest.mark.parametrize("kind", [Follower, Blind])
def test_a_new_spoofer_that_keeps_the_contract_passes(kind):
    spoofer = kind()
    check_spoofer(spoofer)
    assert not hasattr(spoofer, "memory")  # the object itself was left alone


class Planned(Blind):
    """Goes by a plan that has an entry for every decision of its own."""

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


@pytest.mark.parametrize(
    ("every_s", "between"), [(0.5, "hold"), (2.5, "linear"), (2.5, "hold"), (10.0, "linear")]
)
def test_a_spoofer_that_decides_seldom_is_asked_as_often_as_it_decides(every_s, between):
    check_spoofer(Planned(every_s, between))


@pytest.mark.parametrize("every_s", [0.7, 0.0, float("nan"), "ten", 1e6])
def test_a_pace_that_makes_no_sense_is_told(every_s):
    with pytest.raises(ValueError, match="decision_interval_s"):
        check_spoofer(Planned(every_s))


class KeepsTheObservation(Follower):
    def bind(self, context):
        super().bind(context)
        self.last = np.zeros((context.receivers, len(context.observation_names)), dtype=np.float32)

    def act(self, observation):
        later, self.last = self.last, observation
        return np.nan_to_num(super().act(later), nan=0.5)


def write(spoofer, observation, action):
    observation[observation > 1.0] = 1.0
    return action


CHANGES = {
    "one for all": (
        lambda s, o, a: a[0].copy(),
        r"of shape \(5, 2\), .* got float64 of shape \(2,\)",
    ),
    "single": (lambda s, o, a: np.float32(a), r"array of shape \(5, 2\), .* got float32 of"),
    "transposed": (lambda s, o, a: np.asfortranarray(a), "a C-contiguous float64 array"),
    "a list": (lambda s, o, a: a.tolist(), "`act` must return an array, got list"),
    "unbounded": (lambda s, o, a: 0.0 * a + 1.5, r"finite and within \[-1, 1\], got 1.5"),
    "NaN": (lambda s, o, a: a * np.nan, r"finite and within \[-1, 1\], got nan"),
    "its memory": (lambda s, o, a: s.memory["mean"], r"is \(part of\) `memory\['mean'\]`"),
    "writes": (write, "the spoofer writes into its observation"),
}


class Changed(Follower):
    """Changes what it does."""

    def __init__(self, name):
        super().__init__()
        self.name = name

    def act(self, observation):
        return CHANGES[self.name][0](self, observation, super().act(observation))


@pytest.mark.parametrize(
    ("spoofer", "said"),
    [
        *((Changed(name), said) for name, (_, said) in CHANGES.items()),
        (odd(knowledge="everything"), "knowledge` must be one of 'blind', 'tracking', 'oracle'"),
        (odd(tunable="speed"), "tunable` must name a setting that is a number"),
        (odd(tuning_range=lambda context: (0.0, 0.0)), "two numbers, 0 < low < high, got 0.0 and"),
        (KeepsTheObservation(), "valid during `act` only"),
    ],
)
def test_a_broken_spoofer_is_caught(spoofer, said):
    with pytest.raises(AssertionError, match=said):
        check_spoofer(spoofer)
