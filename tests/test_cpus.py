"""What the compiler makes of the kernels, on this processor or the one that it is asked for."""

import re

import numba
import numpy as np
import pytest

from spoofgym import _jit
from spoofgym.attacks._kernels import false_position
from spoofgym.detectors.ewma import judge_channels
from spoofgym.envs import _kernels as step
from spoofgym.receiver import _kernels as receiver

from . import cpus
from .envs.support import single

LANES_SIGNATURE = "(float64[::1], float64[::1], int64)"

if numba.config.DISABLE_JIT:
    pytest.skip("nothing is compiled", allow_module_level=True)


def compiled(kernel, *signatures):
    """Compile a kernel once more: code from the cache can't be looked at."""
    copy = type(kernel)(kernel.py_func, targetoptions=kernel.targetoptions)
    for signature in signatures or kernel.signatures:
        copy.compile(signature)
    return copy


@pytest.fixture(scope="module")
def _played():
    """An environment has been stepped, so that all of its kernels know their arguments."""
    env = single(detector="ewma")
    env.reset(seed=1)
    env.step(np.zeros(2, dtype=np.float32))
    env.close()


@pytest.mark.usefixtures("_played")
@pytest.mark.parametrize(
    "kernel",
    [receiver.run_epochs, step.finish, false_position, judge_channels],
    ids=lambda kernel: kernel.__name__,
)
def test_no_operations_are_fused_and_no_sums_regrouped(kernel):
    """These are called from Python, and hold the code of all that they call."""
    code = compiled(kernel).inspect_llvm()
    assert code
    for text in code.values():
        operations = re.findall(r" = f(?:add|sub|mul|div) ((?:[a-z]+ )*)(?:double|<)", text)
        assert operations or kernel is step.finish
        assert not any(operations), "a rule of floating point is relaxed"
        assert not re.search(r"llvm\.(?:fma|fmuladd)", text)


def test_the_machine_code_is_for_the_processor_that_is_asked_for():
    """``zmm`` are the registers of AVX-512, ``ymm`` those of AVX."""
    name = numba.config.CPU_NAME
    features = set(cpus.KINDS[name].split()) if name else cpus.host_features()
    (code,) = compiled(receiver.strapdown_lanes, LANES_SIGNATURE).inspect_asm().values()
    registers = set(re.findall(r"%([xyz]mm)", code))
    assert "xmm" in registers
    assert ("ymm" in registers) == ("avx2" in features)
    assert "zmm" not in registers or "avx512f" in features


def test_a_kind_is_skipped_that_the_processor_cannot_run():
    features = set(cpus.KINDS["haswell"].split()) | {"sse2"}
    runs = [kind for kind in cpus.KINDS if not cpus.missing(kind, features)]
    assert runs == ["generic", "nehalem", "haswell"]
    assert "avx512f" in cpus.missing("znver4", features)


def test_an_unknown_kind_is_named_with_the_valid_ones():
    with pytest.raises(SystemExit, match="'pentium'; valid are generic, nehalem"):
        cpus.main(["pentium"])


def test_where_no_kind_can_run_that_is_no_success(monkeypatch, capsys):
    monkeypatch.setattr(cpus, "host_features", set)
    assert cpus.main([]) == 1
    assert "generic         skipped: this processor lacks sse2" in capsys.readouterr().out
