"""One side of the duel: Gymnasium's contracts, batches, and pools of opponents."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from spoofgym import duel_v0
from spoofgym.duel.duel import with_world
from spoofgym.envs import SpoofEnv
from spoofgym.spoofers import Ramp

from .support import BRIEF, PAPERS, QUIET, SHORT, aec, aec_epochs, parallel, parallel_epochs, wary

STRONG = {"name": "false-position", "acceleration_limit_mps2": 1.0}
SPOOFERS = [{"name": "ramp", "rate_mps": 0.5}, "none", Ramp(rate_mps=3.0)]
WARY = duel_v0.PolicyDetector(policy=duel_v0.FunctionPolicy(wary), threshold=0.2)
DETECTORS = ["ewma", "snapshot-chi2", WARY]
FULL = {**BRIEF, "attack": STRONG, "action": "full-command"}
SPOOFER = {"pool": DETECTORS, "weights": [1.0, 1.0, 2.0], **FULL}
DOMAIN = {
    "domain": {"start_s": (0.0, 30.0), "turned_deg": (0.0, 360.0), "worlds": 2},
    "target_heading_deg": "random",
}
FOLLOWING = [
    {"name": "ramp", "rate_mps": 0.5, "heading_deg": "target"},
    "none",
    Ramp(rate_mps=3.0, heading_deg="target"),
]
DETECTOR = {"pool": SPOOFERS, **BRIEF, "attack": STRONG, "threshold": 0.5}


@pytest.mark.parametrize(
    ("name", "kwargs"),
    [
        ("SpooferView", {**SPOOFER, "knowledge": "oracle", "pool": ["never", WARY]}),
        ("DetectorView", {**DETECTOR, "decision_delay": 1, "statistic": "channel"}),
    ],
)
def test_gymnasium_check_env(name, kwargs):
    kwargs = {key: value for key, value in kwargs.items() if key != "weights"}
    check_env(gym.make(f"spoofgym/{name}-v0", **kwargs).unwrapped)


def spoofer_actions(k, observation):
    return np.clip(observation[..., :2].astype(np.float64) + 0.3 + 0.01 * k, -1.0, 1.0)


def detector_actions(k, observation):
    return wary(np.atleast_2d(observation)).reshape(*observation.shape[:-1], 13)


def single_runs(make, act, seed, steps):
    """Observations, rewards and ends, the next episode begun where one ends."""
    env, rows = make(), []
    observation, _ = env.reset(seed=seed)
    for k in range(steps):
        observation, reward, over, _, _ = env.step(act(k, observation))
        rows.append((observation, reward, over, env.opponent))
        if over:
            observation, _ = env.reset()
    return rows


AS_SPOOFER = duel_v0.SpooferView, duel_v0.SpooferVectorView, spoofer_actions
AS_DETECTOR = duel_v0.DetectorView, duel_v0.DetectorVectorView, detector_actions
CASES = {
    "spoofer": (AS_SPOOFER, "next_step", SPOOFER),
    "detector": (AS_DETECTOR, "same_step", DETECTOR),
    "detector-late": (
        AS_DETECTOR,
        "next_step",
        {**DETECTOR, "decision_delay": 1, "threshold": "running"},
    ),
    "spoofer-domain": (AS_SPOOFER, "same_step", {**SPOOFER, **DOMAIN}),
    "detector-domain": (AS_DETECTOR, "next_step", {**DETECTOR, **DOMAIN, "pool": FOLLOWING}),
    "detector-decisions": (
        AS_DETECTOR,
        "same_step",
        {**DETECTOR, "decision_interval_s": 1.5, "between": "linear"},
    ),
}


@pytest.mark.parametrize(("side", "mode", "kwargs"), CASES.values(), ids=CASES)
def test_every_receiver_of_a_vector_view_is_the_single_view(side, mode, kwargs):
    receivers, steps, seed = 4, 75, 11
    single, vector, act = side
    envs = vector(receivers, autoreset_mode=mode, **kwargs)
    observation, _ = envs.reset(seed=seed)
    expected = [
        single_runs(lambda: single(**kwargs), act, seed + i, steps) for i in range(receivers)
    ]
    place, restarting, ends = np.zeros(receivers, dtype=int), np.zeros(receivers, dtype=bool), 0
    opponents = set()
    for _ in range(steps):
        # an action is a function of the receiver's own count of steps and its observation
        given = np.stack([act(place[i], observation[i]) for i in range(receivers)])
        playing = envs.opponents
        observation, reward, over, _, info = envs.step(given)
        for i in range(receivers):
            if restarting[i]:
                continue
            seen, paid, ended, who = expected[i][place[i]]
            last = info["final_obs"][i] if mode == "same_step" and over[i] else observation[i]
            np.testing.assert_array_equal(last, seen)
            assert (reward[i], over[i], playing[i]) == (paid, ended, who)
            opponents.add(who)
            place[i] += 1
        restarting = over.copy() if mode == "next_step" else restarting
        ends += over.sum()
    assert ends > receivers
    assert len(opponents) == 3


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


FORMS = (aec, aec_epochs), (parallel, parallel_epochs)
"""Without and with a delay."""


@pytest.mark.parametrize(("delay", "live_s"), [(0, 10.0), (1, 10.0), (1, 0.0)])
def test_a_policy_in_a_pool_plays_as_its_agent_does_in_the_duel(delay, live_s):
    timeline = {**SHORT, "live_s": live_s}
    policy = duel_v0.FunctionPolicy(wary)
    opponent = duel_v0.PolicyDetector(policy=policy, threshold=0.1, decision_delay=delay)
    view = duel_v0.SpooferView(opponent, **{**FULL, "timeline": timeline})
    settings = {"timeline": timeline, "attack": STRONG, "threshold": 0.1, "attack_probability": 1.0}
    duel, run = FORMS[delay][0](**settings), FORMS[delay][1]
    detected = set()
    for seed, push in ((3, np.array([0.0, 1.0])), (4, np.array([0.0, 0.01]))):
        view.reset(seed=seed)
        over, expected = False, []
        while not over:
            _, _, over, _, info = view.step(push)
            expected.append(info["displacement_m"])
        detected.add(info["detected"])
        _, own, _, last = run(duel, seed, lambda k, p=push: p, lambda k, seen: wary(seen[None])[0])
        np.testing.assert_array_equal(own[: len(expected)], expected)
        assert last["undetected_displacement_m"] == info["undetected_displacement_m"]
    assert detected == ({False, True} if live_s else {False})


@pytest.mark.parametrize("delay", [0, 1])
def test_the_detectors_view_is_the_duel_against_that_spoofer(delay):
    kwargs = {**BRIEF, "attack": STRONG, "threshold": 1.0}
    view = duel_v0.DetectorView({"name": "ramp", "rate_mps": 0.5}, decision_delay=delay, **kwargs)
    duel, run, attacked = FORMS[delay][0](**kwargs), FORMS[delay][1], set()
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
    ("make", "pool"),
    [
        (lambda: duel_v0.SpooferVectorView(2, **SPOOFER, autoreset_mode="disabled"), "cusum"),
        (lambda: duel_v0.DetectorVectorView(2, **DETECTOR, autoreset_mode="disabled"), "none"),
    ],
)
def test_after_a_change_of_the_pool_all_receivers_begin_anew(make, pool):
    envs = make()
    action = np.full(envs.action_space.shape, -0.3)
    envs.reset(seed=1)
    envs.step(action)
    envs.set_pool([pool], [2.0])
    for options in ({"reset_mask": np.array([True, False])}, {"domain": 3}):
        with pytest.raises((ValueError, TypeError), match=r"that of all receivers|must be a dict"):
            envs.reset(options=options)
        with pytest.raises(RuntimeError, match="the pool has changed"):
            envs.step(action)
    envs.reset(options={"reset_mask": np.array([True, True])})
    envs.step(action)
    assert envs.opponents == [pool] * 2
    envs.reset(options={"reset_mask": np.array([True, False])})
    envs.step(action)


@pytest.mark.parametrize(
    ("make", "kwargs", "message"),
    [
        (duel_v0.SpooferView, {"pool": []}, "at least one opponent"),
        (duel_v0.SpooferView, {"pool": ["ewma"], "weights": [0.5, 0.5]}, "one number for each"),
        (duel_v0.SpooferView, {"pool": ["ewma"], "weights": [-1.0]}, "finite, >= 0, and not all"),
        (duel_v0.SpooferView, {"pool": ["ewma"], "weights": ["x"]}, "`weights` must be numbers"),
        (duel_v0.SpooferView, {"pool": 3}, "`pool` must be an opponent or a list"),
        (duel_v0.SpooferView, {"pool": "gone.onnx"}, "there is no ONNX file gone.onnx"),
        (duel_v0.SpooferView, {"render_mode": "svg"}, "`render_mode` must be 'human' or 'rgb_arr"),
        (duel_v0.SpooferVectorView, {"infos": ["tim_s"]}, "did you mean 'time_s'"),
        (duel_v0.SpooferView, {"attak": "x"}, "^SpooferView has no arg.*attack, .* pool,.*mean"),
        (
            duel_v0.DetectorVectorView,
            {"attak": "x"},
            "^DetectorVectorView has no arg.* pool,.*mean",
        ),
        (duel_v0.DetectorView, {"pool": "ramq"}, "did you mean 'ramp'"),
        (
            duel_v0.DetectorView,
            {"decision_delay": 2},
            "`decision_delay` must be a whole number from 0 to 1, got 2",
        ),
        (duel_v0.DetectorView, {"pool": "ewma-profile"}, "'ewma-profile' does not fit this"),
        (duel_v0.DetectorView, {"render_mode": "rgb_array"}, "in DetectorView: .* only SpooferVi"),
    ],
)
def test_bad_settings(make, kwargs, message):
    with pytest.raises((ValueError, TypeError), match=message) as told:
        make(**{**BRIEF, **kwargs})
    assert "SpoofCore" not in str(told.value)


def test_a_detector_beside_the_pool_is_one_too_many():
    for make, kwargs in ((gym.make, {}), (gym.make_vec, {"num_envs": 2})):
        with pytest.raises(ValueError, match=r"two detectors .* `pool` = solution-.* = 'cusum'"):
            make("spoofgym/BenchT6-v1", detector="cusum", **kwargs)


def test_the_spoofers_view_draws_its_episodes_and_changes_its_pool():
    pytest.importorskip("matplotlib")
    view = duel_v0.SpooferView(**SPOOFER, render_mode="rgb_array")
    plain = duel_v0.SpooferView(**SPOOFER)
    for seed, pool in ((1, None), (2, "cusum")):
        for each in (view, plain):
            if pool is not None:
                each.set_pool(pool)
                with pytest.raises(RuntimeError, match="reset"):
                    each.step(np.zeros(2))
            each.reset(seed=seed)
        first = view.render()
        for k in range(3):
            push = spoofer_actions(k, np.zeros(2))
            drawn, other = view.step(push), plain.step(push)
            np.testing.assert_array_equal(drawn[0], other[0])
            assert drawn[4] == other[4]
        frame = view.render()
        assert frame.shape == first.shape == (700, 1120, 3)
        assert (frame != first).any()
    assert view.opponent == "cusum"
    view.close()
    view = duel_v0.SpooferView("ewma", **BRIEF, knowledge="oracle")
    with pytest.raises(ValueError, match=r"the pool snapshot-chi2 gives .* but ewma gave"):
        view.set_pool("snapshot-chi2")
    view.reset(seed=1)
    view.step(np.zeros(view.action_space.shape))


@pytest.mark.parametrize("delay", [0, 1])
def test_an_episode_may_last_as_long_as_the_flight(delay):
    timeline = {"warmup_s": 200.0, "live_s": 10.0, "attack_s": 207.5, "time_to_alert_s": 10.0}
    kwargs = {**PAPERS, "threshold": 0.5, "timeline": timeline, "decision_delay": delay}
    envs = duel_v0.DetectorVectorView(2, "ramp", **kwargs)
    setup = envs.core.duel.setup
    spare = setup.world.epochs - 1 - (setup.onset + setup.steps + setup.hold)
    envs.reset(seed=1)
    alarm = np.tile(QUIET, (2, 1))
    envs.step(alarm)
    alarm[0] = 1.0
    assert envs.step(alarm)[2].tolist() == [True, False]
    # from here on the receivers end at different times, and one runs on while the other is reset
    for _ in range(envs.core.duel.epochs - 2):
        observation, _, over, _, _ = envs.step(np.tile(QUIET, (2, 1)))
        assert np.isfinite(observation).all()
    assert over.tolist() == [False, True]
    envs.step(np.tile(QUIET, (2, 1)))
    last = envs.core.duel.core.engine.simulator.epochs
    assert spare == 1
    assert last[1] == setup.onset + (1 - delay)
