"""Errors of navigation; the others are in `core.errors`."""

from importlib.util import find_spec

from soundspaces_sim.core.errors import SoundSpacesSimError
from soundspaces_sim.core.extras import install_hint


class EpisodeError(SoundSpacesSimError):
    """A file of navigation episodes is damaged, or an episode cannot be walked."""


class MissingExtraError(SoundSpacesSimError, ImportError):
    """A package of an optional extra is not installed."""


_PACKAGES = {"nav": "gymnasium", "train": "torch", "figures": "matplotlib"}


def need(what: str, *extras: str) -> None:
    """Raise `MissingExtraError`, which says that `what` needs it, if the package of an extra is missing."""
    for extra in extras:
        if find_spec(_PACKAGES[extra]) is None:
            raise MissingExtraError(f"{what} needs {_PACKAGES[extra]}: {install_hint(extra)}")
