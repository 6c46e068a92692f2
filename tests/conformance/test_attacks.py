"""Every attack keeps the contract, and `check_attack` catches whoever breaks it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from spoofgym.attacks import ATTACKS, THREATS, FalsePosition, Meaconer, PerChannel
from spoofgym.core.declared import list_declarations
from spoofgym.testing import check_attack

from ..nightly import heavy

SOME = ("S05", "S11", "S30")


CONTROLLED = [
    (name, control)
    for name, kind in ATTACKS.items()
    for control in list_declarations(kind)["control"][0].one_of
]


FORMS = [(True, "all"), (False, SOME), (True, SOME), (False, "all")]


@pytest.mark.parametrize("form", heavy(FORMS, *FORMS[2:]), ids=str)
@pytest.mark.parametrize(("name", "control"), CONTROLLED)
def test_every_attack_keeps_the_contract(name, control, form):
    coherent, channels = form
    check_attack({"name": name, "control": control, "coherent": coherent, "channels": channels})


@pytest.mark.parametrize("axes", ["n", "d", "end"])
def test_a_false_position_keeps_the_contract_along_any_axes(axes):
    check_attack(FalsePosition(axes=axes, acceleration_limit_mps2=1.0, rate_limit_mps=3.0))


@pytest.mark.parametrize("control", ["rate", "offset"])
@pytest.mark.parametrize("basis", ["position+clock", "rotated"])
@pytest.mark.parametrize("channels", ["all", "6 drawn"])
def test_offsets_keep_the_contract_in_any_basis(basis, channels, control):
    settings = {"basis": basis, "channels": channels, "control": control}
    check_attack({"name": "offsets", "slot_order": "elevation", **settings})


OPTIONS = {
    "replaced": {"errors": "replaced"},
    "replaced-pseudoranges": {"errors": {"bias_sd_m": 1.0}, "coherent": False},
    "tracking": {"tracking": {"sd_m": 1.0, "delay_s": 0.7, "bias_m": [1.0, 2.0, 3.0]}},
    "clock": {"spoofer_clock": {"offset_sd_m": 5.0, "drift_mps": 0.1, "frequency_psd": 0.01}},
    "capture": {"capture": {"delay_s": 2.0, "alignment_m": 0.05}},
    "all": {
        "errors": "replaced",
        "tracking": {"sd_m": 1.0},
        "spoofer_clock": {"phase_psd": 0.01},
        "capture": {"alignment_m": None},
        "channels": "S1*",
    },
}


OPTIONED = [(name, word) for name in ATTACKS for word in OPTIONS]
ALONE = [
    *(("false-position", "tracking"), ("false-position", "capture"), ("meaconer", "clock")),
    *(("per-channel", "replaced"), ("offsets", "replaced-pseudoranges")),
]
OFTEN = {*ALONE, *((name, "all") for name in ATTACKS)}
"""All together with every attack, and each alone with one of them."""


@pytest.mark.parametrize("case", heavy(OPTIONED, *({*OPTIONED} - OFTEN)), ids="-".join)
def test_every_option_keeps_the_contract(case):
    name, word = case
    options = OPTIONS[word]
    if not ATTACKS[name].takes_tracking:
        options = {key: value for key, value in options.items() if key != "tracking"}
    check_attack({"name": name, **options})


@pytest.mark.parametrize("follows", [True, False])
def test_a_meaconer_with_an_antenna_of_its_own_keeps_the_contract(follows):
    check_attack({"name": "meaconer", "antenna_m": [30.0, 10.0, -5.0], "follows": follows})


@pytest.mark.parametrize("name", sorted(set(THREATS) - {"partial-constellation"}))
def test_every_threat_keeps_the_contract(name):
    check_attack(name)


def test_the_attack_itself_is_left_alone():
    attack = PerChannel()
    check_attack(attack)
    assert not hasattr(attack, "memory")


class NeverStill(PerChannel):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        super().command(action, epochs, d_range, d_rate, lo, hi)
        d_range[lo:hi, self.mask] += 1e-12


class WritesToTheAction(FalsePosition):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        if action is not None:
            np.clip(action, -1.0, 1.0, out=action)
        super().command(action, epochs, d_range, d_rate, lo, hi)


class LeavesHoles(PerChannel):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        full, unused = np.zeros_like(d_range), np.zeros_like(d_rate)
        super().command(action, epochs, full, unused, lo, hi)
        d_range[lo:hi, self.mask] = full[lo:hi, self.mask]
        d_rate[lo:hi, self.mask] = unused[lo:hi, self.mask]


class TakesAll(FalsePosition):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        super().command(action, epochs, d_range, d_rate, lo, hi)
        d_range[lo:hi, ~self.mask] = self.memory["rate"][lo:hi, :1]


class WholeBatch(PerChannel):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        super().command(action, epochs, d_range, d_rate, 0, len(epochs))


class BrakesWhenHolding(PerChannel):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        if action is None:
            self.memory["rate"][lo:hi] *= 0.5
        super().command(action, epochs, d_range, d_rate, lo, hi)


class Jumps(PerChannel):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        if action is not None:
            self.memory["displacement"][lo:hi] += 0.1 * action[lo:hi]
        super().command(action, epochs, d_range, d_rate, lo, hi)


@dataclass(kw_only=True)
class Hurries(PerChannel):
    """Takes twice the limit that it states, of acceleration or of rate."""

    factor: float = 2.0

    @property
    def unit_scale(self):
        return self.factor * super().unit_scale


class Overshoots(Hurries):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        stated, self.rate_limit_mps = self.rate_limit_mps, 1e9
        super().command(action, epochs, d_range, d_rate, lo, hi)
        self.rate_limit_mps = stated


class Lazy(PerChannel):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        weak = None if action is None else 0.5 * action
        super().command(weak, epochs, d_range, d_rate, lo, hi)


class LagsBehind(FalsePosition):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        super().command(action, epochs, d_range, d_rate, lo, hi)
        d_rate[lo:hi] *= 0.99


class RatesAnyhow(PerChannel):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        super().command(action, epochs, d_range, d_rate, lo, hi)
        d_rate[lo:hi, self.mask] = self.memory["rate"][lo:hi]


class Powerless(PerChannel):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        d_range[lo:hi], d_rate[lo:hi] = 0.0, 0.0


class KeepsTheAction(PerChannel):
    def bind(self, context):
        super().bind(context)
        self.last = None

    def command(self, action, epochs, d_range, d_rate, lo, hi):
        later, self.last = self.last, action
        super().command(later, epochs, d_range, d_rate, lo, hi)


class BendsTheWorld(PerChannel):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        super().command(action, epochs, d_range, d_rate, lo, hi)
        self.world.position_e[-1] += 1.0


@dataclass(kw_only=True)
class OneSetting(PerChannel):
    things: set


class AsOneVector(PerChannel):
    """Says that its limits are those of a vector, though they are those of every element."""

    limits_size = True


class RunsAhead(Meaconer):
    def command(self, action, epochs, d_range, d_rate, lo, hi):
        super().command(action, epochs, d_range, d_rate, lo, hi)
        self.memory["displacement"][lo:hi] -= 0.5


def odd(base=PerChannel, **changes):
    """An attack that says something else of itself."""
    return type("Odd", (base,), changes)()


def bind_without_rate(self, context):
    FalsePosition.bind(self, context)
    del self.memory["rate"]


BROKEN = {
    "silent": (odd(label=""), "`label` must name the threat"),
    "mislabelled": (
        odd(FalsePosition, label="false-position-pseudorange-only"),
        "`label` must say 'pseudorange-only' where",
    ),
    "empty slots": (
        odd(select_channels=lambda self, world: np.ones(world.channels, dtype=bool)),
        "must not name an empty slot",
    ),
    "by number": (
        odd(select_channels=lambda self, world: np.ones(world.channels, dtype=int)),
        r"`select_channels` must return \(12,\) bool, got \(12,\) int64",
    ),
    "same names": (
        odd(FalsePosition, action_names=lambda self, world: ("push",) * len(self.axes)),
        r"a tuple of different names, one an element, got \('push', 'push'\)",
    ),
    "settings": (OneSetting(things={1}), "must fit into JSON, .* of type set can't be written"),
    "vector": (AsOneVector(), "more than `acceleration_limit_mps2` = 0.05, got 0."),
    "no rate": (odd(FalsePosition, bind=bind_without_rate), "must hold 'rate', zeros of shape"),
    "powerless": (Powerless(), "commands must change at least one pseudorange"),
    "never still": (NeverStill(), "an action of zeros must leave the measurements as they are"),
    "writes": (WritesToTheAction(), "must not write to `action` or `epochs`"),
    "holes": (LeavesHoles(), "a finite number into every element of `d_range`"),
    "takes all": (TakesAll(channels=SOME), "0 for satellites that are not captured"),
    "whole batch": (WholeBatch(), "the same for receivers lo to hi as for all|leave receivers out"),
    "brakes": (BrakesWhenHolding(), r"without a command \(None\) the rate must stay as it is"),
    "jumps": (Jumps(), r"must follow from the rate, D\+ = D \+ \(v \+ v\+\) tau / 2"),
    "acceleration": (Hurries(), "more than `acceleration_limit_mps2` = 0.05, got 0.1"),
    "rate": (Hurries(control="rate"), "must not exceed `rate_limit_mps` = 5, got 10"),
    "overshoots": (Overshoots(factor=1.0), "must not exceed `rate_limit_mps` = 5, got"),
    "lazy": (Lazy(), "an action of -0.1.* must command 0.05 times as much"),
    "lags": (LagsBehind(), "the range rate must be the derivative of the range"),
    "rates anyhow": (RatesAnyhow(coherent=False), "coherent=False the range rates must be left"),
    "keeps the action": (KeepsTheAction(), "valid during `command` only"),
    "runs ahead": (RunsAhead(), "with `one_sided` must not fall below 0"),
    "bends the world": (BendsTheWorld(), "has changed the arrays of the"),
}


@pytest.mark.parametrize(("attack", "said"), BROKEN.values(), ids=BROKEN)
def test_a_broken_attack_is_caught(attack, said):
    with pytest.raises(AssertionError, match=said):
        check_attack(attack)


def test_what_is_no_attack_is_refused():
    with pytest.raises(TypeError, match=r"^an attack is a name"):
        check_attack(FalsePosition)
