"""The compilers of parts, without machine code, and of kernels, without the code that they were made from.

Numba optimises and makes machine code of every function, also of one that only other functions call. A kernel has
its parts' code linked in and is optimised and made into machine code as a whole. What is made of a part by itself
would never be run, and takes a third of the time of compiling.

Beside a function's machine code, Numba keeps LLVM's on disk, to be linked into functions that call it, and parses
that whenever it loads the function. Nothing compiled calls most kernels: of their LLVM code, only names are kept,
by which machine code is found. The rest is a third of the time in which a first simulation loads its kernels.

Numba gives a function every word of every array by itself, seven an array. Parts with records of arrays for
arguments have hundreds of them, most of which they only hand on. What is linked into a kernel is made internal to
it, so that LLVM may drop arguments that nothing reads and inline what is called from one place. That takes 20 to
50 % off the time of paths by edges.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder


class _NoEngine:
    """In place of what holds machine code: a part's environment (its globals as Python objects) is in none."""

    @staticmethod
    def set_env(_name: str, _environment: Any) -> None:
        pass


class _PartLibrary(JITCodeLibrary):
    """A library that can be linked and not be called."""

    def _optimize_final_module(self) -> None:
        """Nothing: a kernel optimises all that is linked into it."""

    @property
    def codegen(self) -> type[_NoEngine]:
        return _NoEngine

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, _name: str) -> int:
        """0: there is none."""
        self._ensure_finalized()
        return 0


class _KernelLibrary(JITCodeLibrary):
    """A library that is called and, once it was loaded from disk, cannot be linked (`forget_names`)."""

    def _optimize_final_module(self) -> None:
        """Optimise a kernel with parts that no one else may call."""
        for function in self._final_module.functions:
            if function.linkage == llvmlite.binding.Linkage.linkonce_odr:  # as Numba links it in
                function.linkage = "internal"
        super()._optimize_final_module()

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        """Numba's form of a library: name, kind, (machine code, LLVM's bitcode)."""
        self._ensure_finalized()
        return self.name, "object", (self._get_compiled_object(), _names_alone(self._final_module))


def _names_alone(module: Any) -> bytes:
    """Bitcode of a module that defines what another does, by name."""
    functions = [
        f'define void @"{f.name}"() {{ unreachable }}' for f in module.functions if not f.is_declaration
    ]
    values = [f'@"{v.name}" = global i8 0' for v in module.global_variables if not v.is_declaration]
    named = llvmlite.binding.parse_assembly("\n".join(functions + values))
    bitcode: bytes = named.as_bitcode()
    return bitcode


def forget_names(library: JITCodeLibrary) -> None:
    """Make a kernel's library that was loaded refuse to be linked: Numba raises `RuntimeError` then."""
    library._shared_module = None


class PartCompiler(CompilerBase):
    """Numba's compiler of parts, for `numba.njit(pipeline_class=PartCompiler)`."""

    def define_pipelines(self) -> list[Any]:
        return self._into(_PartLibrary)

    def _into(self, library: type[JITCodeLibrary]) -> list[Any]:
        state = self.state
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()  # as where Numba makes the library
        return [DefaultPassBuilder.define_nopython_pipeline(state)]


class KernelCompiler(PartCompiler):
    """Numba's compiler of kernels."""

    def define_pipelines(self) -> list[Any]:
        return self._into(_KernelLibrary)
