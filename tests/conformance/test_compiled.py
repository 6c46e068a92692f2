"""What is compiled stands where the cache is named by the sources that it comes from."""

import ast
from pathlib import Path

from spoofgym.core.compile import COMPILED_LAYERS
from spoofgym.core.compile import FOUNDATION as FOUNDATION_FILES

from . import sources

PLAIN = {"core", "policies", "spoofers"}
"""What knows no physics, cards and sessions of ONNX files, and spoofers: nothing that a kernel
could take in, but for the foundation. No file of kernels imports the last."""
FOUNDATION = {Path(name).stem for name in FOUNDATION_FILES}
"""Modules of `core` that are in every digest."""
OF_NUMBA = {"core/compile.py", "core/devices.py", "core/simd.py"}
"""The decorator, how it compiles, which devices there are, and the types of vectors; `cuda/`
compiles for devices."""
DECORATORS = {"njit", "inline_njit"}
BRIDGES = {"envs/spoofer_binding.py", "envs/victims.py", "receiver/raw_measurements.py"}
"""Files of compiled layers that may know of other packages, since nothing compiled imports them."""


def in_layer(path):
    """Place of a file's package among the layers with compiled code, None for others."""
    parts = path.relative_to(sources.ROOT).parts
    known = len(parts) > 1 and parts[0] in COMPILED_LAYERS
    return COMPILED_LAYERS.index(parts[0]) if known else None


def test_numba_is_used_by_the_one_decorator_alone():
    users = {
        sources.name_of(path)
        for path in sources.files()
        for name, _ in sources.imports_of(path)
        if name.split(".")[0] == "numba"
    }
    assert {user for user in users if not user.startswith("cuda/")} <= OF_NUMBA


def test_compiled_functions_stand_in_compiled_layers_and_decorators_are_bare():
    """``@njit(...)`` would have settings of its own, and a use by module or alias be hidden."""
    for path in sources.files():
        where, text = sources.name_of(path), path.read_text().replace("spoofgym.core.compile", "")
        takes = {
            name
            for module, names in sources.imports_of(path)
            if module == "spoofgym.core.compile"
            for name in names
        }
        assert not any(f"compile.{name}" in text for name in DECORATORS), where
        if where != "core/compile.py" and DECORATORS & takes:
            assert in_layer(path) is not None, f"{where}: add its package to COMPILED_LAYERS"
            assert takes <= DECORATORS, where
        for node in ast.walk(sources.tree_of(path)):
            for decorator in getattr(node, "decorator_list", ()):
                called = isinstance(decorator, ast.Call) and ast.unparse(decorator.func)
                assert called not in DECORATORS, (where, node.name)


def test_compiled_layers_import_only_from_those_whose_sources_count():
    """A constant or a function of a layer that isn't in the digest would go stale."""
    for path in sources.files():
        where, layer = sources.name_of(path), in_layer(path)
        if layer is None:
            continue
        counted = {*PLAIN, *FOUNDATION, *COMPILED_LAYERS[: layer + 1]}
        counted -= {"spoofers"} if path.stem.endswith("kernels") else set()
        for module, names in sources.imports_of(path):
            package = module.split(".")
            if package[0] == "spoofgym" and where not in BRIDGES:
                assert {*(package[1:2] or names)} <= counted, (where, module)
            for bridge in BRIDGES if path.name != "__init__.py" else ():
                room, name = bridge.removesuffix(".py").split("/")
                assert module != f"spoofgym.{room}.{name}", where
                assert module != f"spoofgym.{room}" or name not in names, where


def test_no_layer_reaches_for_threads_of_its_own():
    """After a parallel region of GNU OpenMP, a forked child dies."""
    assert [path for path in sources.files() if "prange" in path.read_text()] == []
