"""The names of the module `rlr_audio_propagation`."""

import soundspaces_rlr.identity as identity
from soundspaces_rlr.context import Context
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.records import (
    BoxMaterialCategories,
    ChannelLayout,
    ChannelLayoutType,
    Config,
    Ray,
)

__version__ = identity.VERSION
#: Channels of first-order ambisonics (ACN) that hold x, y and z.
AMBISONICS_XYZ_INDEX = [3, 1, 2]

__all__ = [
    "AMBISONICS_XYZ_INDEX",
    "BoxMaterialCategories",
    "ChannelLayout",
    "ChannelLayoutType",
    "Config",
    "Context",
    "Ray",
    "RlrError",
    "__version__",
]
