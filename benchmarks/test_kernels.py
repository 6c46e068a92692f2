"""Parts of an epoch, compiled: all receivers once."""

import pytest

from . import perf


@pytest.fixture(scope="module", params=[1, 64, 256])
def rig(request):
    made = perf.Rig(request.param, 1)
    yield made
    made.close()


@pytest.mark.parametrize("part", [*perf.KERNELS, perf.ATTACK])
def test_part(benchmark, rig, part):
    benchmark.extra_info["receivers"] = rig.receivers
    benchmark(rig.run_part, part, 1)
