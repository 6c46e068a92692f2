"""An environment goes to another process as it is: files, joblib, SubprocVecEnv."""

import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
from numba import cloudpickle

from spoofgym.core.compile import is_disabled, njit
from spoofgym.earth import wgs84

from .envs.support import VICTIMS, victim, victims


def play(env: Any, steps: int = 4) -> list[Any]:
    """What some steps show, with the same command for every receiver."""
    command = np.full(env.action_space.shape, 0.3, dtype=np.float32)
    return [part for _ in range(steps) for part in env.step(command)[:2]]


def go_on(env: Any) -> list[Any]:
    return [*play(env), env.reset(seed=5)[0], *play(env)]


def under_way(env: Any) -> Any:
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


def assert_same(seen: list[Any], expected: list[Any]) -> None:
    for one, other in zip(seen, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_file_of_environments_goes_on_in_a_fresh_process_with_the_same_bits(tmp_path):
    envs = {kind: under_way(victim(kind)) for kind in VICTIMS}
    envs |= {f"{kind} of 3": under_way(victims(kind, 3)) for kind in ("TightlyCoupled", "Snapshot")}
    (tmp_path / "envs.pkl").write_bytes(pickle.dumps(envs))
    child = [sys.executable, "-c", CHILD, str(tmp_path)]
    done = subprocess.run(child, cwd=Path(__file__).parents[1], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    seen = pickle.loads((tmp_path / "seen.pkl").read_bytes())
    assert list(seen) == list(envs)
    for name, env in envs.items():
        assert_same(seen[name], go_on(env))


def test_joblib_s_workers_play_environments_that_they_are_handed():
    envs = [under_way(victim("TightlyCoupled")), under_way(victims("TightlyCoupled", 2))]
    seen = joblib.Parallel(n_jobs=2, backend="loky")(joblib.delayed(go_on)(env) for env in envs)
    for found, env in zip(seen, envs, strict=True):
        assert_same(found, go_on(env))


def test_stable_baselines3_s_processes_play_an_environment_of_a_lambda():
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    env = victim("TightlyCoupled")
    workers = vec_env.SubprocVecEnv([lambda: env])
    try:
        workers.seed(3)
        seen = [workers.reset()[0]]
        for _ in range(4):
            observation, reward, *_ = workers.step(
                np.full((1, *env.action_space.shape), 0.3, np.float32)
            )
            seen += [observation[0], reward[0]]
    finally:
        workers.close()
    assert_same(seen, [env.reset(seed=3)[0], *play(env)])


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
