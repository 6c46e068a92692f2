"""What a start loads: counted in modules, since seconds depend on the machine."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from spoofgym.core.startup import NUMPY_ENVIRONMENT, start_program

ROOT = Path(__file__).resolve().parents[1]

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


def test_a_network_that_is_played_leaves_nothing_in_the_home(tmp_path):
    path = ROOT / "spoofgym/policies/zoo/ewma-ppo.onnx"
    code = f"""
from pathlib import Path
from spoofgym.policies.onnx_model import make_session
make_session(Path({str(path)!r}).read_bytes())
"""
    unset = {"CI", "ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME"}
    variables = {name: x for name, x in os.environ.items() if name not in unset}
    variables["HOME"] = str(tmp_path)
    subprocess.run([sys.executable, "-c", code], env=variables, check=True)
    assert not [*tmp_path.rglob("*icrosoft*")]


def test_an_import_loads_neither_the_compiler_nor_anything_else_that_is_heavy():
    assert loaded("import spoofgym, spoofgym.cli") & (HEAVY | COMPILER) == set()


def test_a_first_step_loads_only_what_it_needs():
    found = loaded(FIRST_STEPS)
    assert "numba" in found  # so that the rest is not missing because nothing was played
    unwanted = HEAVY | {"pettingzoo", "rich", "typer"}
    unwanted |= {f"scipy.{part}" for part in ("interpolate", "optimize", "sparse", "stats")}
    assert found & unwanted == set()


@pytest.mark.parametrize(
    ("program", "words"),
    [("bin/spoofgym", "spoofgym: error: spoofgym"), ("-c", "ImportError: spoofgym")],
)
def test_an_older_python_is_refused_in_one_line(program, words):
    old = f"import sys; sys.version_info = 3, 10, 12; sys.argv[0] = {program!r}; import spoofgym"
    done = subprocess.run([sys.executable, "-c", old], capture_output=True, text=True, check=False)
    said = done.stderr.splitlines()
    assert done.returncode == 1
    assert said[-1].startswith(f"{words} needs Python 3.11 or newer")
    assert len(said) == 1 or program == "-c"
    make = ["make", "VENV=none", "PYTHON=false", "bench"]
    done = subprocess.run(make, capture_output=True, text=True, check=False, cwd=ROOT)
    assert len(done.stderr.splitlines()) == 1
    assert "spoofgym needs Python 3.11 or newer" in done.stderr


def test_the_program_alone_has_one_thread_and_small_pages(monkeypatch):
    monkeypatch.setattr(signal, "signal", lambda number, handler: None)
    for name, own in NUMPY_ENVIRONMENT.items():
        monkeypatch.delenv(name, raising=False)
        for program, expected in (("python", None), ("spoofgym", own), ("spoofgym", "3")):
            monkeypatch.setattr(sys, "orig_argv", ["python", "-m", program])
            if expected == "3":
                monkeypatch.setenv(name, expected)
            start_program()
            assert os.environ.get(name) == expected
