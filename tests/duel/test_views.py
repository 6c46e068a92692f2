"""One side of the duel: Gymnasium's contracts, batches, and pools of opponents."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from spoofgym import duel_v0
from spoofgym.duel.duel import with_world
from spoofgym.envs import SpoofEnv
from spoofgym.spoofers import Ramp

from ..envs.players import Player, assert_same
from .support import ALARM, BRIEF, FORMS, ONE_SKY, PAPERS, QUIET, wary

STRONG = {"name": "false-position", "acceleration_limit_mps2": 1.0}
FULL = {**BRIEF, "attack": STRONG, "action": "full-command"}
WARY = duel_v0.PolicyDetector(policy=duel_v0.FunctionPolicy(wary), threshold=0.2)
SPOOFER = {"pool": ["ewma", "snapshot-chi2", WARY], "weights": [1.0, 1.0, 2.0], **FULL}
DOMAIN = {
    "domain": {"start_s": (0.0, 30.0), "turned_deg": (0.0, 360.0), "worlds": 2},
    "target_heading_deg": "random",
}
DETECTOR = {
    "pool": [{"name": "ramp", "rate_mps": 0.5}, "none", Ramp(rate_mps=3.0)],
    **{**BRIEF, "attack": STRONG, "threshold": 0.5},
}
AGED = {"domain": {**ONE_SKY, "age_s": (11.0, 16.0)}, "onset": "within"}
FOLLOWING = [
    {"name": "ramp", "rate_mps": 0.5, "heading_deg": "target"},
    "none",
    Ramp(rate_mps=3.0, heading_deg="target"),
]


@pytest.mark.parametrize(
    ("name", "kwargs"),
    [
        ("SpooferView", {**SPOOFER, "knowledge": "oracle", "pool": ["never", WARY]}),
        ("DetectorView", {**DETECTOR, "decision_delay": 1, "statistic": "channel"}),
    ],
)
def test_gymnasium_check_env(name, kwargs):
    kwargs = {key: value for key, value in kwargs.items() if key != "weights"}
    check_env(gym.make(f"spoofgym/{name}-v0", **kwargs).unwrapped, skip_render_check=True)


CASES = {
    "spoofer": ("Spoofer", "next_step", SPOOFER),
    "late": ("Detector", "next_step", {**DETECTOR, "decision_delay": 1, "threshold": "running"}),
    "spoofer-domain": ("Spoofer", "same_step", {**SPOOFER, **DOMAIN}),
    "detector-domain": ("Detector", "next_step", {**DETECTOR, **DOMAIN, "pool": FOLLOWING}),
    "decisions": (
        "Detector",
        "same_step",
        {**DETECTOR, "decision_interval_s": 1.5, "between": "linear"},
    ),
    "within": ("Detector", "next_step", {**DETECTOR, **AGED}),
    "late-within": ("Detector", "same_step", {**DETECTOR, **AGED, "decision_delay": 1}),
}


@pytest.mark.parametrize(("side", "mode", "kwargs"), CASES.values(), ids=CASES)
def test_every_receiver_of_a_vector_view_is_the_single_view(side, mode, kwargs):
    steps, seed, push = 40, 11, 1.0 if side == "Spoofer" else 0.2
    envs = getattr(duel_v0, f"{side}VectorView")(4, autoreset_mode=mode, **kwargs)
    many = Player(envs, mode, push=push).begin(seed)
    opponents, alone = [], []
    for i in range(4):
        view = getattr(duel_v0, f"{side}View")(**kwargs)
        player = Player(view, "single", first=i, push=push).begin(seed + i)
        opponents.append(view.opponent)
        alone += player.go(steps)
    assert envs.opponents == opponents
    assert len({*opponents}) > 1
    assert_same(many.go(steps), alone)
    assert all(sum("reward" not in each for each in row) > 1 for row in alone)  # of episodes


def test_the_spoofers_view_of_one_detector_is_the_env_with_it():
    ours = duel_v0.SpooferView("ewma", alarm_price=1.5, **FULL)
    theirs = SpoofEnv(detector="ewma", **with_world(FULL))
    ours.reset(seed=8)
    theirs.reset(seed=8)
    over = False
    while not over:
        mine, other = ours.step(np.array([0.1, 0.5])), theirs.step(np.array([0.1, 0.5]))
        np.testing.assert_array_equal(mine[0], other[0])
        over = mine[2]
        assert mine[1:] == other[1:]


@pytest.mark.parametrize("delay", [0, 1])
def test_the_detectors_view_is_the_duel_against_that_spoofer(delay):
    kwargs = {**BRIEF, "attack": STRONG, "threshold": 1.0}
    view = duel_v0.DetectorView({"name": "ramp", "rate_mps": 0.5}, decision_delay=delay, **kwargs)
    make, run = FORMS[delay]
    duel, attacked = make(**kwargs), set()
    for seed in range(3):
        view.reset(seed=seed)
        over, total = False, 0.0
        while not over:
            _, reward, over, _, info = view.step(QUIET)
            total += reward
        attacked.add(info["attacked"])
        lost = info["undetected_displacement_m"] if info["attacked"] else 0.0
        assert total == pytest.approx(-lost, abs=1e-9)
        # a ramp of 0.5 m/s at 1 m/s^2 and epochs of 0.5 s is at its rate after one command
        *_, last = run(duel, seed, lambda k: np.array([0.0, float(k == 0)]), lambda k, seen: QUIET)
        assert last["attacked"] == info["attacked"]
        assert last["undetected_displacement_m"] == info["undetected_displacement_m"]
    assert attacked == {False, True}


@pytest.mark.parametrize(
    ("view", "kwargs", "pool"),
    [("SpooferVectorView", SPOOFER, "cusum"), ("DetectorVectorView", DETECTOR, "none")],
)
def test_after_a_change_of_the_pool_all_receivers_begin_anew(view, kwargs, pool):
    envs = getattr(duel_v0, view)(2, **kwargs, autoreset_mode="disabled")
    action = np.full(envs.action_space.shape, -0.3)
    envs.reset(seed=1)
    envs.step(action)
    envs.set_pool([pool], [2.0])
    for options in ({"reset_mask": np.array([True, False])}, {"domain": 3}):
        with pytest.raises((ValueError, TypeError), match=r"reset all receivers|must be a dict"):
            envs.reset(options=options)
        with pytest.raises(RuntimeError, match="the pool has changed"):
            envs.step(action)
    for mask in ([True, True], [True, False]):
        envs.reset(options={"reset_mask": np.array(mask)})
        envs.step(action)
        assert envs.opponents == [pool] * 2


@pytest.mark.parametrize(
    ("make", "kwargs", "message"),
    [
        # pools
        ("SpooferView", {"pool": []}, "at least one opponent"),
        ("SpooferView", {"pool": ["ewma"], "weights": [0.5, 0.5]}, "one number for each"),
        ("SpooferView", {"pool": ["ewma"], "weights": [-1.0]}, "finite, >= 0, and not all"),
        ("SpooferView", {"pool": ["ewma"], "weights": ["x"]}, "`weights` must be numbers"),
        ("SpooferView", {"pool": 3}, "`pool` must be an opponent or a list"),
        ("SpooferView", {"pool": "gone.onnx"}, "there is no ONNX file gone.onnx"),
        ("DetectorView", {"pool": "ramq"}, "did you mean 'ramp'"),
        ("DetectorView", {"pool": "ewma-profile"}, "'ewma-profile' does not fit this"),
        # arguments
        (
            "SpooferView",
            {"attak": "x"},
            "^SpooferView got an unexpected keyword arg.*attack, .* pool,.*mean",
        ),
        (
            "DetectorVectorView",
            {"attak": "x"},
            "^DetectorVectorView got an unexpected .* pool,.*mean",
        ),
        ("DetectorView", {"decision_delay": 2}, "a whole number from 0 to 1, got 2"),
        ("DetectorView", {"render_mode": "rgb_array"}, "in DetectorView: .* only SpooferVi"),
        # of the duel
        ("parallel_env", {"statistic": "satellite"}, "statistic.*'satellite'"),
        ("parallel_env", {"payoff": "neyman-person"}, "did you mean 'neyman-pearson'"),
        ("parallel_env", {"payoff": {"name": "weighted", "delay": 1.0}}, "no setting 'delay'; va"),
        ("parallel_env", {"threshold": 0.0}, "must be 'running', a number above 0 .* got 0.0"),
        ("parallel_env", {"threshold": True}, "must be 'running', a number .* got True"),
        ("parallel_env", {"false_alarm": 1.0}, "`false_alarm` must be .* below 1, got 1.0"),
        ("parallel_env", {"attack_probability": 1.5}, "must be a number from 0 to 1, got 1.5"),
        ("parallel_env", {"exclusion_s": True}, "`exclusion_s` must be .*, got True"),
        ("parallel_env", {"decision_delay": 0}, "takes no `decision_delay`: it is 0 in duel"),
        ("parallel_env", {"weighs": "yes"}, "`weighs` must be True or False"),
        ("parallel_env", {"render_mode": "human"}, "nothing to render"),
        ("parallel_env", {"thresholds": 0.5}, "did you mean 'threshold'"),
    ],
)
def test_bad_settings(make, kwargs, message):
    count = (1,) if "Vector" in make else ()
    with pytest.raises((ValueError, TypeError), match=message) as told:
        getattr(duel_v0, make)(*count, **{**BRIEF, **kwargs})
    assert "SpoofCore" not in str(told.value)


def test_a_detector_beside_the_pool_is_one_too_many():
    for make, kwargs in ((gym.make, {}), (gym.make_vec, {"num_envs": 2})):
        with pytest.raises(ValueError, match=r"two detectors .* `pool` = solution-.* = 'cusum'"):
            make("spoofgym/BenchT6-v1", detector="cusum", **kwargs)


def test_the_spoofers_view_draws_its_episodes_and_changes_its_pool():
    pytest.importorskip("matplotlib")
    view, plain = (duel_v0.SpooferView(**SPOOFER, render_mode=m) for m in ("rgb_array", None))
    for seed, pool in ((1, None), (2, "cusum")):
        for each in (view, plain):
            if pool is not None:
                each.set_pool(pool)
                with pytest.raises(RuntimeError, match="reset"):
                    each.step(np.zeros(2))
            each.reset(seed=seed)
        first = view.render()
        for _ in range(3):
            drawn, other = (each.step(np.array([0.3, 0.5])) for each in (view, plain))
            np.testing.assert_array_equal(drawn[0], other[0])
            assert drawn[4] == other[4]
        assert view.render().shape == first.shape == (700, 1120, 3)
        assert (view.render() != first).any()
    assert view.opponent == "cusum"
    view.close()
    view = duel_v0.SpooferView("ewma", **BRIEF, knowledge="oracle")
    with pytest.raises(ValueError, match=r"against the pool snapshot-chi2, but .* against ewma"):
        view.set_pool("snapshot-chi2")


@pytest.mark.parametrize("delay", [0, 1])
def test_an_episode_may_last_as_long_as_the_flight(delay):
    timeline = {"warmup_s": 200.0, "live_s": 10.0, "attack_s": 207.5, "time_to_alert_s": 10.0}
    kwargs = {**PAPERS, "threshold": 0.5, "timeline": timeline, "decision_delay": delay}
    envs = duel_v0.DetectorVectorView(2, "ramp", **kwargs)
    setup = envs.core.duel.setup
    assert setup.world.epochs - 1 - (setup.onset + setup.steps + setup.hold) == 1
    envs.reset(seed=1)
    quiet = np.tile(QUIET, (2, 1))
    envs.step(quiet)
    assert envs.step(np.stack([ALARM, QUIET]))[2].tolist() == [True, False]
    # from here on the receivers end at different times, and one runs on while the other is reset
    for _ in range(envs.core.duel.epochs - 2):
        observation, _, over, _, _ = envs.step(quiet)
        assert np.isfinite(observation).all()
    assert over.tolist() == [False, True]
    envs.step(quiet)
    assert envs.core.duel.core.engine.simulator.epochs[1] == setup.onset + (1 - delay)
