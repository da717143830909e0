"""The errors a user can meet.

Every message says what went wrong, where, what was expected, what was found, and what to do next.
The command line turns any of them into one line on stderr and exit code 2.
"""


class SoundSpacesSimError(Exception):
    """Base of all errors that this package raises on purpose."""


class SceneError(SoundSpacesSimError):
    """A scene is unknown, cannot be read, or has no usable geometry."""


class MaterialError(SoundSpacesSimError):
    """A material table, a material file or a label map is not usable."""


class ConfigError(SoundSpacesSimError):
    """A setting is unknown, has the wrong type, or is out of range."""


class PointError(SoundSpacesSimError):
    """A point is malformed, not finite, or outside the scene."""


class SimulationError(SoundSpacesSimError):
    """A simulation made values that cannot be: energies that are not finite, or negative."""


class DatasetError(SoundSpacesSimError):
    """A dataset is missing, incomplete, damaged, or of a schema this version cannot read."""


class PairIndexError(SoundSpacesSimError, IndexError):
    """A source or listener index is out of range."""


class EpisodeError(SoundSpacesSimError):
    """A file of navigation episodes is damaged, or an episode cannot be walked."""
