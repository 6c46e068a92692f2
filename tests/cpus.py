"""The tests of identity on other kinds of processors: ``python -m tests.cpus [KIND ...]``.

Every kind has processes and a compile cache of its own.  A kind with instructions that this
processor lacks is skipped, and named.  What the tightly coupled engine computes is compared between
the kinds, to the last bit (`tests.digests`); with ``--compare`` that is all that is done.  Only
compiled code is for another kind: NumPy, BLAS and the C library choose by the processor itself.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence

from llvmlite.binding import get_host_cpu_features

from spoofgym.core.compile import CACHE_VARIABLE

Digests = dict[str, dict[str, str]]  # by run and by field, as `tests.digests` prints them
COMPARE = "--compare"
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
TESTS = (
    "tests/test_cpus.py",
    "tests/simulation/test_engine.py",
    "tests/duel/test_views.py::test_every_receiver_of_a_vector_view_is_the_single_view",
    "tests/receiver/test_strapdown.py",
    "tests/receiver/test_kernels.py",
)


def host_features() -> set[str]:
    return {name for name, has in get_host_cpu_features().items() if has}


def run(kind: str, cache: str, *module: str, read: bool = False) -> str | None:
    """What a module prints, where that is read, in a process that compiles for a kind; else None.

    Without the empty setting of numba that stands for this processor.
    """
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
    chosen = {"NUMBA_CPU_NAME": kind, "NUMBA_CPU_FEATURES": "", CACHE_VARIABLE: cache}
    output = subprocess.PIPE if read else None
    command = [sys.executable, "-m", *module]
    done = subprocess.run(command, env=kept | chosen, stdout=output, text=True, check=False)
    return None if done.returncode else done.stdout or ""


def differences(computed: Mapping[str, Digests]) -> list[str]:
    """Where kinds differ from the first one: a line for every run, with the fields."""
    (first, expected), *others = computed.items()
    found = []
    for kind, given in others:
        for name in {**expected, **given}:
            mine, theirs = expected.get(name, {}), given.get(name, {})
            fields = [each for each in {**mine, **theirs} if mine.get(each) != theirs.get(each)]
            if fields:
                found.append(f"{kind} differs from {first}: {name}: {', '.join(fields)}")
    return found


def main(arguments: Sequence[str]) -> int:
    """Number of kinds that fail or differ; 1 also where this processor can run none of them."""
    kinds = [kind for kind in arguments if kind != COMPARE] or list(KINDS)
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise SystemExit(f"unknown kinds {unknown}; valid are {', '.join(KINDS)}, and {COMPARE}")
    results: dict[str, str] = {}
    computed: dict[str, Digests] = {}
    for kind in kinds:
        print(f"== {kind}", flush=True)
        if lacking := sorted(set(KINDS[kind].split()) - host_features()):
            results[kind] = f"skipped: this processor lacks {', '.join(lacking)}"
            continue
        with tempfile.TemporaryDirectory(prefix="spoofgym-cpus-") as cache:
            passed = COMPARE in arguments or run(kind, cache, "pytest", "-q", *TESTS) is not None
            found = run(kind, cache, "tests.digests", read=True)
        if found is not None:
            computed[kind] = json.loads(found)
        results[kind] = "passed" if passed and found is not None else "FAILED"
    wrong = differences(computed) if computed else []
    results |= {line.partition(" ")[0]: "FAILED: other bits" for line in wrong}
    print(*wrong, sep="\n")
    for kind, result in results.items():
        print(f"{kind:16}{result}")
    if len(computed) > 1 and not wrong:
        fields = sum(map(len, next(iter(computed.values())).values()))
        print(f"the same bits in {fields} fields: {', '.join(computed)}")
    outcomes = [result.partition(":")[0] for result in results.values()]
    return outcomes.count("FAILED") or int("passed" not in outcomes)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
