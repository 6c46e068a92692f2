"""A GPU that is not there, or too small, is an error that says so."""

import importlib.util
import subprocess
import sys
from types import SimpleNamespace

import pytest

from spoofgym.core.devices import check_driver, check_free_memory
from spoofgym.envs import SpoofVectorEnv

CARD = SimpleNamespace(type="cuda")
MEMORY = SimpleNamespace(  # 10 MiB are free, a fifth of them as PyTorch holds them
    mem_get_info=lambda _: (8 * 2**20, 2**30),
    memory_reserved=lambda _: 5 * 2**20,
    memory_allocated=lambda _: 3 * 2**20,
)


def test_drivers_that_are_missing_or_old_are_errors():
    driver = SimpleNamespace(get_version=lambda: (12, 4))
    old = SimpleNamespace(cudadrv=SimpleNamespace(driver=SimpleNamespace(driver=driver)))
    with pytest.raises(RuntimeError, match="finds none"):
        check_driver(SimpleNamespace(is_available=lambda: False))
    with pytest.raises(RuntimeError, match=r"finds one of CUDA 12\.4"):
        check_driver(SimpleNamespace(is_available=lambda: True, **vars(old)))


def test_too_many_receivers_are_an_error_with_the_largest_number():
    with pytest.raises(ValueError, match="free: at most 95"):
        check_free_memory(MEMORY, CARD, 96, 2**20 / 10)
    check_free_memory(MEMORY, CARD, 95, 2**20 / 10)


def test_an_environment_that_is_too_large_is_refused_before_it_is_allocated(monkeypatch):
    torch = pytest.importorskip("torch")
    from spoofgym.cuda import memory, pool, supported, vector_env

    nothing = {"SIMULATED": True, "import_torch": lambda: torch, "launch": lambda *_: None}

    def check(_, __, *sizes):
        check_free_memory(MEMORY, CARD, *sizes)

    for module in (memory, pool, supported, vector_env):
        for name, stand_in in {**nothing, "check_free_memory": check}.items():
            monkeypatch.setattr(module, name, stand_in, raising=False)
    short = {"warmup_s": 1.0, "live_s": 1.0, "attack_s": 2.0, "time_to_alert_s": 1.0}
    how = {"pasts": 2, "timeline": short, "detector": "never", "imu_rate_hz": 10}
    with pytest.raises(ValueError, match=r"1000000000000 receivers .* free: at most \d+"):
        vector_env.CudaVectorEnv(10**12, **how)
    with pytest.raises(ValueError, match="2000 receivers need"):  # to start episodes from
        vector_env.CudaVectorEnv(1, **how | {"pasts": 2_000})
    vector_env.CudaVectorEnv(2, **how).close()


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
