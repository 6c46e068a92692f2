"""The tests of identity on other kinds of processors: ``python -m tests.cpus [KIND ...]``.

Every kind has a process and a compile cache of its own.  A kind with instructions that this
processor lacks is skipped, and named.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence

from llvmlite.binding import get_host_cpu_features

from spoofgym._jit import CACHE_VARIABLE

_HASWELL = "sse4.2 popcnt avx2 fma bmi bmi2 f16c lzcnt movbe"
_AVX512 = "avx512f avx512bw avx512cd avx512dq avx512vl adx clwb"
_ZNVER3 = f"{_HASWELL} sse4a sha adx clwb vaes vpclmulqdq"
KINDS = {
    "generic": "sse2",
    "nehalem": "sse4.2 popcnt",
    "haswell": _HASWELL,
    "skylake-avx512": f"{_HASWELL} {_AVX512}",
    "znver3": _ZNVER3,
    "znver4": f"{_ZNVER3} {_AVX512} avx512bf16 avx512bitalg avx512ifma avx512vbmi avx512vbmi2 "
    "avx512vnni avx512vpopcntdq gfni",
}
"""LLVM's names of processors, and of the instructions that it may use for them."""
VIEWS = "tests/duel/test_views.py::test_every_receiver_of_a_vector_view_is_the_single_view"
TESTS = (
    "tests/test_cpus.py",
    "tests/simulators/test_engine.py",
    VIEWS,
    "tests/receiver/test_strapdown.py",
    "tests/receiver/test_kernels.py",
)


def host_features() -> set[str]:
    """What this processor can execute, by LLVM's names."""
    return {name for name, has in get_host_cpu_features().items() if has}


def missing(kind: str, features: set[str]) -> list[str]:
    """What a processor with these features lacks to run code for a kind."""
    return sorted(set(KINDS[kind].split()) - features)


def environment(kind: str, cache: str) -> dict[str, str]:
    """Variables of a process that compiles for a kind: without the empty one for this processor."""
    chosen = {"NUMBA_CPU_NAME": kind, "NUMBA_CPU_FEATURES": "", CACHE_VARIABLE: cache}
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
    return kept | chosen


def passes(kind: str) -> bool:
    """Run the tests in a process that compiles for a kind."""
    with tempfile.TemporaryDirectory(prefix="spoofgym-cpus-") as cache:
        command = [sys.executable, "-m", "pytest", "-q", *TESTS]
        return subprocess.run(command, env=environment(kind, cache), check=False).returncode == 0


def main(kinds: Sequence[str]) -> int:
    """Number of kinds whose tests fail; 1 also where this processor can run none of them."""
    features, results = host_features(), {}
    for kind in kinds or KINDS:
        if kind not in KINDS:
            raise SystemExit(f"unknown kind of processor {kind!r}; valid are {', '.join(KINDS)}")
        lacking = missing(kind, features)
        print(f"== {kind}", flush=True)
        results[kind] = (
            f"skipped: this processor lacks {', '.join(lacking)}"
            if lacking
            else ("passed" if passes(kind) else "FAILED")
        )
    for kind, result in results.items():
        print(f"{kind:16}{result}")
    outcomes = list(results.values())
    return outcomes.count("FAILED") or int("passed" not in outcomes)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
