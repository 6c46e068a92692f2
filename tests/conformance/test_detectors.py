"""Every detector keeps the contract, and `check_detector` catches whoever breaks it."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from spoofgym.detectors import DETECTORS, Detector, Verdict
from spoofgym.testing import check_detector
from spoofgym.testing.epochs import COORDINATES, ZERO, position_script

VARIANTS = [
    *DETECTORS,
    {"name": "acna", "variant": "literal"},
    {"name": "acna", "variant": "held", "jump_window": 20, "slow_threshold_m": None},
    {"name": "acna", "max_exclusion_s": 2.0, "readmission_fixes": 1},
    {"name": "ewma", "weight_scale": None},
    {"name": "ewma", "smoothing": 1.0, "false_alarm": 0.1, "weight_scale": 1.0},
    {"name": "raim", "exclude": True, "false_alarm": 0.5},
    {"name": "glr-ramp", "signals": "both", "window": 20, "baseline": 10},
    {"name": "glr-step", "signals": "range_rate", "window": 8, "baseline": 30},
    {"name": "innovation-rate", "weight_scale": 1.0},
    {
        "name": "innovation-rate",
        "threshold": 0.05,
        "weight_scale": 0.5,
        "memory_s": 20.0,
        "start_s": 4.0,
        "settled_s": 8.0,
        "max_exclusion_s": 6.0,
        "min_satellites": 4,
    },
    {"name": "lag-cusum", "signals": "both", "lag": 10, "baseline": 15, "threshold": 3.0},
    {"name": "oracle-ramp", "onset_s": 10.0, "min_satellites": 0},
    {"name": "oracle-step", "onset_s": 10.0, "max_exclusion_s": None, "threshold": 0.01},
    {"name": "snapshot-chi2", "signals": "pseudorange"},
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
    {"name": "sequential-chi2", "signals": "both", "false_alarm": 0.5},
    {"name": "shewhart", "signals": "both", "weight_scale": 0.5, "bias_window_s": 2.0},
    {"name": "snapshot-chi2", "bias_window_s": 2.0},
    {"name": "solution-separation", "longest_s": 5.0, "spacing_s": 2.0, "false_alarm": 0.5},
    {"name": "windowed-chi2", "window": 1, "covariance": "estimated", "covariance_window": 30},
    {"name": "windowed-chi2", "window": 4, "false_alarm": 0.3, "covariance": "estimated"},
    {"name": "windowed-chi2", "window": 1000},
    {"name": "pool", "members": ["cusum", "shewhart"], "weights": [0.5, 0.5]},
]


@pytest.mark.parametrize("detector", VARIANTS, ids=str)
def test_every_detector_keeps_the_contract(detector):
    check_detector(detector)


class Sum(Detector):
    """A detector that does all as it should: a cumulative sum that weighs channels down."""

    paper = "page1954"
    scope = "channel"
    drift = 0.5

    def bind(self, context):
        super().bind(context)
        self.memory.declare("sum", np.zeros((context.receivers, context.channels)))

    def statistic(self, epoch):
        n = epoch.visible.shape[1]
        normalized = np.abs(epoch.innovation[:, :n]) / np.sqrt(epoch.innovation_variance[:, :n])
        total = np.maximum(0.0, self.memory["sum"] + normalized - self.drift)
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


@pytest.mark.parametrize(
    "detector",
    [Sum(), AnyChannel(), Odometer(), FarFix(), EveryCoordinate()],
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


class NoPaper(Sum):
    paper = " "


class OddScope(Sum):
    scope = "satellite"


class OddWatch(Sum):
    measures = "positions"


class OddOracle(Sum):
    oracle = 1


class OneWeight(FarFix):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict._replace(weights=verdict.weights[:, :1].copy())


class UnknownNeed(Sum):
    needs = frozenset({"true_position"})


class NoBase(Sum):
    def bind(self, context):
        self.total = np.zeros((context.receivers, context.channels))


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


class PlainTuple(Sum):
    def judge(self, epoch):
        return tuple(super().judge(epoch))


class ListOfAlarms(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict._replace(alarm=verdict.alarm.tolist())


class OneColumn(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict._replace(statistic=verdict.statistic[:, :1].copy())


class SinglePrecision(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict._replace(statistic=verdict.statistic.astype(np.float32))


class NumberedAlarms(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict._replace(alarm=verdict.alarm.astype(int))


class RelativeInnovation(Sum):
    def statistic(self, epoch):
        n = epoch.visible.shape[1]
        with np.errstate(invalid="ignore"):
            share = np.abs(epoch.innovation[:, :n]) / np.abs(epoch.innovation).sum(axis=1)[:, None]
        return np.where(epoch.visible, share, 0.0)


class MeanOfNone(AnyChannel):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        visible = epoch.visible.sum(axis=1, keepdims=True)
        mean = np.abs(epoch.innovation).sum(axis=1, keepdims=True) / visible
        return verdict._replace(statistic=np.nan_to_num(mean))


class NegativeWeights(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict._replace(weights=1.0 - 2.0 * (verdict.weights < 1.0))


class SeesTheInvisible(Sum):
    def statistic(self, epoch):
        return super().statistic(epoch) + 0.1


class AlarmsInTheDark(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict._replace(alarm=verdict.alarm | ~epoch.visible)


class RejectsTheInvisible(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        n = epoch.visible.shape[1]
        verdict.weights[:, n:] = epoch.visible
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


class HandsOutItsMemory(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict._replace(statistic=self.memory["sum"])


class HandsOutTheEpoch(Sum):
    def judge(self, epoch):
        return super().judge(epoch)._replace(alarm=epoch.visible)


class OneBuffer(Sum):
    def bind(self, context):
        super().bind(context)
        self.out = np.zeros((context.receivers, context.channels))

    def judge(self, epoch):
        verdict = super().judge(epoch)
        self.out[:] = verdict.statistic
        return verdict._replace(statistic=self.out)


class BroadcastWeights(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict._replace(weights=np.broadcast_to(1.0, epoch.innovation.shape))


class SometimesWatches(Sum):
    def judge(self, epoch):
        verdict = super().judge(epoch)
        return verdict if verdict.alarm.any() else verdict._replace(weights=None)


class AveragesReceivers(Sum):
    def statistic(self, epoch):
        total = super().statistic(epoch)
        return np.where(epoch.visible, total + total.mean(axis=0), 0.0)


class RollsGlobalDice(Sum):
    def judge(self, epoch):
        np.random.random()  # noqa: NPY002 - what nobody may do
        return super().judge(epoch)


class RollsDice(Sum):
    def bind(self, context):
        super().bind(context)
        self.rng = np.random.default_rng()

    def statistic(self, epoch):
        return np.where(epoch.visible, super().statistic(epoch) + self.rng.random(), 0.0)


class RollsSeededDice(RollsDice):
    def bind(self, context):
        super().bind(context)
        self.rng = np.random.default_rng(0)

    def statistic(self, epoch):
        jitter = self.rng.random(epoch.visible.shape)
        return np.where(epoch.visible, Sum.statistic(self, epoch) + jitter, 0.0)


class CountsInTheClass(Sum):
    seen = 0

    def statistic(self, epoch):
        type(self).seen += 1
        return np.where(epoch.visible, super().statistic(epoch) + self.seen, 0.0)


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


class NeverForgets(Sum):
    def reset(self, mask=None):
        pass


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


BROKEN = {
    NoPaper: "`NoPaper.paper` must be a key in references.bib",
    OddScope: "`OddScope.scope` must be 'channel' .* got 'satellite'",
    OddWatch: "`OddWatch.measures` must be 'satellites', 'position' or 'any', got 'positions'",
    OddOracle: "`OddOracle.oracle` must be True or False, got 1",
    OneWeight: "`weights` must have shape \\(5, 2\\) for 5 receivers with a position of 2 coor",
    UnknownNeed: "optional fields of an epoch .* got frozenset\\({'true_position'}\\)",
    NoBase: "must have a `memory` made by the base class, got None",
    NoBaseButDeclares: "`bind` finds no memory .* call `super\\(\\).bind",
    BoundOnce: "must be of 1 receivers, got 5; make it again in every `bind`",
    Undeclared: "keeps 'last' in its memory without having declared it",
    Shrunk: "memory 'sum' .* declared as float64 of shape \\(5, 12\\) and has become .* \\(5,\\)",
    PlainTuple: "must return a `Verdict`, got tuple",
    ListOfAlarms: "`alarm` must be an array, got list",
    OneColumn: "`statistic` must have shape \\(5, 12\\) .* got \\(5, 1\\)",
    SinglePrecision: "`statistic` must be of type float64, got float32",
    NumberedAlarms: "`alarm` must be of type bool, got int64",
    RelativeInnovation: "`statistic` must be finite, got nan for receiver",
    NegativeWeights: "`weights` must lie within 0 and 1, got -1.0 for receiver",
    SeesTheInvisible: "the statistic of a channel that isn't visible must be 0, got 0.1",
    AlarmsInTheDark: "a channel that isn't visible must not alarm",
    RejectsTheInvisible: "the weights of a channel that isn't visible must be 1, .* got 0",
    Writes: "the detector writes into its epoch, which is read-only",
    BreaksTheSeal: "has changed `epoch.innovation`",
    KeepsTheEpoch: "valid during `judge` only",
    HandsOutItsMemory: "`statistic` is \\(part of\\) `memory\\['sum'\\]`",
    HandsOutTheEpoch: "`alarm` is \\(part of\\) `epoch.visible`",
    OneBuffer: "`statistic` has changed while the detector went on",
    BroadcastWeights: "`weights` must be a C-contiguous array",
    SometimesWatches: "an array at every epoch or None at every epoch",
    AveragesReceivers: "must be the same, bit for bit, among 1 and among 5 receivers",
    RollsGlobalDice: "uses the global random numbers",
    RollsDice: "When all is done again, the detector must do the same",
    RollsSeededDice: "must be the same, bit for bit, among 1 and among 5 receivers",
    CountsInTheClass: "When all is done again, the detector must do the same",
    CountsOutsideTheMemory: "After a reset the detector must be as it was after `bind`",
    CountsOutsideButResets: "When the rows of its memory are moved to another batch",
    NeverForgets: "After a reset the detector must be as it was after `bind`",
    ForgetsAll: "A reset of some receivers must leave the others alone",
    HoldsALambda: "cannot be pickled",
    ForgetsWhenCopied: "A deep-copied detector must go on as if it had not been",
}


@pytest.mark.parametrize("kind", BROKEN, ids=lambda kind: kind.__name__)
def test_a_broken_detector_is_caught(kind):
    with pytest.raises(AssertionError, match=BROKEN[kind]):
        check_detector(kind())


def test_a_warning_where_nothing_is_in_view_is_an_error():
    with pytest.raises(RuntimeWarning, match="invalid value encountered in divide"):
        check_detector(MeanOfNone())


def test_what_is_no_detector_is_refused():
    with pytest.raises(TypeError, match="a detector is a name"):
        check_detector(Sum)
    with pytest.raises(ValueError, match=r"unknown detector 'ewna'.*did you mean 'ewma'"):
        check_detector("ewna")
