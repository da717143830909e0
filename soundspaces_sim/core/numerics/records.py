"""How records are passed to parts: field by field, or whole where their package says so (`pass_whole`).

Numba takes named tuples apart at a call, down to the seven fields of every array, and puts them together again in
the function that is called. Where records hold hundreds of arrays, half of all code that LLVM is given does nothing
else. A record that is passed whole is one argument, which LLVM takes apart where it has to. What is computed is the
same. But LLVM inlines a function the sooner the more arguments it has, so the innermost loops of the path tracer
were up to twice as slow with whole records: those of `transport.paths` stay as Numba has them.
"""

from __future__ import annotations

from typing import Any

from numba.core import types
from numba.core.datamodel import models
from numba.core.datamodel.registry import register_default

_whole: list[str] = []  # packages and modules, with a dot behind them


def pass_whole(package: str) -> None:
    """Pass the records of a package or a module whole. To be called when it is imported, before any is compiled."""
    _whole.append(package + ".")


@register_default(types.NamedTuple)
class RecordModel(models.TupleModel):
    """Numba's model of named tuples, but for those that are passed whole."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind)
        self._passed_whole = f"{kind.instance_class.__module__}.".startswith(tuple(_whole))

    def get_argument_type(self) -> Any:
        """Of LLVM, of what is passed."""
        return self.get_value_type() if self._passed_whole else super().get_argument_type()

    def as_argument(self, builder: Any, value: Any) -> Any:
        """What is passed of a value."""
        return value if self._passed_whole else super().as_argument(builder, value)

    def from_argument(self, builder: Any, value: Any) -> Any:
        """The value of what is passed."""
        return value if self._passed_whole else super().from_argument(builder, value)
