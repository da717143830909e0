"""Settings by name: one that does not exist is an error of ours, which names the nearest that does."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

from soundspaces_sim.core.errors import ConfigError


def check_keywords(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise `ConfigError` for the first name given that is not known; `what` has these settings."""
    names = list(known)
    for name in given:
        if name not in names:
            raise ConfigError(f"{what}: there is no setting {name!r}{did_you_mean(name, names)}")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``; did you mean walks?``, or, where nothing is near, what there is."""
    names = list(known)
    near = get_close_matches(name, names, 1, 0.6) or [n for n in names if n.startswith(name)][:1]
    return f"; did you mean {near[0]}?" if near else f"; there are: {', '.join(names)}"


def nearest(name: str, known: Iterable[object]) -> str:
    """``; did you mean 'telephone'?``, or nothing where nothing is near."""
    found = get_close_matches(name, [str(k) for k in known], 1, 0.5)
    return f"; did you mean '{found[0]}'?" if found else ""


class Checked(type):
    """Of classes whose unknown keyword arguments are a `ConfigError` and no TypeError."""

    def __call__(cls, *args: Any, **given: Any) -> Any:
        parameters = inspect.signature(cls.__init__).parameters  # type: ignore[misc]
        if all(p.kind != p.VAR_KEYWORD for p in parameters.values()):
            check_keywords(cls.__name__, given, [n for n in parameters if n != "self"])
        return super().__call__(*args, **given)
