"""Every id does what it did when its trajectory was stored."""

import os
import subprocess
import sys
from functools import cache

import gymnasium as gym
import numpy as np
import pytest

from . import trajectories
from .trajectories import FEW, STEPS

NOISE = "3df5a44369fc0d5bf806c87edbb93246ca6df4d150d2bc92c5d4d999618b9f86"
"""Of the first version; another digest means other noise under every id."""
LONG = (
    *("BenchD1-v1", "BenchD2-v1", "BenchD3-v1", "BenchT4-v1"),
    *("BenchS2-v2", "BenchS3-v2", "BenchD2-v2", "BenchD3-v2"),
)
"""Longer flights of what others play, up to half an hour of attack after an hour's past."""
ROUNDING_M = 1e-6
"""Errors of a few metres are differences of positions of 6e6 m, of which 1e-9 were 6 mm."""


SOME = ("LooselyCoupled-v0", "Zhong2025-v0")
REMOTE = """
import sys
from spoofgym.detectors import calibrated
from tests.golden.trajectories import cases, digest
calibrated.DEFAULT_RATE = None  # as here
for name in sys.argv[1:]:
    print(digest(cases()[name]()))
"""


@cache
def played(name, steps):
    return trajectories.cases()[name](steps=steps)


def test_the_files_are_small_and_every_id_has_one():
    files = list(trajectories.FOLDER.iterdir())
    assert {path.stem for path in files} == set(trajectories.cases())
    assert sum(path.stat().st_size for path in files) < 400_000


def test_the_default_environment_is_a_task():
    one, other = map(gym.spec, (trajectories.DEFAULT, trajectories.SAME_AS_DEFAULT))
    assert one.entry_point == other.entry_point
    assert one.vector_entry_point == other.vector_entry_point
    assert one.kwargs == other.kwargs


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        *((pytest.param(name, STEPS, marks=pytest.mark.nightly)) for name in (*LONG, *FEW)),
        *((name, FEW.get(name, STEPS)) for name in trajectories.cases() if name not in LONG),
    ],
)
def test_the_trajectory_is_the_stored_one(name, steps):
    mine, stored = played(name, steps), trajectories.load(name)
    assert set(mine) >= set(stored)  # more information may be told, none may go
    for key, expected in stored.items():
        length = min(len(expected), len(mine[key]))  # of two ids 20 steps are stored
        expected, mine[key] = expected[:length], mine[key][:length]
        assert mine[key].dtype == expected.dtype, key
        single = expected.dtype == np.float32  # of which a last bit may fall to the other side
        relative = 1.2e-7 if single else 1e-9
        np.testing.assert_allclose(mine[key], expected, rtol=relative, atol=ROUNDING_M, err_msg=key)


def test_trajectories_are_the_same_in_another_process():
    """To the last bit, in another order, with other hashes of strings."""
    here = [trajectories.digest(played(name, STEPS)) for name in SOME]
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    command = [sys.executable, "-c", REMOTE, *reversed(SOME)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == here[::-1]


def test_the_noise_is_that_of_the_first_version():
    assert trajectories.noise_digest() == NOISE
