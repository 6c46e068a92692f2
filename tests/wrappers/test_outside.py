"""A detector outside of the loop judges as it does within."""

from functools import partial

import numpy as np
import pytest

from spoofgym import wrappers
from spoofgym.detectors import DETECTORS, Calibrated, make_detector
from spoofgym.simulation.simulator import weighs
from spoofgym.wrappers import vector as vector_wrappers

from ..envs.support import HOLD, LIVE, STEPS, LooksAtEpochs, single, vector, victim


@pytest.fixture(scope="module")
def setup():
    return single(detector="never").unwrapped.core.setup


def loose(name):
    """A detector whose alarms come soon, so that there are some of them."""
    made = make_detector({"name": name})
    return Calibrated(made, scale=0.2) if made.calibrates else made


@pytest.mark.parametrize("name", [n for n in DETECTORS if n != "pool"])
def test_the_verdicts_outside_are_those_within_to_the_bit(setup, name):
    detector = make_detector(name)
    try:
        setup.check_fit(detector)
    except ValueError as error:
        pytest.skip(f"no detector of this victim: {error}")
    if weighs(setup, detector):
        with pytest.raises(ValueError, match="which needs the loop: take `DetectorWrapper`"):
            wrappers.PassiveDetector(single(), {"name": name})
        return
    made = loose(name)
    within = single(detector=made, end="at-window-end")
    outside = wrappers.PassiveDetector(single(end="at-window-end"), made, end=False)
    both = vector_wrappers.PassiveDetector(vector(2, end="at-window-end"), made, end=False)
    begun, inner = outside.reset(seed=4)[1], within.reset(seed=4)[1]
    first = both.reset(seed=4)[1]
    assert begun["alarm"] == inner["warmup_alarm"] == first["alarm"][0]
    over = detected = False
    while not over:
        detected = detected or inner.get("detected", False)
        *_, over, _, inner = within.step([0.0, 0.9])
        verdict = within.unwrapped.core.engine.simulator.verdict
        mine, theirs = outside.step([0.0, 0.9])[4], both.step([[0.0, 0.9]] * 2)[4]
        if over and detected:  # then the time to alert is not run within
            break
        assert mine["alarm"] == inner["alarm"] == theirs["alarm"][0]
        if not over:  # else the verdict within is that of the last epoch to alert
            ratio = (verdict.statistic / verdict.threshold).max()
            assert mine["statistic"] / mine["threshold"] == ratio
            assert theirs["statistic"][0] / theirs["threshold"][0] == ratio


def test_a_filter_of_its_own_sees_the_whole_start_from_outside():
    world = {"scenario": "trolley", "receiver": "matched", "end": "at-window-end"}
    spec = {"name": "snapshot-chi2", "filter": "augmented", "thresholds": "nominal"}
    within = single(detector=spec, **world)
    outside = wrappers.PassiveDetector(single(detector="never", **world), spec, end=False)
    within.reset(seed=1)
    assert len(outside.reset(seed=1)[1]["settling_epochs"]) == LIVE
    for _ in range(STEPS - 1):
        within.step([0.0, 0.5])
        mine = outside.step([0.0, 0.5])[4]
        verdict = within.unwrapped.core.engine.simulator.verdict
        assert mine["statistic"] / mine["threshold"] == (verdict.statistic / verdict.threshold)
        assert mine["statistic"] > 0.0


class TenLines(LooksAtEpochs):
    """Alarms where a range rate is far from what was predicted; knows nothing of this library."""

    def look(self, epochs):
        ratio = [
            np.max(np.abs(e.innovation) / np.sqrt(e.innovation_variance), initial=0) for e in epochs
        ]
        return {"statistic": max(ratio), "threshold": 3.0, "alarm": max(ratio) > 3.0}


@pytest.mark.parametrize("epochs", [1, 5])
def test_an_ordinary_wrapper_sees_every_epoch_once(epochs):
    interval_s = 0.5 * epochs if epochs > 1 else None
    env = victim("Zhong2025", detector="never", decision_interval_s=interval_s)
    env = TenLines(wrappers.EpochInfo(env))
    _, info = env.reset(seed=1)
    times, counts, over = [e.time for e in info["epochs"]], [], False
    while not over:
        *_, over, _, info = env.step([0.0, 0.0])
        counts.append(len(info["epochs"]))
        times += [e.time for e in info["epochs"]]
    assert counts == [epochs] * (STEPS // epochs - 1) + [epochs + HOLD]
    np.testing.assert_allclose(np.diff(times), 0.5)
    assert len(times) == LIVE + STEPS + HOLD
    assert info["epochs"][0].innovation.shape == (24,)
    assert info["epochs"][0].innovation_cov.shape == (24, 24)
    assert not info["epochs"][0].innovation.flags.writeable


@pytest.mark.parametrize("mode", ["next_step", "disabled"])
def test_an_alarm_ends_the_episode_of_its_receiver_alone(mode):
    made = Calibrated(make_detector("snapshot-chi2"), scale=0.3)
    envs = vector_wrappers.PassiveDetector(vector(3, autoreset_mode=mode), made)
    singles = [wrappers.PassiveDetector(single(), made) for _ in range(3)]
    envs.reset(seed=7)
    for k, env in enumerate(singles):
        env.reset(seed=7 + k)
    fresh, ended = [False] * 3, 0
    for _ in range(2 * STEPS):
        if mode == "disabled" and any(fresh):
            info = envs.reset(options={"reset_mask": np.array(fresh)})[1]
            for row in np.flatnonzero(fresh):
                assert singles[row].reset()[1]["alarm"] == info["alarm"][row]
            fresh = [False] * 3
        _, _, over, _, info = envs.step([[0.0, 1.0]] * 3)
        for row, env in enumerate(singles):
            mine = env.reset()[1] if fresh[row] else env.step([0.0, 1.0])[4]
            for name in ("alarm", "statistic", "time_s"):
                assert mine[name] == info[name][row]
            assert over[row] == (mine["alarm"] and not fresh[row]) or mine["time_s"] > 20.0
        fresh, ended = over.tolist(), ended + over.sum()
    assert ended > 3


def test_what_does_not_fit_is_refused_by_name():
    vectors = partial(vector, 2)
    with pytest.raises(TypeError, match=r"its twin for that is `spoofgym.wrappers.vector.Detector"):
        wrappers.DetectorWrapper(vectors(), "snapshot-chi2")
    with pytest.raises(ValueError, match="needs infos='all' and an `autoreset_mode`"):
        vector_wrappers.PassiveDetector(vectors(autoreset_mode="same_step"), "snapshot-chi2")
    with pytest.raises(ValueError, match="a pool draws its members only in the loop"):
        wrappers.PassiveDetector(single(), {"name": "pool", "members": ["shewhart"]})
    with pytest.raises(ValueError, match="'truth'"):
        single(epoch=["truth"])
    with pytest.raises(TypeError, match="`epoch` must be True, False or names"):
        single(epoch="innovation_cov")
