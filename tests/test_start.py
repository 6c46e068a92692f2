"""What a start loads: counted in modules, since seconds depend on the machine."""

import subprocess
import sys

import pytest

HEAVY = {"IPython", "matplotlib", "onnxruntime", "pandas", "pyarrow", "stable_baselines3", "torch"}
COMPILER = {"llvmlite", "numba", "scipy"}
FIRST_STEP = """
env = __import__("gymnasium").make("spoofgym/{name}")
env.reset(seed=1)
env.step(env.action_space.sample())
"""


def loaded(code):
    """Modules that a fresh process has loaded after some lines."""
    command = [sys.executable, "-c", f"import sys\n{code}\nprint(*sys.modules)"]
    return {*subprocess.check_output(command, text=True).split()}


@pytest.mark.parametrize("code", ["import spoofgym", "import spoofgym.cli"])
def test_an_import_loads_neither_the_compiler_nor_anything_else_that_is_heavy(code):
    assert loaded(code) & (HEAVY | COMPILER) == set()


@pytest.mark.parametrize("name", ["TightlyCoupled-v0", "Snapshot-v0"])
def test_a_first_step_loads_only_what_it_needs(name):
    found = loaded(f"import spoofgym\n{FIRST_STEP.format(name=name)}")
    assert "numba" in found  # so that the rest is not missing because nothing was played
    unwanted = HEAVY | {"pettingzoo", "rich", "typer"}
    unwanted |= {f"scipy.{part}" for part in ("interpolate", "optimize", "sparse", "stats")}
    assert found & unwanted == set()
