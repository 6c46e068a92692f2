"""A GPU that is not there, or too small, is an error that says so."""

import importlib.util
import subprocess
import sys
from types import SimpleNamespace

import pytest

from spoofgym.core.devices import check_driver, check_free_memory
from spoofgym.envs import SpoofVectorEnv


def test_drivers_that_are_missing_or_old_are_errors():
    driver = SimpleNamespace(get_version=lambda: (12, 4))
    old = SimpleNamespace(cudadrv=SimpleNamespace(driver=SimpleNamespace(driver=driver)))
    with pytest.raises(RuntimeError, match="finds none"):
        check_driver(SimpleNamespace(is_available=lambda: False))
    with pytest.raises(RuntimeError, match=r"finds one of CUDA 12\.4"):
        check_driver(SimpleNamespace(is_available=lambda: True, **vars(old)))


def test_too_many_receivers_are_an_error_with_the_largest_number():
    with pytest.raises(ValueError, match="free: at most 95"):
        check_free_memory(96, 2**20, 100 * 2**20)
    check_free_memory(95, 2**20, 100 * 2**20)


def test_the_package_needs_no_compiler_for_devices():
    script = "import sys, spoofgym.envs; print([m for m in ('numba_cuda', 'torch', "
    script += "'spoofgym.cuda') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


def test_a_device_without_its_extra_is_an_error_that_names_it():
    if importlib.util.find_spec("numba_cuda") is None:
        with pytest.raises(ImportError, match=r"spoofgym\[cuda\]"):
            SpoofVectorEnv(2, device="cuda")
    with pytest.raises(ValueError, match="device"):
        SpoofVectorEnv(2, device="tpu")
