"""Errors of navigation; the others are in `base.errors`."""

from soundspaces_sim.base.errors import SoundSpacesSimError


class EpisodeError(SoundSpacesSimError):
    """A file of navigation episodes is damaged, or an episode cannot be walked."""


class MissingExtraError(SoundSpacesSimError, ImportError):
    """A package of an optional extra is not installed."""
