"""Kinds that are chosen by name: a table per kind, whose entries are loaded when they are asked for.

A table lies in the room of its kind (renderers, exporters, pages, engines) and maps a name to an
`Entry`; a new one is a file and a line in the table. What lists or checks names loads none of them.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any, NamedTuple

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.extras import neighbour_hint

_log = logging.getLogger(__name__)


class Entry(NamedTuple):
    """Where a kind's function lives, ``package.module:function``, and what it does, in one line. `neighbour`: the
    folder in neighbours/ of the distribution that has it, after those that it needs; empty for the core's own."""

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
        raise ConfigError(f"{what}: not installed; {neighbour_hint(*entry.neighbour.split())}")
    return load(entry.target)


def load(target: str) -> Any:
    """What ``package.module:name`` names, imported when it is first asked for."""
    module, _, attribute = target.partition(":")
    return getattr(import_module(module), attribute)


def names(table: Mapping[str, Entry]) -> str:
    """``a, b or c``."""
    *most, last = table
    return f"{', '.join(most)} or {last}" if most else last


def installed(group: str, kind: type) -> list[Any]:
    """What distributions of their own offer by entry points of a group, as far as it can be loaded and is of this
    kind. Of others a warning names the distribution."""
    found = []
    for entry in entry_points(group=group):
        try:
            offered = entry.load()
            if not isinstance(offered, kind):
                raise TypeError(f"expected a {kind.__name__}, got {type(offered).__name__}")
        except Exception as error:  # whatever a stranger's module raises
            _log.warning("%s and is left out (%s)", _offer(entry), _cause(error))
        else:
            found.append(offered)
    return found


def installed_by_name(group: str, name: str) -> Any:
    """What an entry point offers, None if there is none. Raises `ConfigError`, which names the distribution, for
    what cannot be loaded."""
    for entry in entry_points(group=group, name=name):
        try:
            return entry.load()
        except Exception as error:  # whatever a stranger's module raises
            raise ConfigError(f"{_offer(entry)} ({_cause(error)}): install it anew") from error
    return None


def _offer(entry: EntryPoint) -> str:
    of = "" if entry.dist is None else f"{entry.dist.name}: "
    return f"{of}what it offers as {entry.group} '{entry.name}', {entry.value}, cannot be loaded"


def _cause(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"[:200]
