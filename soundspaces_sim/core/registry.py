"""Kinds that are chosen by name: a table per kind, whose entries are loaded when they are asked for.

A table lies in the room of its kind (renderers, exporters, pages, engines) and maps a name to an
`Entry`; a new one is a file and a line in the table. What lists or checks names loads none of them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.extras import neighbour_hint


class Entry(NamedTuple):
    """Where a kind's function lives, ``package.module:function``, and what it does, in one line. `neighbour`: the
    folder in neighbours/ of the distribution that has it, empty for the core's own."""

    target: str
    about: str
    neighbour: str = ""


def check_name(kind: str, table: Mapping[str, Entry], name: str) -> None:
    """Raise `ConfigError` unless `name` is in the table; `kind` is what the setting is called."""
    if name not in table:
        raise ConfigError(f"{kind}: expected {names(table)}, got {name!r}")


def find(kind: str, table: Mapping[str, Entry], name: str) -> Any:
    """The function of that name. Raises `ConfigError` if there is none, or if it is not installed."""
    check_name(kind, table, name)
    entry = table[name]
    return of_neighbour(f"{kind} {name}", entry) if entry.neighbour else load(entry.target)


def of_neighbour(what: str, entry: Entry) -> Any:
    """What a distribution of its own has. Raises `ConfigError`, which says how `what` is installed."""
    package = re.split("[.:]", entry.target)[0]
    if find_spec(package) is None:
        raise ConfigError(f"{what}: not installed; {neighbour_hint(entry.neighbour)}")
    return load(entry.target)


def load(target: str) -> Any:
    """What ``package.module:name`` names, imported when it is first asked for."""
    module, _, attribute = target.partition(":")
    return getattr(import_module(module), attribute)


def names(table: Mapping[str, Entry]) -> str:
    """``a, b or c``."""
    *most, last = table
    return f"{', '.join(most)} or {last}" if most else last
