"""Terms by name, as settings, as objects and from files; tables of them; actions; rewards."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.detectors.observation import Elapsed, InnovationSd, PredictedMotion
from spoofgym.duel_v0 import DetectorView
from spoofgym.envs import make_terms
from spoofgym.envs.terms import TERMS, describe_terms
from spoofgym.envs.terms.observation import OBSERVATION_TERMS, OwnCommand, Time
from spoofgym.envs.terms.reward import AlarmPenalty, DisplacementGain
from spoofgym.envs.terms.termination import AtAlarm, AtDisplacement
from tools.environments_page import read_table

from ..support import LIVE, VICTIMS, AlarmAt, single, vector, victim, victims

NEEDED = {"channels": {"ids": ["S05"]}, "at-displacement": {"limit_m": 5.0}}
NEEDED |= {"residual": {"spoofer": {"name": "ramp", "rate_mps": 0.3}}}
NEEDED |= {"at-stealth-budget": {"budget_nats": 2.0}, "at-steps": {"steps": 4}}


@pytest.mark.parametrize("kind", TERMS)
def test_every_term_goes_through_json(kind):
    for name in TERMS[kind]:
        (term,) = make_terms(kind, {"name": name, **NEEDED.get(name, {})})
        assert type(term) is TERMS[kind][name]
        said = describe_terms(kind, term)
        assert said[0]["name"] == name
        assert make_terms(kind, json.loads(json.dumps(said))) == (term,)
        with pytest.raises(AttributeError):  # frozen
            term.name_of_nothing = 1


def offered(term):
    """Environments, single and three at a time, of each victim that has what a term observes."""
    plain = {"observation": term, "end_at_alarm": False}
    for kind, own in [*((kind, {}) for kind in VICTIMS), ("Zhong2025", {"control": "rate"})]:
        try:
            yield victim(kind, **plain, **own).unwrapped, victims(kind, 3, **plain, **own)
        except (TypeError, ValueError):
            continue


def write(term, core):
    """What a term says by itself, (B, k), with NaN where it writes nothing."""
    snapshot, written = core.snapshot(), np.full((3, len(core.observation_names)), np.nan, "f4")
    table = term.table(core.setup) if hasattr(term, "table") else None
    if table is None:
        term(snapshot, written)
        return written
    assert table.shape == (len(core.setup.epoch_time), written.shape[1])
    return table[snapshot.simulator.epochs]


def check_observed(term, env, envs):
    least, most = term.bounds(envs.core.setup)
    assert np.isfinite([least, most]).all()
    assert envs.observation_names == env.observation_names == term.names(envs.core.setup)
    command = np.full(envs.action_space.shape, 0.5)
    first, one = envs.reset(seed=3)[0], env.reset(seed=3)[0]
    for k in range(5):
        many = envs.step(command)[0] if k else first
        one = env.step(command[0])[0] if k else one
        assert envs.observation_space.contains(many), (term, many)
        written = write(term, envs.core)
        assert np.isfinite(written).all(), (term, "must write finite numbers everywhere", written)
        np.testing.assert_allclose(many, np.clip(written, least, most), rtol=1e-5, err_msg=term)
        np.testing.assert_array_equal(one, many[0], err_msg=f"{term} in a batch, and alone")
    np.testing.assert_array_equal(envs.reset(seed=3)[0], first, err_msg=f"{term} after a reset")


@pytest.mark.parametrize("name", OBSERVATION_TERMS)
def test_every_observation_term_is_observed_in_every_victim_that_offers_it(name):
    (term,) = make_terms("observation", name)
    played = [check_observed(term, *made) for made in offered(term)]
    assert played, f"no victim offers what {term} observes"


def test_names_settings_and_objects_may_stand_side_by_side():
    terms = make_terms("observation", ["time", {"name": "own-command", "scale_m": 7}, Time()])
    assert terms == (Time(), OwnCommand(scale_m=7), Time())
    assert make_terms("reward", "alarm-penalty") == (AlarmPenalty(),)
    assert make_terms("end", AtAlarm()) == (AtAlarm(),)


def test_terms_of_a_file(tmp_path):
    toml, path = tmp_path / "terms.toml", tmp_path / "terms.json"
    toml.write_text(
        '[[end]]\nname = "at-alarm"\n[[end]]\nname = "at-displacement"\nlimit_m = 3.5\n'
    )
    assert make_terms("end", toml) == make_terms("end", str(toml))
    assert make_terms("end", toml) == (AtAlarm(), AtDisplacement(3.5))
    path.write_text(json.dumps({"reward": ["displacement-gain"]}))
    assert make_terms("reward", path) == (DisplacementGain(),)
    with pytest.raises(ValueError, match="has no 'action'; it has: reward"):
        make_terms("action", path)
    for text, message in (
        (json.dumps({"rewards": []}), r"valid: action, end, .*; did you mean 'reward'"),
        ("[]", "must hold lists by kind"),
        ("{", r"terms\.json' can't be read"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            make_terms("reward", path)
    with pytest.raises(ValueError, match="there is no file"):
        make_terms("reward", tmp_path / "other.toml")


@dataclass(frozen=True)
class Alarms:
    """An own observation: alarms of the last verdict."""

    knowledge: ClassVar[str] = "oracle"

    def names(self, setup):
        return ("alarms",)

    def bounds(self, setup):
        return 0.0, 20.0

    def __call__(self, snapshot, out):
        verdict = snapshot.simulator.verdict
        out[:, 0] = 0.0 if verdict is None else verdict.alarm.sum(axis=1)


def test_own_terms_are_taken_as_objects_and_by_a_name_of_their_own(monkeypatch):
    env = single(observation=["time", Alarms()]).unwrapped
    assert env.observation_names == ("time_since_onset", "time_left", "alarms")
    with pytest.raises(TypeError, match="Alarms has no name among the observation terms"):
        describe_terms("observation", Alarms())
    monkeypatch.setitem(TERMS["observation"], "alarms", Alarms)
    spec = single(observation=["time", "alarms"]).spec
    again = gym.make(gym.envs.registration.EnvSpec.from_json(spec.to_json())).unwrapped
    assert again.observation_names == env.observation_names


def played(action, attack):
    """Displacements of an episode in which every command is the same."""
    settings = {"detector": "never", "target_heading_deg": 90.0, "attack": attack}
    envs = vector(2, action=action, **settings)
    envs.reset(seed=3)
    return envs, lambda given: envs.step(np.tile(given, (2, 1)))[4]["displacement_m"]


def test_channels_leave_the_others_alone():
    attack = {"name": "per-channel", "control": "rate"}
    envs, _ = played(None, attack)
    every = envs.action_names
    envs, step = played({"name": "channels", "ids": ["S05", "S09"]}, attack)
    assert envs.action_names == ("S05_rate", "S09_rate")
    step([1.0, -0.5])
    rate = envs.core.engine.simulator.attack.memory["rate"][0]
    wanted = np.zeros(len(every))
    wanted[every.index("S05_rate")], wanted[every.index("S09_rate")] = 5.0, -2.5
    np.testing.assert_array_equal(rate, wanted)


def test_a_common_offset_moves_the_clock_and_not_the_position():
    attack = {"name": "per-channel", "control": "rate", "rate_limit_mps": 1.0}
    envs, step = played("common-offset", attack)
    other, still = played("common-offset", attack)
    assert envs.action_names == ("common_rate",)
    for _ in range(25):
        moved, kept = step([1.0]), still([0.0])
    np.testing.assert_allclose(moved, kept, atol=0.1)
    clock = [e.core.engine.simulator.buffers.fields["clock"][:, 0] for e in (envs, other)]
    np.testing.assert_allclose(clock[0] - clock[1], 12.5, atol=1.0)


def test_the_reward_is_exactly_the_sum_of_its_parts():
    envs = vector(3, reward=list(TERMS["reward"]), end_at_alarm=False, detector=AlarmAt(LIVE + 15))
    envs.reset(seed=1)
    used = set()
    for _ in range(30):
        given = np.outer([1.0, 0.5, 0.2], [0.2, 1.0])
        _, reward, terminated, _, info = envs.step(given)
        total = np.zeros(3)
        for name in (name for name in info if name.startswith("reward_")):
            total = total + info[name]
            used |= {name} if info[name].any() else set()
        np.testing.assert_array_equal(total, reward)
        np.testing.assert_array_equal(info["reward_alarmed_epochs"], np.where(info["alarm"], -1, 0))
        np.testing.assert_array_equal(info["reward_effort"], -0.1 * (given**2).mean(axis=1))
    assert terminated.all()
    undetected = info["undetected_displacement_m"]
    np.testing.assert_array_equal(info["reward_terminal_displacement"], undetected)
    assert len(used) == len(TERMS["reward"])


@dataclass(frozen=True)
class Boundless:
    """A reward of a user, which divides by nothing."""

    name: ClassVar[str] = "boundless"

    def __call__(self, outcome):
        return np.full(len(outcome.gain), np.inf)


def test_a_reward_that_is_not_finite_is_refused():
    envs = vector(2, reward=Boundless())
    envs.reset(seed=1)
    with pytest.raises(
        ValueError, match=r"info\['reward_boundless'\] must be finite, got \[inf inf\]"
    ):
        envs.step(np.zeros((2, 2)))


def test_the_table_of_the_detector_s_view_is_what_it_observes():
    one_sky = {"turn_on": "drawn"}  # which is made sooner
    names = gym.make("spoofgym/DetectorView-v0", domain=one_sky).unwrapped.observation_names
    scales = {
        "range_sd": InnovationSd.range_scale_m,
        "rate_sd": InnovationSd.rate_scale_mps,
        "predicted_velocity": PredictedMotion.velocity_scale_mps,
        "specific_force": PredictedMotion.force_scale_mps2,
        "angular_rate": PredictedMotion.rate_scale_rps,
        "elapsed": Elapsed.scale_s,
    }
    next_one = 0
    for index, words, _, scale in read_table(DetectorView):
        first, _, last = index.partition("-")
        word = re.sub(r"_(slotJJ|XXX)$", "", words)
        assert int(first) == next_one
        next_one = int(last or first) + 1
        assert {name.startswith(word) for name in names[int(first) : next_one]} == {True}
        assert float(scale) == scales.get(word, 1.0)
    assert next_one == len(names)
