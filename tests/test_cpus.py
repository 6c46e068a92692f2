"""What the compiler makes of the kernels, on this processor or the one that it is asked for."""

import re

import numba
import numpy as np
import pytest
from numba.core.caching import NullCache

from spoofgym.attacks import ATTACKS
from spoofgym.envs import _kernels as step
from spoofgym.receiver import _kernels as receiver
from spoofgym.receiver import replay
from spoofgym.simulation import Engine
from spoofgym.simulation.recording import record_run

from . import cpus, digests
from .envs.support import single
from .nightly import heavy

LANES_SIGNATURE = "(A, int64, A, A, int64, A, A)".replace("A", "float64[:, ::1]")
"""Of `mechanize`, of eight receivers."""

if numba.config.DISABLE_JIT:
    pytest.skip("nothing is compiled", allow_module_level=True)


def compiled(kernel, *signatures):
    """Compile a kernel once more: code from the cache can't be looked at."""
    copy = type(kernel)(kernel.py_func, {}, kernel.targetoptions, NullCache())
    for signature in signatures or kernel.signatures:
        copy.compile(signature)
    return copy


MORE = step.play_epoch, step.finish
"""Which take long, and have what they call from the same decorator."""


@pytest.fixture(scope="module")
def _played():
    """All that is called from Python has been, so that it knows its arguments.

    What compiled code calls knows them only where that has been compiled, not loaded from a cache.
    """
    for detector in ("ewma", "cusum"):  # in one kernel with the score, and apart from it
        env = single(detector=detector)
        env.reset(seed=1)
        env.step(np.zeros(2, dtype=np.float32))
        setup = env.unwrapped.core.setup
        env.close()
    engine = Engine(1, digests.setup_of("default"), threads=1)
    engine.reset([np.random.default_rng(1)])
    engine.close()
    initial, recording, _ = record_run(setup, np.random.default_rng(1), epochs=2)
    replay(recording, setup.receiver, initial=initial)


@pytest.mark.usefixtures("_played")
@pytest.mark.parametrize(
    "kernel",
    heavy([step.play_epoch, receiver.run_epoch, step.finish], *MORE),
    ids=lambda kernel: kernel.__name__,
)
def test_no_operations_are_fused_and_no_sums_regrouped(kernel):
    code = compiled(kernel).inspect_llvm()
    assert code
    for text in code.values():
        operations = re.findall(r" = f(?:add|sub|mul|div) ((?:[a-z]+ )*)(?:double|<)", text)
        assert operations or kernel is step.finish
        assert not any(operations), "a rule of floating point is relaxed"
        assert not re.search(r"llvm\.(?:fma|fmuladd)", text)


def test_the_machine_code_is_for_the_processor_that_is_asked_for():
    name = numba.config.CPU_NAME
    features = set(cpus.KINDS[name].split()) if name else cpus.host_features()
    (code,) = compiled(receiver.mechanize, LANES_SIGNATURE).inspect_asm().values()
    registers = set(re.findall(r"%([xyz]mm)", code))
    widest = "zmm" if "avx512f" in features else ("ymm" if "avx2" in features else "xmm")
    assert "xmm" in registers
    assert max(registers) == widest  # a vector of eight fills as few registers as can be


def test_the_runs_hold_every_attack_with_all_equipment():
    attacks = [settings["attack"] for settings in digests.RUNS.values() if "attack" in settings]
    full = {attack["name"] for attack in attacks if isinstance(attack, dict)}
    assert full == {*ATTACKS}, "`RUNS` in tests/digests.py has a run of every attack"
    setup = digests.setup_of("default")
    assert digests.run_digests(setup, 3) == digests.run_digests(setup, 3)


@pytest.mark.usefixtures("default_rate")
@pytest.mark.parametrize("name", digests.RUNS)
def test_a_process_of_its_own_can_play_the_runs(name):
    Engine(1, digests.setup_of(name), threads=1).close()
