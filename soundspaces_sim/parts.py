"""Parts of the simulator for programs that are built on it, beside the names of `soundspaces_sim` itself.

    from soundspaces_sim.parts import WaveField, prepare_scene

They are what the distributions in `neighbours/` use: kept as docs/promise.md says, however the modules behind them
are cut. `parts.pyi` lists them by the package that they come from; each is loaded when it is first used.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

#: Module and name there of every part, by its name here.
_PLACES = {
    alias.asname or alias.name: (f"{__package__}.{node.module}", alias.name)
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}
__all__ = sorted(_PLACES)


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, there = _PLACES[name]
    value = globals()[name] = getattr(import_module(module), there)
    return value


def __dir__() -> list[str]:
    return __all__
