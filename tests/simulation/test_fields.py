"""Which optional fields an epoch has: what somebody needs, and the same bits whatever that is."""

import numpy as np
import pytest

from spoofgym.detectors import Never, make_detector
from spoofgym.detectors.learned import DetectorAgent
from spoofgym.receiver.epoch import OPTIONAL
from spoofgym.simulation import Engine
from spoofgym.simulation.divergence import Divergence
from spoofgym.simulation.monitors import Monitor, PassiveDetectors

from .support import SETUPS, rngs, setup_of, step, warm

every_victim = pytest.mark.parametrize("kind", SETUPS)
FAST = {"warmup_s": 4.0, "live_s": 3.0, "attack_s": 5.0, "time_to_alert_s": 1.0}


class Reader(Never):
    def __init__(self, *needs):
        self.needs = frozenset(needs)

    def judge(self, epoch):
        assert given(epoch) >= self.needs
        return super().judge(epoch)


def given(epoch):
    return {name for name in OPTIONAL if getattr(epoch, name) is not None}


def tight(detector="never"):
    return setup_of("tightly-coupled", detector=detector, timeline=FAST)


@every_victim
def test_an_epoch_has_what_the_detector_needs_and_one_that_forgets_fails_alike(kind):
    setup = setup_of(kind, detector=Reader("design", "predicted_cov"))
    assert setup.has > setup.detector.needs
    victim = warm(setup, 2)
    assert victim.fields == given(victim.epoch) == {"design", "predicted_cov"}
    message = r"Forgetful reads `epoch.design`, .* `needs = frozenset\({'design'}\)` into the class"
    with pytest.raises(TypeError, match=message):
        warm(setup_of(kind, detector=Forgetful()), 2)


@every_victim
def test_all_fields_may_be_wanted_and_have_the_same_bits(kind):
    wanted, frugal = (setup_of(kind, detector=Never()) for _ in range(2))
    wanted.fields = wanted.has
    mine, theirs = warm(wanted, 3), warm(frugal, 3)
    assert given(mine.epoch) == wanted.has
    assert not given(theirs.epoch)
    for _ in range(5):
        step(mine, 0.3)
        step(theirs, 0.3)
        variance = np.einsum("bii->bi", mine.epoch.innovation_cov)
        np.testing.assert_array_equal(mine.epoch.innovation_variance, variance)
        for name in set(theirs.epoch._fields) - set(OPTIONAL):
            same = getattr(mine.epoch, name), getattr(theirs.epoch, name)
            np.testing.assert_array_equal(*same, err_msg=name)
        np.testing.assert_array_equal(mine.position, theirs.position)
    for array in filter(lambda array: array is not None, mine.epoch):
        assert array.flags.c_contiguous
        assert not array.flags.writeable
        assert len(array) == 3


def test_needs_of_loop_passive_detectors_monitors_and_agents_are_met():
    pool = make_detector({"name": "pool", "members": ["aime", "raim"]})
    passive = PassiveDetectors([Reader("imu_delta"), pool, make_detector("ewma")])
    assert passive.needs == {"imu_delta", "innovation_cov", "pseudorange", "satellite_position"}
    setup = tight("snapshot-chi2").copy_with(monitors=[passive, Divergence()])
    engine = Engine(2, setup, twin=True)
    engine.reset(rngs(2))
    engine.step(np.zeros((2, 2)))
    union = passive.needs | Divergence.needs | {"innovation_cov"}
    assert engine.simulator.fields == given(engine.simulator.epoch) == union
    assert given(engine.twin.epoch) == {"innovation_cov"}  # nobody monitors a clean twin
    variances = (each.epoch.innovation_variance for each in (engine.simulator, engine.twin))
    np.testing.assert_array_equal(*variances)
    with pytest.raises(LookupError, match="has no monitor Forgotten"):
        engine.simulator.monitor(type("Forgotten", (Monitor,), {}))
    assert DetectorAgent().needs == {"innovation_cov", "imu_delta"}
    victim = warm(tight(DetectorAgent()), 2)
    assert given(victim.epoch) == victim.detector.needs
    assert victim.detector.memory["observation"].any()


class Forgetful(Never):
    def judge(self, epoch):
        return super().judge(epoch._replace(innovation=epoch.design[:, :, 0]))


class Late(Monitor):
    def bind(self, simulator):
        simulator.bind_detector(Reader("transition", "design"))

    def update(self, simulator):
        raise NotImplementedError


class Compass(Late):
    needs = frozenset({"cn0_dbhz", "design"})

    def bind(self, simulator):
        pass


@pytest.mark.parametrize(
    ("monitor", "message"),
    [
        (Late(), "Reader needs design, transition, but the fields of the epochs are fixed when a"),
        (Compass(), "Compass needs cn0_dbhz, which a tightly coupled receiver does not have"),
    ],
)
def test_fields_are_known_before_the_first_epoch(monitor, message):
    with pytest.raises(ValueError, match=message):
        warm(tight().copy_with(monitors=[monitor]), 1)
