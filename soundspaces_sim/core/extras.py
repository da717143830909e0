"""What to install for what is optional."""

from __future__ import annotations

from importlib.util import find_spec

from soundspaces_sim.core.errors import SoundSpacesSimError

_PACKAGES = {"nav": "gymnasium", "figures": "matplotlib"}


class MissingExtraError(SoundSpacesSimError, ImportError):
    """A package of an optional extra is not installed."""


def install_hint(extra: str) -> str:
    """The command that installs an extra: of a clone, since the package is on no index."""
    return f"`pip install -e '.[{extra}]'` in a clone of soundspaces_sim"


def neighbour_hint(*folders: str) -> str:
    """The command that installs folders of neighbours/, likewise."""
    return f"in a clone: .venv/bin/pip install {' '.join(f'./neighbours/{name}' for name in folders)}"


def need(what: str, *extras: str) -> None:
    """Raise `MissingExtraError`, which says that `what` needs it, if the package of an extra is missing."""
    for extra in extras:
        if find_spec(_PACKAGES[extra]) is None:
            raise MissingExtraError(f"{what} needs {_PACKAGES[extra]}: {install_hint(extra)}")
