"""How a function is compiled: in full where Python calls it, else as far as its callers need.

What only compiled code calls needs no wrapper for Python, no machine code and no file of the cache:
its callers take its intermediate code in, and LLVM optimizes that once, as a part of theirs.
"""

from __future__ import annotations

import sys
from typing import Any

from numba.core import sigutils
from numba.core.caching import FunctionCache, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult, Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler  # type: ignore[attr-defined]
from numba.core.registry import CPUDispatcher
from numba.core.types.misc import unliteral


class _Part(JITCodeLibrary):  # type: ignore[misc]
    """Intermediate code of a function that only compiled code calls; not optimized by itself."""

    def finalize(self) -> None:
        """Take in what it calls, and leave all else to its callers."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True


def is_part(result: CompileResult) -> bool:
    """Whether a compiled function can be called from compiled code alone."""
    return isinstance(result.library, _Part)


class _Compiler(_FunctionCompiler):  # type: ignore[misc]
    """Compiles a function in full, or as a `_Part` where that is asked for."""

    as_part = False

    def _compile_core(self, args: Any, return_type: Any) -> CompileResult:
        if not self.as_part:
            return super()._compile_core(args, return_type)
        self.as_part = False
        flags = self.targetdescr.options.parse_as_flags(Flags(), self.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        target = self.targetdescr.target_context
        library = _Part(target.codegen(), self.py_func.__qualname__)
        result = compile_extra(
            self.targetdescr.typing_context,
            target,
            self.py_func,
            args=args,
            return_type=return_type,
            flags=flags,
            locals=self.locals,
            library=library,
            pipeline_class=self.pipeline_class,
        )
        target.insert_user_function(library, result.fndesc, [library])
        return result._replace(entry_point=library)


class Function(CPUDispatcher):  # type: ignore[misc]
    """A compiled function: for Python, or as a part of other compiled functions, or both."""

    _compiler: Any

    # numba rebuilds what was pickled with its code by the first three.
    def __init__(
        self,
        function: Any,
        variables: dict[str, Any],
        options: dict[str, Any],
        cache: FunctionCache | None = None,
    ) -> None:
        super().__init__(function, variables, options)
        self._compiler = _Compiler(
            function, self.targetdescr, options, self.locals, self._compiler.pipeline_class
        )
        self._cache = cache or NullCache()

    def __reduce__(self) -> Any:
        """Pickle a function of a module by its name, as Python does, and any other with its code.

        What another process imports is compiled there already, or loaded from the cache.
        """
        name, module = self.py_func.__qualname__, sys.modules.get(self.py_func.__module__)
        named = module is not None and module.__name__ != "__main__"
        return name if named and getattr(module, name, None) is self else super().__reduce__()

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """How a call from compiled code is compiled.

        By the types of its arguments, not once more for every constant.
        """
        plain = tuple(map(unliteral, args))
        named = {name: unliteral(kind) for name, kind in kws.items()}
        with global_compiler_lock:
            self._compiler.as_part = True
            try:
                return super().get_call_template(plain, named)
            finally:
                self._compiler.as_part = False

    def compile(self, sig: Any) -> Any:
        """Compile for some types of arguments, if that has not been done."""
        with global_compiler_lock:
            args, _ = sigutils.normalize_signature(sig)
            found = self.overloads.get(tuple(args))
            if found is not None and is_part(found) and not self._compiler.as_part:
                del self.overloads[tuple(args)]
            return super().compile(sig)

    def add_overload(self, cres: CompileResult) -> None:
        """Keep what has been compiled; Python finds only what it can call."""
        if is_part(cres):
            self.overloads[tuple(cres.signature.args)] = cres
        else:
            super().add_overload(cres)
