"""A pool of warm-ups: M pasts, the same for everyone, each with a future of its own."""

import json
import pickle

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats

from spoofgym.core.simd import LANES
from spoofgym.simulation.engine import POOL_SEED, Engine
from spoofgym.simulation.tight import TightlyCoupledSimulator
from spoofgym.truth.sensors import SOURCES
from spoofgym.wrappers import AlarmRecorder, EpochInfo, RecordEpochs
from spoofgym.wrappers.streams import Recorder

from .support import DOMAINS, SETUPS, rngs, setup_of

M = 5
TIMELINE = {"warmup_s": 8.0, "live_s": 3.0, "attack_s": 6.0, "time_to_alert_s": 1.0}
FRESH = ("imu", "clock", "gnss", "spoofer", "correlated")

every_victim = pytest.mark.parametrize("kind", SETUPS)


def pooled(kind, receivers, **settings):
    return Engine(receivers, setup_of(kind, **settings), warm_pool=M)


def pasts(kind, **settings):
    """The receivers of which all episodes are copies."""
    seeds = [np.random.SeedSequence(POOL_SEED, spawn_key=(k,)) for k in range(M)]
    simulator = setup_of(kind, **settings).simulator(M, lambda work, b: work(0, b))
    simulator.warm_up([np.random.default_rng(seed) for seed in seeds])
    return simulator


def played(engine, generators, rounds=3, steps=4):
    errors, moves = [], np.ones((engine.receivers, len(engine.setup.action_names)))
    for _ in range(rounds):
        engine.reset(generators)
        for _ in range(steps):
            engine.step(moves)
            errors.append(engine.simulator.error_n().copy())
    return np.array(errors)


@every_victim
def test_a_receiver_is_the_same_in_any_batch_and_with_a_reset_of_some(kind):
    together = played(pooled(kind, 9), rngs(9))
    for row in (0, 4, 8):
        alone = played(pooled(kind, 1), rngs(1, first=100 + row))
        assert np.array_equal(alone[:, 0], together[:, row])
    engine, generators = pooled(kind, 9), rngs(9)
    engine.reset(generators)
    some = np.array([8, 2])
    for _ in range(2):
        engine.reset([generators[row] for row in some], some)
    for k in range(4):
        engine.step(np.ones((9, len(engine.setup.action_names))))
        assert np.array_equal(engine.simulator.error_n()[some], together[8 + k][some])


@every_victim
def test_all_episodes_have_pasts_of_the_pool_and_futures_of_their_own(kind):
    count = 40
    settings = {"domain": DOMAINS[kind]}
    engine = Engine(count, setup_of(kind, **settings), warm_pool=M, twin=True)
    pool = pasts(kind, **settings)
    engine.reset(rngs(count))
    mine, theirs = engine.simulator, pool.error_n()
    of = np.array([np.flatnonzero((theirs == each).all(axis=1)).item() for each in mine.error_n()])
    counts = np.bincount(of, minlength=M)
    assert stats.chisquare(counts).pvalue > 1e-3  # each is as likely as any other
    assert np.array_equal(engine.warmup_alarm, pool.memory["warmup_alarm"][of])
    assert np.array_equal(mine.epochs, pool.epochs[of])
    assert np.array_equal(mine.memory["key"], pool.memory["key"][of])
    assert np.array_equal(mine.verdict.statistic, pool.verdict.statistic[of])
    engine.step(None)
    assert len(np.unique(mine.error_n(), axis=0)) == count
    assert np.array_equal(mine.error_n(), engine.twin.error_n())


def test_the_noise_after_the_onset_is_that_of_the_episode():
    engine, pool = pooled("tightly-coupled", 6), pasts("tightly-coupled")
    exact = Engine(6, setup_of("tightly-coupled"))
    generators = rngs(6), rngs(6)
    for _ in range(2):
        engine.reset(generators[0])
        exact.reset(generators[1])
    keys, own = engine.simulator.sensors.keys, exact.simulator.sensors.keys
    of_pool = {tuple(each.ravel().tolist()) for each in pool.sensors.keys.transpose(1, 0, 2)}
    old = [k for k, name in enumerate(SOURCES) if name not in FRESH]
    pool_old = {tuple(each.ravel().tolist()) for each in pool.sensors.keys[old].transpose(1, 0, 2)}
    for row in range(6):
        for k, name in enumerate(SOURCES):
            assert (name in FRESH) == np.array_equal(keys[k, row], own[k, row])
        assert tuple(keys[old][:, row].ravel().tolist()) in pool_old
        assert tuple(keys[:, row].ravel().tolist()) not in of_pool
    assert np.array_equal(engine.simulator.attack.memory["key"], keys[SOURCES.index("spoofer")])


def test_an_interrupted_pool_is_made_whole_by_the_next_reset_and_copied(monkeypatch):
    engine = pooled("tightly-coupled", 3)

    def interrupted(*args):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(TightlyCoupledSimulator, "live_epochs", interrupted)
        with pytest.raises(KeyboardInterrupt):
            engine.reset(rngs(3))
    fresh, generators = pooled("tightly-coupled", 3), rngs(3)
    assert np.array_equal(played(engine, generators), played(fresh, rngs(3)))
    other, theirs = pickle.loads(pickle.dumps((engine, generators)))
    assert np.array_equal(played(engine, generators), played(other, theirs))


@pytest.mark.parametrize("pool", [None, 3])
def test_recorded_files_name_it(pool, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    settings = {"timeline": TIMELINE, "warm_pool": pool, "action": "full-command"}
    env = RecordEpochs(gym.make("spoofgym/Zhong2025-v0", **settings), tmp_path)
    env.reset(seed=1)
    env.step(np.zeros(2, dtype=np.float32))
    env.close()
    (file,) = tmp_path.glob("*.parquet")
    assert json.loads(parquet.read_metadata(file).metadata[b"spoofgym"]).get("warm_pool") == pool


def test_all_forms_of_an_environment_take_it():
    settings = {"timeline": TIMELINE, "warm_pool": 3, "action": "full-command"}
    envs = gym.make_vec(
        "spoofgym/Zhong2025-v0", 4, **settings, autoreset_mode="same_step", threads=2
    )
    single = gym.make("spoofgym/Zhong2025-v0", **settings, disable_env_checker=True)
    push, pushes = np.full(2, 0.5, dtype=np.float32), np.full((4, 2), 0.5, dtype=np.float32)
    assert np.array_equal(single.reset(seed=7)[0], envs.reset(seed=5)[0][2])
    assert single.spec.kwargs["warm_pool"] == 3
    assert envs.unwrapped.core.engine._next is None
    for _ in range(20):
        observation, _, terminated, _, _ = single.step(push)
        if terminated:
            observation = single.reset()[0]
        assert np.array_equal(observation, envs.step(pushes)[0][2])
    world = {"timeline": TIMELINE, "scenario": "zhong2025", "domain": None}
    view = gym.make("spoofgym/SpooferView-v0", **world, warm_pool=3, pool=["ewma"])
    assert view.unwrapped.core.engine.warm_pool == 3
    for env in (envs, single, view):
        env.close()


def test_what_is_given_of_an_episode_gives_it_a_past_of_its_own():
    with pytest.raises(ValueError, match="`warm_pool` must be a whole number of at least 1, got"):
        Engine(2, setup_of("robot"), warm_pool=0)
    settings = {"target_heading_deg": "random"}
    engine, own = pooled("tightly-coupled", 2, **settings), setup_of("tightly-coupled", **settings)
    alone = Engine(2, own)
    for each in (engine, alone):
        each.reset(rngs(2), given={"target_heading_deg": 10.0})
    assert np.array_equal(engine.simulator.error_n(), alone.simulator.error_n())
    assert not engine._flown.any()


def test_pasts_are_flown_when_they_are_picked_and_not_again(monkeypatch):
    flown, warm_up = [], TightlyCoupledSimulator.warm_up

    def counted(simulator, generators, given=None):
        flown.append(len(generators))
        return warm_up(simulator, generators, given)

    monkeypatch.setattr(TightlyCoupledSimulator, "warm_up", counted)
    aged = {"age_s": (10.0, 60.0)}
    engine = Engine(1, setup_of("tightly-coupled", domain=aged), warm_pool=30)
    generators = rngs(1)
    for _ in range(200):
        engine.reset(generators)
    assert max(flown) == LANES  # beside the one that is picked, the next younger ones
    assert sum(flown) == 30
    assert len(flown) < 15
    engine.close()
    engine.reset(generators)
    assert sum(flown) > 30


AGED = {"worlds": 2, "constellation_time_s": (0.0, 80_000.0), "age_s": (10.0, 301.0)}


@pytest.mark.parametrize(
    ("domain", "given", "pool"),
    [
        (AGED, {}, 256),
        (AGED, {"warm_pool": 7}, 7),
        (AGED, {"warm_pool": 0}, None),
        ({**AGED, "age_s": (10.0, 300.0)}, {}, None),
        (None, {}, None),
    ],
)
def test_old_receivers_share_pasts_unless_they_are_scored(domain, given, pool):
    world = {"timeline": TIMELINE, "domain": domain, "detector": "never", **given}
    env = gym.make("spoofgym/Zhong2025-v0", **world, disable_env_checker=True)
    assert env.unwrapped.core.engine.warm_pool == pool
    if pool is None:
        AlarmRecorder(env)
    else:
        with pytest.raises(ValueError, match=f"share {pool} pasts .* with warm_pool=0"):
            AlarmRecorder(env)
    scored = Recorder(EpochInfo(env), threads=1)
    assert scored.core.engine.warm_pool is None
    env.close()


def test_a_seed_gives_the_same_episode_whatever_was_flown_before():
    short = {**AGED, "age_s": (10.0, 40.0)}
    world = {"domain": short, "timeline": TIMELINE, "warm_pool": 5}
    envs = gym.make_vec("spoofgym/Zhong2025-v0", 3, **world, action="full-command")
    first, _ = envs.reset(seed=4)
    pushes = np.full(envs.action_space.shape, 0.5, dtype=np.float32)
    for _ in range(40):
        envs.step(pushes)
    copied = pickle.loads(pickle.dumps(envs.unwrapped))
    assert np.array_equal(copied.step(pushes)[0], envs.step(pushes)[0])
    assert np.array_equal(copied.reset(seed=4)[0], first)
    assert np.array_equal(envs.reset(seed=4)[0], first)
    envs.close()
