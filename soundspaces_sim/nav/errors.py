"""Errors of navigation; the others are in `core.errors`."""

from soundspaces_sim.core.errors import SoundSpacesSimError


class EpisodeError(SoundSpacesSimError):
    """A file of navigation episodes is damaged, or an episode cannot be walked."""
