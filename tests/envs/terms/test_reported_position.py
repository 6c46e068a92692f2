"""What the victim broadcasts: late, in steps, and by its own solution."""

import numpy as np
import pytest

from spoofgym.envs import SpoofCore
from spoofgym.envs.terms.observation import ReportedDeviation, ReportedPosition, Time
from spoofgym.simulation import TightlyCoupledSetup

from ..support import SHORT, victim


def core_of(receivers, *terms, **settings):
    setup = TightlyCoupledSetup(timeline=SHORT, detector="never")
    core = SpoofCore(receivers, setup, observation=(Time(), *terms), **settings)
    core.reset([np.random.default_rng(i) for i in range(receivers)])
    return core


def run(core, steps=12, action=1.0):
    """(K, B, 3) what was reported, and (K, B, 2) the error of the victim north and east."""
    seen, error = [core.observe()[:, 2:]], [core.engine.simulator.error_n()[:, :2]]
    for _ in range(steps):
        _, observation = core.step(np.full((core.receivers, 1), action))
        seen.append(observation[:, 2:])
        error.append(core.engine.simulator.error_n()[:, :2])
    return np.array(seen), np.array(error)


@pytest.mark.parametrize("latency_s", [0.0, 3.0])
def test_a_report_is_of_its_epoch(latency_s):
    term = ReportedDeviation(scale_m=1.0, latency_s=latency_s, step_m=0.0)
    seen, error = run(core_of(8, term))
    late = np.round(seen[..., 2] / 0.5).astype(int)
    assert (late >= 0).all()
    if latency_s:
        assert late.max() > 2
        assert len(np.unique(late[6:])) > 2
    else:
        assert not seen[..., 2].any()
    for k in range(7 if latency_s else 0, len(seen)):
        for b in range(8):
            np.testing.assert_allclose(seen[k, b, :2], error[k - late[k, b], b], atol=1e-3)


def test_the_default_latency_is_at_most_two_epochs():
    seen, _ = run(core_of(16, ReportedPosition()), steps=20)
    alone, _ = run(core_of(1, ReportedPosition()), steps=20)
    assert np.array_equal(seen[:, 0], alone[:, 0])  # by the episode, not the batch
    late = np.round(seen[..., 2] / 0.5).astype(int)
    # 0 takes a latency of 0; more than 0.5 s comes in one of six reports
    assert set(np.unique(late)) == {1, 2}
    assert 0.05 < (late == 2).mean() < 0.35


def test_positions_come_in_steps():
    seen, _ = run(core_of(4, ReportedPosition(scale_m=1000.0, step_m=5.0)))
    steps = seen[..., :2] * (1000.0 / 5.0)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    assert np.ptp(steps[..., 1]) > 100.0


def test_reports_come_as_often_as_they_are_sent():
    term = ReportedPosition(scale_m=1.0, interval_s=2.0, latency_s=0.0, step_m=0.0)
    seen, _ = run(core_of(2, term), steps=12)
    age = np.round(seen[:, 0, 2] / 0.5).astype(int)
    assert age.tolist() == [0, 1, 2, 3] * 3 + [0]
    with pytest.raises(ValueError, match=r"must be at most 31 s together .* got 0.5 and 40"):
        core_of(1, ReportedPosition(latency_s=40.0))


@pytest.mark.parametrize("kind", ["Zhong2025", "LooselyCoupled", "Snapshot", "WheeledRobot"])
def test_every_victim_reports(kind):
    env = victim(kind, knowledge="blind+reported", detector="never")
    names = env.unwrapped.observation_names
    assert names[-3:] == ("reported_position_north", "reported_position_east", "report_age")
    seen, _ = env.reset(seed=1)
    for _ in range(8):
        seen, *_ = env.step(np.zeros(env.action_space.shape))
    assert env.observation_space.contains(seen)
    deviation = victim(kind, knowledge="tracking+reported", detector="never").unwrapped
    assert deviation.observation_names[-2] == "reported_deviation_east"
