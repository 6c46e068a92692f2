"""An environment goes to another process as it is: files, joblib, SubprocVecEnv."""

import multiprocessing
import os
import pickle
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import gymnasium as gym
import joblib
import numpy as np
import pytest
from numba import cloudpickle

from spoofgym.core.compile import is_disabled, njit
from spoofgym.earth import wgs84

from .envs.support import victim, victims


def play(env, steps=4):
    """What some steps show, with the same command for every receiver."""
    command, shown = np.full(env.action_space.shape, 0.3, dtype=np.float32), []
    for _ in range(steps):
        *parts, terminated, truncated, _ = env.step(command)
        shown += parts
        if np.ndim(terminated) == 0 and (terminated or truncated):
            env.reset(seed=9)
    return shown


def go_on(env):
    return [*play(env), env.reset(seed=5)[0], *play(env)]


def under_way(env):
    env.reset(seed=1)
    play(env, 1)
    return env


CHILD = """
import pickle, sys
from pathlib import Path
from tests.test_pickling import go_on
folder = Path(sys.argv[1])
envs = pickle.loads((folder / "envs.pkl").read_bytes())
(folder / "seen.pkl").write_bytes(pickle.dumps({name: go_on(env) for name, env in envs.items()}))
"""


def test_what_was_pickled_compiled_is_plain_python_where_nothing_is_compiled():
    script = (
        "import pickle, sys; function = pickle.load(sys.stdin.buffer); "
        "print(type(function).__name__, function(7e6, 0.0, 0.0)[0])"
    )
    variables, content = {**os.environ, "NUMBA_DISABLE_JIT": "1"}, pickle.dumps(wgs84.gravity)
    shown = subprocess.check_output([sys.executable, "-c", script], input=content, env=variables)
    kind, value = shown.decode().split()
    assert kind == "function"
    assert float(value) == pytest.approx(wgs84.gravity(7e6, 0.0, 0.0)[0], rel=1e-12)


KINDS = ["Zhong2025", "3 Snapshot", "LooselyCoupled", "Snapshot", "WheeledRobot"]


@pytest.mark.parametrize("kinds", [KINDS[:2], pytest.param(KINDS[2:], marks=pytest.mark.nightly)])
def test_a_file_of_environments_goes_on_in_a_fresh_process_with_the_same_bits(kinds, tmp_path):
    made = (victims(each[2:], 3) if each[0] == "3" else victim(each) for each in kinds)
    envs = dict(zip(kinds, map(under_way, made), strict=True))
    (tmp_path / "envs.pkl").write_bytes(pickle.dumps(envs))
    child = [sys.executable, "-c", CHILD, str(tmp_path)]
    done = subprocess.run(child, cwd=Path(__file__).parents[1], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    seen = pickle.loads((tmp_path / "seen.pkl").read_bytes())
    handed = joblib.Parallel(n_jobs=2, backend="loky")(
        joblib.delayed(go_on)(env) for env in envs.values()
    )
    for (name, env), other in zip(envs.items(), handed, strict=True):
        for one, two, mine in zip(seen[name], other, go_on(env), strict=True):
            np.testing.assert_array_equal(one, mine)
            np.testing.assert_array_equal(two, mine)


IDS = sorted(name for name, spec in gym.registry.items() if spec.namespace == "spoofgym")
FORMS = [(name, None) for name in IDS]
FORMS += [(name, 2) for name in IDS if gym.spec(name).vector_entry_point is not None]


def make_form(name, number):
    return gym.make(name) if number is None else gym.make_vec(name, num_envs=number)


@pytest.mark.nightly
@pytest.mark.parametrize("method", ["spawn", "forkserver"])
@pytest.mark.parametrize("form", FORMS, ids=str)
def test_every_environment_goes_on_in_any_process(method, form):
    env = under_way(make_form(*form))
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(method)) as pool:
        seen = pool.submit(go_on, env).result()
    for one, mine in zip(seen, go_on(env), strict=True):
        np.testing.assert_array_equal(one, mine)
    env.close()


@pytest.mark.nojit
def test_a_compiled_function_is_pickled_by_its_name():
    for with_ in (pickle, cloudpickle):
        content = with_.dumps(wgs84.gravity)
        assert len(content) < 100
        assert pickle.loads(content) is wgs84.gravity


@pytest.mark.skipif(is_disabled(), reason="plain functions are Python's")
def test_a_compiled_function_without_a_name_is_pickled_with_its_code():
    factor = 3.0

    @njit
    def own(x):
        return factor * wgs84.gravity(x, 0.0, 0.0)[0]

    content, expected = cloudpickle.dumps(own), own(6378137.0)
    # as in another process, which does not know it
    type(own)._memo.pop(own._uuid)
    again = pickle.loads(content)
    assert again is not own
    assert again(6378137.0) == expected
