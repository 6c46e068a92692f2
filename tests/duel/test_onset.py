"""Attacks that begin at a drawn moment within the detector's episode."""

import numpy as np
import pytest

from spoofgym import duel_v0

from .support import ALARM, BRIEF, FORMS, QUIET, aec

AGES_S = (12.0, 40.0)
LATE = {
    **BRIEF,
    "domain": {"turn_on": "drawn", "age_s": AGES_S},
    "threshold": 1.0,
    "attack_probability": 1.0,
}
WITHIN = {**LATE, "onset": "within"}
EQUIPPED = {
    "name": "false-position",
    "acceleration_limit_mps2": 1.0,
    "capture": {"delay_s": 2.0},
    "tracking": {"sd_m": 2.0},
    "spoofer_clock": {"drift_mps": 0.1, "frequency_psd": 1e-3},
    "errors": {"code_sd_m": 0.5, "range_rate_sd_mps": 0.05},
}
RAMP = {"name": "ramp", "rate_mps": 0.5}


def vector(count=5, **changes):
    return duel_v0.DetectorVectorView(count, RAMP, **{"weighs": False, **changes})


def play(envs, steps, options=None, seed=3):
    """Observations (steps + 1, B, o), rewards, ends (steps, B), and information by step."""
    observation, info = envs.reset(seed=seed, options=options)
    seen, paid, ends, infos = [observation], [], [], [info]
    for _ in range(steps):
        observation, reward, over, _, info = envs.step(np.full(envs.action_space.shape, -1.0))
        seen.append(observation)
        paid.append(reward)
        ends.append(over)
        infos.append(info)
    return np.array(seen), np.array(paid), np.array(ends), infos


@pytest.mark.parametrize("attack", ["false-position", EQUIPPED])
@pytest.mark.parametrize("delay", [0, 1])
def test_from_the_onset_on_it_is_the_game_whose_reset_ends_there(attack, delay):
    given = {"attack": attack, "decision_delay": delay}
    whole = vector(**WITHIN, **given)
    epochs, longest = whole.core.duel.epochs, whole.core.episode_steps
    assert longest == 60 + epochs
    seen, paid, ends, _ = play(whole, longest)
    late = vector(**LATE, **given)
    seen_late, paid_late, ends_late, _ = play(late, epochs)
    ages = late.core.duel.core.engine.simulator.ages - late.core.duel.setup.filter_only
    assert len(np.unique(ages)) > 3
    for row, age in enumerate(ages):
        assert not ends[: age + epochs - 1, row].any()
        assert ends[age + epochs - 1, row]
        assert (paid[:age, row] == 0.0).all()
        np.testing.assert_array_equal(paid[age : age + epochs, row], paid_late[:, row])
        assert paid_late[:, row].any()
        length = epochs + 1 - delay  # without a delay the last one is not observed anew
        first = 0 if delay == 0 else 1
        np.testing.assert_array_equal(
            seen[age + first : age + length, row], seen_late[first:length, row]
        )
    assert ends_late[-1].all()


def test_nothing_but_measurements_depends_on_the_onset_before_the_end():
    envs = vector(**WITHIN)
    *_, ends, infos = play(envs, envs.core.episode_steps)
    simulator = envs.core.duel.core.engine.simulator
    reset, first, *_ = infos
    assert reset["time_s"].tolist() == [10.5] * 5  # detectors go live after 10 s
    assert len(np.unique(simulator.onset)) > 1
    hidden = ("attacked", "undetected_displacement_m")
    for now, over in zip(infos[1:], ends, strict=True):
        assert all(not now[name][~over].any() for name in hidden)
        if over.any():
            break
        for name in first:
            assert len(np.unique(now[name])) == 1
    # a given age does not show either, and is an option of a reset
    for age_s in AGES_S:
        _, info = envs.reset(seed=4, options={"domain": {"age_s": age_s}})
        assert info["time_s"].tolist() == [10.5] * 5


@pytest.mark.parametrize("payoff", ["neyman-pearson", "weighted"])
def test_an_alarm_before_the_onset_is_a_false_one(payoff):
    view = duel_v0.DetectorView(RAMP, **{**WITHIN, "threshold": 0.5}, payoff=payoff)
    for age_s, false in ((12.0, False), (40.0, True)):
        view.reset(seed=1, options={"domain": {"age_s": age_s}})
        total = 0.0
        for k in range(8):  # the youngest are attacked after 2 s, 4 epochs
            _, reward, over, _, info = view.step(ALARM if k == 7 else QUIET)
            total += reward
        assert over
        assert info["attacked"] == (not false)
        if payoff == "weighted":
            assert (total == -100.0) == false
        else:
            assert false <= (total == 0.0)


def test_the_running_threshold_follows_whole_clean_episodes_alone():
    changes = {**WITHIN, "threshold": "running", "false_alarm": 0.25}
    for probability, moves in ((0.0, True), (1.0, False)):
        duel = vector(**{**changes, "attack_probability": probability}, autoreset_mode="disabled")
        threshold = duel.core.duel.threshold
        duel.reset(seed=1, options={"domain": {"age_s": 40.0}})
        threshold.values[:] = 0.5  # at first nothing exceeds it
        *_, over, _, _ = duel.step(np.ones(duel.action_space.shape))
        assert over.all()
        assert np.allclose(threshold.values, 0.5 + 0.1 * 0.75 * moves)


def test_a_threshold_is_of_all_epochs_that_are_judged():
    def policy(observation):
        average = np.abs(observation[:, 24:36]).max(axis=1, keepdims=True)
        return np.clip(average / 15.0 - 1.0, -1.0, 1.0)

    world = {**BRIEF, "domain": LATE["domain"], "weighs": False}
    request = {"false_alarm": 0.2, "runs": 24, **world}
    found = duel_v0.calibrate_policy(policy, onset="within", **request)
    late = duel_v0.calibrate_policy(policy, **request)
    early, whole = np.array([row[1:] for row in found.witnesses]).T
    window = np.array([row[2] for row in late.witnesses])  # the agent is not asked before it
    np.testing.assert_array_equal(whole, np.maximum(early, window))
    assert (early > window).any()
    assert found.point(per_run=0.2).scale >= late.point(per_run=0.2).scale
    assert 17.0 + 2.0 < found.window_s < 17.0 + 30.0
    assert (found.world["onset"], found.detector) == ("within", late.detector)


def test_the_spoofer_is_not_called_before_the_onset():
    for make, run in FORMS:
        duel = make(**{**WITHIN, "domain": {"turn_on": "drawn", "age_s": (14.0, 14.5)}})
        order, own, _, last = run(duel, 5, lambda k: np.array([0.0, 1.0]), lambda k, seen: QUIET)
        age = int(duel.unwrapped.duel.core.engine.simulator.ages[0]) - 20
        assert age in (8, 9)
        assert (own[:age] == 0.0).all()
        assert (own[age:] != 0.0).all()
        assert len(own) == age + duel.unwrapped.duel.epochs
        if make is aec:
            assert order == ["detector_0"] * age + ["spoofer_0", "detector_0"] * (len(own) - age)
        else:
            assert order == [False] * age + [True] * (len(own) - age)
        assert last["attacked"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"onset": "later"}, "must be 'reset' or 'within'"),
        ({"domain": {"turn_on": "drawn"}}, "needs a drawn onset.*age_s"),
        ({"domain": {"turn_on": "drawn", "age_s": (20.0, 20.0)}}, "needs a drawn onset"),
    ],
)
def test_an_onset_that_can_be_counted_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        duel_v0.DetectorView(RAMP, **{**BRIEF, "onset": "within", **changes})
