"""Every detector keeps the contract, and `check_detector` catches whoever breaks it."""

import copy
from collections import deque
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from spoofgym.detectors import DETECTORS, Detector, Verdict
from spoofgym.detectors.base import compare
from spoofgym.testing import check_detector
from spoofgym.testing.epochs import COORDINATES, ZERO, position_script

from ..nightly import heavy

LATE = {"start_s": 4.0, "settled_s": 8.0, "max_exclusion_s": 6.0, "min_satellites": 4}
FURTHER = [
    {"name": "ewma", "smoothing": 1.0, "false_alarm": 0.1, "weight_scale": 1.0},
    {"name": "innovation-rate", "weight_scale": 1.0},
    {"name": "snapshot-chi2", "signals": "pseudorange"},
    {"name": "sequential-chi2", "signals": "both", "false_alarm": 0.5},
    {"name": "windowed-chi2", "window": 4, "false_alarm": 0.3, "covariance": "estimated"},
    {"name": "windowed-chi2", "window": 1000},
]
"""Like others, for `make test-nightly`."""
VARIANTS = [
    *DETECTORS,
    *FURTHER,
    {"name": "acna", "variant": "literal"},
    {"name": "acna", "variant": "held", "jump_window": 20, "slow_threshold_m": None},
    {"name": "acna", "max_exclusion_s": 2.0, "readmission_fixes": 1},
    {"name": "ewma", "weight_scale": None},
    {"name": "raim", "exclude": True, "false_alarm": 0.5},
    {"name": "glr-ramp", "signals": "both", "window": 20, "baseline": 10},
    {"name": "glr-step", "signals": "range_rate", "window": 8, "baseline": 30},
    {"name": "innovation-rate", "threshold": 0.05, "weight_scale": 0.5, "memory_s": 20.0, **LATE},
    {"name": "lag-cusum", "signals": "both", "lag": 10, "baseline": 15, "threshold": 3.0},
    {"name": "oracle-ramp", "onset_s": 10.0, "min_satellites": 0},
    {"name": "oracle-step", "onset_s": 10.0, "max_exclusion_s": None, "threshold": 0.01},
    {"name": "snapshot-chi2", "signals": "range_rate", "false_alarm": 0.5},
    {"name": "srv-raim", "exclude": True, "false_alarm": 0.5, "frame": "ecef"},
    {"name": "traversal-raim", "exclude": True, "false_alarm": 0.5},
    {"name": "aime", "signals": "both", "windows_s": (1.0, 3.0), "bias_window_s": 2.0},
    {"name": "clock-drift", "signals": "range_rate", "window_s": 1.0, "bias_window_s": 2.0},
    {"name": "cumulative-bank", "signals": "pseudorange", "windows_s": (1.0, 3.0)},
    {"name": "cusum", "signals": "both", "limit": 3.0, "bias_window_s": 2.0},
    {"name": "ewma", "weight_scale": 0.1, "max_exclusion_s": 2.0, "min_satellites": 4},
    {"name": "fma", "signals": "both", "shape": "ramp", "window_s": 3.0, "bias_window_s": 2.0},
    {"name": "joint-chart", "weight_scale": 0.1, "max_exclusion_s": 2.0, "false_alarm": 0.1},
    {"name": "joint-chart", "end_rule": "literal", "weight_scale": None},
    {"name": "sequential-chi2", "window_s": 3.0, "bias_window_s": 2.0},
    {"name": "shewhart", "signals": "both", "weight_scale": 0.5, "bias_window_s": 2.0},
    {"name": "snapshot-chi2", "bias_window_s": 2.0},
    {"name": "solution-separation", "longest_s": 5.0, "spacing_s": 2.0, "false_alarm": 0.5},
    {"name": "windowed-chi2", "window": 1, "covariance": "estimated", "covariance_window": 30},
    {"name": "pool", "members": ["cusum", "shewhart"], "weights": [0.5, 0.5]},
]


@pytest.mark.parametrize("detector", heavy(VARIANTS, *FURTHER), ids=str)
def test_every_detector_keeps_the_contract(detector):
    check_detector(detector)


class Sum(Detector):
    """A detector that does all as it should: a cumulative sum that weighs channels down."""

    scope = "channel"

    def bind(self, context):
        super().bind(context)
        self.memory.declare("sum", np.zeros((context.receivers, context.channels)))

    def statistic(self, epoch):
        n = epoch.visible.shape[1]
        normalized = np.abs(epoch.innovation[:, :n]) / np.sqrt(epoch.innovation_variance[:, :n])
        total = np.maximum(0.0, self.memory["sum"] + normalized - 0.5)
        total[~epoch.visible] = 0.0
        return total

    def judge(self, epoch):
        total = self.statistic(epoch)
        self.memory["sum"] = total.copy()
        weights = np.ones_like(epoch.innovation)
        weights[:, : total.shape[1]] = 1.0 / (1.0 + total)
        return Verdict(total, np.full_like(total, 5.0), total > 5.0, weights)


class AnyChannel(Sum):
    """The same, as a test of the whole receiver that is passive."""

    scope = "receiver"

    def judge(self, epoch):
        statistic = super().judge(epoch).statistic.max(axis=1, keepdims=True)
        return Verdict(statistic, np.full_like(statistic, 5.0), statistic > 5.0)


class Odometer(Sum):
    """Needs what an epoch does not have by default."""

    needs = frozenset({"auxiliary_position", "gnss_position", "cn0_dbhz"})

    def statistic(self, epoch):
        apart = np.linalg.norm(epoch.auxiliary_position - epoch.gnss_position, axis=1)
        return np.where(epoch.visible, super().statistic(epoch) + apart[:, None], 0.0)


class FarFix(Detector):
    """Rejects a fix that is too far from where odometry says, and sums up how far it was."""

    paper = "page1954"
    measures = "position"
    needs = frozenset({"auxiliary_position", "gnss_position"})

    def bind(self, context):
        super().bind(context)
        self.memory.declare("sum", np.zeros(context.receivers))

    def judge(self, epoch):
        apart = np.linalg.norm(epoch.auxiliary_position - epoch.gnss_position, axis=1)
        self.memory["sum"] = np.maximum(0.0, self.memory["sum"] + apart - 20.0)
        statistic = self.memory["sum"][:, None].copy()
        alarm = statistic > 50.0
        weights = np.where(alarm, 0.0, np.ones_like(epoch.innovation))
        return Verdict(statistic, np.full_like(statistic, 50.0), alarm, weights)


class EveryCoordinate(FarFix):
    """Judges what is measured one by one: a position by its coordinates."""

    measures = "any"
    scope = "channel"
    needs = frozenset()

    def judge(self, epoch):
        channels = epoch.visible.shape[1] or epoch.innovation.shape[1]
        statistic = np.abs(epoch.innovation[:, :channels])
        return Verdict(statistic, np.full_like(statistic, 9.0), statistic > 9.0)


class Mean(Detector):
    """Mean square of the last eight epochs, and an alarm only when there are eight."""

    paper = "page1954"
    sets: ClassVar[dict[str, int]] = {}

    def bind(self, context):
        super().bind(context)
        self.memory.declare("ring", np.zeros((context.receivers, 8)))
        self.memory.declare("seen", np.zeros(context.receivers))
        vars(self).update(self.sets)

    def judge(self, epoch):
        square = (epoch.innovation**2 / epoch.innovation_variance).mean(axis=1)
        ring = np.hstack([self.memory["ring"][:, 1:], square[:, None]])
        self.memory["ring"], self.memory["seen"] = ring, self.memory["seen"] + 1.0
        statistic = ring.mean(axis=1, keepdims=True)
        alarm = (statistic > 5.0) & (self.memory["seen"][:, None] >= 8.0)
        return Verdict(statistic, np.full_like(statistic, 5.0), alarm)


class Stateless(Detector):
    """Remembers nothing, and has no `bind`."""

    paper = "page1954"

    def judge(self, epoch):
        return compare(np.abs(epoch.innovation).max(axis=1, keepdims=True), 9.0)


class Declared(Mean):
    sets: ClassVar = {"silent_epochs": 7, "memory_epochs": 8}


class TooSilent(Mean):
    sets: ClassVar = {"silent_epochs": 9}


class WithoutMemory(Mean):
    sets: ClassVar = {"silent_epochs": 7}


@pytest.mark.parametrize(
    "detector",
    [Sum(), AnyChannel(), Odometer(), FarFix(), EveryCoordinate(), Declared(), Stateless()],
    ids=lambda detector: type(detector).__name__,
)
def test_a_new_detector_that_keeps_the_contract_passes(detector):
    check_detector(detector)
    assert not hasattr(detector, "memory")  # the object itself was left alone


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_a_made_up_fix_is_the_prediction_and_the_innovation(coordinates):
    script = position_script(coordinates)
    sizes = []
    for epoch in script.epochs:
        apart = (epoch.gnss_position - epoch.predicted_position)[:, :coordinates]
        np.testing.assert_allclose(apart, epoch.innovation, atol=1e-9)
        assert epoch.visible.shape == (len(epoch.time), 0)
        solved = np.linalg.solve(epoch.innovation_cov, epoch.innovation[:, :, None])[:, :, 0]
        sizes.append((epoch.innovation * solved).sum(axis=1).mean() / coordinates)
    assert 0.7 < np.mean(sizes[:ZERO]) < 1.3  # innovations are as large as they are said to be


def test_a_detector_of_satellites_refuses_a_position():
    with pytest.raises(ValueError, match="Sum measures satellites, but the receiver measures posi"):
        Sum().bind(position_script(2).context)
    with pytest.raises(ValueError, match="FarFix measures position, but the receiver measures sat"):
        FarFix().bind(position_script(2).context._replace(channels=4))


class NoBaseButDeclares(Sum):
    def bind(self, context):
        self.memory.declare("sum", np.zeros((context.receivers, context.channels)))


class BoundOnce(Sum):
    def bind(self, context):
        if not hasattr(self, "memory"):
            super().bind(context)


class Undeclared(Sum):
    def judge(self, epoch):
        self.memory["last"] = epoch.innovation.copy()
        return super().judge(epoch)


class Shrunk(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        self.memory["sum"] = self.memory["sum"].max(axis=1)
        return verdict


class Writes(Sum):
    def judge(self, epoch):
        epoch.innovation[~np.hstack([epoch.visible, epoch.visible])] = 0.0
        return super().judge(epoch)


class BreaksTheSeal(Sum):
    def judge(self, epoch):
        epoch.innovation.flags.writeable = True
        epoch.innovation[:, 0] += 1.0
        return super().judge(epoch)


class KeepsTheEpoch(Sum):
    def bind(self, context):
        super().bind(context)
        self.last = None

    def statistic(self, epoch):
        total = super().statistic(epoch)
        if self.last is not None:
            total[epoch.visible] += np.abs(self.last).max()
        self.last = epoch.innovation
        return total


class OneBuffer(Sum):
    def bind(self, context):
        super().bind(context)
        self.out = np.zeros((context.receivers, context.channels))

    def judge(self, epoch):
        verdict = super().judge(epoch)
        self.out[:] = verdict.statistic
        return verdict._replace(statistic=self.out)


class CountsOutsideTheMemory(Sum):
    def bind(self, context):
        super().bind(context)
        self.count = np.zeros(context.receivers)

    def statistic(self, epoch):
        self.count += 1.0
        return np.where(epoch.visible, super().statistic(epoch) + self.count[:, None], 0.0)


class CountsOutsideButResets(CountsOutsideTheMemory):
    def reset(self, mask=None):
        super().reset(mask)
        self.count[slice(None) if mask is None else mask] = 0.0


class MeanOfNone(Sum):
    def statistic(self, epoch):
        return super().statistic(epoch) / epoch.visible.sum(axis=1, keepdims=True)


class KeepsAList(Sum):
    def bind(self, context):
        super().bind(context)
        self.past = deque(maxlen=2)

    def statistic(self, epoch):
        self.past.append(np.abs(epoch.innovation).max())
        return np.where(epoch.visible, super().statistic(epoch) + max(self.past), 0.0)


class ForgetsAll(Sum):
    def reset(self, mask=None):
        super().reset(None)


class HoldsALambda(Sum):
    def bind(self, context):
        super().bind(context)
        self.curve = lambda x: x


class ForgetsWhenCopied(Sum):
    def __getstate__(self):
        state = copy.copy(self.__dict__)
        if "memory" in state:
            state["memory"] = copy.copy(self.memory)
            state["memory"].reset()
        return state


def mean_over(epoch, verdict):
    return verdict.statistic.mean(axis=0) * epoch.visible


def dice():
    return np.random.random()  # noqa: NPY002 - what nobody may do


CHANGES = {
    "a tuple": (lambda d, e, v: tuple(v), "must return a `Verdict`, got tuple"),
    "one column": (
        lambda d, e, v: v._replace(statistic=v.statistic[:, :1].copy()),
        r"`statistic` must have shape \(5, 12\) .* got \(5, 1\)",
    ),
    "relative": (
        lambda d, e, v: v._replace(statistic=np.where(e.innovation.any(), v.statistic, np.nan)),
        "`statistic` must be finite, got nan for receiver",
    ),
    "seen in the dark": (
        lambda d, e, v: v._replace(statistic=v.statistic + 0.1),
        "the statistic of a channel that isn't visible must be 0, got 0.1",
    ),
    "alarm in the dark": (
        lambda d, e, v: v._replace(alarm=v.alarm | ~e.visible),
        "a channel that isn't visible must not alarm",
    ),
    "weight in the dark": (
        lambda d, e, v: v._replace(weights=np.hstack([e.visible, e.visible]).astype(float)),
        "the weights of a channel that isn't visible must be 1, .* got 0",
    ),
    "its memory": (
        lambda d, e, v: v._replace(statistic=d.memory["sum"]),
        r"`statistic` is \(part of\) `memory\['sum'\]`",
    ),
    "the epoch": (
        lambda d, e, v: v._replace(alarm=e.visible),
        r"`alarm` is \(part of\) `epoch.visible`",
    ),
    "some weights": (
        lambda d, e, v: v if v.alarm.any() else v._replace(weights=None),
        "an array at every epoch or None at every epoch",
    ),
    "an average": (
        lambda d, e, v: compare(v.statistic + mean_over(e, v), v.threshold),
        "must be the same, bit for bit, among 1 and among 5 receivers",
    ),
    "an alarm of its own": (
        lambda d, e, v: v._replace(alarm=e.visible & (v.statistic < v.threshold)),
        "`alarm` must be whether the statistic exceeds the threshold, got True with",
    ),
    "global dice": (
        lambda d, e, v: v._replace(statistic=v.statistic + 0.0 * dice()),
        "uses the global random numbers",
    ),
    "dice": (
        lambda d, e, v: compare(v.statistic * np.random.default_rng().random(), v.threshold),
        "When all is done again, the detector must do the same",
    ),
}


class Changed(Sum):
    """Changes what it says."""

    def __init__(self, name):
        self.name = name

    def judge(self, epoch):
        return CHANGES[self.name][0](self, epoch, super().judge(epoch))


@dataclass
class OneSetting(Sum):
    """Has a setting that JSON has not."""

    things: set


def stating(**stated):
    return type("Odd", (Sum,), stated)()


BROKEN = {
    "paper": (stating(paper=" "), "must be a key in references.bib"),
    "scope": (stating(scope="satellite"), "must be 'channel' .* got 'satellite'"),
    "measures": (
        stating(measures="positions"),
        "must be 'satellites', 'position' or 'any', got 'positions'",
    ),
    "oracle": (stating(oracle=1), "must be True or False, got 1"),
    "needs": (
        stating(needs=frozenset({"true_position"})),
        r"optional fields .* got frozenset\({'true_position'}",
    ),
    "silent": (Mean(), "no alarm in the first 7 epochs .* set `self.silent_epochs = 7` in `bind`"),
    "not silent": (
        TooSilent(),
        "`TooSilent.silent_epochs` is 9, but there is an alarm after 7 epochs",
    ),
    "window": (
        WithoutMemory(),
        "no longer matters after 8 epochs; set `self.memory_epochs = 8` in `bind`",
    ),
    "settings": (OneSetting({1, 2}), "must fit into JSON, .* of type set can't be written down"),
    **{name: (Changed(name), said) for name, (_, said) in CHANGES.items()},
    "no base": (NoBaseButDeclares(), r"`bind` finds no memory .* call `super\(\).bind"),
    "bound once": (BoundOnce(), "must be of 1 receivers, got 5; make it again in every `bind`"),
    "undeclared": (Undeclared(), "keeps 'last' in its memory without having declared it"),
    "shrunk": (
        Shrunk(),
        r"memory 'sum' .* declared as float64 of shape \(5, 12\) and has become .* \(5,\)",
    ),
    "writes": (Writes(), "the detector writes into its epoch, which is read-only"),
    "breaks the seal": (BreaksTheSeal(), "has changed `epoch.innovation`"),
    "keeps the epoch": (KeepsTheEpoch(), "valid during `judge` only"),
    "one buffer": (OneBuffer(), "`statistic` has changed while the detector went on"),
    "counts": (CountsOutsideTheMemory(), "After a reset the detector must be as it was after `bi"),
    "moved": (CountsOutsideButResets(), "When the rows of its memory are moved to another batch"),
    "forgets": (ForgetsAll(), "A reset of some receivers must leave the others alone"),
    "lambda": (HoldsALambda(), "cannot be pickled"),
    "a list": (KeepsAList(), "bit for bit, .* Likely causes: .* state outside `memory` .* or sums"),
    "misspelt": (
        stating(judge=lambda self, epoch: epoch.innovations),
        r"`Odd.judge` failed in epoch 0 of .*: AttributeError: an `Epoch` has no 'innovations'; "
        r"valid: time, .*weights; did you mean 'innovation'\?",
    ),
    "none to divide by": (
        MeanOfNone(),
        r"`MeanOfNone.judge` failed in epoch \d+ of made-up epochs, of 5 receivers that see "
        r"0 to \d satellites: RuntimeWarning: invalid value encountered in divide",
    ),
    "copied": (ForgetsWhenCopied(), "A deep-copied detector must go on as if it had not been"),
}


@pytest.mark.parametrize(("detector", "said"), BROKEN.values(), ids=BROKEN)
def test_a_broken_detector_is_caught(detector, said):
    with pytest.raises(AssertionError, match=said):
        check_detector(detector)


def test_what_is_no_detector_is_refused():
    with pytest.raises(TypeError, match="a detector is a name"):
        check_detector(dict)
    with pytest.raises(ValueError, match=r"unknown detector 'ewna'.*did you mean 'ewma'"):
        check_detector("ewna")
