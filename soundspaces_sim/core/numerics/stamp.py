"""What machine code depends on: a digest of a kernel, of all that is compiled into it, and its arguments' fields.

It goes by bytecode and by the values of globals, from function to function: an edit of a message, a docstring or
of a function that no kernel calls changes no digest, and a constant three files away changes those it is part of.
"""

from __future__ import annotations

import hashlib
import sys
import types
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import types as numba_types

from soundspaces_sim.core.numerics.compilers import KernelCompiler

_FOREIGN = ("numba", "numpy", "llvmlite", "scipy")


def code_digest(function: Callable[..., Any]) -> str:
    """SHA-256 of a function's code, of what it refers to, directly or not, and of our compilers."""
    described = _describe(function, ()), _describe(KernelCompiler, ())
    return hashlib.sha256(repr(described).encode()).hexdigest()


def field_names(signature: Any) -> tuple[Any, ...]:
    """Names of the fields of all named tuples among argument types, in order: the types do not tell them apart."""
    arguments = getattr(signature, "args", signature)
    return tuple(names for argument in arguments for names in _fields(argument))


def _fields(argument: Any) -> Iterator[Any]:
    if isinstance(argument, numba_types.BaseTuple):
        yield from ([argument.fields] if isinstance(argument, numba_types.BaseNamedTuple) else [])  # type: ignore[attr-defined]
        for inner in argument.types:  # type: ignore[attr-defined]
            yield from _fields(inner)


def _describe(value: Any, within: tuple[int, ...]) -> Any:
    """What compiled code takes from a value that it refers to; `within`: functions that are being described."""
    # That of a dispatcher, of an intrinsic.
    function = getattr(value, "py_func", None) or getattr(value, "_defn", None)
    if function is not None:
        chosen = getattr(value, "targetoptions", {}).items()  # sets have another order in each process
        options = sorted((name, repr(sorted(v) if isinstance(v, set) else v)) for name, v in chosen)
        return "compiled", options, _describe(function, within)
    module, name = _origin(value)
    if isinstance(value, types.FunctionType) and not _is_foreign(module):
        return "recursion" if id(value) in within else _describe_function(value, (*within, id(value)))
    if isinstance(value, np.ndarray):
        return "array", value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()
    if (
        isinstance(value, bool | int | float | complex | str | bytes | np.generic | np.dtype)
        or value is None
    ):
        return type(value).__name__, repr(value)
    if isinstance(value, tuple | list):
        return type(value).__name__, [_describe(item, within) for item in value]
    if isinstance(value, type) and hasattr(value, "_fields"):
        return "record", name, value._fields
    return module, name, "" if _is_foreign(module) else _file_digest(module)


def _origin(value: Any) -> tuple[str, str]:
    """Module and name of a module, a function, a class, or of an object's class."""
    if isinstance(value, types.ModuleType):
        return value.__name__, ""
    named = value if hasattr(value, "__qualname__") else type(value)
    return getattr(named, "__module__", None) or "", named.__qualname__


def _describe_function(function: types.FunctionType, within: tuple[int, ...]) -> Any:
    names = list(_names(function.__code__))
    referred = {name: function.__globals__[name] for name in names if name in function.__globals__}
    referred |= _closure(function)
    described = []
    for name, value in referred.items():
        if isinstance(value, types.ModuleType) and not _is_foreign(value.__name__):
            # Of a module of ours what is taken from it: any name that the code uses and the module has.
            taken = [(n, _describe(vars(value)[n], within)) for n in names if n in vars(value)]
            described.append((name, taken))
        else:
            described.append((name, _describe(value, within)))
    defaults = _describe(function.__defaults__ or (), within)
    return function.__qualname__, _code(function.__code__, function.__doc__), defaults, described


def _closure(function: types.FunctionType) -> dict[str, Any]:
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    return {name: cell.cell_contents for name, cell in cells}


def _names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def _code(code: types.CodeType, docstring: str | None) -> Any:
    """Bytecode and constants, without the docstring and the numbers of lines."""
    constants = code.co_consts
    if docstring is not None and constants and constants[0] == docstring:
        constants = constants[1:]
    inner = [_code(c, None) if isinstance(c, types.CodeType) else repr(c) for c in constants]
    return code.co_code.hex(), inner, code.co_names, code.co_varnames, code.co_argcount


def _is_foreign(module: str) -> bool:
    """Whether a module comes with Python or with what compiles: Numba tells versions of these apart."""
    top = module.partition(".")[0]
    return top in _FOREIGN or top in sys.stdlib_module_names


@cache
def _file_digest(module: str) -> str:
    """Of an object that is none of the above, the file that it comes from."""
    path = getattr(sys.modules.get(module), "__file__", None)
    return hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else ""
