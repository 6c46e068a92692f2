"""Actions that correct an attack: at 0 the base to the bit, for every form and way of playing."""

import shutil

import gymnasium as gym
import numpy as np
import pytest

import spoofgym
from spoofgym.envs import attach
from spoofgym.envs.terms import action
from spoofgym.spoofers.learned import ModelPolicy
from spoofgym.wrappers import ResidualAction, vector

from .support import SHORT

ID = "spoofgym/Zhong2025-v0"
RAMP = {"name": "ramp", "rate_mps": 0.3, "amplitude": 1.25}
CURVES = {"name": "action-curves", "curves": [[0.1, 0.3], [0.2, 0.0], [0.1, 0.1], [0.0, -0.2]]}
PACE = {"decision_interval_s": 5.0, "between": "linear"}
FORMS = {
    "false position": ({}, RAMP),
    "decisions": (PACE, {"name": "accelerating-ramp", "acceleration_mps2": 0.05}),
    "offsets": ({"control": "rate", "basis": "rotated", **PACE}, CURVES),
    "some satellites": (
        {"control": "rate", "basis": "position+clock", "channels": "5 of 8", **PACE},
        CURVES,
    ),
}


def play(env, act, seed=3):
    """Displacements and observations of an episode."""
    observation, _ = env.reset(seed=seed)
    found, over = [], False
    while not over:
        observation, _, over, _, info = env.step(act(observation))
        found.append([info["displacement_m"], *observation])
    return np.array(found)


@pytest.mark.parametrize("form", FORMS)
def test_a_correction_of_0_is_the_base_to_the_bit(form):
    own, base = FORMS[form]
    own = {"timeline": SHORT, "detector": "never", **own}
    plain = gym.make(ID, **own)
    spoofer = attach(base, plain)
    expected = play(plain, lambda seen: spoofer.act(seen[None])[0])
    env = ResidualAction(gym.make(ID, **own), base)
    assert env.action_space == plain.action_space
    nothing = np.zeros(env.action_space.shape)
    for _ in range(2):  # the base begins anew at every reset
        np.testing.assert_array_equal(play(env, lambda _: nothing), expected)
    other = play(env, lambda _: nothing - 0.5)
    assert np.abs(other[-1, 0] - expected[-1, 0]) > 0.01


def test_every_receiver_of_a_vector_has_an_episode_of_the_base_of_its_own():
    own = {"timeline": SHORT, "end_at_alarm": False}
    single = ResidualAction(gym.make(ID, **own), RAMP)
    expected = play(single, lambda _: np.full(1, 0.2), seed=6)[:, 1:]
    for made in (
        vector.ResidualAction(gym.make_vec(ID, num_envs=3, infos="all", **own), RAMP),
        gym.make_vec(ID, num_envs=3, action={"name": "residual", "spoofer": RAMP}, **own),
    ):
        made.reset(seed=4)  # and once more for one alone, which is then half an episode behind
        for _ in range(len(expected) // 2):
            made.step(np.full((3, 1), 0.2))
        mask = np.array([False, False, True])
        made.reset(seed=[None, None, 6], options={"reset_mask": mask})
        seen = [made.step(np.full((3, 1), 0.2))[0][2] for _ in range(len(expected) // 4)]
        np.testing.assert_array_equal(seen, expected[: len(seen)])


def test_a_scale_is_a_part_of_the_largest_action_of_the_base():
    env = ResidualAction(gym.make(ID, timeline=SHORT), RAMP)
    spoofer = attach(
        {"name": "ramp", "rate_mps": 0.3 * 1.25 * 0.6}, plain := gym.make(ID, timeline=SHORT)
    )
    expected = play(plain, lambda seen: spoofer.act(seen[None])[0])
    found = play(env, lambda _: np.full(1, -1.0))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_a_base_observes_what_it_was_shown_even_if_the_array_is_changed_then():
    heading = {"target_heading_deg": "random", "timeline": SHORT, "detector": "never"}
    env = ResidualAction(gym.make(ID, **heading), {**RAMP, "heading_deg": "target"})
    expected = play(env, lambda _: np.zeros(1))

    def spoil(seen):
        seen *= 0.5
        return np.zeros(1)

    np.testing.assert_array_equal(play(env, spoil)[:, 0], expected[:, 0])


def test_a_fixed_heading_beside_drawn_ones_is_warned_of():
    action = {"name": "rate-setpoint", "dimensions": 2}
    env = gym.make(ID, target_heading_deg="random", timeline=SHORT, action=action)
    with pytest.warns(UserWarning, match="push along a fixed heading: Ramp"):
        ResidualAction(env, {"name": "ramp", "rate_mps": 0.3})


def test_what_does_not_fit_is_refused_with_what_would():
    def make(base, scale=None, **settings):
        return ResidualAction(gym.make(ID, timeline=SHORT, **settings), base, scale)

    with pytest.raises(ValueError, match="`scale` must be a number above 0 and at most 2 or None"):
        make(RAMP, 0.0)
    with pytest.raises(ValueError, match="unknown spoofer 'rampp'"):
        make("rampp")
    with pytest.raises(ValueError, match="`scale` must be given with the base Feedback"):
        make("feedback", knowledge="oracle")
    with pytest.raises(ValueError, match="statistic"):
        make("feedback", 0.1, knowledge="blind")
    with pytest.raises(ValueError, match="which commands nothing"):
        make({"name": "action-curves", "curves": [[0.0, 0.0]]})
    with pytest.raises(ValueError, match="depend on what it sees"):
        make("none")
    with pytest.raises(ValueError, match="a correction stands alone"):
        gym.make(ID, action=["full-command", {"name": "residual", "spoofer": "ramp"}])
    with pytest.raises(ValueError, match="corrections of the base Ramp"):
        attach("ramp", make({"name": "ramp", "rate_mps": 0.1}))
    with pytest.raises(ValueError, match="one base alone"):
        ResidualAction(make(RAMP), RAMP)
    env = gym.make(ID, timeline=SHORT)
    env.reset(seed=0)
    with pytest.raises(RuntimeError, match="an episode has started"):
        ResidualAction(env, "ramp")


def test_a_policy_plays_with_its_base_wherever_it_plays(tmp_path):
    torch = pytest.importorskip("torch")
    pytest.importorskip("onnxscript")
    from spoofgym.export import onnx

    own = {"timeline": SHORT, "detector": "never", "knowledge": "blind"}
    env = ResidualAction(gym.make(ID, **own), RAMP, 0.2)
    net = torch.nn.Linear(env.observation_space.shape[0], 1)
    torch.nn.init.zeros_(net.weight)
    torch.nn.init.constant_(net.bias, 0.5)
    path = str(tmp_path / "mine.onnx")
    with pytest.raises(ValueError, match="would scale the correction alone"):
        onnx(net, env, path, amplitude=0.9)
    card = onnx(net, env, path)
    assert card.action.names == ("along_target_setpoint_correction",)
    runs = {"runs": 4, "amplitude": None}
    score = spoofgym.evaluate(path, **runs)
    world = {"env": ID, "detector": "never", "timeline": SHORT}
    constant = lambda seen: np.full((len(seen), 1), 0.3 * 1.25 + 0.5 * 0.2)  # noqa: E731
    expected = spoofgym.evaluate(constant, **runs, **world)
    np.testing.assert_allclose(score.displacement_m, expected.displacement_m, rtol=1e-5)
    judge = {"detector": {"name": "snapshot-chi2", "thresholds": "nominal"}, "rule": "exact"}
    both = [
        spoofgym.evaluate(each, runs=40, fit_runs=80, **{**world, **judge})  # many side by side
        for each in (path, constant)
    ]
    np.testing.assert_allclose(both[0].displacement_m, both[1].displacement_m, rtol=1e-5)
    made = attach(path, env)
    played = play(env, lambda seen: made.act(seen[None])[0])
    again = ResidualAction(gym.make(ID, **own), {**RAMP, "heading_deg": 90.0}, 0.2)
    attach(path, again)  # the same base in other words
    plain = str(tmp_path / "base.onnx")
    onnx(net, gym.make(ID, **own), plain)
    above = str(tmp_path / "above.onnx")
    onnx(net, ResidualAction(gym.make(ID, **own), plain, 0.2), above)
    moved = tmp_path / "moved"
    shutil.copytree(tmp_path, moved, ignore=lambda *_: ["moved"])
    reached = [spoofgym.evaluate(each, **runs) for each in (above, str(moved / "above.onnx"))]
    np.testing.assert_array_equal(reached[0].displacement_m, reached[1].displacement_m)
    attach(str(moved / "above.onnx"), ResidualAction(gym.make(ID, **own), plain, 0.2))
    with pytest.raises(ValueError, match="corrects a base itself, and a policy corrects only one"):
        ResidualAction(gym.make(ID, **own), above, 0.2)
    with pytest.raises(ValueError, match=r"in memory can't be a base.*spoofgym\.export\.onnx"):
        ResidualAction(gym.make(ID, **own), ModelPolicy(net), 0.2)
    (moved / "base.onnx").unlink()
    with pytest.raises(ValueError, match=r"there is no ONNX file base\.onnx"):
        spoofgym.evaluate(str(moved / "above.onnx"), **runs)
    torch.nn.init.constant_(net.bias, 0.1)
    onnx(net, gym.make(ID, **own), plain)
    with pytest.raises(ValueError, match="SHA-256"):  # another base under the same name
        spoofgym.evaluate(above, **runs)
    torch.nn.init.constant_(net.bias, 0.5)
    with torch.no_grad():
        alone = play(env, lambda seen: net(torch.as_tensor(seen)[None])[0].numpy())
    np.testing.assert_allclose(played, alone, atol=1e-4)
    with pytest.raises(ValueError, match="action"):
        attach(path, ResidualAction(gym.make(ID, **own), "ramp", 0.2))
    with pytest.raises(ValueError, match="made for another environment"):
        attach(path, gym.make(ID, **own))


def test_a_base_is_made_once(monkeypatch):
    made = []
    make = action.make_spoofer
    monkeypatch.setattr(action, "make_spoofer", lambda spec: made.append(spec) or make(spec))
    gym.make(ID, timeline=SHORT, action=action.Residual(RAMP)).reset(seed=1)
    assert made == [RAMP]


def test_the_environment_of_stable_baselines_has_it_too():
    pytest.importorskip("stable_baselines3")
    from spoofgym.sb3 import ResidualAction as OfSb3
    from spoofgym.sb3 import SpoofVecEnv

    own = {"scenario": "zhong2025", "timeline": SHORT, "end_at_alarm": False, "seed": 4}
    envs = OfSb3(SpoofVecEnv(2, **own), RAMP)
    given = SpoofVecEnv(2, action={"name": "residual", "spoofer": RAMP}, **own)
    np.testing.assert_array_equal(envs.reset(), given.reset())
    for _ in range(70):  # beyond the end of an episode
        action = np.full((2, 1), -0.5)
        np.testing.assert_array_equal(envs.step(action)[0], given.step(action)[0])
