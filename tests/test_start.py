"""What a start loads: counted in modules, since seconds depend on the machine."""

import os
import signal
import subprocess
import sys

from spoofgym.core.startup import start_program

HEAVY = {"IPython", "matplotlib", "onnxruntime", "pandas", "pyarrow", "stable_baselines3", "torch"}
COMPILER = {"llvmlite", "numba", "scipy"}
FIRST_STEPS = """
import gymnasium
for name in ("Zhong2025-v0", "Snapshot-v0"):
    env = gymnasium.make(f"spoofgym:spoofgym/{name}")  # which imports what is before the colon
    env.reset(seed=1)
    env.step(env.action_space.sample())
"""


def loaded(code):
    """Modules that a fresh process has loaded after some lines."""
    command = [sys.executable, "-c", f"import sys\n{code}\nprint(*sys.modules)"]
    return {*subprocess.check_output(command, text=True).split()}


def test_an_import_loads_neither_the_compiler_nor_anything_else_that_is_heavy():
    assert loaded("import spoofgym, spoofgym.cli") & (HEAVY | COMPILER) == set()


def test_a_first_step_loads_only_what_it_needs():
    found = loaded(FIRST_STEPS)
    assert "numba" in found  # so that the rest is not missing because nothing was played
    unwanted = HEAVY | {"pettingzoo", "rich", "typer"}
    unwanted |= {f"scipy.{part}" for part in ("interpolate", "optimize", "sparse", "stats")}
    assert found & unwanted == set()


def test_the_program_alone_multiplies_matrices_by_one_thread(monkeypatch):
    monkeypatch.setattr(signal, "signal", lambda number, handler: None)
    monkeypatch.delenv(name := "OPENBLAS_NUM_THREADS", raising=False)
    for program, expected in (("python", None), ("spoofgym", "1"), ("spoofgym", "3")):
        monkeypatch.setattr(sys, "orig_argv", ["python", "-m", program])
        if expected == "3":
            monkeypatch.setenv(name, expected)
        start_program()
        assert os.environ.get(name) == expected
