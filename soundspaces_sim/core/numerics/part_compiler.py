"""The compiler of parts: LLVM's code to link into kernels, and no machine code.

Numba makes machine code of every function, also of one that only other functions call. A kernel has its parts' code
linked in and is made into machine code as a whole, so what is made of a part by itself is never run; it
takes a fifth of the time of compiling.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder


class _NoEngine:
    """In place of what holds machine code: a part's environment (its globals as Python objects) is in none."""

    @staticmethod
    def set_env(_name: str, _environment: Any) -> None:
        pass


class _PartLibrary(JITCodeLibrary):
    """A library that can be linked and not be called."""

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


class PartCompiler(CompilerBase):
    """Numba's compiler with such libraries, for `numba.njit(pipeline_class=PartCompiler)`."""

    def define_pipelines(self) -> list[Any]:
        state = self.state
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return [DefaultPassBuilder.define_nopython_pipeline(state)]
